//! A band of rows: what is held of a level while its pages are made.

use super::BuildError;
use super::level::{FAMILY_CELLS, Level};
use super::quantise::HOLE;
use super::rows::Rows;
use escarp_proto::geometry::PAGE_CELLS;
use escarp_proto::page::{ChildSlot, Range};

/// 257 rows of samples, southern row first, as wide as whole families; or a part of them.
pub(crate) struct Band {
    /// Its first column.
    pub(crate) west: usize,
    pub(crate) stride: usize,
    pub(crate) samples: Vec<i32>,
}

/// Samples of a band up to which the next is read while one is encoded: wider ones take turns, so
/// that memory is that of one.
pub(super) const MOST_AHEAD: usize = 1 << 25;

/// The band that is encoded, and the one that is read meanwhile.
pub(super) struct Bands {
    pub(super) now: Band,
    pub(super) next: Option<Band>,
}

impl Bands {
    pub(super) fn new(level: &Level, most_ahead: usize) -> Bands {
        let now = Band::new(level);
        let next = (now.samples.len() <= most_ahead).then(|| Band::new(level));
        Bands { now, next }
    }

    /// Reads the first band; the southern row of the one before it is where a band has its own.
    pub(super) fn read(
        &mut self,
        level: &Level,
        number: usize,
        rows: &mut dyn Rows,
    ) -> Result<(), BuildError> {
        self.now.carry_over();
        self.now.fill_below(level, number, rows)
    }

    /// Goes on to the next band.
    pub(super) fn advance(
        &mut self,
        level: &Level,
        number: usize,
        rows: &mut dyn Rows,
    ) -> Result<(), BuildError> {
        match &mut self.next {
            Some(next) => {
                std::mem::swap(&mut self.now, next);
                Ok(())
            }
            None => self.read(level, number, rows),
        }
    }
}

impl Band {
    pub(super) fn new(level: &Level) -> Band {
        let stride = level.columns.div_ceil(PAGE_CELLS) * FAMILY_CELLS + 1;
        Band {
            west: 0,
            stride,
            samples: vec![HOLE; stride * (FAMILY_CELLS + 1)],
        }
    }

    /// Makes the southern row the northern one.
    pub(super) fn carry_over(&mut self) {
        let stride = self.stride;
        self.samples.copy_within(..stride, FAMILY_CELLS * stride);
    }

    /// Reads a band. Its northern row is the southern row of the band before.
    pub(super) fn fill(
        &mut self,
        level: &Level,
        number: usize,
        before: &Band,
        rows: &mut dyn Rows,
    ) -> Result<(), BuildError> {
        let stride = self.stride;
        self.samples[FAMILY_CELLS * stride..].copy_from_slice(&before.samples[..stride]);
        self.fill_below(level, number, rows)
    }

    /// Reads all rows but the northern one, and that too if there is no band before. What lies
    /// beyond the data is, and stays, a hole.
    pub(super) fn fill_below(
        &mut self,
        level: &Level,
        number: usize,
        rows: &mut dyn Rows,
    ) -> Result<(), BuildError> {
        let first = number * FAMILY_CELLS;
        let is_northern = first + FAMILY_CELLS + 1 >= level.height;
        let n = if is_northern {
            level.height - first
        } else {
            FAMILY_CELLS
        };
        if n < FAMILY_CELLS {
            self.samples[n * self.stride..FAMILY_CELLS * self.stride].fill(HOLE);
        }
        if !rows.may_have_data(first as u32, n as u32) {
            self.samples[..n * self.stride].fill(HOLE);
            return Ok(());
        }
        rows.read(first as u32, n as u32, self.stride, &mut self.samples)
    }

    pub(super) fn sample(&self, x: usize, y: usize) -> Option<i32> {
        let x = x.checked_sub(self.west)?;
        let height = *self.samples.get(y * self.stride + x)?;
        (x < self.stride && height != HOLE).then_some(height)
    }

    /// Whether all samples of the family that starts at a column are holes, borders included.
    pub(super) fn is_empty_below(&self, column: usize) -> bool {
        self.samples.chunks_exact(self.stride).all(|row| {
            row[column..=column + FAMILY_CELLS]
                .iter()
                .all(|&h| h == HOLE)
        })
    }

    /// Whether a sample is a corner of a valid finest triangle, as far as the band shows. Each of
    /// the four cells around it has one triangle with a right angle at the sample or opposite it,
    /// and, where the cell's diagonal starts at the sample, two.
    pub(super) fn is_on_surface(&self, x: usize, y: usize) -> bool {
        let at = |dx: i32, dy: i32| {
            let place = (
                x.checked_add_signed(dx as isize),
                y.checked_add_signed(dy as isize),
            );
            matches!(place, (Some(x), Some(y)) if self.sample(x, y).is_some())
        };
        let diagonal_starts_here = (x + y).is_multiple_of(2);
        [(1, 1), (-1, 1), (-1, -1), (1, -1)]
            .into_iter()
            .any(|(dx, dy)| {
                let (beside, above, across) = (at(dx, 0), at(0, dy), at(dx, dy));
                if diagonal_starts_here {
                    across && (beside || above)
                } else {
                    beside && above
                }
            })
    }

    /// The slot of a page without any valid triangle: nothing is lost, so a page that holds
    /// samples which are on no triangle of any page is stored for their sake. Of samples that
    /// pages share, the page to the north-east counts, if there is one.
    pub(super) fn lone_samples(
        &self,
        (x, y): (usize, usize),
        (columns, rows): (usize, usize),
    ) -> ChildSlot {
        let lone = (0..columns * rows)
            .map(|i| (x + i % columns, y + i / columns))
            .filter(|&(x, y)| self.sample(x, y).is_some() && !self.is_on_surface(x, y))
            .filter_map(|(x, y)| self.sample(x, y))
            .fold(Range::EMPTY, Range::with);
        if lone.is_empty() {
            ChildSlot::Empty
        } else {
            ChildSlot::Mixed(lone)
        }
    }
}
