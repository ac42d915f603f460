//! The part about what is left out.

use super::super::conduct::Report;
use super::super::leave_out::LeaveOut;
use super::super::plot::{Bar, Bars, number};
use super::super::tables::{Table, percent, ratio};
use super::{Plot, Section};

pub(super) fn leave_out(report: &Report) -> Section {
    let px = report.reference_px;
    let plots = report.leave_out.first().map(|first| bars(report, first));
    Section {
        title: "What is left out",
        shows: format!(
            "One view, the last of the flight, at {px} px, with nothing there before. Bytes are those of the parts of \
             records that were asked for; used are those without which the mesh could not be what it is. The full \
             surface has two triangles a cell. The second table has what each step saves, of what was left by the one \
             before it. Pipelines and textures are not in it: no renderer runs here."
        ),
        correct: "Bytes received over bytes used near 1, and both a small part of the dataset; few triangles that are \
                  not in view.",
        plots: plots.unwrap_or_default(),
        tables: vec![received(report), savings(report)],
    }
}

fn received(report: &Report) -> Table {
    let mut table = Table::new(&[
        "mesher",
        "bytes received",
        "bytes used",
        "received / used",
        "pages received",
        "pages drawn",
        "in view",
        "triangles",
        "sent to be drawn",
        "in view",
        "bytes for the GPU",
    ]);
    for out in &report.leave_out {
        let counts = [
            out.received_pages,
            out.drawn_pages,
            out.seen_pages,
            out.triangles,
            out.sent_triangles,
            out.seen_triangles,
            out.gpu_bytes,
        ];
        let mut row = vec![
            out.mesher.to_string(),
            number(out.received_bytes as f64),
            number(out.used_bytes as f64),
            ratio(out.received_over_used),
        ];
        row.extend(counts.map(|count| number(count as f64)));
        table.rows.push(row);
    }
    table
}

/// What each step leaves out, and of how much.
fn savings(report: &Report) -> Table {
    let mut table = Table::new(&["mesher", "what is left out", "of", "left", "saved"]);
    for out in &report.leave_out {
        for (what, of, left) in [
            (
                "bytes that the view does not need",
                out.dataset_bytes,
                out.received_bytes,
            ),
            (
                "pages that the view does not need",
                out.dataset_pages,
                out.received_pages,
            ),
            (
                "triangles out of view",
                out.full_triangles,
                out.full_seen_triangles,
            ),
            (
                "triangles below the tolerance",
                out.full_seen_triangles,
                out.seen_triangles,
            ),
            (
                "mesh in pages out of view",
                out.triangles,
                out.sent_triangles,
            ),
        ] {
            table.rows.push(vec![
                out.mesher.to_string(),
                what.into(),
                number(of as f64),
                number(left as f64),
                // A mesh may have more triangles in view than the surface has samples there.
                percent((1.0 - left as f64 / of.max(1) as f64).max(0.0)),
            ]);
        }
    }
    table
}

fn bars(report: &Report, out: &LeaveOut) -> Vec<(&'static str, Plot)> {
    let chart = |title: &str, label: &str, bars: &[(&str, u64)]| {
        let bar = |(name, value): &(&str, u64)| Bar {
            name: (*name).into(),
            parts: vec![*value as f64],
        };
        Plot::Bars(Bars {
            title: format!("{}, {}: {title}", report.dataset.name, out.mesher),
            label: label.into(),
            parts: vec![String::new()],
            bars: bars.iter().map(bar).collect(),
        })
    };
    let bytes = [
        ("the whole dataset", out.dataset_bytes),
        ("received", out.received_bytes),
        ("used by the mesh", out.used_bytes),
    ];
    let triangles = [
        ("full resolution", out.full_triangles),
        ("full resolution, in view", out.full_seen_triangles),
        ("of the mesh", out.triangles),
        ("of the mesh, to be drawn", out.sent_triangles),
        ("of the mesh, in view", out.seen_triangles),
    ];
    vec![
        (
            "leave-out-bytes",
            chart("bytes of one view", "bytes", &bytes),
        ),
        (
            "leave-out-triangles",
            chart("triangles of one view", "triangles", &triangles),
        ),
    ]
}
