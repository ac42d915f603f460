//! All pages of one level, band by band.

use super::checkpoint::{Checkpoints, Done};
use super::quantise::HOLE;
use super::rows::Rows;
use super::{BuildError, Progress};
use crate::dataset::{DatasetWriter, FamilyBytes, FamilyId};
use escarp_proto::err8::Err8;
use escarp_proto::geometry::{
    GridLevels, PAGE_CELLS, PAGE_LEVELS, PAGE_SAMPLES, PAGE_SLOTS, PageId, Slot,
};
use escarp_proto::page::{
    ChildSlot, Codec, Kind, PAGE_AREA, Page, PageError, Range, Record, implied_slot,
};
use rayon::prelude::*;
use std::collections::HashMap;

/// Cells on the side of a family.
pub(crate) const FAMILY_CELLS: usize = PAGE_CELLS * PAGE_CELLS;

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
pub(crate) struct Slots {
    /// The first column and row.
    first: (usize, usize),
    columns: usize,
    states: Vec<State>,
    errors: Vec<Err8>,
    mixed: HashMap<usize, Range>,
}

impl Slots {
    fn new(columns: usize, rows: usize) -> Slots {
        Self::window((0, 0), columns, rows)
    }

    /// Of a part of a level.
    pub(crate) fn window(first: (usize, usize), columns: usize, rows: usize) -> Slots {
        Slots {
            first,
            columns,
            states: vec![State::Empty; columns * rows],
            errors: vec![Err8(0); columns * rows],
            mixed: HashMap::new(),
        }
    }

    pub(crate) fn set(&mut self, column: usize, row: usize, slot: ChildSlot) {
        let at = (row - self.first.1) * self.columns + column - self.first.0;
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
    pub(crate) fn get(&self, column: usize, row: usize) -> ChildSlot {
        let (column, row) = (column - self.first.0, row - self.first.1);
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
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) heights: Vec<i32>,
    pub(super) slots: Slots,
}

/// Rows of the samples that a level below left.
pub(super) struct MemoryRows<'a> {
    from: &'a Above,
}

impl<'a> MemoryRows<'a> {
    pub(super) fn new(from: &'a Above) -> Self {
        MemoryRows { from }
    }
}

impl Rows for MemoryRows<'_> {
    fn read(
        &mut self,
        first: u32,
        n: u32,
        stride: usize,
        out: &mut [i32],
    ) -> Result<(), BuildError> {
        let width = self.from.width;
        let rows = self.from.heights.chunks_exact(width).skip(first as usize);
        for (out, row) in out.chunks_mut(stride).zip(rows.take(n as usize)) {
            out[..width].copy_from_slice(row);
        }
        Ok(())
    }
}

/// The pages of one level that the data reaches.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Level {
    grid: GridLevels,
    level: u8,
    codec: Codec,
    /// Samples at this level's spacing.
    width: usize,
    height: usize,
    /// Pages.
    columns: usize,
    rows: usize,
}

/// 257 rows of samples, southern row first, as wide as whole families; or a part of them.
pub(crate) struct Band {
    /// Its first column.
    pub(crate) west: usize,
    pub(crate) stride: usize,
    pub(crate) samples: Vec<i32>,
}

/// Samples of a band up to which the next is read while one is encoded: wider ones take turns, so
/// that memory is that of one.
const MOST_AHEAD: usize = 1 << 25;

/// The band that is encoded, and the one that is read meanwhile.
struct Bands {
    now: Band,
    next: Option<Band>,
}

impl Bands {
    fn new(level: &Level, most_ahead: usize) -> Bands {
        let now = Band::new(level);
        let next = (now.samples.len() <= most_ahead).then(|| Band::new(level));
        Bands { now, next }
    }

    /// Reads the first band; the southern row of the one before it is where a band has its own.
    fn read(
        &mut self,
        level: &Level,
        number: usize,
        rows: &mut dyn Rows,
    ) -> Result<(), BuildError> {
        self.now.carry_over();
        self.now.fill_below(level, number, rows)
    }

    /// Goes on to the next band.
    fn advance(
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
    fn new(level: &Level) -> Band {
        let stride = level.columns.div_ceil(PAGE_CELLS) * FAMILY_CELLS + 1;
        Band {
            west: 0,
            stride,
            samples: vec![HOLE; stride * (FAMILY_CELLS + 1)],
        }
    }

    /// Makes the southern row the northern one.
    fn carry_over(&mut self) {
        let stride = self.stride;
        self.samples.copy_within(..stride, FAMILY_CELLS * stride);
    }

    /// Reads a band. Its northern row is the southern row of the band before.
    fn fill(
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
    fn fill_below(
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

    fn sample(&self, x: usize, y: usize) -> Option<i32> {
        let x = x.checked_sub(self.west)?;
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
    /// samples which are on no triangle of any page is stored for their sake. Of samples that
    /// pages share, the page to the north-east counts, if there is one.
    fn lone_samples(&self, (x, y): (usize, usize), (columns, rows): (usize, usize)) -> ChildSlot {
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
