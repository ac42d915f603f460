//! Upwards: what the vertices that are beyond the tolerance depend on.
//!
//! An edge vertex needs the centres on both of its sides; a centre, of a page's root as well,
//! needs the edge vertices at its square's corners, which are of the next coarser level. So going
//! from the finest level to the coarsest, each is complete when the next one is looked at. What a
//! page on the way has only for others' sake passes all tests, as does the cell in which it hangs:
//! its own triangles need not be looked at.

use super::{Known, NONE, PageKind, Seen, Selection};
use crate::geometry::{Edge, PAGE_LEVELS, PageId};
use crate::page::SLOT_PART;

impl Selection {
    /// Adds all that is depended on.
    pub(super) fn close(&mut self, known: &mut dyn Known) {
        for depth in (0..self.levels.len()).rev() {
            if self.levels[depth].is_empty() {
                continue;
            }
            for level in (0..usize::from(PAGE_LEVELS)).rev() {
                self.close_level(depth, level, known);
            }
            for at in 0..self.levels[depth].len() {
                self.hang(self.levels[depth][at]);
            }
        }
    }

    /// Completes the squares of one level.
    fn close_level(&mut self, depth: usize, level: usize, known: &mut dyn Known) {
        // Pages that come meanwhile have nothing on this level that others depend on.
        for at in 0..self.levels[depth].len() {
            let index = self.levels[depth][at];
            let marks = &mut self.entries[index as usize].marks;
            marks.take_corners(level);
            if marks.edges[level] == [0; 4] {
                continue;
            }
            for edge in Edge::ALL {
                let marks = self.entries[index as usize].marks.across(level, edge);
                if marks != 0 {
                    self.pass_on(index, (level, edge), marks, known);
                }
            }
        }
        for at in 0..self.levels[depth].len() {
            let index = self.levels[depth][at];
            self.entries[index as usize].marks.take_edges(level);
        }
    }

    /// Vertices on a border are those of the page across as well.
    fn pass_on(
        &mut self,
        index: u32,
        (level, edge): (usize, Edge),
        marks: u64,
        known: &mut dyn Known,
    ) {
        let neighbour = self.neighbour(index, edge, known);
        if neighbour == NONE {
            return;
        }
        let entry = &self.entries[index as usize];
        let in_view = entry.blocks || entry.seen != Seen::Nothing;
        let excess = entry.excess[level];
        let beyond = &mut self.entries[neighbour as usize];
        beyond.marks.edges[level][edge.opposite() as usize] |= marks;
        if level >= usize::from(beyond.own_parts) {
            beyond.blocks |= in_view;
            for lacking in &mut beyond.excess[..=level] {
                *lacking = lacking.max(excess);
            }
        }
    }

    /// The page across an edge, which is added if need be; [`NONE`] if there is none.
    fn neighbour(&mut self, index: u32, edge: Edge, known: &mut dyn Known) -> u32 {
        let entry = &self.entries[index as usize];
        let kept = entry.neighbours[edge as usize];
        if kept != NONE {
            return kept;
        }
        let Some(id) = entry.id.neighbour(edge) else {
            return NONE;
        };
        let found = self.ensure(id, known);
        self.entries[index as usize].neighbours[edge as usize] = found;
        if found != NONE {
            self.entries[found as usize].neighbours[edge.opposite() as usize] = index;
        }
        found
    }

    /// The entry of a page, which is added if need be, as are those above it. [`NONE`] if there is
    /// no room.
    fn ensure(&mut self, id: PageId, known: &mut dyn Known) -> u32 {
        if let Some(&index) = self.by_id.get(&id) {
            return index;
        }
        let Some((above, slot)) = id.parent() else {
            return NONE;
        };
        let parent = self.ensure(above, known);
        if parent == NONE {
            return NONE;
        }
        let above = &mut self.entries[parent as usize];
        let kind = match above.kind {
            PageKind::Stored => {
                if above.sketch.is_none() && !above.guessed {
                    above.sketch = known.sketch(above.id);
                    above.guessed = above.sketch.is_none();
                }
                match above
                    .sketch
                    .as_ref()
                    .and_then(|sketch| sketch.has_record(slot))
                {
                    Some(true) => PageKind::Stored,
                    Some(false) => PageKind::Implied,
                    None => PageKind::Unknown,
                }
            }
            other => other,
        };
        self.add(id, parent, kind).unwrap_or(NONE)
    }

    /// A page hangs below another, which is complete as far as it depends on it.
    fn hang(&mut self, index: u32) {
        let entry = &mut self.entries[index as usize];
        entry.marks.centres[0] = 1;
        entry.parts = entry.own_parts.max(entry.marks.parts());
        let (id, parent) = (entry.id, entry.parent);
        let in_view = entry.blocks || entry.seen != Seen::Nothing;
        let excess = entry.excess[0];
        let Some((_, slot)) = id.parent() else { return };
        let (column, row) = slot.position();
        let above = &mut self.entries[parent as usize];
        above.marks.cells[row] |= 1 << column;
        if above.own_parts < SLOT_PART {
            above.blocks |= in_view;
            for lacking in &mut above.excess[..usize::from(SLOT_PART)] {
                *lacking = lacking.max(excess);
            }
        }
    }
}
