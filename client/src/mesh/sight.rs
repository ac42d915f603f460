//! Triangles as a view sees them: how far their errors reach, and how far away they are.

use super::frustum::Frustum;
use super::place::PageSquare;
use super::squares::{self, At, ErrorCode, PLACES};
use super::surface::{Node, Surface};
use escarp_proto::geometry::{Edge, PAGE_SAMPLES, Quadrant};
use escarp_proto::georef::WorldBox;
use escarp_proto::page::Kind;
use escarp_proto::view::{Tests, View};

/// A view of a surface.
#[derive(Debug, Clone)]
pub(super) struct Sight {
    pub(super) tests: Tests,
    pub(super) frustum: Frustum,
    quantum_m: f64,
    origin_m: [f64; 2],
    sample_spacing_m: [f64; 2],
}

/// The columns and rows of a page's samples, from the eye, metres.
#[derive(Debug, Clone)]
pub(super) struct Lines {
    columns_m: [f64; PAGE_SAMPLES],
    rows_m: [f64; PAGE_SAMPLES],
}

/// The two sides of the tests of a square: of its edge triangles, by [`Edge`], then of its
/// quadrants, by [`Quadrant`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sides {
    /// How far the errors reach, metres.
    pub(super) reach_m: [f64; 8],
    /// How far away the regions are, metres.
    pub(super) distance_m: [f64; 8],
}

/// A triangle, or a square's two halves, seen from the eye.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Seen {
    /// How far the error reaches: it is beyond the tolerance within this distance, metres.
    pub(super) reach_m: f64,
    pub(super) distance_m: f64,
    pub(super) region: WorldBox,
}

impl Seen {
    /// Whether the error is beyond the tolerance.
    pub(super) fn fails(&self) -> bool {
        self.reach_m > self.distance_m
    }

    /// How many times over the tolerance the error is.
    pub(super) fn excess(&self) -> f64 {
        match self.reach_m > 0.0 {
            true => self.reach_m / self.distance_m,
            false => 0.0,
        }
    }
}

impl Sides {
    /// Whether an error is beyond the tolerance.
    pub(super) fn fails(&self, test: usize) -> bool {
        self.reach_m[test] > self.distance_m[test]
    }
}

impl Sight {
    pub(super) fn of(surface: &Surface, view: &View) -> Sight {
        Sight {
            tests: Tests::of(view),
            frustum: Frustum::of(view),
            quantum_m: surface.georef.quantum_m,
            origin_m: surface.georef.origin_m,
            sample_spacing_m: surface.georef.sample_spacing_m,
        }
    }

    /// The triangle of a square's centre and an edge, which its edge vertex splits.
    pub(super) fn edge(&self, node: &Node, square: PageSquare, edge: Edge) -> Seen {
        let at = squares::at(square);
        let error = node.squares.edges(at)[edge as usize];
        self.seen(
            error,
            self.edge_box(node, square, edge, node.squares.range(at)),
        )
    }

    /// A quadrant as two triangles, which its centre splits.
    pub(super) fn quadrant(&self, node: &Node, square: PageSquare, quadrant: Quadrant) -> Seen {
        let (error, range) = node.squares.quadrant(squares::at(square), quadrant);
        self.seen(error, self.square_box(node, square.child(quadrant), range))
    }

    /// An edge vertex itself, with another error than the triangle's that it splits.
    pub(super) fn vertex(
        &self,
        node: &Node,
        square: PageSquare,
        edge: Edge,
        error: ErrorCode,
    ) -> Seen {
        let sample = square.edge(edge);
        let x_m = self.line_m(node, sample % PAGE_SAMPLES, 0);
        let y_m = self.line_m(node, sample / PAGE_SAMPLES, 1);
        let at_m = [
            x_m,
            y_m,
            f64::from(node.page.height(sample)) * self.quantum_m,
        ];
        let (reach_m, distance_m) = self.tests.sides(
            error.metres(),
            &WorldBox {
                min: at_m,
                max: at_m,
            },
        );
        Seen {
            reach_m,
            distance_m,
            region: self.edge_box(node, square, edge, node.squares.range(squares::at(square))),
        }
    }

    /// As [`quadrant`](Self::quadrant), with another error.
    pub(super) fn quadrant_with(
        &self,
        node: &Node,
        square: PageSquare,
        quadrant: Quadrant,
        error: ErrorCode,
    ) -> Seen {
        let (_, range) = node.squares.quadrant(squares::at(square), quadrant);
        self.seen(error, self.square_box(node, square.child(quadrant), range))
    }

    /// What a square holds, and the box of all of it.
    pub(super) fn square(&self, node: &Node, square: PageSquare) -> (Kind, WorldBox) {
        let (column, row) = (square.column as usize, square.row as usize);
        let known = node.outlines.as_ref();
        let kind = known.map(|bounds| bounds.box_error(square.level, column, row).kind);
        let range = node.squares.range_of(square);
        (
            kind.unwrap_or_default(),
            self.square_box(node, square, range),
        )
    }

    fn seen(&self, error: ErrorCode, region: WorldBox) -> Seen {
        let (reach_m, distance_m) = self.tests.sides(error.metres(), &region);
        Seen {
            reach_m,
            distance_m,
            region,
        }
    }

    /// The half of a square that holds an edge triangle.
    fn edge_box(&self, node: &Node, square: PageSquare, edge: Edge, range: [i64; 2]) -> WorldBox {
        let side = square.side();
        let (x, y) = (square.column as usize * side, square.row as usize * side);
        let (half, end) = (side / 2, side);
        let (xs, ys) = match edge {
            Edge::East => ([x + half, x + end], [y, y + end]),
            Edge::North => ([x, x + end], [y + half, y + end]),
            Edge::West => ([x, x + half], [y, y + end]),
            Edge::South => ([x, x + end], [y, y + half]),
        };
        self.world_box(node, xs, ys, range)
    }

    fn square_box(&self, node: &Node, square: PageSquare, range: [i64; 2]) -> WorldBox {
        let side = square.side();
        let (x, y) = (square.column as usize * side, square.row as usize * side);
        self.world_box(node, [x, x + side], [y, y + side], range)
    }

    fn world_box(&self, node: &Node, x: [usize; 2], y: [usize; 2], range: [i64; 2]) -> WorldBox {
        let [x, y] = [(x, 0), (y, 1)].map(|(ends, axis)| ends.map(|i| self.line_m(node, i, axis)));
        let z = range.map(|height| height as f64 * self.quantum_m);
        WorldBox {
            min: [x[0], y[0], z[0]],
            max: [x[1], y[1], z[1]],
        }
    }

    /// World `x` of a column of a page's samples, or `y` of a row, metres.
    fn line_m(&self, node: &Node, line: usize, axis: usize) -> f64 {
        let grid = node.mesh.origin[axis] + line as u32 * node.mesh.stride;
        self.origin_m[axis] + f64::from(grid) * self.sample_spacing_m[axis]
    }

    pub(super) fn lines(&self, node: &Node) -> Lines {
        let [x_m, y_m, _] = self.tests.eye_m;
        Lines {
            columns_m: std::array::from_fn(|i| self.line_m(node, i, 0) - x_m),
            rows_m: std::array::from_fn(|i| self.line_m(node, i, 1) - y_m),
        }
    }

    /// All tests of a square at once: those of [`edge`](Self::edge) and
    /// [`quadrant`](Self::quadrant), bit by bit.
    pub(super) fn sides(&self, node: &Node, lines: &Lines, at: At) -> Sides {
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
        let z = self.above_m(node.squares.range(at));
        let edges = node.squares.edges(at);
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
            let (error, range) = node.squares.quadrant(at, quadrant);
            found.reach_m[4 + quadrant as usize] = error.metres() * self.tests.threshold;
            found.distance_m[4 + quadrant as usize] = flat.max(self.above_m(range));
        }
        found
    }

    /// How far the eye is above or below heights, metres, at least 0.
    fn above_m(&self, range: [i64; 2]) -> f64 {
        let [lo, hi] = range.map(|height| height as f64 * self.quantum_m);
        let eye_m = self.tests.eye_m[2];
        (lo - eye_m).max(eye_m - hi).max(0.0)
    }
}
