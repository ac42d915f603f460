//! Downwards: which triangles and cells of a page are beyond the tolerance.

use super::limits::{Axis, limit, limit_with, rows, squares};
use super::marks::Marks;
use super::sketch::{Sketch, first};
use super::{Known, NONE, PART_COUNTS, PageKind, Scope, Seen, Selection, below};
use crate::geometry::{
    GridLevels, PAGE_CELLS, PAGE_LEVELS, PAGE_SAMPLES, PAGE_SLOTS, PageId, Slot,
};
use crate::georef::WorldBox;
use crate::page::{SLOT_PART, last_part};
use crate::sight::Sight;
use crate::sight::squares::{ErrorCode, PAGE_SQUARES};

/// One selection's view.
pub(super) struct Pass<'a> {
    grid: GridLevels,
    sight: &'a Sight,
    scope: Scope,
}

/// A page from the eye, in metres of error: distances over the threshold.
struct Around {
    columns: [f32; PAGE_SAMPLES],
    rows: [f32; PAGE_SAMPLES],
    /// Height of the page's lowest step above the eye, and what a step adds; and how much of that
    /// may be rounding.
    base: f32,
    step: f32,
    slack: f32,
    /// How far the page is to the side.
    flat: f32,
    /// A metre.
    metre: f32,
}

/// Heights of the squares of a page that count beside the distance to the side.
struct Heights<'a> {
    around: &'a Around,
    sketch: &'a Sketch,
    /// By how much heights may be farther out.
    wider: f32,
    /// Nothing is known but those of the whole page.
    of_page: bool,
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
        let around = pass.around(entry.id, &sketch);
        let is_stored = entry.kind == PageKind::Stored;
        let found = pass.find(entry.id, &sketch, &around, is_stored);
        entry.guessed = found.guessed;
        (entry.own_parts, entry.parts) = (found.parts, found.parts);
        entry.excess[1..].copy_from_slice(&found.excess[1..]);
        entry.marks = found.marks;
        entry.sketch = Some(sketch.clone());
        for row in 0..PAGE_CELLS {
            let mut left = found.cells[row];
            while left != 0 {
                let column = left.trailing_zeros() as usize;
                left &= left - 1;
                self.add_below(pass, index, &sketch, &around, (column, row));
            }
        }
    }

    fn add_below(
        &mut self,
        pass: &Pass<'_>,
        index: u32,
        sketch: &Sketch,
        around: &Around,
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
        let flat = around.flat_of(column, row, 1);
        let high = around.above([cells.lo[at], cells.hi[at]]);
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

fn metres(code: u16) -> f32 {
    ErrorCode::from_code(code).metres() as f32
}

impl<'a> Pass<'a> {
    pub(super) fn new(grid: GridLevels, sight: &'a Sight, scope: Scope) -> Pass<'a> {
        Pass { grid, sight, scope }
    }

    /// What the tests find of a page that is stored.
    #[cfg(test)]
    pub(super) fn find_in(&self, id: PageId, sketch: &Sketch) -> Found {
        self.find(id, sketch, &self.around(id, sketch), true)
    }

    fn around(&self, id: PageId, sketch: &Sketch) -> Around {
        let tests = &self.sight.tests;
        let (x, y) = self.grid.page_origin(id);
        let stride = self.grid.page_stride(id);
        let line = |origin: u32, axis: usize, i: usize| {
            let at_m = self.sight.grid_m(origin + i as u32 * stride, axis);
            ((at_m - tests.eye_m[axis]) / tests.threshold) as f32
        };
        let columns = std::array::from_fn(|i| line(x, 0, i));
        let rows = std::array::from_fn(|i| line(y, 1, i));
        let height_m = |code| sketch.steps.height(code) as f64 * self.sight.quantum_m();
        let base = ((height_m(0) - tests.eye_m[2]) / tests.threshold) as f32;
        let step = ((height_m(1) - height_m(0)) / tests.threshold) as f32;
        let last = PAGE_SAMPLES - 1;
        let outside = |lines: &[f32; PAGE_SAMPLES]| lines[0].max(-lines[last]).max(0.0);
        Around {
            base,
            step,
            slack: (base.abs() + 255.0 * step) * 1e-6,
            flat: outside(&columns).max(outside(&rows)),
            columns,
            rows,
            metre: (1.0 / tests.threshold) as f32,
        }
    }

    /// Whether a page may be seen, by a range of heights, coded as the page above has it.
    fn seen(&self, id: PageId, above: &Sketch, range: [u8; 2]) -> Seen {
        let (x, y) = self.grid.page_origin(id);
        let cells = self.grid.square_cells(id.level());
        let [lo, hi] = range.map(|code| above.steps.height(code) as f64 * self.sight.quantum_m());
        let line = |grid, axis| self.sight.grid_m(grid, axis);
        let region = WorldBox {
            min: [line(x, 0), line(y, 1), lo],
            max: [line(x + cells, 0), line(y + cells, 1), hi],
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
        let nearest = around.nearest(sketch);
        let mut found = Found {
            parts: last,
            guessed: false,
            excess: [0.0; PART_COUNTS],
            marks: Marks::default(),
            cells: [0; PAGE_CELLS],
        };
        found.marks.centres[0] = 1;
        // What stands for the parts that a client has not, though they are known here.
        let mut rest = None;
        if is_stored {
            let known = sketch.parts.min(last);
            for part in 1..last.min(known + 1) {
                let code = sketch.rest[usize::from(part)];
                if !around.any_fails(sketch, part, code) {
                    found.parts = part;
                    rest = (part < known).then_some(code);
                    break;
                }
                found.excess[usize::from(part)] = metres(code) / nearest;
            }
            if found.parts > known {
                found.guessed = true;
                let excess = found.excess[usize::from(known)];
                found.parts = last.min(known + parts_for(excess));
            }
        }
        let depth = found.parts.min(sketch.parts).min(PAGE_LEVELS);
        let heights = around.heights(sketch, rest.map_or(0.0, |rest| around.wider(rest)));
        let outlines = rest.is_some() && sketch.has_holes;
        let more = rest.filter(|_| !outlines).map_or(0.0, metres);
        let (columns, rows) = (
            Axis::new(&around.columns, more),
            Axis::new(&around.rows, more),
        );
        let level = |(columns, rows), more: f32, by_level: bool| Level {
            sketch,
            columns,
            rows,
            heights: heights.as_ref().map(|heights| heights.limits(more)),
            by_level: by_level.then(|| {
                let of_level = |level: usize| [sketch.rest[level]; PAGE_SQUARES];
                Box::new(std::array::from_fn(of_level))
            }),
        };
        level((&columns, &rows), more, outlines).mark_to(depth, &mut found.marks);
        if more > 0.0 {
            // Nor is anything beyond the tolerance of which fewer parts say that it is not.
            let mut most = Marks::default();
            let columns = Axis::new(&around.columns, 0.0);
            let rows = Axis::new(&around.rows, 0.0);
            level((&columns, &rows), 0.0, true).mark_to(depth, &mut most);
            most.centres[0] = 1;
            found.marks.keep_common(&most);
        }
        if found.parts > PAGE_LEVELS
            && let Some(cells) = &sketch.cells
        {
            let limits = heights.map(|heights| heights.cell_limits(0.0));
            let (x, y) = (columns.halves::<PAGE_CELLS>(), rows.halves::<PAGE_CELLS>());
            let limits = limits.as_ref().map(|limits| &limits[..]);
            found.cells = self::rows(&cells.errors, &x.whole, &y.whole, limits);
        }
        found
    }
}

/// What the squares of a page are held against.
struct Level<'a> {
    sketch: &'a Sketch,
    columns: &'a Axis,
    rows: &'a Axis,
    heights: Option<[u16; PAGE_SQUARES]>,
    /// If all that counts is what a number of parts says of all squares alike: that, by level.
    by_level: Option<Box<[[u16; PAGE_SQUARES]; PAGE_LEVELS as usize]>>,
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

    /// What is believed of the squares of a level.
    fn codes<'a>(&'a self, known: &'a [u16; PAGE_SQUARES], level: u8) -> &'a [u16; PAGE_SQUARES] {
        match &self.by_level {
            Some(rest) => &rest[usize::from(level)],
            None => known,
        }
    }

    /// Marks what fails among the squares of a level.
    fn mark<const N: usize>(&self, level: u8, marks: &mut Marks) {
        let at = first(level)..first(level) + N * N;
        let (x, y) = (self.columns.halves::<N>(), self.rows.halves::<N>());
        let heights = self.heights.as_ref().map(|heights| &heights[at.clone()]);
        let edges = [
            (&x.upper, &y.whole),
            (&x.whole, &y.upper),
            (&x.lower, &y.whole),
            (&x.whole, &y.lower),
        ];
        for (edge, (x, y)) in edges.into_iter().enumerate() {
            let codes = self.codes(&self.sketch.edges[edge], level);
            marks.edges[usize::from(level)][edge] |= squares(&codes[at.clone()], x, y, heights);
        }
        if level > 0 {
            let codes = self.codes(&self.sketch.halves, level);
            let found = squares(&codes[at], &x.whole, &y.whole, heights);
            marks.centres[usize::from(level)] |= found;
        }
    }
}

impl Around {
    /// How far a square, `cells` of the page wide, is to the side.
    fn flat_of(&self, column: usize, row: usize, cells: usize) -> f32 {
        let along = |lines: &[f32; PAGE_SAMPLES], i: usize| {
            lines[i * cells].max(-lines[(i + 1) * cells]).max(0.0)
        };
        along(&self.columns, column).max(along(&self.rows, row))
    }

    /// How far heights are above or below, at least.
    fn above(&self, [lo, hi]: [u8; 2]) -> f32 {
        let height = |code: u8| self.base + self.step * f32::from(code);
        (height(lo).max(-height(hi)) - self.slack).max(0.0)
    }

    /// By how much heights may be farther out while this bound is what is believed: by the bound,
    /// and by a step of the codes that they have then.
    fn wider(&self, code: u16) -> f32 {
        if code == 0 {
            return 0.0;
        }
        let bound = metres(code) * self.metre;
        bound + (255.0 * self.step + 2.0 * bound) * (2.0 / 253.0)
    }

    /// How far the page is, at least.
    fn nearest(&self, sketch: &Sketch) -> f32 {
        match sketch.is_empty() {
            true => self.flat,
            false => self.flat.max(self.above([sketch.lo[0], sketch.hi[0]])),
        }
    }

    /// The heights of a page, unless all of it is farther to the side than up or down, or it has
    /// none: a client that has not all of it takes heights for heights of the surface.
    fn heights<'a>(&'a self, sketch: &'a Sketch, wider: f32) -> Option<Heights<'a>> {
        let height = |code: u8| self.base + self.step * f32::from(code);
        let farthest = height(sketch.hi[0]).max(-height(sketch.lo[0])) + self.slack;
        let counts = farthest > self.flat && !sketch.is_empty();
        let of_page = sketch.has_holes && wider > 0.0;
        counts.then_some(Heights {
            around: self,
            sketch,
            wider,
            of_page,
        })
    }

    /// Whether any square of a level fails if each has this bound, and nothing finer is known.
    fn any_fails(&self, sketch: &Sketch, level: u8, code: u16) -> bool {
        let wider = self.wider(code);
        let Some(heights) = self.heights(sketch, wider) else {
            return code >= limit(self.flat);
        };
        let lowest = (self.nearest(sketch) - wider).max(self.flat);
        if heights.of_page || code < limit(lowest) {
            return code >= limit(lowest);
        }
        let (columns, rows) = (Axis::new(&self.columns, 0.0), Axis::new(&self.rows, 0.0));
        if level == PAGE_LEVELS {
            let limits = heights.cell_limits(0.0);
            return any::<PAGE_CELLS>(code, &columns, &rows, &limits);
        }
        let limits = heights.limits(0.0);
        let limits = &limits[first(level)..];
        match level {
            1 => any::<2>(code, &columns, &rows, limits),
            2 => any::<4>(code, &columns, &rows, limits),
            _ => any::<8>(code, &columns, &rows, limits),
        }
    }
}

fn any<const N: usize>(code: u16, columns: &Axis, rows: &Axis, heights: &[u16]) -> bool {
    let codes = [code; PAGE_SLOTS];
    let (x, y) = (columns.halves::<N>(), rows.halves::<N>());
    let found = self::rows(&codes[..N * N], &x.whole, &y.whole, Some(&heights[..N * N]));
    found.iter().any(|&row| row != 0)
}

impl Heights<'_> {
    /// Limits of the heights of squares; `more` is added to every error.
    fn limits(&self, more: f32) -> [u16; PAGE_SQUARES] {
        let mut limits = [0; PAGE_SQUARES];
        self.fill(&mut limits, (&self.sketch.lo, &self.sketch.hi), more);
        limits
    }

    /// Of cells; of the whole page's heights, if theirs are not known.
    fn cell_limits(&self, more: f32) -> [u16; PAGE_SLOTS] {
        let mut limits = [0; PAGE_SLOTS];
        match &self.sketch.cells {
            Some(cells) => self.fill(&mut limits, (&cells.lo, &cells.hi), more),
            None => limits.fill(self.limit(self.sketch.lo[0], self.sketch.hi[0], more)),
        }
        limits
    }

    fn fill<const N: usize>(
        &self,
        limits: &mut [u16; N],
        (lo, hi): (&[u8; N], &[u8; N]),
        more: f32,
    ) {
        if self.of_page {
            return limits.fill(self.limit(self.sketch.lo[0], self.sketch.hi[0], more));
        }
        for (limit, (&lo, &hi)) in limits.iter_mut().zip(lo.iter().zip(hi)) {
            *limit = self.limit(lo, hi, more);
        }
    }

    fn limit(&self, lo: u8, hi: u8, more: f32) -> u16 {
        let height = |code: u8| self.around.base + self.around.step * f32::from(code);
        let away = height(lo).max(-height(hi)) - self.around.slack;
        limit_with((away - self.wider).max(0.0), more)
    }
}
