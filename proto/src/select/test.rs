//! Downwards: which triangles and cells of a page are beyond the tolerance.

use super::eyes::Eyes;
use super::limits::{Axis, Lines, limit, limit_with, rows, squares};
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
use std::cell::OnceCell;

/// One selection's view.
pub(super) struct Pass<'a> {
    grid: GridLevels,
    sight: &'a Sight,
    eyes: Eyes,
    scope: Scope,
}

/// A page from where the eye may be, in metres of error: distances over the threshold.
struct Around {
    columns: Lines,
    rows: Lines,
    /// Height of the page's lowest step above the highest place of the eye, and above the lowest;
    /// what a step adds; and how much of that may be rounding.
    base: [f32; 2],
    step: f32,
    slack: f32,
    /// How far the page is to the side.
    flat: f32,
    /// A metre.
    metre: f32,
    /// Limits of columns and rows, once they have been asked for.
    axes: OnceCell<[Axis; 2]>,
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
        self.find(id, sketch, &self.around(id, sketch), true)
    }

    fn around(&self, id: PageId, sketch: &Sketch) -> Around {
        let unit = 1.0 / self.sight.tests.threshold;
        let (x, y) = self.grid.page_origin(id);
        let stride = self.grid.page_stride(id);
        let over = |metres: f64| (metres * unit) as f32;
        let lines = |origin: u32, axis: usize| {
            let at_m = |i: usize| self.sight.grid_m(origin + i as u32 * stride, axis);
            Lines {
                beyond: std::array::from_fn(|i| over(at_m(i) - self.eyes.hi_m[axis])),
                before: std::array::from_fn(|i| over(self.eyes.lo_m[axis] - at_m(i))),
            }
        };
        let (columns, rows) = (lines(x, 0), lines(y, 1));
        let height_m = |code| sketch.steps.height(code) as f64 * self.sight.quantum_m();
        let base = [self.eyes.hi_m[2], self.eyes.lo_m[2]].map(|eye_m| over(height_m(0) - eye_m));
        let step = over(height_m(1) - height_m(0));
        let last = PAGE_SAMPLES - 1;
        Around {
            base,
            step,
            slack: (base[0].abs().max(base[1].abs()) + 255.0 * step) * 1e-6,
            flat: columns.between(0, last).max(rows.between(0, last)),
            columns,
            rows,
            metre: over(1.0),
            axes: OnceCell::new(),
        }
    }

    /// Whether a page may be seen, by a range of heights, coded as the page above has it.
    fn seen(&self, id: PageId, above: &Sketch, range: [u8; 2]) -> Seen {
        let (x, y) = self.grid.page_origin(id);
        let cells = self.grid.square_cells(id.level());
        let [lo, hi] = range.map(|code| above.steps.height(code) as f64 * self.sight.quantum_m());
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
        let with_more;
        let [columns, rows] = match more > 0.0 {
            false => around.axes(),
            true => {
                with_more = around.axes_with(more);
                &with_more
            }
        };
        let level = |(columns, rows), more: f32, by_level: bool| Level {
            sketch,
            columns,
            rows,
            heights: heights
                .as_ref()
                .map(|heights| heights.limits(depth.max(1), more)),
            by_level,
        };
        level((columns, rows), more, outlines).mark_to(depth, &mut found.marks);
        if more > 0.0 {
            // Nor is anything beyond the tolerance of which fewer parts say that it is not.
            let mut most = Marks::default();
            let [columns, rows] = around.axes();
            level((columns, rows), 0.0, true).mark_to(depth, &mut most);
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
    /// All that counts is what a number of parts says of all squares of a level alike.
    by_level: bool,
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
        let alike = [self.sketch.rest[usize::from(level)]; 64];
        let codes = |known| match self.by_level {
            true => &alike[..N * N],
            false => {
                let known: &[u16; PAGE_SQUARES] = known;
                &known[at.clone()]
            }
        };
        let (x, y) = (self.columns.halves::<N>(), self.rows.halves::<N>());
        let heights = self.heights.as_ref().map(|heights| &heights[at.clone()]);
        let edges = [
            (&x.upper, &y.whole),
            (&x.whole, &y.upper),
            (&x.lower, &y.whole),
            (&x.whole, &y.lower),
        ];
        for (edge, (x, y)) in edges.into_iter().enumerate() {
            let codes = codes(&self.sketch.edges[edge]);
            marks.edges[usize::from(level)][edge] |= squares(codes, x, y, heights);
        }
        if level > 0 {
            let codes = codes(&self.sketch.halves);
            let found = squares(codes, &x.whole, &y.whole, heights);
            marks.centres[usize::from(level)] |= found;
        }
    }
}

impl Around {
    /// Limits of columns and rows.
    fn axes(&self) -> &[Axis; 2] {
        self.axes.get_or_init(|| self.axes_with(0.0))
    }

    /// The same if `more` is added to every error.
    fn axes_with(&self, more: f32) -> [Axis; 2] {
        [Axis::new(&self.columns, more), Axis::new(&self.rows, more)]
    }

    /// How far a square, `cells` of the page wide, is to the side.
    fn flat_of(&self, column: usize, row: usize, cells: usize) -> f32 {
        let along = |lines: &Lines, i: usize| lines.between(i * cells, (i + 1) * cells);
        along(&self.columns, column).max(along(&self.rows, row))
    }

    /// How far heights are above the eye.
    fn over(&self, lo: u8) -> f32 {
        self.base[0] + self.step * f32::from(lo)
    }

    /// How far heights are below the eye.
    fn under(&self, hi: u8) -> f32 {
        -(self.base[1] + self.step * f32::from(hi))
    }

    /// How far heights are above or below, at least.
    fn above(&self, [lo, hi]: [u8; 2]) -> f32 {
        (self.over(lo).max(self.under(hi)) - self.slack).max(0.0)
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

    /// How far any of the page is, at most.
    fn farthest(&self, sketch: &Sketch) -> f32 {
        let last = PAGE_SAMPLES - 1;
        let end = |lines: &Lines| lines.beyond[last].max(lines.before[0]);
        let flat = end(&self.columns).max(end(&self.rows));
        let high = self.over(sketch.hi[0]).max(self.under(sketch.lo[0]));
        flat.max(high).max(0.0)
    }

    /// The heights of a page, unless all of it is farther to the side than up or down, or it has
    /// none: a client that has not all of it takes heights for heights of the surface.
    fn heights<'a>(&'a self, sketch: &'a Sketch, wider: f32) -> Option<Heights<'a>> {
        let farthest = self.over(sketch.hi[0]).max(self.under(sketch.lo[0])) + self.slack;
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
        if code >= limit(self.farthest(sketch)) {
            return true;
        }
        let [columns, rows] = self.axes();
        if level == PAGE_LEVELS {
            let limits = heights.cell_limits(0.0);
            return any::<PAGE_CELLS>(code, columns, rows, &limits);
        }
        let limits = heights.limits(level + 1, 0.0);
        let limits = &limits[first(level)..];
        match level {
            1 => any::<2>(code, columns, rows, limits),
            2 => any::<4>(code, columns, rows, limits),
            _ => any::<8>(code, columns, rows, limits),
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
    /// Limits of the heights of squares of so many levels; `more` is added to every error.
    fn limits(&self, levels: u8, more: f32) -> [u16; PAGE_SQUARES] {
        let mut limits = [0; PAGE_SQUARES];
        let end = first(levels);
        let ranges = (&self.sketch.lo[..end], &self.sketch.hi[..end]);
        self.fill(&mut limits[..end], ranges, more);
        limits
    }

    /// Of cells; of the whole page's heights, if theirs are not known.
    fn cell_limits(&self, more: f32) -> [u16; PAGE_SLOTS] {
        let mut limits = [0; PAGE_SLOTS];
        match &self.sketch.cells {
            Some(cells) => self.fill(&mut limits, (&cells.lo[..], &cells.hi[..]), more),
            None => limits.fill(self.limit(self.sketch.lo[0], self.sketch.hi[0], more)),
        }
        limits
    }

    fn fill(&self, limits: &mut [u16], (lo, hi): (&[u8], &[u8]), more: f32) {
        if self.of_page {
            return limits.fill(self.limit(self.sketch.lo[0], self.sketch.hi[0], more));
        }
        for (limit, (&lo, &hi)) in limits.iter_mut().zip(lo.iter().zip(hi)) {
            *limit = self.limit(lo, hi, more);
        }
    }

    fn limit(&self, lo: u8, hi: u8, more: f32) -> u16 {
        let away = self.around.over(lo).max(self.around.under(hi)) - self.around.slack;
        limit_with((away - self.wider).max(0.0), more)
    }
}
