//! The parts about error.

use super::super::conduct::Report;
use super::super::plot::{At, Mark, Scale, Series, Style, number};
use super::super::sweep::Run;
use super::super::tables::{self, Table};
use super::{Section, chart, curves};

pub(super) fn error_against_time(report: &Report) -> Section {
    let name = &report.dataset.name;
    let time = (
        "CPU time a frame, ms: median, bar to the 99th percentile",
        Scale::Log,
    );
    let mut largest = curves(report, Style::Marked, |run| {
        [run.resident.median_ms, run.error.max_px]
    });
    for series in &mut largest {
        let own = report
            .runs
            .iter()
            .filter(|run| run.mesher.to_string() == series.name);
        series.reaches = own
            .map(|run| {
                [
                    run.error.max_px,
                    run.resident.median_ms,
                    run.resident.p99_ms,
                ]
            })
            .collect();
    }
    let time_only = ("CPU time a frame, ms, median", Scale::Log);
    let mut typical = curves(report, Style::Marked, |run| {
        [run.resident.median_ms, run.error.rms_px]
    });
    let mut tail = curves(report, Style::Dashed, |run| {
        [run.resident.median_ms, run.error.p999_px]
    });
    tail.iter_mut().for_each(|series| series.name.clear());
    tail.push(Series::new(
        "dashed: 99.9 % of the samples",
        5,
        Style::Dashed,
        Vec::new(),
    ));
    typical.append(&mut tail);
    Section {
        title: "Error against run time",
        shows: format!(
            "What a mesher's frame costs (update and triangulation, all pages there, {}), and how far \
             its mesh is from the full-resolution surface, measured at {}. One point a tolerance, \
             the largest one to the left. Root mean square, 99.9th percentile, maximum and the share beyond \
             the tolerance belong together: they are in the table.",
            report.clock,
            match report.every_sample {
                true => "every sample in view",
                false => "a share of the samples in view, as the table of coverage says",
            }
        ),
        correct: "Curves near the lower left; a mesher that promises a bound has no sample above it, \
                  and its error falls as time is spent.",
        plots: vec![
            (
                "error-time-max",
                chart(
                    format!("{name}: largest error against run time"),
                    largest,
                    time,
                    ("largest error measured, px", Scale::Log),
                    Vec::new(),
                ),
            ),
            (
                "error-time-rms",
                chart(
                    format!("{name}: RMS error against run time"),
                    typical,
                    time_only,
                    ("error measured, RMS, px", Scale::Log),
                    Vec::new(),
                ),
            ),
        ],
        tables: vec![tables::runs(report)],
    }
}

pub(super) fn error_against_triangles(report: &Report) -> Section {
    let name = &report.dataset.name;
    let by_triangles = curves(report, Style::Marked, |run| {
        [run.triangles_mean, run.error.max_px]
    });
    let by_asked = curves(report, Style::Marked, |run| {
        [f64::from(run.error_px), run.error.max_px]
    });
    let mut table = Table::new(&[
        "mesher",
        "asked px",
        "samples compared",
        "of about",
        "frames",
        "finest pages read",
        "of",
        "left out",
        "holes covered",
        "crooked edges",
        "RMS in picture",
        "max in picture",
    ]);
    let maybe = |value: Option<u64>| value.map_or("all".into(), |v| number(v as f64));
    for run in &report.runs {
        let error = &run.error;
        table.rows.push(vec![
            run.mesher.to_string(),
            run.error_px.to_string(),
            number(error.compared as f64),
            number(error.in_view),
            error.frames.to_string(),
            maybe(error.tiles_read),
            maybe(error.tiles_chosen),
            error
                .left_out
                .map_or("not counted".into(), |count| count.to_string()),
            error.covered.to_string(),
            error.crooked_edges.to_string(),
            number(error.rms_projected_px),
            number(error.max_projected_px),
        ]);
    }
    Section {
        title: "Error against triangles, and against what was asked",
        shows: "How many triangles an error costs, and which error a tolerance gives. The table says what \
                was compared. \"Crooked edges\" cross edges of the surface elsewhere than at samples, and are \
                measured there, too; a mesh of nested right triangles has none. The last two columns are how far \
                apart mesh and surface are in the picture, where a pixel at its rim is smaller than in its middle."
            .into(),
        correct: "The fewest triangles at the same measured error; no point above the dotted line for a mesher that \
                  keeps its tolerance; nothing left out, no hole covered.",
        plots: vec![
            (
                "error-triangles",
                chart(format!("{name}: largest error against triangles"), by_triangles,
                    ("triangles a frame, mean", Scale::Log), ("largest error measured, px", Scale::Log), Vec::new()),
            ),
            (
                "error-asked",
                chart(format!("{name}: largest error against the tolerance"), by_asked,
                    ("tolerance asked for, px", Scale::Log), ("largest error measured, px", Scale::Log),
                    vec![Mark { at: At::Diagonal, label: "as asked".into() }]),
            ),
        ],
        tables: vec![table],
    }
}

/// The distribution of a run's deviations, with its true end.
fn cdf(run: &Run) -> Vec<[f64; 2]> {
    let end = run.error.max_over_stated;
    let points = run.error.ratio_cdf.iter().filter(|(ratio, _)| *ratio < end);
    points
        .map(|&(ratio, share)| [ratio, share])
        .chain([[end, 1.0]])
        .collect()
}

pub(super) fn distribution(report: &Report) -> Section {
    let (name, px) = (&report.dataset.name, report.reference_px);
    let mut shares = Vec::new();
    let mut tails = Vec::new();
    for (i, &mesher) in report.plan.meshers.iter().enumerate() {
        let Some(run) = report.run(mesher, px) else {
            continue;
        };
        let points = cdf(run);
        let visible = points.iter().copied().filter(|point| point[0] >= 1e-3);
        shares.push(Series::new(
            &mesher.to_string(),
            i,
            Style::Plain,
            visible.collect(),
        ));
        // What lies beyond each point; the last one beyond which there is something ends the curve.
        let mut beyond: Vec<[f64; 2]> = points
            .iter()
            .map(|[ratio, share]| [*ratio, 1.0 - share])
            .filter(|point| point[0] >= 1e-3 && point[1] > 1e-12)
            .collect();
        if let Some(&[_, last]) = beyond.last() {
            beyond.push([run.error.max_over_stated, last]);
        }
        tails.push(Series::new(&mesher.to_string(), i, Style::Steps, beyond));
    }
    let bound = || {
        vec![Mark {
            at: At::X(1.0),
            label: "the bound".into(),
        }]
    };
    let x = ("error measured over the bound that was stated", Scale::Log);
    Section {
        title: "Measured error over promised bound",
        shows: format!(
            "Each sample's error over the bound that the mesh states, at {px} px: which share has at most that, and \
             on a scale of logarithms which share has more. A mesher that keeps its tolerance states the tolerance; \
             the article's metric states the tolerance as well, and does not keep it; others state the bound of the \
             worst triangle that they leave standing."
        ),
        correct: "Curves that end at 1.0 or before; the nearer to it, the less is spent on what nobody asked for.",
        plots: vec![
            (
                "ratio-cdf",
                chart(
                    format!("{name}: share of samples within a part of the bound"),
                    shares,
                    x,
                    ("share of samples", Scale::Linear),
                    bound(),
                ),
            ),
            (
                "ratio-tail",
                chart(
                    format!("{name}: share of samples beyond a part of the bound"),
                    tails,
                    x,
                    ("share of samples beyond", Scale::Log),
                    bound(),
                ),
            ),
        ],
        tables: Vec::new(),
    }
}
