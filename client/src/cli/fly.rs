//! `escarp-client fly`.

use super::arguments::{FrameBudget, MeshArgs, ServerArgs};
use crate::app::headless::{Driver, FlyOptions, FrameReport, fly};
use crate::flight::{Path as Flight, default_path};
use crate::stages::StageTimes;
use anyhow::{Context, Result};
use clap::Args;
use std::io::{BufWriter, Write};
use std::path::PathBuf;
use std::time::Duration;

#[derive(Debug, Args)]
pub(super) struct FlyArgs {
    #[command(flatten)]
    server: ServerArgs,
    #[command(flatten)]
    mesh: MeshArgs,
    /// Most milliseconds of a frame's work; pages that arrive faster wait. Or none
    #[arg(long, default_value = "none", value_name = "MS")]
    frame_budget_ms: FrameBudget,
    /// Path to fly, JSON; default: from the overview down to a low flight
    #[arg(long, value_name = "FILE.json")]
    path: Option<PathBuf>,
    /// Folder for pictures; none are made without it
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// A picture every N frames, and of the last one
    #[arg(long, default_value_t = 30, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    every: u64,
    /// Wait at each frame until it is within the tolerance, instead of keeping to the clock
    #[arg(long)]
    settle: bool,
    /// Draw the triangles' edges
    #[arg(long)]
    wireframe: bool,
    /// Longest wait for the server, and with --settle at each frame, seconds
    #[arg(long, default_value_t = 30, value_name = "S", value_parser = clap::value_parser!(u64).range(..=86_400))]
    wait: u64,
}

pub(super) fn run(args: &FlyArgs) -> Result<()> {
    let flight = args.path.as_ref().map(read_path).transpose()?;
    let mut driver = Driver::new(
        args.server
            .clone()
            .uncached()
            .open(&args.mesh, args.frame_budget_ms)?,
    );
    let wait = Duration::from_secs(args.wait);
    let start = flight.as_ref().map(|flight| flight.view(0.0));
    let manifest = driver.connect_looking(start.as_ref(), wait)?;
    let flight = flight.unwrap_or_else(|| default_path(&manifest));
    let options = FlyOptions {
        pictures: args.output.clone(),
        every: args.every,
        settle: args.settle,
        wireframe: args.wireframe,
        wait,
    };
    let mut out = BufWriter::new(std::io::stdout().lock());
    let flown = fly(&mut driver, &manifest, &flight, &options, &mut out);
    let frames = match flown.and_then(|frames| Ok(out.flush().map(|()| frames)?)) {
        // Whoever reads the lines has seen enough.
        Err(error) if is_broken_pipe(&error) => return Ok(()),
        frames => frames?,
    };
    summarise(&frames, flight.view(0.0).max_screen_error_px);
    args.mesh
        .report_budget(frames.iter().map(|frame| frame.triangles));
    let away = frames.iter().filter(|frame| !frame.connected).count();
    if away > 0 {
        eprintln!(
            "warning: no connection in {away} of {} frames",
            frames.len()
        );
    }
    warn_of_pages(&driver);
    if let Some(frame) = frames.iter().find(|frame| !frame.notes.is_empty()) {
        let notes = frame.notes.join("; ");
        let time_s = frame.time_s;
        eprintln!("warning: at {time_s:.2} s on the path {notes}; the nearest allowed was flown");
    }
    Ok(())
}

fn warn_of_pages(driver: &Driver) {
    let (lost, reasons) = driver.client.lost_pages();
    let refusals = driver.client.refusals();
    if refusals > 0 {
        eprintln!("warning: pages were refused {refusals} times, and asked for again once each");
    }
    if lost > 0 || refusals > 0 {
        eprintln!("warning: {lost} pages lost: {}", reasons.join("; "));
    }
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        let io = cause.downcast_ref::<std::io::Error>();
        let json = cause.downcast_ref::<serde_json::Error>();
        let kind = io
            .map(|e| e.kind())
            .or(json.and_then(|e| e.io_error_kind()));
        kind == Some(std::io::ErrorKind::BrokenPipe)
    })
}

fn read_path(path: &PathBuf) -> Result<Flight> {
    let json = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    Flight::from_json(&json).with_context(|| format!("{} is no flight", path.display()))
}

/// A few lines for people, beside the lines for programs.
fn summarise(frames: &[FrameReport], error_px: f32) {
    let Some(last) = frames.last() else {
        return;
    };
    let times = |stage: fn(&StageTimes) -> f32| {
        let mut ms: Vec<f32> = frames.iter().map(|frame| stage(&frame.times)).collect();
        ms.sort_unstable_by(f32::total_cmp);
        let at = |percent: usize| ms[(ms.len() - 1) * percent / 100];
        format!("median {:.2} ms, longest {:.2} ms a frame", at(50), at(100))
    };
    let triangles = frames
        .iter()
        .map(|frame| frame.triangles)
        .max()
        .unwrap_or(0);
    let within = frames
        .iter()
        .filter(|f| f.bound_px.is_some_and(|px| px <= f64::from(error_px)));
    let first = frames
        .iter()
        .find(|f| f.bound_px.is_some_and(|px| px <= f64::from(error_px)));
    eprintln!("{} frames, {:.1} s", frames.len(), last.time_s);
    eprintln!(
        "at most {triangles} triangles; {:.3} MB received",
        last.bytes as f64 / 1e6
    );
    eprintln!("decode: {}", times(|times| times.decode_ms));
    eprintln!("link: {}", times(|times| times.link_ms));
    eprintln!("update: {}", times(|times| times.update_ms));
    eprintln!("triangulate: {}", times(|times| times.triangulate_ms));
    match first {
        Some(first) => eprintln!(
            "within {error_px} px first at {:.2} s on the path",
            first.time_s
        ),
        None => eprintln!("never within {error_px} px"),
    }
    eprintln!(
        "{} of {} frames within {error_px} px",
        within.count(),
        frames.len()
    );
    let widest = frames.iter().map(|frame| frame.tolerance_px);
    let widest = widest.fold(0.0, f32::max);
    if widest > error_px {
        eprintln!("budgets: the tolerance was widened, to {widest:.2} px at most");
    }
    let bounds = frames
        .iter()
        .map(|frame| frame.bound_px.unwrap_or(f64::INFINITY));
    let mut bounds: Vec<f64> = bounds.collect();
    bounds.sort_unstable_by(f64::total_cmp);
    let share = |percent: usize| bounds[(bounds.len() - 1) * percent / 100];
    let (half, most) = (share(50), share(99));
    eprintln!("error bound: median {half:.2} px, 99 % at most {most:.2} px");
}
