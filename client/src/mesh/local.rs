//! The quadtree with the errors of its article, for comparison (Ulrich, "Continuous LOD Terrain
//! Meshing Using Adaptive Quadtrees", 2000).
//!
//! A vertex's error is its distance from the edge that it splits. An edge vertex is enabled where
//! `error * threshold` is more than its own distance from the eye, a square where the largest
//! error in it is more than the distance of its box. It promises nothing of the surface between
//! the vertices, nor of errors that add up over levels; what its mesh comes to is found
//! afterwards, by the bounds, and stated.
//!
//! What the article does not have:
//! - below the samples that are here, the bound of what is missing takes the place of the largest
//!   error. It is what the page above says, whether or not the page below is resident, so that
//!   nothing that was fetched is found to be of no use, dropped and fetched again;
//! - on an outline, where a triangle's error is its size whatever the heights are, the bound does.
//!
//! No error is above the bound of the triangle that the vertex splits, and a square's is the
//! largest in it; so where a square passes, all in it does, and which vertices are enabled follows
//! from view and pages alone. Everything is tested in every update: what the other metric knows of
//! when a test is due is not worked out for this one.

use super::mesher::{Found, Mesher};
use super::place::PageSquare;
use super::sight::{Seen, Sight};
use super::squares::{At, ErrorCode, FIRST_FINEST, PAGE_SQUARES, PLACES, ROOT};
use super::standing::largest_excess;
use super::surface::{Index, Node, Surface};
use super::vertices::{Asker, VertexRef};
use escarp_proto::geometry::{Edge, PageId, Quadrant};
use escarp_proto::page::Kind;
use escarp_proto::view::View;

/// The mesher.
#[derive(Debug, Default)]
pub(super) struct LocalQuadtree {
    /// By page.
    errors: Vec<Option<Box<Errors>>>,
}

impl Mesher for LocalQuadtree {
    fn update(&mut self, surface: &mut Surface, view: &View) -> Found {
        let mut pass = Pass {
            sight: Sight::of(surface, view),
            squares: 0,
        };
        let mut pages: Vec<Index> = Vec::new();
        pages.extend(surface.by_id.get(&PageId::ROOT));
        while let Some(page) = pages.pop() {
            if let Some(errors) = self.errors.get(page as usize).and_then(Option::as_deref) {
                pass.visit_page(surface, page, errors);
            }
            let node = surface.node(page);
            let children = node.children.iter();
            let enabled = children.filter(|(slot, _)| node.children_enabled.has(*slot));
            pages.extend(enabled.map(|&(_, child)| child));
        }
        Found {
            excess: largest_excess(surface, &pass.sight),
            squares: pass.squares,
        }
    }

    fn linked(&mut self, surface: &Surface, page: Index) {
        let errors = Errors::of(surface.node(page), surface.georef.quantum_m);
        let place = page as usize;
        if self.errors.len() <= place {
            self.errors.resize_with(place + 1, || None);
        }
        self.errors[place] = Some(Box::new(errors));
    }

    fn unlinked(&mut self, page: Index) {
        self.errors[page as usize] = None;
    }

    fn memory_bytes(&self) -> usize {
        let places = self.errors.capacity() * size_of::<Option<Box<Errors>>>();
        places + self.errors.iter().flatten().count() * size_of::<Errors>()
    }
}

/// Errors of a page's vertices.
#[derive(Debug, PartialEq)]
struct Errors {
    /// Of the edge vertices of its squares, by [`Edge`].
    edges: [[ErrorCode; 4]; PAGE_SQUARES],
    /// The largest of a square: its centre's, its edge vertices', and those below.
    squares: [ErrorCode; PAGE_SQUARES],
}

impl Errors {
    fn of(node: &Node, quantum_m: f64) -> Errors {
        let mut errors = Errors {
            edges: [[ErrorCode::default(); 4]; PAGE_SQUARES],
            squares: [ErrorCode::default(); PAGE_SQUARES],
        };
        // From the smallest upwards.
        for at in (0..PAGE_SQUARES).rev() {
            let square = PLACES[at].square;
            if square.level >= node.page.depth() {
                errors.squares[at] = node.squares.halves(at);
                continue;
            }
            errors.edges[at] = Edge::ALL.map(|edge| edge_error(node, at, edge, quantum_m));
            let mut largest = centre_error(node, at, quantum_m);
            for below in Quadrant::ALL {
                largest = largest.max(errors.quadrant(node, at, below));
            }
            errors.squares[at] = errors.edges[at].into_iter().fold(largest, ErrorCode::max);
        }
        errors
    }

    /// The largest error in a square's quadrant.
    fn quadrant(&self, node: &Node, at: At, quadrant: Quadrant) -> ErrorCode {
        match at < FIRST_FINEST {
            true => self.squares[4 * at + 1 + quadrant as usize],
            false => node.squares.quadrant(at, quadrant).0,
        }
    }
}

/// Whether an outline crosses an edge triangle, or it is in a hole.
fn is_outline(node: &Node, square: PageSquare, edge: Edge) -> bool {
    let (column, row) = (square.column as usize, square.row as usize);
    node.outlines.as_ref().is_some_and(|bounds| {
        bounds.square(square.level, column, row).kinds[edge as usize] != Kind::Full
    })
}

/// How far a sample is from the middle of two others.
fn off(node: &Node, sample: usize, ends: [usize; 2], quantum_m: f64) -> ErrorCode {
    let height = |sample| i64::from(node.page.height(sample));
    let [from, to] = ends.map(height);
    let halves = (2 * height(sample) - from - to).unsigned_abs();
    ErrorCode::covering(halves as f64 / 2.0 * quantum_m)
}

fn edge_error(node: &Node, at: At, edge: Edge, quantum_m: f64) -> ErrorCode {
    let square = PLACES[at].square;
    let bound = node.squares.edges(at)[edge as usize];
    match is_outline(node, square, edge) {
        true => bound,
        false => off(node, square.edge(edge), square.ends(edge), quantum_m).min(bound),
    }
}

/// Of a square's centre, which splits the diagonal from the centre of the square above to one of
/// its corners.
fn centre_error(node: &Node, at: At, quantum_m: f64) -> ErrorCode {
    let square = PLACES[at].square;
    let above = match at {
        ROOT => node
            .page
            .id()
            .parent()
            .and_then(|(_, slot)| PageSquare::cell(slot).parent()),
        _ => square.parent(),
    };
    let Some((_, quadrant)) = above else {
        // The grid's centre is always enabled.
        return ErrorCode::default();
    };
    let (column, row) = (square.column as usize, square.row as usize);
    let known = node.outlines.as_ref();
    let kind = known.map(|bounds| bounds.box_error(square.level, column, row).kind);
    if kind.unwrap_or_default() != Kind::Full {
        return node.squares.halves(at);
    }
    let diagonal = match quadrant.rises() {
        true => [square.sample(0, 0), square.sample(2, 2)],
        false => [square.sample(0, 2), square.sample(2, 0)],
    };
    off(node, square.centre(), diagonal, quantum_m).min(node.squares.halves(at))
}

/// One update's view.
struct Pass {
    sight: Sight,
    squares: u64,
}

impl Pass {
    /// Tests all enabled squares of a page.
    fn visit_page(&mut self, surface: &mut Surface, index: Index, errors: &Errors) {
        let mut left = surface.node(index).centres;
        while left != 0 {
            let at = left.trailing_zeros() as At;
            self.test(surface, index, at, errors);
            // What it enabled or disabled comes after it.
            left = surface.node(index).centres & (u128::MAX << at << 1);
        }
    }

    fn test(&mut self, surface: &mut Surface, index: Index, at: At, errors: &Errors) {
        self.squares += 1;
        for edge in Edge::ALL {
            let vertex = (index, PLACES[at].edges[edge as usize]);
            let seen = self.edge(surface.node(index), at, edge, errors);
            self.ask(surface, vertex, Asker::from(edge), &seen);
        }
        if at < FIRST_FINEST || surface.node(index).squares.has_cells() {
            for quadrant in Quadrant::ALL {
                self.test_quadrant(surface, index, at, quadrant, errors);
            }
        }
    }

    fn edge(&self, node: &Node, at: At, edge: Edge, errors: &Errors) -> Seen {
        let square = PLACES[at].square;
        // Only where it has arrived, and has a height.
        match square.level < node.page.depth() && !is_outline(node, square, edge) {
            true => {
                let error = errors.edges[at][edge as usize];
                self.sight.vertex(node, square, edge, error)
            }
            false => self.sight.edge(node, square, edge),
        }
    }

    fn test_quadrant(
        &mut self,
        surface: &mut Surface,
        index: Index,
        at: At,
        quadrant: Quadrant,
        errors: &Errors,
    ) {
        let node = surface.node(index);
        let square = PLACES[at].square;
        let error = errors.quadrant(node, at, quadrant);
        let seen = self.sight.quadrant_with(node, square, quadrant, error);
        let below = square.child(quadrant);
        match surface.square_below(index, below) {
            Some((page, square)) => {
                let centre = (page, square.centre() as u16);
                self.ask(surface, centre, Asker::First, &seen);
            }
            None if seen.fails() => {
                self.face(surface, &seen);
                surface.want_below(index, below, seen.excess());
            }
            None => {}
        }
    }

    fn ask(&self, surface: &mut Surface, vertex: VertexRef, asker: Asker, seen: &Seen) {
        if seen.fails() != surface.state(vertex).is_asked_by(asker) {
            self.face(surface, seen);
            surface.ask(vertex, asker, seen.fails(), seen.excess());
        }
    }

    /// What is wanted from here on is wanted for this triangle.
    fn face(&self, surface: &mut Surface, seen: &Seen) {
        surface.wishes.in_view = self.sight.frustum.may_see(&seen.region);
        surface.wishes.blocked = false;
    }
}

#[cfg(test)]
mod tests;
