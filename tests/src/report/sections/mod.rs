//! What a report says, part by part: plots, tables, and what a correct system shows there.

mod data;
mod error;
mod savings;
mod time;

use super::conduct::Report;
use super::plot::{Axis, Bars, Chart, Mark, Scale, Series, Style};
use super::sweep::Run;
use super::tables::Table;
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
    pub tables: Vec<Table>,
}

/// All parts.
pub fn sections(report: &Report) -> Vec<Section> {
    vec![
        error::error_against_time(report),
        error::error_against_triangles(report),
        error::distribution(report),
        time::stages(report),
        time::frames(report),
        time::pops(report),
        savings::leave_out(report),
        data::cold_starts(report),
        data::sizes(report),
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
