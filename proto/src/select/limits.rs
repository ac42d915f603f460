//! Tests of many squares at once, on codes.
//!
//! An error is beyond the tolerance where `error * threshold > distance`, that is where its code
//! is at least that of `distance / threshold`, rounded down, and one more: a *limit*. Limits grow
//! with distances, and the distance of a box is the largest of those along the axes. So each
//! column and row of a page has limits of its own, and the limit of a square is the largest of
//! its column's, its row's, and that of its heights.
//!
//! All that is rounded here, is rounded so that a test rather fails.

use crate::geometry::PAGE_SAMPLES;

/// Single precision loses less than this share of a distance.
const LESS: f32 = 1.0 - 1e-6;

/// The smallest code that is beyond the tolerance at this distance, in metres of error, which is
/// not negative.
pub(super) fn limit(distance: f32) -> u16 {
    ((distance * LESS).to_bits() >> 15) as u16 + 1
}

/// The lines of samples along an axis from where the eye may be, in metres of error: how far away
/// is what lies beyond each, and what lies before it, where that is more than 0.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lines {
    pub(super) beyond: [f32; PAGE_SAMPLES],
    pub(super) before: [f32; PAGE_SAMPLES],
}

impl Lines {
    /// How far away is what lies between two lines, at least.
    pub(super) fn between(&self, low: usize, high: usize) -> f32 {
        self.beyond[low].max(self.before[high]).max(0.0)
    }
}

/// Limits of the lines of samples along an axis: for what lies beyond each, and before it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Axis {
    beyond: [u16; PAGE_SAMPLES],
    before: [u16; PAGE_SAMPLES],
}

/// Limits of the columns, or rows, of squares of a level.
#[derive(Debug, Clone, Copy)]
pub(super) struct Halves<const N: usize> {
    /// Of the western or southern half, the other one, and of all of it.
    pub(super) lower: [u16; N],
    pub(super) upper: [u16; N],
    pub(super) whole: [u16; N],
}

impl Axis {
    pub(super) fn new(lines: &Lines) -> Axis {
        Axis {
            beyond: lines.beyond.map(|line| limit(line.max(0.0))),
            before: lines.before.map(|line| limit(line.max(0.0))),
        }
    }

    pub(super) fn halves<const N: usize>(&self) -> Halves<N> {
        let step = (PAGE_SAMPLES - 1) / N;
        let line = |i: usize| (i * step, i * step + step / 2, (i + 1) * step);
        let between = |low: usize, high: usize| self.beyond[low].max(self.before[high]);
        Halves {
            lower: std::array::from_fn(|i| between(line(i).0, line(i).1)),
            upper: std::array::from_fn(|i| between(line(i).1, line(i).2)),
            whole: std::array::from_fn(|i| between(line(i).0, line(i).2)),
        }
    }
}

/// Which squares of a level fail, a bit each by column, by row. Codes, and limits of heights if
/// they count, are column by column.
pub(super) fn rows<const N: usize>(
    codes: &[u16],
    columns: &[u16; N],
    rows: &[u16; N],
    heights: Option<&[u16]>,
) -> [u16; N] {
    let mut found = [0u16; N];
    for (column, codes) in codes.chunks_exact(N).enumerate().take(N) {
        let bit = 1u16 << column;
        let mut limits = rows.map(|row| row.max(columns[column]));
        if let Some(heights) = heights {
            for (limit, &height) in limits.iter_mut().zip(&heights[column * N..]) {
                *limit = height.max(*limit);
            }
        }
        for row in 0..N {
            found[row] |= if codes[row] >= limits[row] { bit } else { 0 };
        }
    }
    found
}

/// As [`rows`], all in one number, row by row.
pub(super) fn squares<const N: usize>(
    codes: &[u16],
    columns: &[u16; N],
    rows: &[u16; N],
    heights: Option<&[u16]>,
) -> u64 {
    let found = self::rows(codes, columns, rows, heights);
    let together = found.iter().enumerate();
    together.fold(0, |all, (row, &bits)| all | u64::from(bits) << (row * N))
}
