//! A page: heights, holes and child slots of a subtree of [`PAGE_LEVELS`] levels.
//!
//! A page is a record of parts. Part 0 is the header; part `k` in `1..=4` holds the vertices of
//! the page's level `k`; part 5 holds the child slots, and is absent in the finest pages. Any
//! prefix of parts is usable: every vertex in it is final, and an error bound covers what has not
//! arrived. `tiles/FORMAT.md` has the byte map.

mod bounds;
mod codec0;
mod codec1;
mod flat;
#[cfg(test)]
pub(crate) mod oracle;
mod record;

pub use bounds::{Bounds, BoxError, SquareErrors, square_index};
pub use codec1::{CodedBits, SymbolCounts};
pub use flat::{implied_cell, implied_heights, implied_slot};
pub use record::{Codec, Record, RecordHeader, RevisionDigest, revision};

use crate::err8::Err8;
use crate::geometry::{PAGE_CELLS, PAGE_LEVELS, PAGE_SAMPLES, PAGE_SLOTS, PageId, Slot};
use thiserror::Error;

/// Heights are integers in a dataset's quantum, at most this far from zero.
pub const MAX_HEIGHT: i32 = 1 << 30;
/// The largest difference of two heights, hence of a surface and any mesh of it, in quanta.
pub const MAX_SPAN: u32 = 1 << 31;
/// Samples in a full page.
pub const PAGE_AREA: usize = PAGE_SAMPLES * PAGE_SAMPLES;
/// Part that holds the child slots.
pub const SLOT_PART: u8 = PAGE_LEVELS + 1;
/// No record is longer: 289 residuals of five bytes, masks, 256 slots of eleven bytes, header.
pub const MAX_RECORD_BYTES: usize = 8192;

/// What a region of the grid holds. Regions are judged by their finest triangles, which are valid
/// if their three samples are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[repr(u8)]
pub enum Kind {
    /// Surface everywhere.
    #[default]
    Full,
    /// Surface nowhere.
    Empty,
    /// The outline of a hole, or of the data, crosses it.
    Mixed,
}

impl Kind {
    /// What two regions hold together.
    pub const fn merge(self, other: Kind) -> Kind {
        match (self, other) {
            (Kind::Full, Kind::Full) => Kind::Full,
            (Kind::Empty, Kind::Empty) => Kind::Empty,
            _ => Kind::Mixed,
        }
    }
}

/// Lowest and highest height of a region, in quanta. Empty when `lo > hi`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Range {
    /// Lowest height.
    pub lo: i32,
    /// Highest height.
    pub hi: i32,
}

impl Range {
    /// The range of nothing.
    pub const EMPTY: Range = Range {
        lo: i32::MAX,
        hi: i32::MIN,
    };

    /// The smallest range that holds both.
    pub fn union(self, other: Range) -> Range {
        Range {
            lo: self.lo.min(other.lo),
            hi: self.hi.max(other.hi),
        }
    }

    /// What both hold.
    pub fn intersection(self, other: Range) -> Range {
        Range {
            lo: self.lo.max(other.lo),
            hi: self.hi.min(other.hi),
        }
    }

    /// The smallest range that holds this one and a height.
    pub fn with(self, height: i32) -> Range {
        self.union(Range {
            lo: height,
            hi: height,
        })
    }

    /// This range widened by a bound, within the allowed heights.
    pub fn widened(self, by: u32) -> Range {
        if self.is_empty() {
            return self;
        }
        let limit = i64::from(MAX_HEIGHT);
        Range {
            lo: (i64::from(self.lo) - i64::from(by)).max(-limit) as i32,
            hi: (i64::from(self.hi) + i64::from(by)).min(limit) as i32,
        }
    }

    /// Whether it holds no height.
    pub const fn is_empty(self) -> bool {
        self.lo > self.hi
    }

    /// `hi - lo`, or 0 if empty.
    pub const fn span(self) -> u32 {
        if self.is_empty() {
            0
        } else {
            self.hi.abs_diff(self.lo)
        }
    }

    /// Whether the other range lies inside.
    pub const fn contains(self, other: Range) -> bool {
        other.is_empty() || (self.lo <= other.lo && other.hi <= self.hi)
    }
}

/// What a page knows of the surface below one of its cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ChildSlot {
    /// Surface everywhere, no further than this bound from the cell's two triangles.
    /// At zero nothing hangs below: the two triangles are the surface.
    Full(Err8),
    /// Surface everywhere, as [`Full`](Self::Full) says, but nothing is stored below: it is what
    /// the cell's four corners imply, interpolated page by page and rounded down.
    Cut(Err8),
    /// No surface: nothing hangs below.
    #[default]
    Empty,
    /// An outline crosses the cell. All heights in it lie in this range.
    Mixed(Range),
}

impl ChildSlot {
    /// What the cell holds.
    pub const fn kind(self) -> Kind {
        match self {
            ChildSlot::Full(_) | ChildSlot::Cut(_) => Kind::Full,
            ChildSlot::Empty => Kind::Empty,
            ChildSlot::Mixed(_) => Kind::Mixed,
        }
    }

    /// Whether a record is stored for the child page.
    pub const fn has_record(self) -> bool {
        match self {
            ChildSlot::Full(error) => error.0 > 0,
            ChildSlot::Empty | ChildSlot::Cut(_) => false,
            ChildSlot::Mixed(_) => true,
        }
    }
}

/// Why page bytes were refused.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum PageError {
    /// The bytes end inside a field.
    #[error("page {page}: bytes end inside {field}")]
    Short {
        /// The page.
        page: PageId,
        /// What was being read.
        field: &'static str,
    },
    /// Bytes follow the last part.
    #[error("page {page}: {left} bytes left over after part {part}")]
    Long {
        /// The page.
        page: PageId,
        /// The last part read.
        part: u8,
        /// How many bytes follow.
        left: usize,
    },
    /// A field has a value that the format does not allow.
    #[error("page {page}: {field} is {found}, allowed is {allowed}")]
    Value {
        /// The page.
        page: PageId,
        /// The field.
        field: &'static str,
        /// Its value.
        found: i64,
        /// What may stand there.
        allowed: &'static str,
    },
    /// A checksum does not match.
    #[error("page {page}: checksum {found:08x}, expected {expected:08x}")]
    Checksum {
        /// The page.
        page: PageId,
        /// Computed from the bytes.
        found: u32,
        /// Stored beside them.
        expected: u32,
    },
}

/// A page as far as its parts have arrived.
#[derive(Debug, Clone, PartialEq)]
pub struct Page {
    id: PageId,
    finest: bool,
    parts: u8,
    heights: Box<[i32; PAGE_AREA]>,
    /// Present if the page has holes.
    valid: Option<Box<[bool; PAGE_AREA]>>,
    /// All valid heights below the page; known, and needed, only if it has holes.
    range: Range,
    /// `rest[k - 1]`: how far the surface may be from the mesh of parts `1..=k`.
    rest: [Err8; PAGE_LEVELS as usize],
    slots: Option<Box<[ChildSlot; PAGE_SLOTS]>>,
    /// Whether some of its slots are cut, known before they have arrived.
    has_cuts: bool,
    /// While parts of a dense record are missing: where the decoder stands.
    stream: Option<codec1::Stream>,
}

impl Page {
    /// A whole page from samples in row-major order from the south-west; `None` is a hole.
    /// `slots` is given for every page but the finest.
    ///
    /// # Errors
    /// [`PageError::Value`] if a height is beyond [`MAX_HEIGHT`].
    pub fn new(
        id: PageId,
        samples: &[Option<i32>; PAGE_AREA],
        slots: Option<Box<[ChildSlot; PAGE_SLOTS]>>,
    ) -> Result<Page, PageError> {
        let holes = samples.iter().any(Option::is_none);
        let valid = holes.then(|| Box::new(samples.map(|sample| sample.is_some())));
        let heights = Box::new(samples.map(|sample| sample.unwrap_or(0)));
        Page::with_slot(id, heights, valid, slots).map(|(page, _)| page)
    }

    /// As [`new`](Self::new), with what the parent's slot must say of the page. `valid` is given
    /// if any sample is a hole; the heights there count for nothing.
    ///
    /// # Errors
    /// [`PageError::Value`] if a height is beyond [`MAX_HEIGHT`].
    pub fn with_slot(
        id: PageId,
        heights: Box<[i32; PAGE_AREA]>,
        valid: Option<Box<[bool; PAGE_AREA]>>,
        slots: Option<Box<[ChildSlot; PAGE_SLOTS]>>,
    ) -> Result<(Page, ChildSlot), PageError> {
        let mut page = Page {
            id,
            finest: slots.is_none(),
            parts: last_part(slots.is_none()),
            heights,
            valid,
            range: Range::EMPTY,
            rest: [Err8(0); PAGE_LEVELS as usize],
            slots,
            has_cuts: false,
            stream: None,
        };
        page.has_cuts = page.any_cut();
        for (i, &height) in page.heights.iter().enumerate() {
            if page.is_valid(i) {
                codec0::check_height(id, i64::from(height))?;
            }
        }
        if page.valid.is_none() && page.slot_kinds().any(|kind| kind != Kind::Full) {
            page.valid = Some(Box::new([true; PAGE_AREA]));
        }
        if page.has_holes() {
            page.range = page.holed_range();
            codec0::fill_holes(&mut page);
        }
        let (rest, slot) = bounds::of_whole(&page);
        page.rest = rest;
        Ok((page, slot))
    }

    fn blank(id: PageId, finest: bool) -> Page {
        Page {
            id,
            finest,
            parts: 0,
            heights: Box::new([0; PAGE_AREA]),
            valid: None,
            range: Range::EMPTY,
            rest: [Err8(0); PAGE_LEVELS as usize],
            slots: None,
            has_cuts: false,
            stream: None,
        }
    }

    /// As it was when only these parts had arrived, of a page without holes.
    fn with_fewer(&self, parts: u8) -> Page {
        Page {
            parts,
            heights: self.heights.clone(),
            rest: self.rest,
            ..Page::blank(self.id, self.finest)
        }
    }

    fn any_cut(&self) -> bool {
        let mut slots = self.slots.iter().flat_map(|slots| slots.iter());
        slots.any(|slot| matches!(slot, ChildSlot::Cut(_)))
    }

    /// The range of all samples, and of everything below.
    fn holed_range(&self) -> Range {
        let samples = (0..PAGE_AREA).filter(|&i| self.is_valid(i));
        let own = samples.fold(Range::EMPTY, |range, i| range.with(self.heights[i]));
        (0..PAGE_SLOTS).fold(own, |range, i| {
            let slot = Slot::from_index(i as u8);
            range.union(match self.slot(slot) {
                ChildSlot::Full(error) | ChildSlot::Cut(error) => {
                    self.cell_range(slot).widened(error.bound())
                }
                ChildSlot::Mixed(below) => below,
                ChildSlot::Empty => Range::EMPTY,
            })
        })
    }

    /// Range of a cell's valid corners.
    fn cell_range(&self, slot: Slot) -> Range {
        let (column, row) = slot.position();
        let south_west = row * PAGE_SAMPLES + column;
        [0, 1, PAGE_SAMPLES, PAGE_SAMPLES + 1]
            .into_iter()
            .map(|corner| south_west + corner)
            .filter(|&i| self.is_valid(i))
            .fold(Range::EMPTY, |range, i| range.with(self.heights[i]))
    }

    fn slot_kinds(&self) -> impl Iterator<Item = Kind> + '_ {
        self.slots
            .iter()
            .flat_map(|slots| slots.iter())
            .map(|slot| slot.kind())
    }

    /// The page's identity.
    pub const fn id(&self) -> PageId {
        self.id
    }

    /// Whether it holds the finest samples, so that nothing hangs below.
    pub const fn is_finest(&self) -> bool {
        self.finest
    }

    /// Parts that have arrived, header apart: `1..=last_part()`.
    pub const fn parts(&self) -> u8 {
        self.parts
    }

    /// Parts of the whole page: 5, or 4 in the finest.
    pub const fn last_part(&self) -> u8 {
        last_part(self.finest)
    }

    /// Levels of vertices that have arrived, `1..=4`.
    pub const fn depth(&self) -> u8 {
        if self.parts > PAGE_LEVELS {
            PAGE_LEVELS
        } else {
            self.parts
        }
    }

    /// Height at a sample of the full page's grid, row-major from the south-west; in a hole, the
    /// fill. Only samples of arrived parts are meaningful.
    pub fn height(&self, sample: usize) -> i32 {
        self.heights[sample]
    }

    /// Whether there is data at a sample.
    pub fn is_valid(&self, sample: usize) -> bool {
        self.valid.as_ref().is_none_or(|valid| valid[sample])
    }

    /// Whether any outline crosses the page, or nothing is in it.
    pub const fn has_holes(&self) -> bool {
        self.valid.is_some()
    }

    /// What is known of the surface below a cell at full depth. In the finest pages a cell is
    /// the surface itself; before part 5 has arrived, the page's own bound stands for each cell.
    pub fn slot(&self, slot: Slot) -> ChildSlot {
        match &self.slots {
            Some(slots) => slots[slot.index()],
            None if self.finest && self.parts >= PAGE_LEVELS => self.finest_cell(slot),
            None => self.slot_until(self.depth()),
        }
    }

    /// What stands for each cell while no more than parts `1..=part` have arrived; known once
    /// these have.
    pub(crate) fn slot_until(&self, part: u8) -> ChildSlot {
        match self.has_holes() {
            true => ChildSlot::Mixed(self.range),
            false => ChildSlot::Full(self.rest[part as usize - 1]),
        }
    }

    /// A finest cell is judged by its two triangles.
    fn finest_cell(&self, slot: Slot) -> ChildSlot {
        if !self.has_holes() {
            return ChildSlot::Full(Err8(0));
        }
        let (column, row) = slot.position();
        let corner = |dx, dy| self.is_valid((row + dy) * PAGE_SAMPLES + column + dx);
        let (sw, se, nw, ne) = (corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1));
        let (ends, tips) = if (column + row) % 2 == 0 {
            (sw && ne, [se, nw])
        } else {
            (nw && se, [sw, ne])
        };
        match (ends && tips[0], ends && tips[1]) {
            (true, true) => ChildSlot::Full(Err8(0)),
            (false, false) => ChildSlot::Empty,
            _ => ChildSlot::Mixed(self.cell_range(slot)),
        }
    }

    /// How far the surface may be from the mesh of parts `1..=part`, in quanta. Known once that
    /// part has arrived; without meaning in a page with holes.
    pub fn rest_bound(&self, part: u8) -> u32 {
        self.rest[part as usize - 1].bound()
    }

    /// Whether a record, or a flat or empty page in its place, can hang below its cells.
    pub const fn has_slots(&self) -> bool {
        self.slots.is_some()
    }
}

/// Parts of a whole page.
pub const fn last_part(finest: bool) -> u8 {
    if finest { PAGE_LEVELS } else { SLOT_PART }
}

/// Samples between vertices of a page's level `k` in the full page's grid.
pub const fn level_step(level: u8) -> usize {
    PAGE_CELLS >> level
}
