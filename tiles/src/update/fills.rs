//! Which samples are fill after an update: those that were, where nothing replaces them, and those
//! of the patches.

use super::finest::Wish;
use crate::build::HOLE;
use crate::dataset::{FilledRun, FilledRuns};

/// The runs of a row of samples, by column.
pub(super) fn fills_of_row(
    wish: &Wish<'_>,
    before: &FilledRuns,
    y: u32,
    width: u32,
) -> Vec<FilledRun> {
    let mut is_fill = vec![false; width as usize];
    for run in runs_of_row(before, y) {
        is_fill[run.x as usize..][..run.length as usize].fill(true);
    }
    for place in wish.removed.iter().filter(|r| r.y[0] <= y && y <= r.y[1]) {
        is_fill[place.x[0] as usize..=place.x[1] as usize].fill(false);
    }
    // The patch named first is laid on last.
    for patch in wish.patches.iter().rev() {
        for (x, height) in patch.row(y) {
            if height != HOLE {
                is_fill[x as usize] = patch.fills().contains(x, y);
            }
        }
    }
    let mut runs = Vec::new();
    let mut x = 0;
    for same in is_fill.chunk_by(|a, b| a == b) {
        let length = same.len() as u32;
        if same[0] {
            runs.push(FilledRun { y, x, length });
        }
        x += length;
    }
    runs
}

fn runs_of_row(runs: &FilledRuns, y: u32) -> &[FilledRun] {
    let all = runs.runs();
    let first = all.partition_point(|run| run.y < y);
    let end = all.partition_point(|run| run.y <= y);
    &all[first..end]
}
