//! Which pages, and how many of their parts, a mesh needs for a view: the selection.
//!
//! The server makes it for each view over the whole dataset, and sends what the client has not;
//! the client makes it over what is resident, for a view that is yet to come. It lists what the
//! default mesher would have asked for, page by page, until nothing more is beyond the tolerance,
//! without building a mesh:
//!
//! ```text
//! downwards   from the root: how many parts until the bound of what is missing is within the
//!   (test)    tolerance, and with them, which triangles and cells are beyond it; below those
//!             cells, the pages that hang there
//! upwards     from the finest pages: what the vertices of these triangles depend on, square by
//!   (close)   square and across the borders of pages; which may be pages of their own
//! ```
//!
//! Bounds never grow when parts arrive, so a client with more than what is listed asks for no more
//! either. Where a test is not the mesh's own, bit by bit, it is on the safe side: what is listed
//! may be a little more than what the mesh asks for, never less.

mod around;
mod close;
mod eyes;
mod limits;
mod marks;
mod sketch;
mod test;
#[cfg(test)]
mod tests;

pub use eyes::Eyes;
pub use sketch::Sketch;

use crate::geometry::{GridLevels, PageId, Slot};
use crate::georef::Georef;
use crate::page::{SLOT_PART, last_part};
use crate::sight::Sight;
use crate::view::View;
use crate::wire::Class;
pub use crate::wire::Scope;
use marks::Marks;
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};
use std::sync::Arc;

/// Counts of parts that a client may have of a page, header apart: 0 to [`SLOT_PART`].
pub const PART_COUNTS: usize = SLOT_PART as usize + 1;

/// Where the selection looks pages up.
pub trait Known {
    /// What is known of a page: one with a record, or one whose slot says that it is cut. It is
    /// asked for a page only after all those above it. `None` if nothing is: it is damaged, or not
    /// here.
    fn sketch(&mut self, page: PageId) -> Option<Arc<Sketch>>;
}

/// What is selected for.
#[derive(Debug, Clone, Copy)]
pub struct Look<'a> {
    /// The view, but for its eye.
    pub view: &'a View,
    /// Where the eye may be.
    pub eyes: Eyes,
    /// What of the terrain is of use.
    pub scope: Scope,
}

/// A page with a record that the mesh needs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Need {
    /// The page.
    pub page: PageId,
    /// The last part that is needed.
    pub last_part: u8,
    /// Blocker if something in view waits for it, InView if it may be seen itself, else Ring.
    pub class: Class,
    /// By the number of parts that the client has of the page, header apart: about how many times
    /// over the tolerance the mesh stands for the lack of the rest. 0 from `last_part` on.
    pub excess: [f32; PART_COUNTS],
    /// Nothing is known of the page, so that its last part, and what is below it, is a guess.
    pub guessed: bool,
}

/// What a selection came to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// Some needs were left out, as the limit was reached.
    pub truncated: bool,
    /// About how many times over the tolerance the mesh stands with all that is listed; 1 if
    /// nothing was left out.
    pub excess: f32,
    /// Pages that were looked at, those without a record included.
    pub pages: usize,
}

/// Selects, and keeps the room that it takes for the next time. One serves any number of
/// datasets and sessions, one at a time.
#[derive(Debug, Default)]
pub struct Selection {
    entries: Vec<Entry>,
    by_id: HashMap<PageId, u32, BuildHasherDefault<KeyHasher>>,
    /// Entries by level of pages.
    levels: [Vec<u32>; PAGE_DEPTH],
    most: usize,
    truncated: bool,
    left_out: f32,
}

/// Levels of pages, at most.
const PAGE_DEPTH: usize = 7;
/// No entry.
const NONE: u32 = u32::MAX;

/// What is known of a page before its sketch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum PageKind {
    /// It has a record.
    Stored,
    /// It has none, and follows from the page above.
    Implied,
    /// Whether it has one is not known, nor whether it is there at all.
    Unknown,
}

/// A page that is needed.
#[derive(Debug)]
struct Entry {
    id: PageId,
    parent: u32,
    kind: PageKind,
    sketch: Option<Arc<Sketch>>,
    /// Parts that its own tests ask for; 0 if it is there for others only.
    own_parts: u8,
    parts: u8,
    guessed: bool,
    seen: Seen,
    /// Something in view waits for it.
    blocks: bool,
    excess: [f32; PART_COUNTS],
    neighbours: [u32; 4],
    marks: Marks,
}

/// Whether a page may be seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Seen {
    Nothing,
    Some,
    All,
}

impl Selection {
    /// Selects for a view that is in order ([`View::check`]): at most `limit` needs, those of
    /// coarser pages first, so that each comes after the page above it.
    ///
    /// Takes time and memory in proportion to the needs, and those to `limit`, whatever the
    /// sketches say.
    pub fn select(
        &mut self,
        space: (GridLevels, &Georef),
        view: &View,
        scope: Scope,
        known: &mut dyn Known,
        limit: usize,
        out: &mut Vec<Need>,
    ) -> Outcome {
        let eyes = Eyes::at(view.eye_m);
        self.select_for(space, Look { view, eyes, scope }, known, limit, out)
    }

    /// The same for all views that differ from one in nothing but where the eye is: what is listed
    /// is enough for each of them.
    pub fn select_for(
        &mut self,
        (grid, georef): (GridLevels, &Georef),
        Look { view, eyes, scope }: Look<'_>,
        known: &mut dyn Known,
        limit: usize,
        out: &mut Vec<Need>,
    ) -> Outcome {
        self.clear(limit);
        let sight = Sight::new(georef, view);
        self.test(&test::Pass::new(grid, &sight, scope).from(eyes), known);
        self.close(known);
        let outcome = self.list(grid, limit, out);
        self.clear(0);
        outcome
    }

    fn clear(&mut self, limit: usize) {
        self.entries.clear();
        self.by_id.clear();
        self.levels.iter_mut().for_each(Vec::clear);
        // Pages without a record, and those that are there for others only, count as well.
        self.most = limit.saturating_mul(4).clamp(64, NONE as usize);
        self.truncated = false;
        self.left_out = 1.0;
    }

    /// A new entry; `None` if there are too many.
    fn add(&mut self, id: PageId, parent: u32, kind: PageKind) -> Option<u32> {
        if self.entries.len() >= self.most {
            self.truncated = true;
            return None;
        }
        let index = self.entries.len() as u32;
        self.entries.push(Entry {
            id,
            parent,
            kind,
            sketch: None,
            own_parts: 0,
            parts: 1,
            guessed: false,
            seen: Seen::Nothing,
            blocks: false,
            excess: [0.0; PART_COUNTS],
            neighbours: [NONE; 4],
            marks: Marks::default(),
        });
        self.by_id.insert(id, index);
        self.levels[usize::from(id.level() / 4)].push(index);
        Some(index)
    }

    fn list(&self, grid: GridLevels, limit: usize, out: &mut Vec<Need>) -> Outcome {
        out.clear();
        let mut outcome = Outcome {
            truncated: self.truncated,
            excess: self.left_out,
            pages: self.entries.len(),
        };
        let indices = self.levels.iter().flatten();
        let entries = indices.map(|&index| &self.entries[index as usize]);
        for entry in entries.filter(|entry| entry.kind == PageKind::Stored) {
            let need = entry.need(grid);
            if out.len() < limit {
                out.push(need);
            } else {
                outcome.truncated = true;
                outcome.excess = outcome.excess.max(need.excess[0]);
            }
        }
        outcome
    }
}

impl Entry {
    fn need(&self, grid: GridLevels) -> Need {
        let last_part = self.parts.min(last_part(grid.is_finest(self.id)));
        let mut excess = self.excess;
        excess[usize::from(last_part)..].fill(0.0);
        let is_seen = self.seen != Seen::Nothing;
        let for_others = self.parts > self.own_parts;
        Need {
            page: self.id,
            last_part,
            class: match (self.blocks && for_others, is_seen) {
                (true, _) => Class::Blocker,
                (false, true) => Class::InView,
                (false, false) => Class::Ring,
            },
            excess,
            guessed: self.guessed,
        }
    }
}

/// Hashes a page's place; nobody gains by making some collide but those who made the dataset.
#[derive(Debug, Default)]
struct KeyHasher(u64);

impl Hasher for KeyHasher {
    fn write(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.write_u64(byte.into());
        }
    }

    fn write_u8(&mut self, value: u8) {
        self.write_u64(value.into());
    }

    fn write_u32(&mut self, value: u32) {
        self.write_u64(value.into());
    }

    fn write_u64(&mut self, value: u64) {
        self.0 = (self.0.rotate_left(23) ^ value).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }

    fn finish(&self) -> u64 {
        self.0 ^ self.0 >> 29
    }
}

/// The page below a slot, which is there if the page above has been looked at.
fn below(page: PageId, slot: usize) -> Option<PageId> {
    page.child(Slot::from_index(slot as u8))
}
