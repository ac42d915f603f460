//! A view of a surface: the tests of `escarp_proto::sight` on the pages that are resident.

use super::place::PageSquare;
use super::squares::{self, At, ErrorCode};
use super::surface::{Node, Surface};
use escarp_proto::geometry::{Edge, PAGE_SAMPLES, Quadrant};
use escarp_proto::georef::WorldBox;
use escarp_proto::page::Kind;
use escarp_proto::sight::{self, Placed};
pub(super) use escarp_proto::sight::{Lines, Seen, Sides};
use escarp_proto::view::View;
use std::ops::Deref;

/// A view of a surface.
#[derive(Debug, Clone)]
pub(super) struct Sight {
    sight: sight::Sight,
    quantum_m: f64,
}

impl Deref for Sight {
    type Target = sight::Sight;

    fn deref(&self) -> &sight::Sight {
        &self.sight
    }
}

impl Node {
    fn placed(&self) -> Placed<'_> {
        Placed {
            squares: &self.squares,
            origin: self.mesh.origin,
            stride: self.mesh.stride,
        }
    }
}

impl Sight {
    pub(super) fn of(surface: &Surface, view: &View) -> Sight {
        Sight {
            sight: sight::Sight::new(&surface.georef, view),
            quantum_m: surface.georef.quantum_m,
        }
    }

    /// The triangle of a square's centre and an edge, which its edge vertex splits.
    pub(super) fn edge(&self, node: &Node, square: PageSquare, edge: Edge) -> Seen {
        self.sight.edge(node.placed(), square, edge)
    }

    /// A quadrant as two triangles, which its centre splits.
    pub(super) fn quadrant(&self, node: &Node, square: PageSquare, quadrant: Quadrant) -> Seen {
        self.sight.quadrant(node.placed(), square, quadrant)
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
        let page = node.placed();
        let at_m = [
            self.line_m(page, sample % PAGE_SAMPLES, 0),
            self.line_m(page, sample / PAGE_SAMPLES, 1),
            f64::from(node.page.height(sample)) * self.quantum_m,
        ];
        let point = WorldBox {
            min: at_m,
            max: at_m,
        };
        Seen {
            region: self.edge_box(page, square, edge),
            ..self.seen(error, point)
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
        let page = node.placed();
        let (_, range) = node.squares.quadrant(squares::at(square), quadrant);
        self.seen(error, self.square_box(page, square.child(quadrant), range))
    }

    /// What a square holds, and the box of all of it.
    pub(super) fn square(&self, node: &Node, square: PageSquare) -> (Kind, WorldBox) {
        let (column, row) = (square.column as usize, square.row as usize);
        let known = node.outlines.as_ref();
        let kind = known.map(|bounds| bounds.box_error(square.level, column, row).kind);
        let range = node.squares.range_of(square);
        (
            kind.unwrap_or_default(),
            self.square_box(node.placed(), square, range),
        )
    }

    pub(super) fn lines(&self, node: &Node) -> Lines {
        self.sight.lines(node.placed())
    }

    /// All tests of a square at once: those of [`edge`](Self::edge) and
    /// [`quadrant`](Self::quadrant), bit by bit.
    pub(super) fn sides(&self, node: &Node, lines: &Lines, at: At) -> Sides {
        self.sight.sides(&node.squares, lines, at)
    }
}
