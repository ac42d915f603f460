//! The heights of a membrane that hangs in the rim of a void: each is the mean of the four beside
//! it. So none is above the rim's highest or below its lowest, and an even slope goes on evenly.
//!
//! The equations are solved by conjugate gradients (Hestenes and Stiefel, "Methods of Conjugate
//! Gradients for Solving Linear Systems", 1952), one void on one thread, so that the result is
//! the same whatever the number of threads.

use super::FilledRun;
use super::voids::Void;

/// How far, of the rim's range of heights, a height may be from the mean of those beside it.
const TOLERANCE: f64 = 1e-7;

/// Steps after which the heights are taken as they are. A void of the largest size that may be
/// filled needs about as many as it is wide.
const MOST_STEPS: usize = 20_000;

/// No sample of the void.
const NONE: u32 = u32::MAX;

/// The four samples beside each, where they are of the void.
type Beside = Vec<[u32; 4]>;

/// Heights of a void's samples, in the order of its runs; whole steps from the rim where heights
/// have a step.
pub(super) fn fill(void: &Void, step_m: Option<f64>) -> Vec<f64> {
    let Some(base_m) = void.rim().first().map(|rim| rim.height_m) else {
        return Vec::new();
    };
    let (low, high) = void
        .rim()
        .iter()
        .fold((base_m, base_m), |(low, high), rim| {
            (low.min(rim.height_m), high.max(rim.height_m))
        });
    let starts = starts(void.runs());
    let beside = beside(void.runs(), &starts);
    // Heights from the base on, so that an even rim is met exactly.
    let mut pull = vec![0.0; beside.len()];
    for rim in void.rim() {
        if let Some(at) = sample_at(void.runs(), &starts, rim.place) {
            pull[at] += rim.height_m - base_m;
        }
    }
    let mut heights = solve(&beside, pull, TOLERANCE * (high - low));
    for height in &mut heights {
        let rounded = match step_m {
            Some(step_m) => (*height / step_m).round() * step_m,
            None => *height,
        };
        *height = (base_m + rounded).clamp(low, high);
    }
    heights
}

/// Where each run's samples start.
fn starts(runs: &[FilledRun]) -> Vec<usize> {
    let mut end = 0;
    let start = |run: &FilledRun| {
        let start = end;
        end += run.length as usize;
        start
    };
    runs.iter().map(start).collect()
}

/// The number of a sample by its place.
fn sample_at(runs: &[FilledRun], starts: &[usize], (row, column): (u32, u32)) -> Option<usize> {
    let after = runs.partition_point(|run| (run.row, run.column) <= (row, column));
    let run = after.checked_sub(1)?;
    let inside = column - runs[run].column;
    (runs[run].row == row && inside < runs[run].length).then(|| starts[run] + inside as usize)
}

fn beside(runs: &[FilledRun], starts: &[usize]) -> Beside {
    let samples = runs.iter().map(|run| run.length as usize).sum();
    let mut beside = vec![[NONE; 4]; samples];
    for (run, &start) in runs.iter().zip(starts) {
        for i in 1..run.length as usize {
            beside[start + i][0] = (start + i - 1) as u32;
            beside[start + i - 1][1] = (start + i) as u32;
        }
        // Runs of the next row that lie below.
        let end = run.column + run.length;
        let first =
            runs.partition_point(|r| (r.row, r.column + r.length) <= (run.row + 1, run.column));
        for (below, &other) in runs[first..].iter().zip(&starts[first..]) {
            if below.row != run.row + 1 || below.column >= end {
                break;
            }
            for column in run.column.max(below.column)..end.min(below.column + below.length) {
                let north = start + (column - run.column) as usize;
                let south = other + (column - below.column) as usize;
                beside[north][2] = south as u32;
                beside[south][3] = north as u32;
            }
        }
    }
    beside
}

/// Solves `4 h - (sum of h beside) = pull`, until no sample is off by more than the tolerance.
fn solve(beside: &Beside, pull: Vec<f64>, tolerance: f64) -> Vec<f64> {
    let mut heights = vec![0.0; pull.len()];
    let mut residual = pull;
    let mut direction = residual.clone();
    let mut image = vec![0.0; residual.len()];
    let mut norm = dot(&residual, &residual);
    for _ in 0..MOST_STEPS {
        if residual.iter().all(|r| r.abs() <= tolerance) {
            break;
        }
        apply(beside, &direction, &mut image);
        let step = norm / dot(&direction, &image);
        for (i, direction) in direction.iter().enumerate() {
            heights[i] += step * direction;
            residual[i] -= step * image[i];
        }
        let last = std::mem::replace(&mut norm, dot(&residual, &residual));
        let keep = norm / last;
        for (direction, residual) in direction.iter_mut().zip(&residual) {
            *direction = residual + keep * *direction;
        }
    }
    heights
}

fn apply(beside: &Beside, from: &[f64], to: &mut [f64]) {
    for ((to, own), beside) in to.iter_mut().zip(from).zip(beside) {
        let sum: f64 = beside.iter().filter_map(|&b| from.get(b as usize)).sum();
        *to = 4.0 * own - sum;
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
