//! Error bounds of every triangle of a page, derived from its heights and child slots.
//!
//! The mesh is a hierarchy of right triangles: a square's centre and an edge make an *edge
//! triangle*, which its edge vertex splits; a square's diagonal makes two *halves*, which its
//! centre splits (Lindstrom et al., "Real-Time, Continuous Level of Detail Rendering of Height
//! Fields", 1996; Ulrich, "Continuous LOD Terrain Meshing Using Adaptive Quadtrees", 2000).
//!
//! What is stored for a triangle bounds the distance, straight up or down, of the full-resolution
//! surface from the triangle's plane, over the triangle. Two properties make an update of the mesh
//! independent of its history, and both are kept here:
//!
//! - a triangle's error is at least that of the two that it splits into (saturation);
//! - a square's range of heights holds those of its child squares.
//!
//! Integers throughout: equal on every machine, and rounded up. Deviations are exact over the
//! page's own vertices, plus the bound of the cell below: they are linear in each cell, so that
//! its corners suffice.

mod full;

use super::flat::two_triangles;
use super::{ChildSlot, Kind, MAX_SPAN, Page, Range, level_step};
use crate::err8::Err8;
use crate::geometry::{Edge, PAGE_LEVELS, PAGE_SAMPLES, Quadrant, Slot};

/// What is known of a square that is drawn as two triangles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BoxError {
    /// Bound of the distance from the surface, in quanta.
    pub error: u32,
    /// Whether an outline crosses it.
    pub kind: Kind,
    /// Holds all heights in the square.
    pub range: Range,
}

/// What is known of a square whose centre is enabled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SquareErrors {
    /// Bounds of the four edge triangles, by [`Edge`], in quanta.
    pub edges: [u32; 4],
    /// What the edge triangles hold, by [`Edge`].
    pub kinds: [Kind; 4],
    /// Holds all heights in the square.
    pub range: Range,
    /// Bounds of the square's two halves: the southern, the northern.
    halves: [u32; 2],
    half_kinds: [Kind; 2],
}

/// Error bounds of all triangles of a page, as far as its parts have arrived.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bounds {
    depth: u8,
    /// By [`square_index`].
    squares: Vec<SquareErrors>,
    cells: Vec<BoxError>,
}

/// Place of a square of the page's level `level` in level order.
pub const fn square_index(level: u8, column: usize, row: usize) -> usize {
    ((1 << (2 * level)) - 1) / 3 + (row << level) + column
}

/// Which half of a quadrant lies on the side of an edge of its parent: 0 southern, 1 northern.
const fn half_facing(edge: Edge, quadrant: Quadrant) -> usize {
    match (edge, quadrant) {
        (Edge::North, _) => 1,
        (Edge::South, _) => 0,
        (Edge::East, Quadrant::NorthEast) | (Edge::West, Quadrant::NorthWest) => 0,
        (Edge::East, _) | (Edge::West, _) => 1,
    }
}

/// The edge triangles into whose union a square's halves split: of the southern, of the northern.
const fn edges_of_halves(rises: bool) -> [[Edge; 2]; 2] {
    if rises {
        [[Edge::South, Edge::East], [Edge::North, Edge::West]]
    } else {
        [[Edge::South, Edge::West], [Edge::North, Edge::East]]
    }
}

impl Bounds {
    /// Derives all bounds. `promise` is what the parent's slot says of the page; it holds for
    /// every triangle in it, and caps what a page that is not whole must assume.
    ///
    /// Bounds never grow when parts arrive: of a page that is not whole, what its fewer parts say
    /// holds as well.
    pub fn derive(page: &Page, promise: Option<BoxError>) -> Bounds {
        Bounds::derive_by(page, |page| Bounds::derive_own(page, promise))
    }

    /// By `k - 1`: what is known of a page without holes while only parts `1..=k` of it have
    /// arrived, as far as they have and are not the whole page. As [`derive`](Self::derive) has it
    /// of each, in less time.
    ///
    /// # Panics
    /// If the page has holes.
    pub fn of_fewer(page: &Page, promise: Option<BoxError>) -> Vec<Bounds> {
        assert!(!page.has_holes(), "a page without holes");
        let most = page.parts().min(page.last_part() - 1);
        let mut all: Vec<Bounds> = Vec::with_capacity(most.into());
        for parts in 1..=most {
            let mut bounds = Bounds::derive_own(&page.with_fewer(parts), promise);
            if let Some(fewer) = all.last() {
                bounds.meet(fewer);
            }
            all.push(bounds);
        }
        all
    }

    /// Without what fewer parts say.
    fn derive_own(page: &Page, promise: Option<BoxError>) -> Bounds {
        match uniform(page) {
            Some(below) => Bounds::derive_full(page, below, promise),
            None => Bounds::derive_each(page, promise),
        }
    }

    fn derive_by(page: &Page, derive: impl Fn(&Page) -> Bounds) -> Bounds {
        let mut bounds = derive(page);
        if page.parts() < page.last_part() && !page.has_holes() {
            for parts in 1..page.depth() {
                bounds.meet(&derive(&page.with_fewer(parts)));
            }
        }
        bounds
    }

    /// Takes over what is known from fewer levels of vertices where it says more. What a cell
    /// there says holds for all in it. Errors and ranges that are nested stay so.
    fn meet(&mut self, fewer: &Bounds) {
        for level in 0..self.depth {
            for row in 0..1 << level {
                for column in 0..1 << level {
                    let known = fewer.square_or_cell(level, column, row);
                    let square = &mut self.squares[square_index(level, column, row)];
                    for (edge, known) in square.edges.iter_mut().zip(known.edges) {
                        *edge = (*edge).min(known);
                    }
                    for (half, known) in square.halves.iter_mut().zip(known.halves) {
                        *half = (*half).min(known);
                    }
                    square.range = square.range.intersection(known.range);
                }
            }
        }
        let side = 1 << self.depth;
        for (i, cell) in self.cells.iter_mut().enumerate() {
            let known = fewer.square_or_cell(self.depth, i % side, i / side);
            cell.error = cell.error.min(known.halves[0]);
            cell.range = cell.range.intersection(known.range);
        }
    }

    /// A square, or what the cell says that holds it.
    fn square_or_cell(&self, level: u8, column: usize, row: usize) -> SquareErrors {
        if level < self.depth {
            return *self.square(level, column, row);
        }
        let down = level - self.depth;
        let cell = self.cells[((row >> down) << self.depth) + (column >> down)];
        SquareErrors {
            edges: [cell.error; 4],
            halves: [cell.error; 2],
            range: cell.range,
            ..NOTHING
        }
    }

    /// For a page without holes whose cells all have one bound.
    fn derive_full(page: &Page, below: u32, promise: Option<BoxError>) -> Bounds {
        let depth = page.depth();
        let mut bounds = Bounds {
            depth,
            squares: vec![NOTHING; square_index(depth, 0, 0)],
            cells: full::cells(page, below, promise),
        };
        let cap = promise.map_or(MAX_SPAN, |promise| promise.error);
        let limits = (below, cap.min(MAX_SPAN));
        full::squares(page, |(level, column, row), rises, own| {
            let square = bounds.saturate(&own, (level, column, row), rises, limits);
            bounds.squares[square_index(level, column, row)] = square;
        });
        bounds
    }

    /// What is known of a full square: at least what is known of those below.
    fn saturate(
        &self,
        own: &full::Own,
        (level, column, row): (u8, usize, usize),
        rises: bool,
        (below, cap): (u32, u32),
    ) -> SquareErrors {
        let mut square = SquareErrors {
            kinds: [Kind::Full; 4],
            half_kinds: [Kind::Full; 2],
            ..NOTHING
        };
        let bound = |own: u64| (own + u64::from(below)).min(u64::from(cap)) as u32;
        let mut halves = [[0; 2]; 4];
        for quadrant in Quadrant::ALL {
            let (dx, dy) = quadrant.offset();
            let (x, y) = (2 * column + dx as usize, 2 * row + dy as usize);
            let range = match level + 1 == self.depth {
                true => self.cells[(y << self.depth) + x].range,
                false => self.square(level + 1, x, y).range,
            };
            square.range = square.range.union(range);
            halves[quadrant as usize] = [0, 1].map(|half| self.half(level + 1, x, y, half).0);
        }
        for edge in Edge::ALL {
            let below = edge
                .quadrants()
                .map(|quadrant| halves[quadrant as usize][half_facing(edge, quadrant)]);
            let own = bound(own.edges[edge as usize]);
            square.edges[edge as usize] = own.max(below[0]).max(below[1]);
        }
        for (half, edges) in edges_of_halves(rises).into_iter().enumerate() {
            let [a, b] = edges.map(|edge| square.edges[edge as usize]);
            square.halves[half] = bound(own.halves[half]).max(a).max(b);
        }
        square
    }

    /// For any page, square by square; slow, and the oracle of the quick way.
    #[cfg(test)]
    pub(super) fn derive_plain(page: &Page, promise: Option<BoxError>) -> Bounds {
        Bounds::derive_by(page, |page| Bounds::derive_each(page, promise))
    }

    /// As [`derive`](Self::derive), from the page as it is, square by square.
    fn derive_each(page: &Page, promise: Option<BoxError>) -> Bounds {
        let mut bounds = Bounds {
            depth: page.depth(),
            squares: Vec::new(),
            cells: Vec::new(),
        };
        let grid = Grid::of(page);
        bounds.cells = grid.cells(page, promise);
        let count = square_index(bounds.depth, 0, 0);
        bounds.squares = vec![NOTHING; count];
        for level in (0..bounds.depth).rev() {
            for row in 0..1 << level {
                for column in 0..1 << level {
                    let square = bounds.derive_square(&grid, page, (level, column, row), promise);
                    bounds.squares[square_index(level, column, row)] = square;
                }
            }
        }
        bounds
    }

    /// Levels of squares whose errors are known.
    pub const fn depth(&self) -> u8 {
        self.depth
    }

    /// Errors of a square of the page's level `level`, below [`depth`](Self::depth).
    pub fn square(&self, level: u8, column: usize, row: usize) -> &SquareErrors {
        &self.squares[square_index(level, column, row)]
    }

    /// What is known of a square of the page's level `level`, up to and with the depth itself.
    pub fn box_error(&self, level: u8, column: usize, row: usize) -> BoxError {
        if level == self.depth {
            return self.cells[(row << level) + column];
        }
        let square = self.square(level, column, row);
        BoxError {
            error: square.halves[0].max(square.halves[1]),
            kind: square.half_kinds[0].merge(square.half_kinds[1]),
            range: square.range,
        }
    }

    /// What is known of one cell of a page of full depth: as [`box_error`](Self::box_error) of the
    /// page's level [`PAGE_LEVELS`], without deriving the rest.
    ///
    /// # Panics
    /// If the page is not of full depth.
    pub fn cell(page: &Page, slot: Slot, promise: Option<BoxError>) -> BoxError {
        assert!(page.depth() == PAGE_LEVELS, "a page of full depth");
        let (column, row) = slot.position();
        Grid::of(page).cell_at(page, (column, row), promise)
    }

    /// What half a quadrant holds: the half on the side of an edge of its parent, for a quadrant
    /// that is a square of the page's level `level`, up to and with the depth itself.
    pub fn half_kind(&self, level: u8, column: usize, row: usize, edge: Edge) -> Kind {
        let quadrant = Quadrant::of(column as u32, row as u32);
        self.half(level, column, row, half_facing(edge, quadrant)).1
    }

    /// What the parent's slot must say of this page.
    ///
    /// The bound is rounded up to a code; a deviation is never larger than [`MAX_SPAN`].
    pub fn slot(&self) -> ChildSlot {
        let root = self.box_error(0, 0, 0);
        match root.kind {
            Kind::Empty => ChildSlot::Empty,
            Kind::Mixed => ChildSlot::Mixed(root.range),
            Kind::Full => ChildSlot::Full(covering(root.error)),
        }
    }

    /// For a whole page: how far the surface may be from the mesh of its parts `1..=k`, by `k - 1`.
    fn rest_errors(&self) -> [Err8; PAGE_LEVELS as usize] {
        std::array::from_fn(|i| {
            let level = i as u8 + 1;
            let boxes = (0..1 << level)
                .flat_map(|row| (0..1 << level).map(move |column| (column, row)))
                .map(|(column, row)| self.box_error(level, column, row).error);
            covering(boxes.max().unwrap_or(0))
        })
    }

    /// `(error, kind)` of the half of a quadrant that lies on the side of an edge of its parent.
    fn half(&self, level: u8, column: usize, row: usize, half: usize) -> (u32, Kind) {
        if level == self.depth {
            let cell = &self.cells[(row << level) + column];
            return (cell.error, cell.kind);
        }
        let square = self.square(level, column, row);
        (square.halves[half], square.half_kinds[half])
    }

    fn derive_square(
        &self,
        grid: &Grid,
        page: &Page,
        (level, column, row): (u8, usize, usize),
        promise: Option<BoxError>,
    ) -> SquareErrors {
        let mut square = NOTHING;
        for quadrant in Quadrant::ALL {
            let (dx, dy) = quadrant.offset();
            let (x, y) = (2 * column + dx as usize, 2 * row + dy as usize);
            let child = self.box_error(level + 1, x, y);
            square.range = square.range.union(child.range);
        }
        let cap = promise.map_or(MAX_SPAN, |promise| promise.error);
        for edge in Edge::ALL {
            let halves = edge.quadrants().map(|quadrant| {
                let (dx, dy) = quadrant.offset();
                let (x, y) = (2 * column + dx as usize, 2 * row + dy as usize);
                self.half(level + 1, x, y, half_facing(edge, quadrant))
            });
            let kind = halves[0].1.merge(halves[1].1);
            let own = error_of(kind, square.range, || {
                grid.edge_triangle(&self.cells, (level, column, row), edge)
            });
            square.kinds[edge as usize] = kind;
            square.edges[edge as usize] = own.min(cap).max(halves[0].0).max(halves[1].0);
        }
        let rises = match level {
            0 => Quadrant::of(page.id().square().x, page.id().square().y).rises(),
            _ => Quadrant::of(column as u32, row as u32).rises(),
        };
        for (half, [a, b]) in edges_of_halves(rises).into_iter().enumerate() {
            let kind = square.kinds[a as usize].merge(square.kinds[b as usize]);
            let own = error_of(kind, square.range, || {
                grid.half(&self.cells, (level, column, row), rises, half)
            });
            let below = square.edges[a as usize].max(square.edges[b as usize]);
            square.half_kinds[half] = kind;
            square.halves[half] = own.min(cap).max(below);
        }
        square
    }
}

const NOTHING: SquareErrors = SquareErrors {
    edges: [0; 4],
    kinds: [Kind::Empty; 4],
    range: Range::EMPTY,
    halves: [0; 2],
    half_kinds: [Kind::Empty; 2],
};

/// Where an outline crosses, any drawn triangle and all heights lie within the square's range.
fn error_of(kind: Kind, range: Range, full: impl FnOnce() -> u32) -> u32 {
    match kind {
        Kind::Empty => 0,
        Kind::Mixed => range.span(),
        Kind::Full => full(),
    }
}

fn covering(error: u32) -> Err8 {
    Err8::covering(error.min(MAX_SPAN)).unwrap_or(Err8(u8::MAX))
}

/// The vertices that have arrived, one to a cell corner.
struct Grid {
    depth: u8,
    side: usize,
    heights: Vec<i64>,
}

impl Grid {
    fn of(page: &Page) -> Grid {
        let depth = page.depth();
        let step = level_step(depth);
        let side = (1 << depth) + 1;
        let sample = |i: usize| (i / side) * step * PAGE_SAMPLES + (i % side) * step;
        let heights = (0..side * side).map(|i| i64::from(page.height(sample(i))));
        Grid {
            depth,
            side,
            heights: heights.collect(),
        }
    }

    fn cells(&self, page: &Page, promise: Option<BoxError>) -> Vec<BoxError> {
        let side = self.side - 1;
        let places = (0..side * side).map(|i| (i % side, i / side));
        places
            .map(|place| self.cell_at(page, place, promise))
            .collect()
    }

    fn cell_at(
        &self,
        page: &Page,
        (column, row): (usize, usize),
        promise: Option<BoxError>,
    ) -> BoxError {
        let slot = match self.depth {
            PAGE_LEVELS => page.slot(Slot::at(column, row)),
            _ => page.slot(Slot::at(0, 0)),
        };
        let told = self.cell(slot, row * self.side + column, page);
        promise.map_or(told, |promise| capped(told, promise))
    }

    fn cell(&self, slot: ChildSlot, south_west: usize, page: &Page) -> BoxError {
        let kind = slot.kind();
        match slot {
            ChildSlot::Empty => BoxError {
                error: 0,
                kind,
                range: Range::EMPTY,
            },
            ChildSlot::Mixed(range) => BoxError {
                error: if page.is_finest() && page.parts() == page.last_part() {
                    0
                } else {
                    range.span()
                },
                kind,
                range,
            },
            ChildSlot::Full(error) | ChildSlot::Cut(error) => {
                let corners = [0, 1, self.side, self.side + 1];
                let heights = corners.map(|corner| self.heights[south_west + corner] as i32);
                let range = heights.into_iter().fold(Range::EMPTY, Range::with);
                BoxError {
                    error: error.bound(),
                    kind,
                    range: range.widened(error.bound()),
                }
            }
        }
    }

    /// Bound of a full edge triangle. In its own coordinates `v` runs from the square's centre to
    /// the edge and `u` along the edge, so that the triangle is `|u| <= v <= half`.
    fn edge_triangle(&self, cells: &[BoxError], square: (u8, usize, usize), edge: Edge) -> u32 {
        let (level, column, row) = square;
        let side = ((self.side - 1) >> level) as i64;
        let half = side / 2;
        let centre = (column as i64 * side + half, row as i64 * side + half);
        let place = |u: i64, v: i64| match edge {
            Edge::East => (centre.0 + v, centre.1 + u),
            Edge::North => (centre.0 + u, centre.1 + v),
            Edge::West => (centre.0 - v, centre.1 + u),
            Edge::South => (centre.0 + u, centre.1 - v),
        };
        let height = |u, v| {
            let (x, y) = place(u, v);
            self.heights[y as usize * self.side + x as usize]
        };
        let (middle, left, right) = (height(0, 0), height(-half, half), height(half, half));
        let deviation = |u: i64, v: i64| {
            let plane = 2 * half * middle + v * (left + right - 2 * middle) + u * (right - left);
            (2 * half * height(u, v) - plane).unsigned_abs()
        };
        let scale = 2 * half as u64;
        let mut largest = 0;
        for v in 0..half {
            for u in -v - 1..=v {
                let near = [u, u + 1].map(|u| if u.abs() <= v { deviation(u, v) } else { 0 });
                let far = [u, u + 1].map(|u| deviation(u, v + 1));
                let (a, b) = (place(u, v), place(u + 1, v + 1));
                let cell = a.1.min(b.1) as usize * (self.side - 1) + a.0.min(b.0) as usize;
                let own = near[0].max(near[1]).max(far[0]).max(far[1]);
                largest = largest.max(own + scale * u64::from(cells[cell].error));
            }
        }
        round_up(largest, scale)
    }

    /// Bound of a full half of a square: 0 the southern, 1 the northern.
    fn half(
        &self,
        cells: &[BoxError],
        (level, column, row): (u8, usize, usize),
        rises: bool,
        half: usize,
    ) -> u32 {
        let side = (self.side - 1) >> level;
        let south_west = row * side * self.side + column * side;
        let height = |u: usize, v: usize| self.heights[south_west + v * self.side + u];
        let corners = [
            height(0, 0),
            height(side, 0),
            height(0, side),
            height(side, side),
        ];
        let deviation = |u: usize, v: usize| {
            let plane = two_triangles(corners, rises, (u as i64, v as i64), side as i64);
            (side as i64 * height(u, v) - plane).unsigned_abs()
        };
        // Columns of a row of samples that lie in the half, ends included.
        let columns = |v: usize| match (rises, half) {
            (true, 0) => (v, side),
            (true, _) => (0, v),
            (false, 0) => (0, side - v),
            (false, _) => (side - v, side),
        };
        let mut largest = 0;
        for v in 0..side {
            let (a, b) = (columns(v), columns(v + 1));
            for u in a.0.min(b.0)..a.1.max(b.1) {
                let inside = |u: usize, (first, last): (usize, usize)| first <= u && u <= last;
                let at = |u, v, span| if inside(u, span) { deviation(u, v) } else { 0 };
                let south = at(u, v, a).max(at(u + 1, v, a));
                let north = at(u, v + 1, b).max(at(u + 1, v + 1, b));
                let cell = (row * side + v) * (self.side - 1) + column * side + u;
                let below = side as u64 * u64::from(cells[cell].error);
                largest = largest.max(south.max(north) + below);
            }
        }
        round_up(largest, side as u64)
    }
}

/// `scaled / scale`, rounded up, within what a deviation can be.
fn round_up(scaled: u64, scale: u64) -> u32 {
    scaled.div_ceil(scale).min(u64::from(MAX_SPAN)) as u32
}

/// For a whole page: how far the surface may be from the mesh of its parts `1..=k`, by `k - 1`;
/// and what the parent's slot must say of it.
pub(super) fn of_whole(page: &Page) -> ([Err8; PAGE_LEVELS as usize], ChildSlot) {
    if page.has_slots() || page.has_holes() {
        let bounds = Bounds::derive(page, None);
        return (bounds.rest_errors(), bounds.slot());
    }
    // Each square's bound is at least that of what it splits into.
    let [mut root, mut one, mut two, three] = full::largest(page);
    two = two.max(three);
    one = one.max(two);
    root = root.max(one);
    let largest = [root, one, two, three, 0];
    let codes = largest.map(|error| covering(error.min(u64::from(MAX_SPAN)) as u32));
    let [root, rest @ ..] = codes;
    (rest, ChildSlot::Full(root))
}

/// The bound of all cells of a page, if they have the same and there are no holes.
fn uniform(page: &Page) -> Option<u32> {
    match page.slot(Slot::at(0, 0)) {
        ChildSlot::Full(error) if !page.has_slots() && !page.has_holes() => Some(error.bound()),
        _ => None,
    }
}

/// A cell's bound under what the parent says of the whole page.
fn capped(told: BoxError, promise: BoxError) -> BoxError {
    BoxError {
        error: told.error.min(promise.error),
        kind: told.kind,
        range: told.range.intersection(promise.range),
    }
}
