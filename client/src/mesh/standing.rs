//! The bound of a mesh that was not made by bounds.

use super::place::PageSquare;
use super::sight::Sight;
use super::surface::{Index, Surface};
use escarp_proto::geometry::{Edge, PageId, Quadrant};
use escarp_proto::page::PAGE_AREA;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// A square whose centre is enabled, and a bound of all its triangles, over the tolerance.
#[derive(Debug)]
struct Open {
    excess: f64,
    page: Index,
    square: PageSquare,
}

/// The largest bound of a triangle that stands and may be seen, over the tolerance; where it is at
/// most 1, no more exact than that.
///
/// Bounds and boxes are nested, so squares are opened worst first, until none that is left can
/// hold anything worse than what was found: a small part of the mesh, as a rule.
pub(super) fn largest_excess(surface: &Surface, sight: &Sight) -> f64 {
    let root = surface.by_id.get(&PageId::ROOT).map(|&page| Open {
        excess: f64::INFINITY,
        page,
        square: PageSquare::ROOT,
    });
    let mut open: BinaryHeap<Open> = root.into_iter().collect();
    let mut largest = 0.0;
    while let Some(next) = open.pop() {
        if next.excess <= f64::max(largest, 1.0) {
            return f64::max(largest, next.excess);
        }
        largest = f64::max(largest, expand(surface, sight, &next, &mut open));
    }
    largest
}

/// Opens a square: gives the largest bound of its own triangles, and adds the squares below.
fn expand(surface: &Surface, sight: &Sight, next: &Open, open: &mut BinaryHeap<Open>) -> f64 {
    let (index, square) = (next.page, next.square);
    let node = surface.node(index);
    let enabled = |edge: Edge| surface.is_enabled((index, square.edge(edge) as u16));
    let mut largest = 0.0;
    for edge in Edge::ALL.into_iter().filter(|&edge| !enabled(edge)) {
        let seen = sight.edge(node, square, edge);
        if seen.excess() > largest && sight.frustum.may_see(&seen.region) {
            largest = seen.excess();
        }
    }
    for quadrant in Quadrant::ALL {
        if !quadrant.edges().into_iter().any(enabled) {
            continue;
        }
        let seen = sight.quadrant(node, square, quadrant);
        if seen.excess() <= largest || !sight.frustum.may_see(&seen.region) {
            continue;
        }
        let below = surface.square_below(index, square.child(quadrant));
        let is_split = |&(page, square): &(Index, PageSquare)| {
            surface.is_enabled((page, square.centre() as u16))
        };
        match below.filter(is_split) {
            Some((page, _)) if is_surface_itself(surface, page) => {}
            Some((page, square)) => open.push(Open {
                excess: seen.excess(),
                page,
                square,
            }),
            None => largest = seen.excess(),
        }
    }
    largest
}

/// Whether all of a finest page's vertices are enabled, but its corners, which are not its own.
fn is_surface_itself(surface: &Surface, page: Index) -> bool {
    let node = surface.node(page);
    node.page.is_finest() && node.enabled as usize == PAGE_AREA - 4
}

impl Ord for Open {
    fn cmp(&self, other: &Open) -> Ordering {
        self.excess.total_cmp(&other.excess)
    }
}

impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Open) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Open {
    fn eq(&self, other: &Open) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Open {}
