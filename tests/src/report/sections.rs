//! What a report says, part by part: plots, tables, and what a correct system shows there.

use super::conduct::Report;
use super::plot::{At, Axis, Bar, Bars, Chart, Mark, Scale, Series, Style, number};
use super::sweep::Run;
use super::tables::{self, Table, percent, ratio};
use super::variant::Variant;

/// A plot.
#[derive(Debug, Clone)]
pub enum Plot {
    /// Curves.
    Chart(Chart),
    /// Bars.
    Bars(Bars),
}

/// A part of a report.
#[derive(Debug, Clone)]
pub struct Section {
    /// Its heading.
    pub title: &'static str,
    /// What it shows.
    pub shows: String,
    /// What a correct system shows.
    pub correct: &'static str,
    /// `(name of the files, plot)`.
    pub plots: Vec<(&'static str, Plot)>,
    /// Numbers.
    pub table: Option<Table>,
}

/// All parts.
pub fn sections(report: &Report) -> Vec<Section> {
    vec![
        error_against_time(report),
        error_against_triangles(report),
        distribution(report),
        stages(report),
        frames(report),
        pops(report),
        leave_out(report),
        cold_starts(report),
        sizes(report),
    ]
}

/// A curve for each mesher, through its tolerances.
fn curves(report: &Report, style: Style, point: impl Fn(&Run) -> [f64; 2]) -> Vec<Series> {
    let meshers = report.plan.meshers.iter().enumerate();
    let curve = |(i, &mesher): (usize, &Variant)| {
        let runs = report.runs.iter().filter(|run| run.mesher == mesher);
        Series::new(&mesher.to_string(), i, style, runs.map(&point).collect())
    };
    meshers
        .map(curve)
        .filter(|series| !series.points.is_empty())
        .collect()
}

fn axes(series: &[Series], x: (&str, Scale), y: (&str, Scale)) -> (Axis, Axis) {
    let points = || series.iter().flat_map(|series| &series.points);
    let reaches = series.iter().flat_map(|series| &series.reaches);
    let xs = points().map(|p| p[0]).chain(reaches.map(|reach| reach[2]));
    (
        Axis::around(x.0, x.1, xs),
        Axis::around(y.0, y.1, points().map(|p| p[1])),
    )
}

fn chart(
    title: String,
    series: Vec<Series>,
    x: (&str, Scale),
    y: (&str, Scale),
    marks: Vec<Mark>,
) -> Plot {
    let (x, y) = axes(&series, x, y);
    Plot::Chart(Chart {
        title,
        x,
        y,
        series,
        marks,
    })
}

fn error_against_time(report: &Report) -> Section {
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
        table: Some(tables::runs(report)),
    }
}

fn error_against_triangles(report: &Report) -> Section {
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
        table: Some(table),
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

fn distribution(report: &Report) -> Section {
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
        table: None,
    }
}

fn stages(report: &Report) -> Section {
    let (name, px) = (&report.dataset.name, report.reference_px);
    let parts = |stages: &super::supply::Stages| {
        vec![
            stages.decode_ms,
            stages.link_ms,
            stages.update_ms,
            stages.triangulate_ms,
        ]
    };
    let (mut steady, mut starts) = (Vec::new(), Vec::new());
    let mut table = Table::new(&[
        "mesher",
        "situation",
        "decode ms",
        "link ms",
        "update ms",
        "triangulate ms",
        "all ms",
    ]);
    for &mesher in &report.plan.meshers {
        let Some(run) = report.run(mesher, px) else {
            continue;
        };
        for (situation, stages) in [
            ("all there", run.resident_stages),
            ("pages coming", run.coming_stages),
        ] {
            push(
                &mut table,
                &mut steady,
                mesher,
                situation,
                Some(stages),
                &parts,
            );
        }
        for (situation, stages) in [("cold", Some(run.cold)), ("teleport", run.teleport)] {
            push(&mut table, &mut starts, mesher, situation, stages, &parts);
        }
    }
    let names = ["decode", "link", "update", "triangulate"]
        .map(str::to_owned)
        .to_vec();
    let bars = |title: String, label: &str, bars: Vec<Bar>| {
        Plot::Bars(Bars {
            title,
            label: label.into(),
            parts: names.clone(),
            bars,
            log: false,
        })
    };
    Section {
        title: "Where the time goes",
        shows: format!(
            "CPU time by stage at {px} px. All there: a frame of the flight with every page it needs. Pages coming: the \
             same frames when they are flown for the first time, and each page is there at once. Cold: the first picture, \
             from nothing. Teleport: the mean of the first frames after a leap along the flight. Upload and drawing are \
             not in it: no renderer runs here."
        ),
        correct: "A steady frame that costs a small part of a cold one, and in which decoding and linking are small.",
        plots: vec![
            (
                "stages-steady",
                bars(
                    format!("{name}: stages of a frame of the flight, mean"),
                    "CPU time, ms a frame",
                    steady,
                ),
            ),
            (
                "stages-start",
                bars(
                    format!("{name}: stages of a cold start and of a teleport"),
                    "CPU time, ms",
                    starts,
                ),
            ),
        ],
        table: Some(table),
    }
}

fn push(
    table: &mut Table,
    bars: &mut Vec<Bar>,
    mesher: Variant,
    situation: &str,
    stages: Option<super::supply::Stages>,
    parts: &dyn Fn(&super::supply::Stages) -> Vec<f64>,
) {
    let Some(stages) = stages else {
        return;
    };
    let mut row = vec![mesher.to_string(), situation.into()];
    row.extend(parts(&stages).into_iter().map(number));
    row.push(number(stages.total_ms()));
    table.rows.push(row);
    bars.push(Bar {
        name: format!("{mesher}, {situation}"),
        parts: parts(&stages),
    });
}

fn frames(report: &Report) -> Section {
    let (name, px) = (&report.dataset.name, report.reference_px);
    let over_frames = |of: fn(&super::sweep::FrameRow) -> f64| -> Vec<Series> {
        let meshers = report.plan.meshers.iter().enumerate();
        meshers
            .filter_map(|(i, &mesher)| {
                let run = report.run(mesher, px)?;
                let rows = run.frames.iter().enumerate().filter(|(_, row)| !row.leap);
                let points = rows.map(|(frame, row)| [frame as f64, of(row)]);
                Some(Series::new(
                    &mesher.to_string(),
                    i,
                    Style::Plain,
                    points.collect(),
                ))
            })
            .collect()
    };
    let x = ("frame of the flight, leaps left out", Scale::Linear);
    let mut table = Table::new(&[
        "mesher",
        "asked px",
        "changes a frame",
        "share of the mesh",
        "triangles, mean",
        "triangles, most",
    ]);
    for run in &report.runs {
        table.rows.push(vec![
            run.mesher.to_string(),
            run.error_px.to_string(),
            number(run.changes_mean),
            percent(run.changes_mean / run.triangles_mean.max(1.0)),
            number(run.triangles_mean),
            number(run.triangles_max as f64),
        ]);
    }
    Section {
        title: "Changes and triangles, frame by frame",
        shows: format!(
            "Vertices that are enabled or disabled, and pages that are linked, in each frame of the flight at {px} px; and \
             the triangles of its mesh. A vertex that is enabled splits two triangles, one that is disabled merges them."
        ),
        correct: "Changes that are a small part of the mesh, as the picture changes little from frame to frame: ROAM's \
                  paper has under 3 %.",
        plots: vec![
            (
                "changes",
                chart(
                    format!("{name}: splits and merges a frame"),
                    over_frames(|row| row.changes as f64),
                    x,
                    ("changes a frame", Scale::Linear),
                    Vec::new(),
                ),
            ),
            (
                "triangles",
                chart(
                    format!("{name}: triangles a frame"),
                    over_frames(|row| row.triangles as f64),
                    x,
                    ("triangles", Scale::Linear),
                    Vec::new(),
                ),
            ),
        ],
        table: Some(table),
    }
}

fn pops(report: &Report) -> Section {
    let (name, px) = (&report.dataset.name, report.reference_px);
    let series = report.pops.iter().enumerate().map(|(i, pops)| {
        let morph = if pops.morph { ", morph" } else { "" };
        let rows = pops
            .histogram
            .iter()
            .skip(1)
            .filter(|row| row.0 >= 1e-4 && row.1 > 0.0);
        let points = rows.map(|&(from, share)| [from, share]).collect();
        Series::new(&format!("{}{morph}", pops.mesher), i, Style::Steps, points)
    });
    let mut table = Table::new(&[
        "mesher",
        "morph",
        "largest jump px",
        "p99.9 of jumps px",
        "places that move",
        "jumps over 0.5 px",
        "eye, m a frame",
    ]);
    for pops in &report.pops {
        table.rows.push(vec![
            pops.mesher.to_string(),
            if pops.morph { "on" } else { "off" }.into(),
            number(pops.max_px),
            number(pops.p999_px),
            percent(pops.share_moving),
            percent(pops.share_above_half_px),
            number(pops.eye_step_m),
        ]);
    }
    Section {
        title: "Pops",
        shows: format!(
            "How far the displayed surface jumps between two frames of a slow flight, at fixed places of the ground, at \
             {px} px. The flight is flown at a tenth of its pace, 60 frames a second. Places whose surface does not move are \
             not in the plot; the table has their share."
        ),
        correct: "Without geomorph jumps up to the tolerance, and no farther; with it, a small part of a pixel.",
        plots: vec![(
            "pops",
            chart(
                format!("{name}: jumps of the displayed surface"),
                series.collect(),
                ("jump in a frame, px, from", Scale::Log),
                ("share of the places in view", Scale::Log),
                vec![Mark {
                    at: At::X(f64::from(px)),
                    label: "the tolerance".into(),
                }],
            ),
        )],
        table: Some(table),
    }
}

fn leave_out(report: &Report) -> Section {
    let (name, px) = (&report.dataset.name, report.reference_px);
    let mut table = Table::new(&[
        "mesher",
        "bytes received",
        "of the dataset",
        "received / used",
        "pages received",
        "of",
        "pages drawn",
        "in view",
        "triangles",
        "of the full surface",
        "triangles in view",
    ]);
    for out in &report.leave_out {
        table.rows.push(vec![
            out.mesher.to_string(),
            number(out.received_bytes as f64),
            percent(out.received_bytes as f64 / out.dataset_bytes.max(1) as f64),
            ratio(out.received_over_used),
            number(out.received_pages as f64),
            number(out.dataset_pages as f64),
            number(out.drawn_pages as f64),
            number(out.seen_pages as f64),
            number(out.triangles as f64),
            percent(out.triangles as f64 / out.full_triangles.max(1) as f64),
            number(out.seen_triangles as f64),
        ]);
    }
    let bars = |first: &super::leave_out::LeaveOut| {
        let bar = |name: &str, value: u64| Bar {
            name: name.into(),
            parts: vec![value as f64],
        };
        let chart = |title: &str, label: &str, bars: Vec<Bar>| {
            Plot::Bars(Bars {
                title: format!("{name}, {}: {title}", first.mesher),
                label: label.into(),
                parts: vec![String::new()],
                bars,
                log: true,
            })
        };
        vec![
            (
                "leave-out-bytes",
                chart(
                    "bytes of one view",
                    "bytes",
                    vec![
                        bar("the whole dataset", first.dataset_bytes),
                        bar("received", first.received_bytes),
                        bar("used by the mesh", first.used_bytes),
                    ],
                ),
            ),
            (
                "leave-out-triangles",
                chart(
                    "triangles of one view",
                    "triangles",
                    vec![
                        bar("full resolution", first.full_triangles),
                        bar("of the mesh", first.triangles),
                        bar("in pages in view", first.sent_triangles),
                        bar("in view", first.seen_triangles),
                    ],
                ),
            ),
        ]
    };
    Section {
        title: "What is left out",
        shows: format!(
            "One view, the last of the flight, at {px} px, with nothing there before. Bytes are those of the parts of records \
             that were asked for; used are those without which the mesh could not be what it is. The full surface has two \
             triangles a cell; what the tolerance does not need, and what cannot be seen, is left out of it."
        ),
        correct: "Bytes received over bytes used near 1, and both a small part of the dataset; few triangles that are not in view.",
        plots: report.leave_out.first().map(bars).unwrap_or_default(),
        table: Some(table),
    }
}

fn cold_starts(report: &Report) -> Section {
    let (name, px) = (&report.dataset.name, report.reference_px);
    let (mut errors, mut bytes) = (Vec::new(), Vec::new());
    let mut table = Table::new(&[
        "line",
        "first bound s",
        "8 px s",
        "tolerance s",
        "bytes",
        "max / stated",
    ]);
    let seconds = |time: Option<f64>| time.map_or("never".into(), |s| format!("{s:.2}"));
    for (i, start) in report.cold_starts.iter().enumerate() {
        let line = start.line.to_string();
        let at = |of: fn(&super::lines::Moment) -> Option<f64>| {
            let moments = start.moments.iter();
            moments
                .filter_map(|m| Some([m.time_s, of(m)?]))
                .collect::<Vec<_>>()
        };
        errors.push(Series::new(
            &format!("{line}, bound"),
            i,
            Style::Steps,
            at(|m| m.bound_px),
        ));
        errors.push(Series::new("", i, Style::Marked, at(|m| m.measured_px)));
        bytes.push(Series::new(
            &line,
            i,
            Style::Plain,
            at(|m| Some(m.bytes as f64)),
        ));
        table.rows.push(vec![
            line,
            seconds(start.first_bound_s),
            seconds(start.within_8_px_s),
            seconds(start.converged_s),
            number(start.bytes as f64),
            ratio(start.max_over_stated),
        ]);
    }
    let x = ("seconds since connecting", Scale::Log);
    Section {
        title: "Error against seconds since connecting",
        shows: "A client without anything connects, and looks at the last view of the flight. Steps are the bound that it \
                states, marks the largest error measured. Server and client are the real ones, in virtual time; the line \
                has a bandwidth and a delay of one way, and two round trips pass before the first message. TCP's slow \
                start and losses are not modelled."
            .into(),
        correct: "Marks on or below their steps at any moment, and the tolerance after about one and a half round trips \
                  and the time that the bytes take.",
        plots: vec![
            ("cold-error", chart(format!("{name}: error against seconds since connecting"), errors, x,
                ("error, px", Scale::Log),
                vec![Mark { at: At::Y(f64::from(px)), label: "the tolerance".into() }])),
            ("cold-bytes", chart(format!("{name}: bytes against seconds since connecting"), bytes, x,
                ("bytes received", Scale::Log), Vec::new())),
        ],
        table: Some(table),
    }
}

fn sizes(report: &Report) -> Section {
    let mut table = Table::new(&[
        "mesher",
        "asked px",
        "pages",
        "tree MB",
        "bytes a page",
        "bytes a triangle",
        "bytes received",
        "bytes received a page",
    ]);
    for run in &report.runs {
        let (pages, bytes) = (run.pages.max(1) as f64, run.memory_bytes as f64);
        let last = run.frames.last().map_or(1, |frame| frame.triangles.max(1));
        table.rows.push(vec![
            run.mesher.to_string(),
            run.error_px.to_string(),
            run.pages.to_string(),
            number(bytes / 1e6),
            number(bytes / pages),
            number(bytes / last as f64),
            number(run.bytes as f64),
            number(run.bytes as f64 / pages),
        ]);
    }
    let facts = &report.dataset;
    Section {
        title: "Sizes",
        shows: format!(
            "Memory of the client's mesh tree at the end of the flight, pages that are no longer in view included, as it is \
             counted for the memory cap: heights, bounds, state, triangles. A page has 85 squares. The dataset takes {} bytes, \
             {} bits a sample with data.",
            number(facts.bytes as f64),
            number(8.0 * facts.bytes as f64 / facts.valid_samples.max(1) as f64),
        ),
        correct: "Memory that follows the mesh and not the dataset.",
        plots: Vec::new(),
        table: Some(table),
    }
}
