//! What the mesh would use if it were resident.

use super::place::{PageSquare, part_of};
use super::surface::{Index, Surface};
use super::vertices::VertexRef;
use escarp_proto::geometry::{Edge, PageId, Slot};
use escarp_proto::page::SLOT_PART;
use escarp_proto::wire::{Class, Want};
use std::collections::HashMap;

/// Parts of a page that the mesh would use.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wish {
    /// The page.
    pub page: PageId,
    /// Parts that are resident, 0 if none.
    pub resident: u8,
    /// Parts that would be of use.
    pub parts: u8,
    /// How urgent it is.
    pub class: Class,
    /// How many times over the tolerance the mesh is for the lack of it.
    pub excess: f64,
}

impl Wish {
    /// As the protocol says it.
    pub fn to_want(&self) -> Want {
        Want {
            page: self.page.key(),
            first_part: if self.resident == 0 {
                0
            } else {
                self.resident + 1
            },
            last_part: self.parts,
            class: self.class,
            priority: self.excess.min(f64::from(f32::MAX)) as f32,
        }
    }
}

/// What one update wished for.
#[derive(Debug, Default)]
pub(super) struct Wishes {
    by_page: HashMap<PageId, Wish>,
    /// Pages without a record that are to be linked.
    implied: Vec<PageId>,
    /// Whether what is being tested is in view.
    pub(super) in_view: bool,
    /// Whether it was asked for by something else that depends on it.
    pub(super) blocked: bool,
}

impl Wishes {
    pub(super) fn clear(&mut self) {
        self.by_page.clear();
        self.implied.clear();
    }

    fn class(&self) -> Class {
        match (self.in_view, self.blocked) {
            (true, true) => Class::Blocker,
            (true, false) => Class::InView,
            (false, _) => Class::Ring,
        }
    }

    fn add(&mut self, wish: Wish) {
        let class = wish.class;
        let kept = self.by_page.entry(wish.page).or_insert(wish);
        kept.class = kept.class.min(class);
        kept.parts = kept.parts.max(wish.parts);
        kept.excess = kept.excess.max(wish.excess);
    }

    pub(super) fn take_implied(&mut self) -> Vec<PageId> {
        std::mem::take(&mut self.implied)
    }

    /// Most urgent first; equal ones in an order that does not change.
    pub(super) fn sorted(&self) -> Vec<Wish> {
        let mut wishes: Vec<Wish> = self.by_page.values().copied().collect();
        wishes.sort_unstable_by(|a, b| {
            let excess = b.excess.total_cmp(&a.excess);
            a.class.cmp(&b.class).then(excess).then(a.page.cmp(&b.page))
        });
        wishes
    }

    pub(super) fn len(&self) -> usize {
        self.by_page.len()
    }
}

/// Each level of vertices about halves the error, so this many more parts bring it down.
fn parts_for(excess: f64) -> u8 {
    (excess.max(1.0).log2().ceil() as u8).clamp(1, SLOT_PART)
}

impl Surface {
    /// Wants the root page, without which there is nothing.
    pub(super) fn want_root(&mut self) {
        self.wishes.in_view = true;
        self.wishes.blocked = false;
        self.want_page(PageId::ROOT, f64::INFINITY);
    }

    /// Wants the parts that hold a vertex, on the side or sides where they are missing.
    pub(super) fn want_parts_of(&mut self, vertex: VertexRef, excess: f64) {
        let part = part_of(vertex.1 as usize);
        let across = super::place::border(vertex.1 as usize)
            .and_then(|edge| self.node(vertex.0).neighbours[edge as usize]);
        for index in [Some(vertex.0), across].into_iter().flatten() {
            if self.node(index).page.depth() < part {
                self.want_parts(index, part, excess);
            }
        }
    }

    /// Wants at least this part of a resident page.
    fn want_parts(&mut self, index: Index, part: u8, excess: f64) {
        let page = &self.node(index).page;
        let likely = page.parts().saturating_add(parts_for(excess));
        self.wishes.add(Wish {
            page: page.id(),
            resident: page.parts(),
            parts: likely.max(part).min(page.last_part()),
            class: self.wishes.class(),
            excess,
        });
    }

    pub(super) fn want_neighbour(&mut self, index: Index, edge: Edge, excess: f64) {
        if let Some(id) = self.node(index).page.id().neighbour(edge) {
            let before = self.wishes.blocked;
            self.wishes.blocked = true;
            self.want_page(id, excess);
            self.wishes.blocked = before;
        }
    }

    /// Wants a page that is not resident: the topmost page on the way to it that is missing, or
    /// the slots of the one above that.
    pub(super) fn want_page(&mut self, id: PageId, excess: f64) {
        let Some((above, slot)) = id.parent() else {
            return self.want_new(id, excess);
        };
        let Some(&index) = self.by_id.get(&above) else {
            return self.want_page(above, excess);
        };
        let parent = &self.node(index).page;
        if !parent.has_slots() {
            self.want_parts(index, SLOT_PART, excess);
        } else if parent.slot(slot).has_record() {
            self.want_new(id, excess);
        } else {
            self.wishes.implied.push(id);
        }
    }

    fn want_new(&mut self, page: PageId, excess: f64) {
        let most = escarp_proto::page::last_part(self.grid.is_finest(page));
        self.wishes.add(Wish {
            page,
            resident: 0,
            parts: parts_for(excess).min(most),
            class: self.wishes.class(),
            excess,
        });
    }

    /// Wants the page below a cell.
    pub(super) fn want_below(&mut self, index: Index, child: PageSquare, excess: f64) {
        let slot = Slot::at(child.column as usize, child.row as usize);
        if let Some(id) = self.node(index).page.id().child(slot) {
            self.want_page(id, excess);
        }
    }
}
