//! Pages that are stored nowhere: below a flat cell the parent's two triangles are the surface,
//! and below an empty one there is none.

use super::{ChildSlot, PAGE_AREA, Page, Range};
use crate::err8::Err8;
use crate::geometry::{PAGE_CELLS, PAGE_SAMPLES, PAGE_SLOTS, PageId, Quadrant, Slot};

impl Page {
    /// The page below a cell that has no record. `None` if a record is stored for it, or if this
    /// page's slots have not arrived, or at the depth limit.
    pub fn implied_child(&self, slot: Slot, finest: bool) -> Option<Page> {
        if !self.has_slots() || self.slot(slot).has_record() {
            return None;
        }
        let id = self.id.child(slot)?;
        Some(match self.slot(slot) {
            ChildSlot::Empty => Page::empty(id, finest),
            _ => self.flat_child(id, slot, finest),
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

    fn flat_child(&self, id: PageId, slot: Slot, finest: bool) -> Page {
        let (column, row) = slot.position();
        let corner = |dx, dy| i64::from(self.height((row + dy) * PAGE_SAMPLES + column + dx));
        let corners = [corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1)];
        let square = id.square();
        let rises = Quadrant::of(square.x, square.y).rises();
        let mut page = Page::blank(id, finest);
        page.parts = page.last_part();
        for (at, height) in page.heights.iter_mut().enumerate() {
            let place = ((at % PAGE_SAMPLES) as i64, (at / PAGE_SAMPLES) as i64);
            let scaled = two_triangles(corners, rises, place, PAGE_CELLS as i64);
            *height = scaled.div_euclid(PAGE_CELLS as i64) as i32;
        }
        page.slots = (!finest).then(|| Box::new([ChildSlot::Full(Err8(0)); PAGE_SLOTS]));
        page
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
