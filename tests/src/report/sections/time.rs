//! The parts about time, and about what changes from frame to frame.

use super::super::conduct::Report;
use super::super::plot::{At, Bar, Bars, Mark, Scale, Series, Style, number};
use super::super::supply::Stages;
use super::super::sweep::{FrameRow, Run};
use super::super::tables::{Table, percent};
use super::super::variant::Variant;
use super::{Plot, Section, chart};

pub(super) fn stages(report: &Report) -> Section {
    let (name, px) = (&report.dataset.name, report.reference_px);
    let parts = |stages: &Stages| {
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
        tables: vec![table],
    }
}

fn push(
    table: &mut Table,
    bars: &mut Vec<Bar>,
    mesher: Variant,
    situation: &str,
    stages: Option<Stages>,
    parts: &dyn Fn(&Stages) -> Vec<f64>,
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

pub(super) fn frames(report: &Report) -> Section {
    let (name, px) = (&report.dataset.name, report.reference_px);
    let over_frames = |of: fn(&FrameRow) -> f64| -> Vec<Series> {
        let meshers = report.plan.meshers.iter().enumerate();
        let runs = meshers.filter_map(|(i, &mesher)| Some((i, report.run(mesher, px)?)));
        runs.flat_map(|(i, run)| windows(run, i, of)).collect()
    };
    let x = ("frame of the flight, leaps left out", Scale::Linear);
    let mut table = Table::new(&[
        "mesher",
        "asked px",
        "splits a frame",
        "merges a frame",
        "share of the mesh",
        "triangles, mean",
        "triangles, most",
    ]);
    for run in &report.runs {
        table.rows.push(vec![
            run.mesher.to_string(),
            run.error_px.to_string(),
            number(run.splits_mean),
            number(run.merges_mean),
            // Each is a vertex between two triangles.
            percent(2.0 * (run.splits_mean + run.merges_mean) / run.triangles_mean.max(1.0)),
            number(run.triangles_mean),
            number(run.triangles_max as f64),
        ]);
    }
    Section {
        title: "Changes and triangles, frame by frame",
        shows: format!(
            "Vertices that are enabled or disabled in each frame of the flight at {px} px; and \
             the triangles of its mesh. A vertex that is enabled splits two triangles, one that is disabled merges them."
        ),
        correct: "Changes that are a small part of the mesh, as the picture changes little from frame to frame: ROAM's \
                  paper has under 3 %.",
        plots: vec![
            (
                "changes",
                chart(
                    format!("{name}: splits and merges a frame"),
                    over_frames(|row| (row.splits + row.merges) as f64),
                    x,
                    ("splits and merges a frame", Scale::Linear),
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
        tables: vec![table],
    }
}

/// A run's frames, a curve a window; the legend has one of them.
fn windows(run: &Run, number: usize, of: fn(&FrameRow) -> f64) -> Vec<Series> {
    let mut series: Vec<Series> = Vec::new();
    for (frame, row) in run.frames.iter().enumerate() {
        match series.last_mut() {
            Some(last) if !row.leap => last.points.push([frame as f64, of(row)]),
            // What happens in a leap is not a frame like the others.
            _ => {
                let name = match series.is_empty() {
                    true => run.mesher.to_string(),
                    false => String::new(),
                };
                series.push(Series::new(&name, number, Style::Plain, Vec::new()));
            }
        }
    }
    series
}

pub(super) fn pops(report: &Report) -> Section {
    let (name, px) = (&report.dataset.name, report.reference_px);
    let series = report.pops.iter().enumerate().map(|(i, pops)| {
        let rows = pops
            .histogram
            .iter()
            .skip(1)
            .filter(|row| row.0 >= 1e-4 && row.1 > 0.0);
        let points = rows.map(|&(from, share)| [from, share]).collect();
        Series::new(&pops.mesher.to_string(), i, Style::Steps, points)
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
        tables: vec![table],
    }
}
