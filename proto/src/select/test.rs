//! Downwards: which triangles and cells of a page are beyond the tolerance.

use super::around::{Around, Heights, metres};
use super::eyes::Eyes;
use super::limits::{Axis, limit, rows, squares};
use super::marks::Marks;
use super::sketch::{Sketch, Told, first};
use super::{Known, NONE, PART_COUNTS, PageKind, Scope, Seen, Selection, below};
use crate::geometry::{GridLevels, PAGE_CELLS, PAGE_LEVELS, PageId, Slot};
use crate::georef::WorldBox;
use crate::page::{SLOT_PART, last_part};
use crate::sight::Sight;
use crate::sight::squares::PAGE_SQUARES;

/// One selection's view.
pub(super) struct Pass<'a> {
    grid: GridLevels,
    sight: &'a Sight,
    eyes: Eyes,
    scope: Scope,
}

/// What the tests of a page found.
pub(super) struct Found {
    pub(super) parts: u8,
    pub(super) guessed: bool,
    excess: [f32; PART_COUNTS],
    pub(super) marks: Marks,
    /// Cells that are beyond the tolerance, by row.
    pub(super) cells: [u16; PAGE_CELLS],
}

impl Selection {
    /// Tests all pages from the root downwards.
    pub(super) fn test(&mut self, pass: &Pass<'_>, known: &mut dyn Known) {
        if let Some(root) = self.add(PageId::ROOT, NONE, PageKind::Stored) {
            let root = &mut self.entries[root as usize];
            root.seen = Seen::Some;
            root.excess[0] = f32::INFINITY;
        }
        let mut next = 0;
        while next < self.entries.len() {
            self.test_page(pass, next as u32, known);
            next += 1;
        }
    }

    fn test_page(&mut self, pass: &Pass<'_>, index: u32, known: &mut dyn Known) {
        let entry = &mut self.entries[index as usize];
        let Some(sketch) = known.sketch(entry.id) else {
            entry.guessed = true;
            entry.parts = parts_for(entry.excess[0]);
            entry.own_parts = entry.parts;
            return;
        };
        let around = pass.around(entry.id);
        let is_stored = entry.kind == PageKind::Stored;
        let found = pass.find(entry.id, &sketch, &around, is_stored);
        entry.guessed = found.guessed;
        (entry.own_parts, entry.parts) = (found.parts, found.parts);
        entry.excess[1..].copy_from_slice(&found.excess[1..]);
        entry.marks = found.marks;
        entry.sketch = Some(sketch.clone());
        let heights = around.heights(&sketch.all());
        for row in 0..PAGE_CELLS {
            let mut left = found.cells[row];
            while left != 0 {
                let column = left.trailing_zeros() as usize;
                left &= left - 1;
                self.add_below(pass, index, &sketch, (&around, &heights), (column, row));
            }
        }
    }

    fn add_below(
        &mut self,
        pass: &Pass<'_>,
        index: u32,
        sketch: &Sketch,
        (around, heights): (&Around, &Heights<'_>),
        (column, row): (usize, usize),
    ) {
        let above = &self.entries[index as usize];
        let slot = Slot::at(column, row);
        let Some(id) = below(above.id, slot.index()) else {
            return;
        };
        let Some(cells) = &sketch.cells else { return };
        let at = column * PAGE_CELLS + row;
        let seen = match above.seen {
            Seen::Some => pass.seen(id, sketch, [cells.lo[at], cells.hi[at]]),
            told => told,
        };
        if pass.scope == Scope::InView && seen == Seen::Nothing {
            return;
        }
        let flat = around.flat_of(column, row);
        let high = heights.above([cells.lo[at], cells.hi[at]]);
        let excess = metres(cells.errors[at]) / flat.max(high);
        let kind = match cells.stored[row] >> column & 1 {
            0 => PageKind::Implied,
            _ => PageKind::Stored,
        };
        match self.add(id, index, kind) {
            Some(child) => {
                self.entries[index as usize].marks.cells[row] |= 1 << column;
                let child = &mut self.entries[child as usize];
                (child.seen, child.excess[0]) = (seen, excess);
            }
            None => self.left_out = self.left_out.max(excess),
        }
    }
}

/// Each level of vertices about halves the error, so this many parts bring it down.
fn parts_for(excess: f32) -> u8 {
    (excess.max(1.0).log2().ceil() as u8).clamp(1, SLOT_PART)
}

impl<'a> Pass<'a> {
    pub(super) fn new(grid: GridLevels, sight: &'a Sight, scope: Scope) -> Pass<'a> {
        let eyes = Eyes::at(sight.tests.eye_m);
        Pass {
            grid,
            sight,
            eyes,
            scope,
        }
    }

    /// The same from wherever the eye may be.
    pub(super) fn from(self, eyes: Eyes) -> Pass<'a> {
        Pass { eyes, ..self }
    }

    /// What the tests find of a page that is stored.
    #[cfg(test)]
    pub(super) fn find_in(&self, id: PageId, sketch: &Sketch) -> Found {
        self.find(id, sketch, &self.around(id), true)
    }

    fn around(&self, id: PageId) -> Around {
        Around::new(self.grid, self.sight, &self.eyes, id)
    }

    /// Whether a page may be seen, by a range of heights, coded as the page above has it.
    fn seen(&self, id: PageId, above: &Sketch, range: [u8; 2]) -> Seen {
        let (x, y) = self.grid.page_origin(id);
        let cells = self.grid.square_cells(id.level());
        let [lo, hi] =
            range.map(|code| above.all().steps.height(code) as f64 * self.sight.quantum_m());
        let line = |grid, axis| self.sight.grid_m(grid, axis);
        let min = [line(x, 0), line(y, 1), lo];
        let max = [line(x + cells, 0), line(y + cells, 1), hi];
        // What one eye sees of a page, another one sees of the page moved the other way.
        let (eye_m, eyes) = (self.sight.tests.eye_m, &self.eyes);
        let region = WorldBox {
            min: std::array::from_fn(|i| min[i] - (eyes.hi_m[i] - eye_m[i])),
            max: std::array::from_fn(|i| max[i] - (eyes.lo_m[i] - eye_m[i])),
        };
        let frustum = &self.sight.frustum;
        match (frustum.may_see(&region), frustum.sees_all(&region)) {
            (false, _) => Seen::Nothing,
            (true, true) => Seen::All,
            (true, false) => Seen::Some,
        }
    }

    fn find(&self, id: PageId, sketch: &Sketch, around: &Around, is_stored: bool) -> Found {
        let last = last_part(self.grid.is_finest(id));
        let mut found = Found {
            parts: last,
            guessed: false,
            excess: [0.0; PART_COUNTS],
            marks: Marks::default(),
            cells: [0; PAGE_CELLS],
        };
        found.marks.centres[0] = 1;
        if is_stored {
            found.count_parts(sketch, around, last);
        }
        found.mark(sketch, around, last);
        found
    }
}

impl Found {
    /// How many parts are enough.
    fn count_parts(&mut self, sketch: &Sketch, around: &Around, last: u8) {
        let known = sketch.parts.min(last);
        let all = around.heights(&sketch.all());
        let nearest = around.nearest(&all);
        for part in 1..last.min(known + 1) {
            let code = sketch.rest[usize::from(part)];
            let fails = match sketch.has_holes {
                true => code >= limit(around.nearest_by(&all, code)),
                false => around.any_fails(&around.heights(&sketch.told(part)), part, code),
            };
            if !fails {
                self.parts = part;
                return;
            }
            self.excess[usize::from(part)] = metres(code) / nearest;
        }
        if last > known {
            self.guessed = true;
            let excess = self.excess[usize::from(known)];
            self.parts = last.min(known + parts_for(excess));
        }
    }

    /// What is beyond the tolerance by what so many parts tell.
    fn mark(&mut self, sketch: &Sketch, around: &Around, last: u8) {
        let parts = self.parts.min(sketch.parts);
        let depth = parts.min(PAGE_LEVELS);
        let told = sketch.told(parts);
        let heights = around.heights(&told);
        let is_steep = around.is_steep(&heights);
        // Outlines leave no more than a bound for all squares of a level until all is here.
        let by_level = sketch.has_holes && parts < sketch.parts.min(last);
        let limits = match (is_steep, by_level) {
            (false, _) => None,
            (true, false) => Some(heights.limits(depth)),
            (true, true) => {
                let code = sketch.rest[usize::from(parts)];
                Some([limit(around.nearest_by(&heights, code)); PAGE_SQUARES])
            }
        };
        let [columns, rows] = around.axes();
        let level = Level {
            told,
            columns,
            rows,
            limits,
            alike: by_level.then_some(&sketch.rest),
        };
        level.mark_to(depth, &mut self.marks);
        if self.parts > PAGE_LEVELS
            && let Some(cells) = &sketch.cells
        {
            let limits = is_steep.then(|| heights.limits_of(&cells.lo, &cells.hi));
            let (x, y) = (columns.halves::<PAGE_CELLS>(), rows.halves::<PAGE_CELLS>());
            let limits = limits.as_ref().map(|limits| &limits[..]);
            self.cells = self::rows(&cells.errors, &x.whole, &y.whole, limits);
        }
    }
}

/// What the squares of a page are held against.
struct Level<'a> {
    told: Told<'a>,
    columns: &'a Axis,
    rows: &'a Axis,
    /// Of heights, if they count.
    limits: Option<[u16; PAGE_SQUARES]>,
    /// Bounds of all squares of a level, if nothing is told of each.
    alike: Option<&'a [u16; PAGE_LEVELS as usize + 1]>,
}

impl Level<'_> {
    /// Marks what fails among the squares of so many levels.
    fn mark_to(&self, depth: u8, marks: &mut Marks) {
        self.mark::<1>(0, marks);
        if depth > 1 {
            self.mark::<2>(1, marks);
        }
        if depth > 2 {
            self.mark::<4>(2, marks);
        }
        if depth > 3 {
            self.mark::<8>(3, marks);
        }
    }

    /// Marks what fails among the squares of a level.
    fn mark<const N: usize>(&self, level: u8, marks: &mut Marks) {
        let at = first(level)..first(level) + N * N;
        let alike = self.alike.map(|bounds| [bounds[usize::from(level)]; 64]);
        let alike = alike.as_ref().map(|alike| &alike[..N * N]);
        let (x, y) = (self.columns.halves::<N>(), self.rows.halves::<N>());
        let limits = self.limits.as_ref().map(|limits| &limits[at.clone()]);
        let edges = [
            (&x.upper, &y.whole),
            (&x.whole, &y.upper),
            (&x.lower, &y.whole),
            (&x.whole, &y.lower),
        ];
        for (edge, (x, y)) in edges.into_iter().enumerate() {
            let codes = alike.unwrap_or(&self.told.edges[edge][at.clone()]);
            marks.edges[usize::from(level)][edge] |= squares(codes, x, y, limits);
        }
        if level > 0 {
            let codes = alike.unwrap_or(&self.told.halves[at]);
            let found = squares(codes, &x.whole, &y.whole, limits);
            marks.centres[usize::from(level)] |= found;
        }
    }
}
