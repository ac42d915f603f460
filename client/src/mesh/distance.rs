//! Squares split by distance over size alone, as in quadtree terrains for Direct3D: whatever the
//! surface is like, near squares are small and far ones large.
//!
//! A square that is split has its centre and its four edge vertices enabled: four squares of two
//! triangles each. What else is needed so that no crack opens is enabled by the surface. It
//! promises no error; what its mesh comes to is found afterwards, and stated.

use super::mesher::{Found, MeshOptions, Mesher};
use super::place::PageSquare;
use super::size::{Sizes, split_ratio};
use super::standing::largest_excess;
use super::surface::{Index, Surface};
use super::vertices::Asker;
use escarp_proto::geometry::{Edge, PageId, Quadrant, Slot};
use escarp_proto::view::View;

/// The mesher. It keeps nothing from one update to the next but what it has asked for.
#[derive(Debug)]
pub(super) struct Distance {
    options: MeshOptions,
}

impl Distance {
    pub(super) fn new(options: &MeshOptions) -> Distance {
        Distance { options: *options }
    }
}

impl Mesher for Distance {
    fn update(&mut self, surface: &mut Surface, view: &View) -> Found {
        let ratio = split_ratio(&self.options, view);
        let mut pass = Pass {
            sizes: Sizes::of(surface, view, ratio),
        };
        if let Some(&root) = surface.by_id.get(&PageId::ROOT) {
            let nearness = pass.sizes.nearness(surface.node(root), PageSquare::ROOT);
            pass.visit(surface, root, PageSquare::ROOT, nearness);
        }
        Found {
            excess: largest_excess(surface, &pass.sizes.sight),
            squares: pass.sizes.squares,
        }
    }

    fn linked(&mut self, _: &Surface, _: Index) {}

    fn unlinked(&mut self, _: Index) {}
}

/// One update.
struct Pass {
    sizes: Sizes,
}

impl Pass {
    /// Splits a square, or no longer, and all below it. A square that is not near enough, or lies
    /// in one that is not, has a nearness of at most 1.
    fn visit(&mut self, surface: &mut Surface, page: Index, square: PageSquare, nearness: f64) {
        let split = nearness > 1.0;
        let centre = (page, square.centre() as u16);
        if square == PageSquare::ROOT {
            surface.node_mut(page).last_use = surface.updates;
        }
        surface.wishes.in_view = true;
        surface.wishes.blocked = false;
        surface.ask(centre, Asker::First, split, nearness);
        if !surface.is_enabled(centre) {
            return;
        }
        for edge in Edge::ALL {
            let vertex = (page, square.edge(edge) as u16);
            surface.ask(vertex, edge.into(), split, nearness);
        }
        for quadrant in Quadrant::ALL {
            self.visit_quadrant(surface, (page, square), quadrant, split);
        }
    }

    fn visit_quadrant(
        &mut self,
        surface: &mut Surface,
        (page, square): (Index, PageSquare),
        quadrant: Quadrant,
        split: bool,
    ) {
        let child = square.child(quadrant);
        let node = surface.node(page);
        if child.level == 4 && node.page.is_finest() {
            return;
        }
        let below = surface.square_below(page, child);
        // Its nearness counts only where the square above is split; elsewhere nothing but what was
        // asked for before is of interest.
        let nearness = match split && may_enter(surface, page, child) {
            true => self.sizes.nearness(node, child),
            false => 0.0,
        };
        match below {
            Some((below, square)) => {
                let enabled = surface.is_enabled((below, square.centre() as u16));
                if nearness > 1.0 || enabled {
                    self.visit(surface, below, square, nearness);
                }
            }
            None if nearness > 1.0 => surface.want_below(page, child, nearness),
            None => {}
        }
    }
}

/// Pages without a record are what the page above says of them: no triangle of theirs would show
/// more than its.
fn may_enter(surface: &Surface, page: Index, child: PageSquare) -> bool {
    if child.level < 4 {
        return true;
    }
    let slot = Slot::at(child.column as usize, child.row as usize);
    surface.node(page).page.slot(slot).has_record()
}
