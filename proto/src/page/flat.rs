//! Pages that are stored nowhere: below an empty cell there is no surface; below a flat one it is
//! the parent's two triangles, and below a cut one what these imply.
//!
//! ```text
//! nw ........ ne     A height is that of the cell's two triangles, rounded down. So those on a
//! :         / :      side of the cell follow from the side's two ends alone, and pages on its
//! :     /     :      two sides share them. Below, each cell of the page implies its own page in
//! : /         :      the same way, down to the finest: an exactly defined grid of integers,
//! sw ........ se     less than one quantum a level from the two triangles.
//! ```

use super::{ChildSlot, PAGE_AREA, Page, Range};
use crate::err8::Err8;
use crate::geometry::{
    GridLevels, PAGE_CELLS, PAGE_LEVELS, PAGE_SAMPLES, PAGE_SLOTS, PageId, Quadrant, Slot,
};

/// A page's corners: south-west, south-east, north-west, north-east.
const CORNERS: [usize; 4] = [0, PAGE_SAMPLES - 1, PAGE_AREA - PAGE_SAMPLES, PAGE_AREA - 1];

/// The heights of a page that nothing is stored of, from its corners: south-west, south-east,
/// north-west, north-east.
pub fn implied_heights(id: PageId, corners: [i32; 4]) -> [i32; PAGE_AREA] {
    let square = id.square();
    let rises = Quadrant::of(square.x, square.y).rises();
    let corners = corners.map(i64::from);
    std::array::from_fn(|at| implied_height(corners, rises, at))
}

fn implied_height(corners: [i64; 4], rises: bool, at: usize) -> i32 {
    let place = ((at % PAGE_SAMPLES) as i64, (at / PAGE_SAMPLES) as i64);
    let scaled = two_triangles(corners, rises, place, PAGE_CELLS as i64);
    scaled.div_euclid(PAGE_CELLS as i64) as i32
}

/// What a parent can say of a page instead of storing it: that it is flat, or cut. `None` if the
/// page, without holes, or what hangs below it, is not just what its corners imply.
pub fn implied_slot(
    id: PageId,
    grid: GridLevels,
    heights: &[i32; PAGE_AREA],
    slots: Option<&[ChildSlot; PAGE_SLOTS]>,
) -> Option<ChildSlot> {
    let corners = CORNERS.map(|at| i64::from(heights[at]));
    let stored_below = |slot: &ChildSlot| slot.has_record() || *slot == ChildSlot::Empty;
    if slots.is_some_and(|slots| slots.iter().any(stored_below)) {
        return None;
    }
    let square = id.square();
    let rises = Quadrant::of(square.x, square.y).rises();
    let is_implied = |at| heights[at] == implied_height(corners, rises, at);
    // The middle first: it tells most pages apart.
    if !is_implied(PAGE_AREA / 2) || !(0..PAGE_AREA).all(is_implied) {
        return None;
    }
    Some(cell_slot(corners, levels_below(id, grid) + 1))
}

/// What a parent can say of a cell below which nothing is to be stored, from the cell's corners
/// (south-west, south-east, north-west, north-east) and how many levels of pages hang below it:
/// flat, or cut.
pub fn implied_cell(corners: [i32; 4], levels: u8) -> ChildSlot {
    cell_slot(corners.map(i64::from), levels)
}

/// Levels of pages below a page.
fn levels_below(id: PageId, grid: GridLevels) -> u8 {
    grid.finest_page_level().saturating_sub(id.level()) / PAGE_LEVELS
}

/// What is known below a cell when nothing is stored, with so many levels of pages below it. It
/// is flat if no height is rounded on any of them: if all sides rise by whole quanta a sample.
/// Each level rounds by less than a quantum.
fn cell_slot([sw, se, nw, ne]: [i64; 4], levels: u8) -> ChildSlot {
    let cells = 1i64 << (PAGE_LEVELS * levels).min(60);
    let is_even = |rise: i64| rise % cells == 0;
    if [se - sw, ne - nw, nw - sw, ne - se]
        .into_iter()
        .all(is_even)
    {
        return ChildSlot::Full(Err8(0));
    }
    ChildSlot::Cut(Err8::covering(u32::from(levels)).unwrap_or(Err8(u8::MAX)))
}

impl Page {
    /// The page below a cell that has no record. `None` if a record is stored for it, or if this
    /// page's slots have not arrived, or at the depth limit.
    pub fn implied_child(&self, slot: Slot, grid: GridLevels) -> Option<Page> {
        if !self.has_slots() || self.slot(slot).has_record() {
            return None;
        }
        let id = self.id.child(slot)?;
        Some(match self.slot(slot) {
            ChildSlot::Empty => Page::empty(id, grid.is_finest(id)),
            told => self.interpolated_child(id, slot, told, grid),
        })
    }

    /// A page without any data.
    pub fn empty(id: PageId, finest: bool) -> Page {
        let mut page = Page::blank(id, finest);
        page.parts = page.last_part();
        page.valid = Some(Box::new([false; PAGE_AREA]));
        page.range = Range::EMPTY;
        page.slots = (!finest).then(|| Box::new([ChildSlot::Empty; PAGE_SLOTS]));
        page
    }

    fn interpolated_child(
        &self,
        id: PageId,
        slot: Slot,
        told: ChildSlot,
        grid: GridLevels,
    ) -> Page {
        let (column, row) = slot.position();
        let south_west = row * PAGE_SAMPLES + column;
        let beside = [0, 1, PAGE_SAMPLES, PAGE_SAMPLES + 1];
        let corners = beside.map(|corner| self.height(south_west + corner));
        let finest = grid.is_finest(id);
        let mut page = Page::blank(id, finest);
        page.parts = page.last_part();
        *page.heights = implied_heights(id, corners);
        page.slots = (!finest).then(|| match told {
            ChildSlot::Cut(_) => page.implied_slots(levels_below(id, grid)),
            _ => Box::new([ChildSlot::Full(Err8(0)); PAGE_SLOTS]),
        });
        page.has_cuts = page.any_cut();
        page
    }

    fn implied_slots(&self, levels: u8) -> Box<[ChildSlot; PAGE_SLOTS]> {
        Box::new(std::array::from_fn(|i| {
            let (column, row) = Slot::from_index(i as u8).position();
            let corner = |dx, dy| i64::from(self.heights[(row + dy) * PAGE_SAMPLES + column + dx]);
            let corners = [corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1)];
            cell_slot(corners, levels)
        }))
    }
}

/// `side` times the height, at `(u, v)` in `0..=side`, of a square's two triangles. Corners are
/// south-west, south-east, north-west, north-east; the diagonal rises from south-west or falls
/// from north-west.
pub(super) fn two_triangles(
    [sw, se, nw, ne]: [i64; 4],
    rises: bool,
    (u, v): (i64, i64),
    side: i64,
) -> i64 {
    match (rises, if rises { u >= v } else { u + v <= side }) {
        (true, true) => side * sw + u * (se - sw) + v * (ne - se),
        (true, false) => side * sw + v * (nw - sw) + u * (ne - nw),
        (false, true) => side * sw + u * (se - sw) + v * (nw - sw),
        (false, false) => side * ne + (side - u) * (nw - ne) + (side - v) * (se - ne),
    }
}
