//! Measures all that a report has.

use super::clock;
use super::facts::{DatasetFacts, Machine};
use super::flight::Windows;
use super::leave_out::{self, LeaveOut};
use super::lines::{self, ColdStart};
use super::measure::surface::{FullSurface, MOST_WHOLE_SAMPLES};
use super::plan::Plan;
use super::pop::{self, Pops};
use super::sweep::{self, Run};
use super::variant::Variant;
use anyhow::Result;
use escarp_client::flight::Path as Flight;
use escarp_tiles::dataset::Dataset;
use serde::Serialize;
use std::sync::Arc;
use std::time::Duration;

/// All that was measured on a dataset.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// The dataset.
    pub dataset: DatasetFacts,
    /// Where and when.
    pub machine: Machine,
    /// What the times are.
    pub clock: &'static str,
    /// How it was called.
    pub command: String,
    /// What was to be measured.
    pub plan: Plan,
    /// The tolerance of figures for which no other is stated, pixels.
    pub reference_px: f32,
    /// The flight.
    pub flight: Flight,
    /// Whether every sample in view was compared.
    pub every_sample: bool,
    /// One for each mesher and tolerance.
    pub runs: Vec<Run>,
    /// Jumps of what is displayed.
    pub pops: Vec<Pops>,
    /// What is left out.
    pub leave_out: Vec<LeaveOut>,
    /// Cold starts.
    pub cold_starts: Vec<ColdStart>,
    /// What could not be measured, and why.
    pub skipped: Vec<Skipped>,
}

/// Something that could not be measured.
#[derive(Debug, Clone, Serialize)]
pub struct Skipped {
    /// What.
    pub what: String,
    /// Why.
    pub why: String,
}

/// Steps that a plan takes for a dataset.
pub fn steps(plan: &Plan) -> u64 {
    let meshers = plan.meshers.len();
    (meshers * plan.errors_px.len() + 2 * meshers + plan.lines.len()) as u64
}

/// Measures a dataset. `progress` is told each step before it is taken.
///
/// # Errors
/// If the dataset is damaged. What a mesher cannot do is noted in the report.
pub fn conduct(
    dataset: &Arc<Dataset>,
    flight: &Flight,
    plan: &Plan,
    command: String,
    progress: &dyn Fn(&str),
) -> Result<Report> {
    progress("reading samples");
    let surface = FullSurface::open(dataset, MOST_WHOLE_SAMPLES)?;
    let windows = Windows::over(flight.clone(), plan.windows, plan.window_frames);
    let mut report = Report {
        dataset: DatasetFacts::of(dataset),
        machine: Machine::here(),
        clock: clock::KIND,
        command,
        plan: plan.clone(),
        reference_px: plan.reference_px(),
        flight: flight.clone(),
        every_sample: surface.whole.is_some(),
        runs: Vec::new(),
        pops: Vec::new(),
        leave_out: Vec::new(),
        cold_starts: Vec::new(),
        skipped: Vec::new(),
    };
    for &variant in &plan.meshers {
        for &px in &plan.errors_px {
            let what = format!("{variant} at {px} px");
            progress(&what);
            let run = sweep::run(&surface, &windows, variant, px, plan.repeats);
            keep(&mut report.runs, &mut report.skipped, what, run);
        }
        report.singles(&surface, &windows, variant, progress);
    }
    let last_s = windows.frames().last().map_or(0.0, |frame| frame.time_s);
    let view = windows.view(last_s, report.reference_px);
    for &line in &plan.lines {
        let what = format!("cold start over {line}");
        progress(&what);
        let limit = Duration::from_secs(plan.cold_limit_s);
        let source = dataset.clone();
        let start = lines::cold_start(&surface, source, line, &view, limit, plan.cold_measurements);
        keep(&mut report.cold_starts, &mut report.skipped, what, start);
    }
    Ok(report)
}

impl Report {
    /// What is measured at the reference tolerance alone.
    fn singles(
        &mut self,
        surface: &FullSurface<'_>,
        windows: &Windows,
        variant: Variant,
        progress: &dyn Fn(&str),
    ) {
        let px = self.reference_px;
        let what = format!("{variant}, slow flight");
        progress(&what);
        let dataset = surface.dataset;
        let pops = pop::measure(dataset, &windows.flight, variant, px, self.plan.slow_steps);
        keep(&mut self.pops, &mut self.skipped, what, pops);
        let what = format!("{variant}, what is left out");
        progress(&what);
        let last_s = windows.frames().last().map_or(0.0, |frame| frame.time_s);
        let out = leave_out::measure(surface, variant, &windows.view(last_s, px));
        keep(&mut self.leave_out, &mut self.skipped, what, out);
    }

    /// The run of a mesher at a tolerance.
    pub fn run(&self, mesher: Variant, error_px: f32) -> Option<&Run> {
        let mut runs = self.runs.iter();
        runs.find(|run| run.mesher == mesher && run.error_px == error_px)
    }
}

fn keep<T>(kept: &mut Vec<T>, skipped: &mut Vec<Skipped>, what: String, result: Result<T>) {
    match result {
        Ok(one) => kept.push(one),
        Err(error) => skipped.push(Skipped {
            what,
            why: format!("{error:#}"),
        }),
    }
}
