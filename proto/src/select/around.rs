//! A page from where the eye may be: how far its columns, rows and heights are.

use super::eyes::Eyes;
use super::limits::{Axis, Lines, limit, rows};
use super::sketch::{Told, first};
use crate::geometry::{GridLevels, PAGE_CELLS, PAGE_LEVELS, PAGE_SAMPLES, PAGE_SLOTS, PageId};
use crate::sight::Sight;
use crate::sight::squares::{ErrorCode, PAGE_SQUARES};
use std::cell::OnceCell;

/// A page from where the eye may be, in metres of error: distances over the threshold.
pub(super) struct Around {
    columns: Lines,
    rows: Lines,
    /// How far the page is to the side.
    pub(super) flat: f32,
    /// The highest place of the eye, and the lowest, metres.
    eye_m: [f64; 2],
    quantum_m: f64,
    /// A metre.
    metre: f64,
    /// Limits of columns and rows, once they have been asked for.
    axes: OnceCell<[Axis; 2]>,
}

/// The heights of a page, as what is told of it has them, from where the eye may be.
pub(super) struct Heights<'a> {
    lo: &'a [u8],
    hi: &'a [u8],
    /// Height of the lowest step above the highest place of the eye, and above the lowest; what a
    /// step adds; and how much of that may be rounding.
    base: [f32; 2],
    step: f32,
    slack: f32,
}

/// The error of a code, metres.
pub(super) fn metres(code: u16) -> f32 {
    ErrorCode::from_code(code).metres() as f32
}

impl Around {
    pub(super) fn new(grid: GridLevels, sight: &Sight, eyes: &Eyes, id: PageId) -> Around {
        let metre = 1.0 / sight.tests.threshold;
        let (x, y) = grid.page_origin(id);
        let stride = grid.page_stride(id);
        let over = |metres: f64| (metres * metre) as f32;
        let lines = |origin: u32, axis: usize| {
            let at_m = |i: usize| sight.grid_m(origin + i as u32 * stride, axis);
            Lines {
                beyond: std::array::from_fn(|i| over(at_m(i) - eyes.hi_m[axis])),
                before: std::array::from_fn(|i| over(eyes.lo_m[axis] - at_m(i))),
            }
        };
        let (columns, rows) = (lines(x, 0), lines(y, 1));
        let last = PAGE_SAMPLES - 1;
        Around {
            flat: columns.between(0, last).max(rows.between(0, last)),
            columns,
            rows,
            eye_m: [eyes.hi_m[2], eyes.lo_m[2]],
            quantum_m: sight.quantum_m(),
            metre,
            axes: OnceCell::new(),
        }
    }

    /// The heights that are told of the page.
    pub(super) fn heights<'a>(&self, told: &Told<'a>) -> Heights<'a> {
        let over = |metres: f64| (metres * self.metre) as f32;
        let height_m = |code| told.steps.height(code) as f64 * self.quantum_m;
        let base = self.eye_m.map(|eye_m| over(height_m(0) - eye_m));
        let step = over(height_m(1) - height_m(0));
        Heights {
            lo: told.lo,
            hi: told.hi,
            base,
            step,
            slack: (base[0].abs().max(base[1].abs()) + 255.0 * step) * 1e-6,
        }
    }

    /// Limits of columns and rows.
    pub(super) fn axes(&self) -> &[Axis; 2] {
        let axes = || [Axis::new(&self.columns), Axis::new(&self.rows)];
        self.axes.get_or_init(axes)
    }

    /// How far a cell is to the side.
    pub(super) fn flat_of(&self, column: usize, row: usize) -> f32 {
        let along = |lines: &Lines, i: usize| lines.between(i, i + 1);
        along(&self.columns, column).max(along(&self.rows, row))
    }

    /// How far the page is, at least.
    pub(super) fn nearest(&self, heights: &Heights<'_>) -> f32 {
        self.flat.max(heights.nearest())
    }

    /// The same if heights may be farther out, as a bound is all that is believed of them: by the
    /// bound, and by a step of the codes that they have then.
    pub(super) fn nearest_by(&self, heights: &Heights<'_>, code: u16) -> f32 {
        let bound = f64::from(metres(code)) * self.metre;
        let step = (255.0 * f64::from(heights.step) + 2.0 * bound) * (2.0 / 253.0);
        let wider = match code {
            0 => 0.0,
            _ => (bound + step) as f32,
        };
        self.flat.max(heights.nearest() - wider)
    }

    /// How far any of the page is, at most.
    fn farthest(&self, heights: &Heights<'_>) -> f32 {
        let last = PAGE_SAMPLES - 1;
        let end = |lines: &Lines| lines.beyond[last].max(lines.before[0]);
        let flat = end(&self.columns).max(end(&self.rows));
        flat.max(heights.farthest()).max(0.0)
    }

    /// Whether heights count, as not all of the page is farther to the side than up or down.
    pub(super) fn is_steep(&self, heights: &Heights<'_>) -> bool {
        heights.farthest() + heights.slack > self.flat && !heights.is_empty()
    }

    /// Whether any square of a level fails if each has this bound.
    pub(super) fn any_fails(&self, heights: &Heights<'_>, level: u8, code: u16) -> bool {
        if code < limit(self.nearest(heights)) {
            return false;
        }
        if !self.is_steep(heights) || code >= limit(self.farthest(heights)) {
            return true;
        }
        let axes = self.axes();
        match level {
            1 => heights.any::<2>(level, code, axes),
            2 => heights.any::<4>(level, code, axes),
            3 => heights.any::<8>(level, code, axes),
            _ => heights.any::<PAGE_CELLS>(PAGE_LEVELS, code, axes),
        }
    }
}

impl Heights<'_> {
    /// How far heights are above the eye.
    fn over(&self, lo: u8) -> f32 {
        self.base[0] + self.step * f32::from(lo)
    }

    /// How far heights are below the eye.
    fn under(&self, hi: u8) -> f32 {
        -(self.base[1] + self.step * f32::from(hi))
    }

    /// How far heights are above or below, at least.
    pub(super) fn above(&self, [lo, hi]: [u8; 2]) -> f32 {
        (self.over(lo).max(self.under(hi)) - self.slack).max(0.0)
    }

    /// How far the whole page's heights are above or below, at least.
    fn nearest(&self) -> f32 {
        match self.is_empty() {
            true => 0.0,
            false => self.above([self.lo[0], self.hi[0]]),
        }
    }

    /// Whether the page has no surface.
    fn is_empty(&self) -> bool {
        self.lo[0] > self.hi[0]
    }

    fn farthest(&self) -> f32 {
        self.over(self.hi[0]).max(self.under(self.lo[0]))
    }

    /// Limits of the heights of squares of so many levels.
    pub(super) fn limits(&self, levels: u8) -> [u16; PAGE_SQUARES] {
        let mut limits = [0; PAGE_SQUARES];
        let end = first(levels);
        self.fill(&mut limits[..end], &self.lo[..end], &self.hi[..end]);
        limits
    }

    /// Limits of heights of cells.
    pub(super) fn limits_of(&self, lo: &[u8], hi: &[u8]) -> [u16; PAGE_SLOTS] {
        let mut limits = [0; PAGE_SLOTS];
        self.fill(&mut limits, lo, hi);
        limits
    }

    fn fill(&self, limits: &mut [u16], lo: &[u8], hi: &[u8]) {
        for (to, (&lo, &hi)) in limits.iter_mut().zip(lo.iter().zip(hi)) {
            *to = limit(self.above([lo, hi]));
        }
    }

    fn any<const N: usize>(&self, level: u8, code: u16, [columns, rows]: &[Axis; 2]) -> bool {
        let (codes, mut limits) = ([code; PAGE_SLOTS], [0; PAGE_SLOTS]);
        let at = first(level)..first(level) + N * N;
        self.fill(&mut limits[..N * N], &self.lo[at.clone()], &self.hi[at]);
        let (x, y) = (columns.halves::<N>().whole, rows.halves::<N>().whole);
        let found = self::rows(&codes[..N * N], &x, &y, Some(&limits[..N * N]));
        found.iter().any(|&row| row != 0)
    }
}
