//! All pages of one level, band by band.

use super::quantise::HOLE;
use super::rows::Rows;
use super::{BuildError, Progress};
use crate::dataset::{DatasetWriter, FamilyBytes, FamilyId};
use escarp_proto::err8::Err8;
use escarp_proto::geometry::{
    GridLevels, PAGE_CELLS, PAGE_LEVELS, PAGE_SAMPLES, PAGE_SLOTS, PageId, Slot,
};
use escarp_proto::page::{ChildSlot, PAGE_AREA, Page, Range, Record, implied_slot};
use rayon::prelude::*;
use std::collections::HashMap;

/// Cells on the side of a family.
const FAMILY_CELLS: usize = PAGE_CELLS * PAGE_CELLS;

/// A [`ChildSlot`] without what it carries.
#[derive(Debug, Clone, Copy)]
#[repr(u8)]
enum State {
    Full,
    Cut,
    Empty,
    Mixed,
}

/// Child slots of a whole level, in little memory: one a page of the level below.
#[derive(Debug)]
pub(super) struct Slots {
    columns: usize,
    states: Vec<State>,
    errors: Vec<Err8>,
    mixed: HashMap<usize, Range>,
}

impl Slots {
    fn new(columns: usize, rows: usize) -> Slots {
        Slots {
            columns,
            states: vec![State::Empty; columns * rows],
            errors: vec![Err8(0); columns * rows],
            mixed: HashMap::new(),
        }
    }

    fn set(&mut self, column: usize, row: usize, slot: ChildSlot) {
        let at = row * self.columns + column;
        self.states[at] = match slot {
            ChildSlot::Full(error) => {
                self.errors[at] = error;
                State::Full
            }
            ChildSlot::Cut(error) => {
                self.errors[at] = error;
                State::Cut
            }
            ChildSlot::Mixed(range) => {
                self.mixed.insert(at, range);
                State::Mixed
            }
            ChildSlot::Empty => State::Empty,
        };
    }

    /// Beyond the data there is nothing.
    fn get(&self, column: usize, row: usize) -> ChildSlot {
        let at = row * self.columns + column;
        if column >= self.columns || at >= self.states.len() {
            return ChildSlot::Empty;
        }
        match self.states[at] {
            State::Full => ChildSlot::Full(self.errors[at]),
            State::Cut => ChildSlot::Cut(self.errors[at]),
            State::Empty => ChildSlot::Empty,
            State::Mixed => self
                .mixed
                .get(&at)
                .map_or(ChildSlot::Empty, |&r| ChildSlot::Mixed(r)),
        }
    }
}

/// What a level leaves for the one above: a sample a page corner, a slot a page.
#[derive(Debug)]
pub(super) struct Above {
    width: usize,
    height: usize,
    heights: Vec<i32>,
    slots: Slots,
}

/// Rows of the samples that a level below left.
pub(super) struct MemoryRows {
    from: Above,
}

impl MemoryRows {
    pub(super) fn new(from: Above) -> Self {
        MemoryRows { from }
    }
}

impl Rows for MemoryRows {
    fn read(&mut self, first: u32, n: u32, out: &mut [i32]) -> Result<(), BuildError> {
        let width = self.from.width;
        let start = first as usize * width;
        out.copy_from_slice(&self.from.heights[start..start + n as usize * width]);
        Ok(())
    }

    fn slots(&self) -> Option<&Slots> {
        Some(&self.from.slots)
    }
}

/// The pages of one level that the data reaches.
pub(super) struct Level {
    grid: GridLevels,
    level: u8,
    /// Samples at this level's spacing.
    width: usize,
    height: usize,
    /// Pages.
    columns: usize,
    rows: usize,
}

/// 257 rows of samples, southern row first, as wide as whole families.
struct Band {
    stride: usize,
    samples: Vec<i32>,
}

impl Band {
    fn sample(&self, x: usize, y: usize) -> Option<i32> {
        let height = *self.samples.get(y * self.stride + x)?;
        (x < self.stride && height != HOLE).then_some(height)
    }

    /// Whether all samples of the family that starts at a column are holes, borders included.
    fn is_empty_below(&self, column: usize) -> bool {
        self.samples.chunks_exact(self.stride).all(|row| {
            row[column..=column + FAMILY_CELLS]
                .iter()
                .all(|&h| h == HOLE)
        })
    }

    /// Whether a sample is a corner of a valid finest triangle, as far as the band shows. Each of
    /// the four cells around it has one triangle with a right angle at the sample or opposite it,
    /// and, where the cell's diagonal starts at the sample, two.
    fn is_on_surface(&self, x: usize, y: usize) -> bool {
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
    /// samples which are on no triangle of any page is stored for their sake.
    fn lone_samples(&self, x: usize, y: usize) -> ChildSlot {
        let lone = (0..PAGE_SLOTS)
            .map(|i| (x + i % PAGE_CELLS, y + i / PAGE_CELLS))
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

/// The pages of a family: encoded, and what each leaves for the level above.
struct Family {
    bytes: Option<FamilyBytes>,
    slots: Vec<(usize, usize, ChildSlot)>,
}

impl Level {
    pub(super) fn new(grid: GridLevels, level: u8, width: u32, height: u32) -> Level {
        let pages = |samples: u32| (samples as usize - 1).div_ceil(PAGE_CELLS).max(1);
        Level {
            grid,
            level,
            width: width as usize,
            height: height as usize,
            columns: pages(width),
            rows: pages(height),
        }
    }

    /// The level whose samples this one left; `None` above the root.
    pub(super) fn above(&self, left: &Above) -> Option<Level> {
        let level = self.level.checked_sub(PAGE_LEVELS)?;
        Some(Level::new(
            self.grid,
            level,
            left.width as u32,
            left.height as u32,
        ))
    }

    /// Makes and writes all pages.
    pub(super) fn run(
        &self,
        rows: &mut dyn Rows,
        writer: &mut DatasetWriter,
        progress: Progress<'_>,
    ) -> Result<Above, BuildError> {
        let mut above = Above {
            width: self.columns + 1,
            height: self.rows + 1,
            heights: vec![HOLE; (self.columns + 1) * (self.rows + 1)],
            slots: Slots::new(self.columns, self.rows),
        };
        let families = self.columns.div_ceil(PAGE_CELLS);
        let mut band = Band {
            stride: families * FAMILY_CELLS + 1,
            samples: Vec::new(),
        };
        band.samples = vec![HOLE; band.stride * (FAMILY_CELLS + 1)];
        for number in (0..self.rows.div_ceil(PAGE_CELLS)).rev() {
            self.fill(&mut band, number, rows)?;
            let slots = rows.slots();
            let made = (0..families)
                .into_par_iter()
                .map(|column| self.family(&band, column, number, slots))
                .collect::<Result<Vec<_>, _>>()?;
            for family in made {
                if let Some(bytes) = family.bytes {
                    writer.append(&bytes)?;
                }
                for (column, row, slot) in family.slots {
                    above.slots.set(column, row, slot);
                }
            }
            self.keep_corners(&band, number, &mut above);
            let done = self.height.saturating_sub(number * FAMILY_CELLS);
            progress(done as u64, self.height as u64);
        }
        Ok(above)
    }

    /// Reads a band. Its northern row is the southern row of the band before.
    fn fill(&self, band: &mut Band, number: usize, rows: &mut dyn Rows) -> Result<(), BuildError> {
        let stride = band.stride;
        let first = number * FAMILY_CELLS;
        band.samples.copy_within(..stride, FAMILY_CELLS * stride);
        band.samples[..FAMILY_CELLS * stride].fill(HOLE);
        let is_northern = first + FAMILY_CELLS + 1 >= self.height;
        let n = if is_northern {
            self.height - first
        } else {
            FAMILY_CELLS
        };
        if !rows.may_have_data(first as u32, n as u32) {
            return Ok(());
        }
        let mut read = vec![HOLE; n * self.width];
        rows.read(first as u32, n as u32, &mut read)?;
        for (row, samples) in read.chunks_exact(self.width).enumerate() {
            band.samples[row * stride..][..self.width].copy_from_slice(samples);
        }
        Ok(())
    }

    fn family(
        &self,
        band: &Band,
        column: usize,
        number: usize,
        slots: Option<&Slots>,
    ) -> Result<Family, BuildError> {
        let mut records = Vec::new();
        let mut left = Vec::new();
        let mut id = FamilyId::ROOT;
        let is_finest = slots.is_none();
        if is_finest && self.level > 0 && band.is_empty_below(column * FAMILY_CELLS) {
            // Its slots are empty until told otherwise.
            return Ok(Family {
                bytes: None,
                slots: left,
            });
        }
        for slot in (0..PAGE_SLOTS).map(|i| Slot::from_index(i as u8)) {
            let (dx, dy) = slot.position();
            let (x, y) = (column * PAGE_CELLS + dx, number * PAGE_CELLS + dy);
            if x >= self.columns || y >= self.rows {
                continue;
            }
            // Pages that the data reaches lie in the grid.
            let Some(page) = PageId::new(self.level, x as u32, y as u32) else {
                continue;
            };
            id = FamilyId::of(page);
            let (made, own) = self.page(band, page, dy, slots)?;
            if let Some(made) = made.filter(|_| own.has_record() || page == PageId::ROOT) {
                records.push((slot, Record::encode(&made).bytes().to_vec()));
            }
            left.push((x, y, own));
        }
        Ok(Family {
            bytes: FamilyBytes::encode(id, &records),
            slots: left,
        })
    }

    /// A page, unless its parent's slot says all that there is to say of it.
    fn page(
        &self,
        band: &Band,
        page: PageId,
        band_row: usize,
        slots: Option<&Slots>,
    ) -> Result<(Option<Page>, ChildSlot), BuildError> {
        let (x, y) = (page.square().x as usize * PAGE_CELLS, band_row * PAGE_CELLS);
        let mut samples = [None; PAGE_AREA];
        for (row, samples) in samples.chunks_exact_mut(PAGE_SAMPLES).enumerate() {
            let from = &band.samples[(y + row) * band.stride + x..][..PAGE_SAMPLES];
            for (sample, &height) in samples.iter_mut().zip(from) {
                *sample = (height != HOLE).then_some(height);
            }
        }
        let slots = slots.map(|slots| {
            let (x, y) = (x, page.square().y as usize * PAGE_CELLS);
            Box::new(std::array::from_fn(|i| {
                let (dx, dy) = Slot::from_index(i as u8).position();
                slots.get(x + dx, y + dy)
            }))
        });
        if page != PageId::ROOT
            && let Some(own) = self.unstored(page, &samples, slots.as_deref())
        {
            return Ok((None, own));
        }
        let finest = slots.is_none();
        let (page, bounds) = Page::with_bounds(page, &samples, slots)?;
        let own = match bounds.slot() {
            ChildSlot::Empty if finest => band.lone_samples(x, y),
            slot => slot,
        };
        Ok((Some(page), own))
    }

    /// What the parent says of a page that needs no record: there is nothing in it, or nothing
    /// but what its corners imply.
    fn unstored(
        &self,
        page: PageId,
        samples: &[Option<i32>; PAGE_AREA],
        slots: Option<&[ChildSlot; PAGE_SLOTS]>,
    ) -> Option<ChildSlot> {
        let is_empty = |slot: &ChildSlot| *slot == ChildSlot::Empty;
        if samples.iter().all(Option::is_none) && slots.is_none_or(|s| s.iter().all(is_empty)) {
            return Some(ChildSlot::Empty);
        }
        implied_slot(page, self.grid, samples, slots)
    }

    /// Keeps the samples at page corners for the level above.
    fn keep_corners(&self, band: &Band, number: usize, above: &mut Above) {
        for row in 0..=PAGE_CELLS {
            let to = number * PAGE_CELLS + row;
            if to >= above.height {
                break;
            }
            let from = &band.samples[row * PAGE_CELLS * band.stride..][..band.stride];
            let kept = from.iter().step_by(PAGE_CELLS).take(above.width);
            for (out, &height) in above.heights[to * above.width..].iter_mut().zip(kept) {
                *out = height;
            }
        }
    }
}
