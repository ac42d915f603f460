//! The parts about bytes, pages and memory.

use super::super::conduct::Report;
use super::super::lines::Moment;
use super::super::plot::{At, Mark, Scale, Series, Style, number};
use super::super::tables::{Table, ratio};
use super::{Section, chart};

pub(super) fn cold_starts(report: &Report) -> Section {
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
        let at = |of: fn(&Moment) -> Option<f64>| {
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
        errors.push(Series::new("", i, Style::Marks, at(|m| m.measured_px)));
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
        correct: "Marks on or below their steps at any moment. The aim is the tolerance after one and a half round trips \
                  and the time that the bytes take; a client that asks for pages as its mesh reaches them needs a round \
                  trip for each level of pages, and more.",
        plots: vec![
            ("cold-error", chart(format!("{name}: error against seconds since connecting"), errors, x,
                ("error, px", Scale::Log),
                vec![Mark { at: At::Y(f64::from(px)), label: "the tolerance".into() }])),
            ("cold-bytes", chart(format!("{name}: bytes against seconds since connecting"), bytes, x,
                ("bytes received", Scale::Log), Vec::new())),
        ],
        tables: vec![table],
    }
}

pub(super) fn sizes(report: &Report) -> Section {
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
        tables: vec![table],
    }
}
