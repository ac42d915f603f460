//! What was measured over lines: tables, a plot, and every number.

use super::client::Kind;
use super::convergence::LEGS;
use super::figures::Outcome;
use super::shaper::Cell;
use crate::report::facts::{DatasetFacts, Machine};
use crate::report::plot::font::Font;
use crate::report::plot::multiples::{Multiples, Panel};
use crate::report::plot::png::png;
use crate::report::plot::svg::{Colours, svg};
use crate::report::plot::{Axis, Scale, Series, Style};
use crate::report::tables::Table;
use anyhow::{Context, Result};
use serde::Serialize;
use std::path::Path;

/// The largest bound that is drawn, pixels.
const MOST_PX: f64 = 5e3;
/// The shortest time that is drawn, seconds.
const LEAST_S: f64 = 0.01;

/// All that was measured of a dataset.
#[derive(Debug, Clone, Serialize)]
pub struct Measured {
    /// How the program was called.
    pub command: String,
    /// Where and when.
    pub machine: Machine,
    /// On what.
    pub dataset: DatasetFacts,
    /// The tolerance, pixels.
    pub error_px: f32,
    /// What was found.
    pub outcomes: Vec<Outcome>,
}

const COLUMNS: [&str; 15] = [
    "leg",
    "RTT ms",
    "Mbit/s",
    "loss %",
    "client",
    "runs",
    "open s",
    "8 px s",
    "2 px s",
    "kB",
    "decode s",
    "target s",
    "over target",
    "from open",
    "received/used",
];

/// A row for each line, client and leg.
pub fn table(outcomes: &[Outcome]) -> Table {
    let mut table = Table::new(&COLUMNS);
    for (leg, name) in LEGS.iter().enumerate() {
        table.rows.extend(
            outcomes
                .iter()
                .filter_map(|outcome| row(outcome, leg, name)),
        );
    }
    table
}

fn row(outcome: &Outcome, leg: usize, name: &str) -> Option<Vec<String>> {
    let figures = outcome.figures(leg)?;
    let cell = outcome.cell;
    let or_dash = |value: Option<f64>| value.map_or("-".into(), |v| format!("{v:.2}"));
    Some(vec![
        name.into(),
        cell.round_trip_ms.to_string(),
        cell.mbit_s.to_string(),
        cell.loss_percent.to_string(),
        outcome.kind.to_string(),
        outcome.runs.len().to_string(),
        format!("{:.2}", figures.opened_s),
        or_dash(figures.within_8_px_s),
        or_dash(figures.converged_s),
        format!("{:.0}", figures.bytes as f64 / 1e3),
        format!("{:.2}", figures.decode_s),
        format!("{:.2}", figures.target_s),
        or_dash(figures.ratio),
        or_dash(figures.ratio_open),
        or_dash(figures.over_used),
    ])
}

/// Small charts of error against time: a column for each loss and round trip, a row for each
/// bandwidth.
pub fn plot(outcomes: &[Outcome], leg: usize, title: &str, error_px: f32) -> Multiples {
    let mut columns: Vec<[f64; 2]> = Vec::new();
    let mut rates: Vec<f64> = Vec::new();
    for Cell {
        round_trip_ms,
        mbit_s,
        loss_percent,
    } in outcomes.iter().map(|outcome| outcome.cell)
    {
        if !columns.contains(&[loss_percent, round_trip_ms]) {
            columns.push([loss_percent, round_trip_ms]);
        }
        if !rates.contains(&mbit_s) {
            rates.push(mbit_s);
        }
    }
    let legs = outcomes
        .iter()
        .filter_map(|outcome| outcome.middle_run(leg));
    let last_s = legs
        .flat_map(|leg| leg.moments.last())
        .map(|moment| moment.time_s)
        .fold(1.0, f64::max);
    let panel = |mbit_s: f64, [loss, rtt]: [f64; 2]| panel(outcomes, leg, [rtt, mbit_s, loss]);
    let rows = rates.iter().map(|&rate| {
        let panels = columns.iter().map(|&column| panel(rate, column)).collect();
        (format!("{rate} Mbit/s"), panels)
    });
    Multiples {
        title: title.into(),
        x: Axis {
            label: "seconds; the dotted line of a colour is 1.5 RTT + bytes / bandwidth + decode"
                .into(),
            scale: Scale::Log,
            range: [LEAST_S, last_s],
        },
        y: Axis {
            label: "bound shown, px".into(),
            scale: Scale::Log,
            range: [1.0, MOST_PX],
        },
        level: Some(error_px.into()),
        rows: rows.collect(),
        columns: columns
            .iter()
            .map(|[loss, rtt]| format!("RTT {rtt} ms, loss {loss} %"))
            .collect(),
        legend: Kind::ALL
            .iter()
            .filter(|kind| outcomes.iter().any(|outcome| outcome.kind == **kind))
            .map(|kind| (kind.in_words().into(), kind.number(), Style::Plain))
            .collect(),
    }
}

fn panel(outcomes: &[Outcome], leg: usize, [rtt, rate, loss]: [f64; 3]) -> Panel {
    let mut panel = Panel::default();
    let here = |outcome: &&Outcome| {
        let cell = outcome.cell;
        (cell.round_trip_ms, cell.mbit_s, cell.loss_percent) == (rtt, rate, loss)
    };
    for outcome in outcomes.iter().filter(here) {
        let Some(run) = outcome.middle_run(leg) else {
            continue;
        };
        let moments = run.moments.iter();
        let points = moments.filter_map(|m| {
            let px = m.bound_px?.clamp(1.0, MOST_PX);
            Some([m.time_s.max(LEAST_S), px])
        });
        let number = outcome.kind.number();
        let points = points.collect();
        panel
            .series
            .push(Series::new("", number, Style::Steps, points));
        if let Some(figures) = outcome.figures(leg) {
            panel.marks.push((figures.target_s.max(LEAST_S), number));
        }
    }
    panel
}

/// Writes `network.json`, `network.csv`, and a plot of each leg as SVG and PNG.
///
/// # Errors
/// If a file cannot be written.
pub fn write(folder: &Path, measured: &Measured) -> Result<()> {
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        std::fs::write(&path, bytes).with_context(|| format!("cannot write {}", path.display()))
    };
    write("network.json", &serde_json::to_vec(measured)?)?;
    write("network.csv", table(&measured.outcomes).csv().as_bytes())?;
    let font = Font::load().context("the program's font is damaged")?;
    for (leg, name) in LEGS.iter().enumerate() {
        let title = format!("{}: error against time {name}", measured.dataset.name);
        let drawing = plot(&measured.outcomes, leg, &title, measured.error_px).draw(&font);
        let file = ["connect", "teleport"][leg];
        write(
            &format!("{file}.svg"),
            svg(&drawing, Colours::Light).as_bytes(),
        )?;
        write(&format!("{file}.png"), &png(&drawing)?)?;
    }
    Ok(())
}
