//! Triangles as a view sees them: how far their errors reach, and how far away they are.

use super::frustum::Frustum;
use super::place::PageSquare;
use super::surface::{Node, Surface};
use escarp_proto::geometry::{Edge, Quadrant};
use escarp_proto::georef::WorldBox;
use escarp_proto::page::{Kind, Range};
use escarp_proto::view::{Tests, View, error_m};

/// A view of a surface.
#[derive(Debug, Clone)]
pub(super) struct Sight {
    pub(super) tests: Tests,
    pub(super) frustum: Frustum,
    quantum_m: f64,
    finest_level: u8,
    /// Half the diagonal of a square, metres, by level.
    half_diagonals_m: Vec<f64>,
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

impl Sight {
    pub(super) fn of(surface: &Surface, view: &View) -> Sight {
        let grid = surface.grid;
        let half_diagonal_m = |level| surface.georef.half_diagonal_m(grid.square_cells(level));
        Sight {
            tests: Tests::of(view),
            frustum: Frustum::of(view),
            quantum_m: surface.georef.quantum_m,
            finest_level: grid.get(),
            half_diagonals_m: (0..=grid.get()).map(half_diagonal_m).collect(),
        }
    }

    /// The triangle of a square's centre and an edge, which its edge vertex splits.
    pub(super) fn edge(&self, node: &Node, square: PageSquare, edge: Edge) -> Seen {
        let (column, row) = (square.column as usize, square.row as usize);
        let errors = node.bounds.square(square.level, column, row);
        let level = usize::from(node.page.id().level() + square.level);
        let (error, kind) = (errors.edges[edge as usize], errors.kinds[edge as usize]);
        let error_m = error_m(error, kind, self.quantum_m, self.half_diagonals_m[level]);
        self.seen(error_m, self.edge_box(node, square, edge, errors.range))
    }

    /// A quadrant as two triangles, which its centre splits.
    pub(super) fn quadrant(&self, node: &Node, square: PageSquare, quadrant: Quadrant) -> Seen {
        let child = square.child(quadrant);
        let (column, row) = (child.column as usize, child.row as usize);
        let below = node.bounds.box_error(child.level, column, row);
        let level = node.page.id().level() + child.level;
        let half_diagonal_m = self.half_diagonals_m[usize::from(level)];
        let error_m = match self.finest_level == level {
            true => 0.0,
            false => error_m(below.error, below.kind, self.quantum_m, half_diagonal_m),
        };
        self.seen(error_m, self.square_box(node, child, below.range))
    }

    /// What a square holds, and the box of all of it.
    pub(super) fn square(&self, node: &Node, square: PageSquare) -> (Kind, WorldBox) {
        let (column, row) = (square.column as usize, square.row as usize);
        let known = node.bounds.box_error(square.level, column, row);
        (known.kind, self.square_box(node, square, known.range))
    }

    fn seen(&self, error_m: f64, region: WorldBox) -> Seen {
        let (reach_m, distance_m) = self.tests.sides(error_m, &region);
        Seen {
            reach_m,
            distance_m,
            region,
        }
    }

    /// The half of a square that holds an edge triangle.
    fn edge_box(&self, node: &Node, square: PageSquare, edge: Edge, range: Range) -> WorldBox {
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

    fn square_box(&self, node: &Node, square: PageSquare, range: Range) -> WorldBox {
        let side = square.side();
        let (x, y) = (square.column as usize * side, square.row as usize * side);
        self.world_box(node, [x, x + side], [y, y + side], range)
    }

    fn world_box(&self, node: &Node, x: [usize; 2], y: [usize; 2], range: Range) -> WorldBox {
        let z = |height: i32| f64::from(height) * self.quantum_m;
        WorldBox {
            min: [node.columns_m[x[0]], node.rows_m[y[0]], z(range.lo)],
            max: [node.columns_m[x[1]], node.rows_m[y[1]], z(range.hi)],
        }
    }
}
