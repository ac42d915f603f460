//! Triangles as a view sees them: how far their errors reach, how far away they are, and whether
//! they may be seen. Meshes and the [selection](crate::select) decide by the same arithmetic.

pub mod frustum;
pub mod place;
pub mod squares;

use crate::geometry::{Edge, PAGE_SAMPLES, Quadrant};
use crate::georef::{Georef, WorldBox};
use crate::view::{Tests, View};
use frustum::Frustum;
use place::PageSquare;
use squares::{At, ErrorCode, PLACES, Squares};

/// A view of a dataset.
#[derive(Debug, Clone)]
pub struct Sight {
    /// Its tests.
    pub tests: Tests,
    /// What it can see.
    pub frustum: Frustum,
    quantum_m: f64,
    origin_m: [f64; 2],
    sample_spacing_m: [f64; 2],
}

/// A page's squares, and where in the grid it is.
#[derive(Debug, Clone, Copy)]
pub struct Placed<'a> {
    /// What its squares are tested by.
    pub squares: &'a Squares,
    /// Grid coordinates of its south-west corner.
    pub origin: [u32; 2],
    /// Grid cells between its samples.
    pub stride: u32,
}

/// The columns and rows of a page's samples, from the eye, metres.
#[derive(Debug, Clone)]
pub struct Lines {
    columns_m: [f64; PAGE_SAMPLES],
    rows_m: [f64; PAGE_SAMPLES],
}

/// The two sides of the tests of a square: of its edge triangles, by [`Edge`], then of its
/// quadrants, by [`Quadrant`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sides {
    /// How far the errors reach, metres.
    pub reach_m: [f64; 8],
    /// How far away the regions are, metres.
    pub distance_m: [f64; 8],
}

/// A triangle, or a square's two halves, seen from the eye.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// How far the error reaches: it is beyond the tolerance within this distance, metres.
    pub reach_m: f64,
    /// How far away it is, metres.
    pub distance_m: f64,
    /// Holds the surface there.
    pub region: WorldBox,
}

impl Seen {
    /// Whether the error is beyond the tolerance.
    pub fn fails(&self) -> bool {
        self.reach_m > self.distance_m
    }

    /// How many times over the tolerance the error is.
    pub fn excess(&self) -> f64 {
        match self.reach_m > 0.0 {
            true => self.reach_m / self.distance_m,
            false => 0.0,
        }
    }
}

impl Sides {
    /// Whether an error is beyond the tolerance.
    #[inline]
    pub fn fails(&self, test: usize) -> bool {
        self.reach_m[test] > self.distance_m[test]
    }
}

impl Sight {
    /// A view of the dataset that is placed so.
    pub fn new(georef: &Georef, view: &View) -> Sight {
        Sight {
            tests: Tests::of(view),
            frustum: Frustum::of(view),
            quantum_m: georef.quantum_m,
            origin_m: georef.origin_m,
            sample_spacing_m: georef.sample_spacing_m,
        }
    }

    /// The triangle of a square's centre and an edge, which its edge vertex splits.
    pub fn edge(&self, page: Placed<'_>, square: PageSquare, edge: Edge) -> Seen {
        let at = squares::at(square);
        let error = page.squares.edges(at)[edge as usize];
        self.seen(error, self.edge_box(page, square, edge))
    }

    /// A quadrant as two triangles, which its centre splits.
    pub fn quadrant(&self, page: Placed<'_>, square: PageSquare, quadrant: Quadrant) -> Seen {
        let (error, range) = page.squares.quadrant(squares::at(square), quadrant);
        self.seen(error, self.square_box(page, square.child(quadrant), range))
    }

    /// A region with an error that it has been given.
    pub fn seen(&self, error: ErrorCode, region: WorldBox) -> Seen {
        let (reach_m, distance_m) = self.tests.sides(error.metres(), &region);
        Seen {
            reach_m,
            distance_m,
            region,
        }
    }

    /// The half of a square that holds an edge triangle.
    pub fn edge_box(&self, page: Placed<'_>, square: PageSquare, edge: Edge) -> WorldBox {
        let side = square.side();
        let (x, y) = (square.column as usize * side, square.row as usize * side);
        let (half, end) = (side / 2, side);
        let (xs, ys) = match edge {
            Edge::East => ([x + half, x + end], [y, y + end]),
            Edge::North => ([x, x + end], [y + half, y + end]),
            Edge::West => ([x, x + half], [y, y + end]),
            Edge::South => ([x, x + end], [y, y + half]),
        };
        let range = page.squares.range(squares::at(square));
        self.world_box(page, xs, ys, range)
    }

    /// A square, or a cell, with a range of heights in quanta.
    pub fn square_box(&self, page: Placed<'_>, square: PageSquare, range: [i64; 2]) -> WorldBox {
        let side = square.side();
        let (x, y) = (square.column as usize * side, square.row as usize * side);
        self.world_box(page, [x, x + side], [y, y + side], range)
    }

    fn world_box(
        &self,
        page: Placed<'_>,
        x: [usize; 2],
        y: [usize; 2],
        range: [i64; 2],
    ) -> WorldBox {
        let [x, y] = [(x, 0), (y, 1)].map(|(ends, axis)| ends.map(|i| self.line_m(page, i, axis)));
        let z = range.map(|height| height as f64 * self.quantum_m);
        WorldBox {
            min: [x[0], y[0], z[0]],
            max: [x[1], y[1], z[1]],
        }
    }

    /// World `x` of a column of a page's samples (axis 0), or `y` of a row (1), metres.
    #[inline]
    pub fn line_m(&self, page: Placed<'_>, line: usize, axis: usize) -> f64 {
        self.grid_m(page.origin[axis] + line as u32 * page.stride, axis)
    }

    /// World `x` of a column of the grid (axis 0), or `y` of a row (1), metres.
    #[inline]
    pub fn grid_m(&self, grid: u32, axis: usize) -> f64 {
        self.origin_m[axis] + f64::from(grid) * self.sample_spacing_m[axis]
    }

    /// Metres a unit of height.
    pub(crate) fn quantum_m(&self) -> f64 {
        self.quantum_m
    }

    /// The columns and rows of a page.
    pub fn lines(&self, page: Placed<'_>) -> Lines {
        let [x_m, y_m, _] = self.tests.eye_m;
        Lines {
            columns_m: std::array::from_fn(|i| self.line_m(page, i, 0) - x_m),
            rows_m: std::array::from_fn(|i| self.line_m(page, i, 1) - y_m),
        }
    }

    /// All tests of a square at once: those of [`edge`](Self::edge) and
    /// [`quadrant`](Self::quadrant), bit by bit.
    #[inline]
    pub fn sides(&self, squares: &Squares, lines: &Lines, at: At) -> Sides {
        let square = PLACES[at].square;
        let side = square.side();
        let along = |lines: &[f64; PAGE_SAMPLES], place: u8| {
            let start = place as usize * side;
            let [low, middle, high] = [start, start + side / 2, start + side].map(|i| lines[i]);
            // Before the lower end, or beyond the upper: of the lower half, the upper, the whole.
            [low.max(-middle), middle.max(-high), low.max(-high)]
        };
        let [west, east, x] = along(&lines.columns_m, square.column);
        let [south, north, y] = along(&lines.rows_m, square.row);
        let z = self.above_m(squares.range(at));
        let edges = squares.edges(at);
        let mut found = Sides {
            reach_m: [0.0; 8],
            distance_m: [0.0; 8],
        };
        let flat = [east.max(y), north.max(x), west.max(y), south.max(x)];
        for edge in 0..4 {
            found.reach_m[edge] = edges[edge].metres() * self.tests.threshold;
            found.distance_m[edge] = flat[edge].max(z);
        }
        for quadrant in Quadrant::ALL {
            let (dx, dy) = quadrant.offset();
            let flat = [west, east][dx as usize].max([south, north][dy as usize]);
            let (error, range) = squares.quadrant(at, quadrant);
            found.reach_m[4 + quadrant as usize] = error.metres() * self.tests.threshold;
            found.distance_m[4 + quadrant as usize] = flat.max(self.above_m(range));
        }
        found
    }

    /// How far the eye is above or below heights, metres, at least 0.
    #[inline]
    fn above_m(&self, range: [i64; 2]) -> f64 {
        let [lo, hi] = range.map(|height| height as f64 * self.quantum_m);
        let eye_m = self.tests.eye_m[2];
        (lo - eye_m).max(eye_m - hi).max(0.0)
    }
}
