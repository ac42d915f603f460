//! Which triangles exist: it follows from the vertices that are enabled and disabled.

use super::super::place::{PageSquare, Role, across, border, role};
use super::super::surface::{Index, Surface};
use super::super::vertices::VertexRef;
use super::item::{Item, Notes};
use super::{Pass, Roam, place_of};
use escarp_proto::geometry::{Edge, PageId};

impl Roam {
    /// Follows the vertices that were enabled or disabled since: triangles come to exist, or
    /// exist no more.
    pub(super) fn follow(&mut self, pass: &mut Pass<'_>) {
        let mut flips = pass.surface.take_flips();
        for (vertex, enabled) in flips.drain(..) {
            self.count(pass.surface, vertex, enabled);
            pass.left = pass.left.saturating_sub(1);
            self.follow_vertex(pass, vertex);
            if let Some(mirror) = mirror(pass.surface, vertex) {
                self.follow_vertex(pass, mirror);
            }
        }
        pass.surface.give_back_flips(flips);
    }

    /// A vertex adds a triangle on each side of the edge that it splits; the root's centre, four.
    pub(super) fn count(&mut self, surface: &Surface, (page, sample): VertexRef, enabled: bool) {
        let id = surface.node(page).page.id();
        let root = sample as usize == PageSquare::ROOT.centre() && id == PageId::ROOT;
        let outer = border(sample as usize).is_some_and(|edge| id.neighbour(edge).is_none());
        let more = match (root, outer) {
            (true, _) => 4,
            (_, true) => 1,
            _ => 2,
        };
        match enabled {
            true => self.triangles += more,
            false => self.triangles -= more,
        }
    }

    pub(super) fn follow_vertex(&mut self, pass: &mut Pass<'_>, (page, sample): VertexRef) {
        match role(sample as usize) {
            Role::Corner => {}
            Role::Centre(square) => {
                for edge in Edge::ALL {
                    self.follow_item(pass, page, Item::edge(square, edge));
                }
            }
            Role::Edge(sides) => {
                for (square, edge) in sides.into_iter().flatten() {
                    for quadrant in edge.quadrants() {
                        self.follow_item(pass, page, Item::quadrant(square, quadrant));
                    }
                }
            }
        }
    }

    pub(super) fn follow_item(&mut self, pass: &mut Pass<'_>, page: Index, item: Item) {
        let exists = item.exists(pass.surface, page);
        let place = place_of(&mut self.notes, page);
        if place.is_none() && !exists {
            return;
        }
        let notes = place.get_or_insert_with(|| {
            self.made = self.made.wrapping_add(1);
            Notes::new(self.made)
        });
        if !notes.set_exists(item, exists) {
            return;
        }
        if exists {
            self.existing += 1;
            return self.test(pass, page, item);
        }
        self.existing -= 1;
        if !notes.any_exist() {
            *place = None;
        }
    }
}

/// The same vertex in the page across the border.
fn mirror(surface: &Surface, (page, sample): VertexRef) -> Option<VertexRef> {
    let edge = border(sample as usize)?;
    let neighbour = surface.node(page).neighbours[edge as usize]?;
    Some((neighbour, across(sample as usize, edge) as u16))
}
