//! All pages of one level, band by band.

use super::above::{Above, Slots};
use super::band::{Band, Bands, MOST_AHEAD};
use super::checkpoint::{Checkpoints, Done};
use super::quantise::HOLE;
use super::rows::Rows;
use super::{BuildError, Progress};
use crate::dataset::{DatasetWriter, FamilyBytes, FamilyId};
use escarp_proto::geometry::{
    GridLevels, PAGE_CELLS, PAGE_LEVELS, PAGE_SAMPLES, PAGE_SLOTS, PageId, Slot,
};
use escarp_proto::page::{
    ChildSlot, Codec, Kind, PAGE_AREA, Page, PageError, Record, implied_slot,
};
use rayon::prelude::*;

/// Cells on the side of a family.
pub(crate) const FAMILY_CELLS: usize = PAGE_CELLS * PAGE_CELLS;

/// The pages of one level that the data reaches.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Level {
    pub(super) grid: GridLevels,
    pub(super) level: u8,
    pub(super) codec: Codec,
    /// Samples at this level's spacing.
    pub(super) width: usize,
    pub(super) height: usize,
    /// Pages.
    pub(super) columns: usize,
    pub(super) rows: usize,
}

/// The pages of a family: encoded, and what each leaves for the level above.
struct Family {
    bytes: Option<FamilyBytes>,
    slots: Vec<(usize, usize, ChildSlot)>,
}

impl Level {
    pub(crate) fn new(
        grid: GridLevels,
        level: u8,
        [width, height]: [u32; 2],
        codec: Codec,
    ) -> Level {
        let pages = |samples: u32| (samples as usize - 1).div_ceil(PAGE_CELLS).max(1);
        Level {
            grid,
            level,
            codec,
            width: width as usize,
            height: height as usize,
            columns: pages(width),
            rows: pages(height),
        }
    }

    /// The level whose samples this one leaves; `None` above the root.
    pub(crate) fn above(&self) -> Option<Level> {
        let level = self.level.checked_sub(PAGE_LEVELS)?;
        let size = [self.columns as u32 + 1, self.rows as u32 + 1];
        Some(Level::new(self.grid, level, size, self.codec))
    }

    /// Level of its pages.
    pub(crate) const fn level(&self) -> u8 {
        self.level
    }

    /// Bands of families.
    pub(crate) const fn bands(&self) -> usize {
        self.rows.div_ceil(PAGE_CELLS)
    }

    /// Whether a family is one of the grid's, of any level.
    pub(super) fn has(&self, family: FamilyId) -> bool {
        let page = family.page(Slot::from_index(0));
        page.is_some_and(|page| self.grid.holds(page))
    }

    /// Samples that the data has at this level.
    pub(super) const fn samples(&self) -> u64 {
        self.width as u64 * self.height as u64
    }

    /// Columns and rows of pages.
    pub(crate) const fn pages(&self) -> (usize, usize) {
        (self.columns, self.rows)
    }

    /// Samples of a band.
    pub(super) const fn band_samples(&self) -> u64 {
        self.width as u64 * FAMILY_CELLS as u64
    }

    /// What the level leaves, before any band is done.
    pub(super) fn new_above(&self) -> Above {
        Above {
            width: self.columns + 1,
            height: self.rows + 1,
            heights: vec![HOLE; (self.columns + 1) * (self.rows + 1)],
            slots: Slots::new(self.columns, self.rows),
        }
    }

    /// Makes and writes all pages. While a band is encoded, the next one is read.
    pub(super) fn run(
        &self,
        rows: &mut dyn Rows,
        slots: Option<&Slots>,
        writer: &mut DatasetWriter,
        checkpoints: &mut Checkpoints,
        progress: Progress<'_>,
    ) -> Result<Above, BuildError> {
        let done = checkpoints.take(self.level).unwrap_or_else(|| Done {
            above: self.new_above(),
            bands_left: self.bands(),
        });
        let (mut above, bands_left) = (done.above, done.bands_left);
        let mut bands = Bands::new(self, MOST_AHEAD);
        if bands_left < self.bands() {
            let northern = (bands_left * FAMILY_CELLS) as u32;
            rows.read(northern, 1, bands.now.stride, &mut bands.now.samples)?;
            rows.resume(checkpoints.stored());
        }
        if let Some(first) = bands_left.checked_sub(1) {
            bands.read(self, first, rows)?;
        }
        for number in (0..bands_left).rev() {
            let stored = rows.stored();
            let band = &bands.now;
            let families = || {
                let columns = (0..self.columns.div_ceil(PAGE_CELLS)).into_par_iter();
                let made = columns.map(|column| self.family(band, column, number, slots));
                made.collect::<Result<Vec<_>, _>>()
            };
            let next = number.checked_sub(1).zip(bands.next.as_mut());
            let read = || match next {
                Some((number, next)) => next.fill(self, number, band, rows),
                None => Ok(()),
            };
            let (made, read) = rayon::join(families, read);
            for family in made? {
                if let Some(bytes) = family.bytes {
                    writer.append(&bytes)?;
                }
                for (column, row, slot) in family.slots {
                    above.slots.set(column, row, slot);
                }
            }
            self.keep_corners(&bands.now, number, &mut above);
            checkpoints.band(self, number, &above, stored, writer)?;
            let done = self.height.saturating_sub(number * FAMILY_CELLS);
            progress(done as u64, self.height as u64);
            // An error of the next band comes after all that is sound has been noted.
            read?;
            if let Some(next) = number.checked_sub(1) {
                bands.advance(self, next, rows)?;
            }
        }
        Ok(above)
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
            if page != PageId::ROOT && Self::is_void(band, page, dy, slots) {
                continue;
            }
            let (record, own) = self.record(band, page, dy, slots)?;
            records.extend(record.map(|record| (slot, record)));
            left.push((x, y, own));
        }
        Ok(Family {
            bytes: FamilyBytes::encode(id, &records),
            slots: left,
        })
    }

    /// A page's record, if one is stored, and what the level above has to know of the page.
    pub(crate) fn record(
        &self,
        band: &Band,
        page: PageId,
        band_row: usize,
        slots: Option<&Slots>,
    ) -> Result<(Option<Vec<u8>>, ChildSlot), PageError> {
        let (made, own) = self.page(band, page, band_row, slots)?;
        let made = made.filter(|_| own.has_record() || page == PageId::ROOT);
        let record = made.map(|made| Record::encode(&made, self.codec).bytes().to_vec());
        Ok((record, own))
    }

    /// Whether nothing is in a page, nor below it: then it is empty, which slots are from the start.
    fn is_void(band: &Band, page: PageId, band_row: usize, slots: Option<&Slots>) -> bool {
        let (x, y) = (page.square().x as usize * PAGE_CELLS, band_row * PAGE_CELLS);
        let west = x - band.west;
        let rows = band.samples.chunks_exact(band.stride).skip(y);
        let samples = rows
            .take(PAGE_SAMPLES)
            .flat_map(|row| &row[west..][..PAGE_SAMPLES]);
        let row = page.square().y as usize * PAGE_CELLS;
        samples.copied().all(|height| height == HOLE)
            && slots.is_none_or(|slots| {
                let below = (0..PAGE_SLOTS).map(|i| Slot::from_index(i as u8).position());
                let kinds = below.map(|(dx, dy)| slots.get(x + dx, row + dy).kind());
                kinds.into_iter().all(|kind| kind == Kind::Empty)
            })
    }

    /// A page, unless its parent's slot says all that there is to say of it.
    fn page(
        &self,
        band: &Band,
        page: PageId,
        band_row: usize,
        slots: Option<&Slots>,
    ) -> Result<(Option<Page>, ChildSlot), PageError> {
        let (x, y) = (page.square().x as usize * PAGE_CELLS, band_row * PAGE_CELLS);
        let mut heights = Box::new([HOLE; PAGE_AREA]);
        for (row, heights) in heights.chunks_exact_mut(PAGE_SAMPLES).enumerate() {
            let from = (y + row) * band.stride + x - band.west;
            heights.copy_from_slice(&band.samples[from..][..PAGE_SAMPLES]);
        }
        let holes = heights
            .iter()
            .fold(false, |any, &height| any | (height == HOLE));
        let valid = holes.then(|| Box::new(heights.map(|height| height != HOLE)));
        let slots = slots.map(|slots| {
            let (x, y) = (x, page.square().y as usize * PAGE_CELLS);
            Box::new(std::array::from_fn(|i| {
                let (dx, dy) = Slot::from_index(i as u8).position();
                slots.get(x + dx, y + dy)
            }))
        });
        if page != PageId::ROOT
            && valid.is_none()
            && let Some(own) = implied_slot(page, self.grid, &heights, slots.as_deref())
        {
            return Ok((None, own));
        }
        let finest = slots.is_none();
        let (page, slot) = Page::with_slot(page, heights, valid, slots)?;
        let own = match slot {
            ChildSlot::Empty if finest => {
                let is_last = |at: u32, count: usize| usize::from(at as usize + 1 == count);
                let columns = PAGE_CELLS + is_last(page.id().square().x, self.columns);
                let rows = PAGE_CELLS + is_last(page.id().square().y, self.rows);
                band.lone_samples((x, y), (columns, rows))
            }
            slot => slot,
        };
        Ok((Some(page), own))
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

#[cfg(test)]
mod tests {
    use super::super::above::MemoryRows;
    use super::*;

    #[test]
    fn a_band_is_the_same_whether_read_ahead_or_in_turn() {
        let grid = GridLevels::new(12).unwrap();
        let level = Level::new(grid, 8, [300, 900], Codec::Dense);
        let above = Above {
            width: 300,
            height: 900,
            heights: (0..300 * 900).collect(),
            slots: Slots::new(1, 1),
        };
        let (mut ahead, mut in_turn) = (Bands::new(&level, usize::MAX), Bands::new(&level, 0));
        let (mut rows, mut same_rows) = (MemoryRows::new(&above), MemoryRows::new(&above));
        ahead.read(&level, 3, &mut rows).unwrap();
        in_turn.read(&level, 3, &mut same_rows).unwrap();
        for number in (0..4).rev() {
            assert!(ahead.now.samples == in_turn.now.samples, "band {number}");
            for (x, y) in [(0, 0), (299, 5), (17, 256), (300, 0), (4, 132)] {
                let row = number * FAMILY_CELLS + y;
                let inside = x < 300 && row < 900;
                let height = inside.then_some((row * 300 + x) as i32);
                assert_eq!(ahead.now.sample(x, y), height, "band {number}: {x}, {y}");
            }
            if let Some(below) = number.checked_sub(1) {
                let next = ahead.next.as_mut().unwrap();
                next.fill(&level, below, &ahead.now, &mut rows).unwrap();
                ahead.advance(&level, below, &mut rows).unwrap();
                in_turn.advance(&level, below, &mut same_rows).unwrap();
            }
        }
    }
}
