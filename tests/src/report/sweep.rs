//! A flight with one mesher and one tolerance: times, triangles, and the error measured.

use super::clock::{self, timed};
use super::flight::{Frame, Windows};
use super::measure::surface::FullSurface;
use super::measure::tally::{Promise, Tally};
use super::measure::triangles;
use super::supply::{Stages, Supply};
use super::variant::Variant;
use anyhow::{Result, ensure};
use serde::Serialize;
use std::time::Duration;

/// Most CPU time that a run may take. One that takes more is noted as not measured.
const LONGEST: Duration = Duration::from_secs(900);

/// A frame of a run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FrameRow {
    /// Time on the flight, seconds.
    pub time_s: f64,
    /// The eye has leapt there.
    pub leap: bool,
    /// What it took while pages came.
    pub coming: Stages,
    /// What it took when all pages were there: the median of the repeats.
    pub resident: Stages,
    /// Triangles of the mesh.
    pub triangles: u64,
    /// Vertices enabled or disabled, pages linked or unlinked, while pages came.
    pub changes: u64,
    /// Vertices enabled while pages came.
    pub splits: u64,
    /// Vertices disabled while pages came.
    pub merges: u64,
    /// Squares tested when all pages were there.
    pub squares: u64,
    /// Updates until nothing was wished for.
    pub rounds: u32,
    /// Bytes of the parts that came.
    pub bytes: u64,
    /// The bound that the mesh states, over the tolerance.
    pub excess: f64,
}

/// Middle, tail and end of times.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Times {
    /// As many take longer as take less, milliseconds.
    pub median_ms: f64,
    /// One in a hundred takes longer, milliseconds.
    pub p99_ms: f64,
    /// The longest, milliseconds.
    pub max_ms: f64,
}

impl Times {
    /// Of any number of times.
    pub fn of(mut times_ms: Vec<f64>) -> Times {
        times_ms.sort_unstable_by(f64::total_cmp);
        let at = |share: f64| {
            let rank = (times_ms.len() as f64 * share).ceil() as usize;
            times_ms.get(rank.max(1) - 1).copied().unwrap_or(0.0)
        };
        Times {
            median_ms: at(0.5),
            p99_ms: at(0.99),
            max_ms: at(1.0),
        }
    }
}

/// What was measured of the error.
#[derive(Debug, Clone, Serialize)]
pub struct ErrorFigures {
    /// Root of the mean square over the samples in view, pixels.
    pub rms_px: f64,
    /// One sample in a thousand is farther off, pixels, rounded up.
    pub p999_px: f64,
    /// Largest deviation, pixels.
    pub max_px: f64,
    /// The largest, over the bound that was stated.
    pub max_over_stated: f64,
    /// The largest, over the tolerance that was asked for.
    pub max_over_asked: f64,
    /// Share of the samples beyond the bound that was stated.
    pub share_above_stated: f64,
    /// Share of the samples beyond the tolerance.
    pub share_above_asked: f64,
    /// How far apart mesh and surface are in the picture, root of the mean square, pixels.
    pub rms_projected_px: f64,
    /// The largest of that, pixels.
    pub max_projected_px: f64,
    /// Frames whose mesh was measured.
    pub frames: u64,
    /// Samples that were compared.
    pub compared: u64,
    /// Samples in view; an estimate where not all were measured.
    pub in_view: f64,
    /// Finest pages that were read; absent where every sample in view was compared.
    pub tiles_read: Option<u64>,
    /// Finest pages that hold a chosen part of a triangle in view.
    pub tiles_chosen: Option<u64>,
    /// Samples of the surface that are not drawn, though nothing may leave them out; absent where
    /// not every sample was compared.
    pub left_out: Option<u64>,
    /// Samples of holes that a triangle larger than the tolerance covers.
    pub covered: u64,
    /// Edges that cross the surface's edges elsewhere than at samples.
    pub crooked_edges: u64,
    /// `[deviation over the bound stated, share of the samples that have at most that]`.
    pub ratio_cdf: Vec<(f64, f64)>,
}

impl ErrorFigures {
    /// Of what was counted.
    pub fn of(tally: &Tally, frames: u64, whole: bool) -> ErrorFigures {
        ErrorFigures {
            rms_px: tally.rms_px(),
            p999_px: tally.quantile_px(0.999),
            max_px: tally.max_px,
            max_over_stated: tally.max_ratio,
            max_over_asked: tally.max_over_asked,
            share_above_stated: tally.share_above_stated(),
            share_above_asked: tally.share_above_asked(),
            rms_projected_px: tally.rms_projected_px(),
            max_projected_px: tally.max_projected_px,
            frames,
            compared: tally.compared,
            in_view: tally.samples,
            tiles_read: (!whole).then_some(tally.tiles[0]),
            tiles_chosen: (!whole).then_some(tally.tiles[1]),
            left_out: whole.then_some(tally.left_out),
            covered: tally.covered,
            crooked_edges: tally.crooked_edges,
            ratio_cdf: tally.ratio.cumulative(),
        }
    }
}

/// A flight with one mesher and one tolerance.
#[derive(Debug, Clone, Serialize)]
pub struct Run {
    /// The mesher.
    pub mesher: Variant,
    /// The tolerance, pixels.
    pub error_px: f32,
    /// Whether the mesher promises to keep it.
    pub keeps_tolerance: bool,
    /// Update and triangulation of a frame, all pages there, frames after a leap left out.
    pub resident: Times,
    /// Decoding, linking, update and triangulation of a frame while pages come, frames after a
    /// leap left out.
    pub coming: Times,
    /// Mean stages of the frames of `resident`, and of `coming`.
    pub resident_stages: Stages,
    /// See `resident_stages`.
    pub coming_stages: Stages,
    /// The first frame, with nothing there.
    pub cold: Stages,
    /// Mean of the frames after a leap, but for the first; absent if there is none.
    pub teleport: Option<Stages>,
    /// Mean triangles a frame.
    pub triangles_mean: f64,
    /// Most triangles of a frame.
    pub triangles_max: u64,
    /// Mean changes of a frame while pages come, leaps left out.
    pub changes_mean: f64,
    /// Mean splits of a frame while pages come, leaps left out.
    pub splits_mean: f64,
    /// Mean merges of a frame while pages come, leaps left out.
    pub merges_mean: f64,
    /// Largest bound that was stated, over the tolerance.
    pub excess_max: f64,
    /// The error, measured.
    pub error: ErrorFigures,
    /// Bytes that came in the whole flight.
    pub bytes: u64,
    /// Pages there at the end.
    pub pages: u64,
    /// Memory of the mesh tree at the end, bytes.
    pub memory_bytes: u64,
    /// Every frame.
    pub frames: Vec<FrameRow>,
}

/// Flies with one mesher and one tolerance.
///
/// # Errors
/// Those of [`Supply::converge`] and [`FullSurface::measure`].
pub fn run(
    surface: &FullSurface<'_>,
    windows: &Windows,
    variant: Variant,
    error_px: f32,
    repeats: usize,
) -> Result<Run> {
    let frames = windows.frames();
    let began = clock::cpu();
    let in_time = || {
        let longest = LONGEST.as_secs();
        ensure!(
            clock::cpu().saturating_sub(began) <= LONGEST,
            "a run takes more than {longest} s of CPU time: ask for a larger error or a smaller picture"
        );
        Ok(())
    };
    let mut supply = Supply::new(surface.dataset, variant);
    let mut rows = Vec::with_capacity(frames.len());
    for frame in &frames {
        rows.push(fly(&mut supply, windows, frame, error_px)?);
        in_time()?;
    }
    let bytes = supply.bytes;
    let mut tally = Tally::default();
    let mut times = vec![Vec::with_capacity(repeats); frames.len()];
    for repeat in 0..repeats.max(1) {
        for (i, frame) in frames.iter().enumerate() {
            let view = windows.view(frame.time_s, error_px);
            let (stats, update_ms) = timed(|| supply.tree.update(&view));
            let (_, triangulate_ms) = timed(|| supply.tree.triangulate());
            times[i].push((update_ms, triangulate_ms));
            rows[i].squares = stats.squares;
            in_time()?;
            if repeat == 0 && frame.measured {
                let promise = Promise::of(f64::from(error_px), stats.excess);
                let mesh = triangles(&supply.tree);
                tally = tally.merge(&surface.measure(&mesh, &view, promise)?);
            }
        }
    }
    for (row, times) in rows.iter_mut().zip(times) {
        row.resident = typical(times);
    }
    let measured = frames.iter().filter(|frame| frame.measured).count() as u64;
    let error = ErrorFigures::of(&tally, measured, surface.whole.is_some());
    Ok(summary(&supply, variant, error_px, bytes, rows, error))
}

fn fly(
    supply: &mut Supply<'_>,
    windows: &Windows,
    frame: &Frame,
    error_px: f32,
) -> Result<FrameRow> {
    let before = supply.bytes;
    let here = supply.converge(&windows.view(frame.time_s, error_px))?;
    Ok(FrameRow {
        time_s: frame.time_s,
        leap: frame.leap,
        coming: here.stages,
        resident: Stages::default(),
        triangles: here.triangles,
        changes: here.stats.changes,
        splits: here.stats.splits,
        merges: here.stats.merges,
        squares: here.stats.squares,
        rounds: here.rounds,
        bytes: supply.bytes - before,
        excess: here.stats.excess,
    })
}

/// The repeat in the middle.
fn typical(mut times: Vec<(f64, f64)>) -> Stages {
    times.sort_unstable_by(|a, b| (a.0 + a.1).total_cmp(&(b.0 + b.1)));
    let (update_ms, triangulate_ms) = times.get(times.len() / 2).copied().unwrap_or_default();
    Stages {
        update_ms,
        triangulate_ms,
        ..Stages::default()
    }
}

fn mean(rows: &[&FrameRow], stages: impl Fn(&FrameRow) -> Stages) -> Stages {
    let mut sum = Stages::default();
    rows.iter().for_each(|row| sum.add(&stages(row)));
    sum.over(rows.len())
}

fn summary(
    supply: &Supply<'_>,
    variant: Variant,
    error_px: f32,
    bytes: u64,
    frames: Vec<FrameRow>,
    error: ErrorFigures,
) -> Run {
    let steady: Vec<&FrameRow> = frames.iter().filter(|row| !row.leap).collect();
    // A flight of one frame is a leap, and nothing else.
    let steady = if steady.is_empty() {
        frames.iter().collect()
    } else {
        steady
    };
    let leaps: Vec<&FrameRow> = frames.iter().skip(1).filter(|row| row.leap).collect();
    let count = steady.len().max(1) as f64;
    let average =
        |of: fn(&FrameRow) -> u64| steady.iter().map(|row| of(row) as f64).sum::<f64>() / count;
    Run {
        mesher: variant,
        error_px,
        keeps_tolerance: variant.keeps_tolerance(),
        resident: Times::of(steady.iter().map(|row| row.resident.mesh_ms()).collect()),
        coming: Times::of(steady.iter().map(|row| row.coming.total_ms()).collect()),
        resident_stages: mean(&steady, |row| row.resident),
        coming_stages: mean(&steady, |row| row.coming),
        cold: frames.first().map(|row| row.coming).unwrap_or_default(),
        teleport: (!leaps.is_empty()).then(|| mean(&leaps, |row| row.coming)),
        triangles_mean: average(|row| row.triangles),
        triangles_max: frames.iter().map(|row| row.triangles).max().unwrap_or(0),
        changes_mean: average(|row| row.changes),
        splits_mean: average(|row| row.splits),
        merges_mean: average(|row| row.merges),
        excess_max: frames.iter().map(|row| row.excess).fold(0.0, f64::max),
        error,
        bytes,
        pages: supply.tree.resident() as u64,
        memory_bytes: supply.tree.memory_bytes() as u64,
        frames,
    }
}
