//! The triangles that a page's tests are about, by number, and what is noted of each.

use super::super::place::PageSquare;
use super::super::surface::{Index, Surface};
use super::super::vertices::{Asker, VertexRef};
use escarp_proto::geometry::{Edge, PAGE_LEVELS, Quadrant};
use escarp_proto::page::square_index;

/// Squares of a page that have a centre.
const SQUARES: usize = square_index(PAGE_LEVELS, 0, 0);
/// Tests of a page: for each square four edge triangles and four quadrants.
pub(super) const ITEMS: usize = 8 * SQUARES;

const PLACES: [PageSquare; SQUARES] = places();

const fn places() -> [PageSquare; SQUARES] {
    let mut places = [PageSquare::ROOT; SQUARES];
    let mut level = 0;
    while level < PAGE_LEVELS {
        let mut row = 0;
        while row < 1 << level {
            let mut column = 0;
            while column < 1 << level {
                places[square_index(level, column, row)] = PageSquare {
                    level,
                    column: column as u8,
                    row: row as u8,
                };
                column += 1;
            }
            row += 1;
        }
        level += 1;
    }
    places
}

/// One side of a diamond, as the page that it lies in numbers it: the triangle of a square's
/// centre and an edge, which the edge's vertex splits, or a quadrant, both halves of which its
/// centre splits. Coarser squares have lower numbers; edges come before quadrants.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Item(u16);

/// What an [`Item`] is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    Edge(PageSquare, Edge),
    Quadrant(PageSquare, Quadrant),
}

impl Item {
    pub(super) const fn from_index(index: usize) -> Item {
        Item(index as u16)
    }

    pub(super) const fn index(self) -> usize {
        self.0 as usize
    }

    pub(super) fn edge(square: PageSquare, edge: Edge) -> Item {
        Item(first(square) + edge as u16)
    }

    pub(super) fn quadrant(square: PageSquare, quadrant: Quadrant) -> Item {
        Item(first(square) + 4 + quadrant as u16)
    }

    pub(super) fn side(self) -> Side {
        let square = PLACES[self.index() / 8];
        match self.index() % 8 {
            edge @ 0..4 => Side::Edge(square, Edge::ALL[edge]),
            quadrant => Side::Quadrant(square, Quadrant::ALL[quadrant - 4]),
        }
    }

    /// The vertex that splits it, and as whom to ask for it; `None` if that is in a page that is
    /// not resident.
    pub(super) fn vertex(self, surface: &Surface, page: Index) -> Option<(VertexRef, Asker)> {
        match self.side() {
            Side::Edge(square, edge) => Some(((page, square.edge(edge) as u16), edge.into())),
            Side::Quadrant(square, quadrant) => surface
                .square_below(page, square.child(quadrant))
                .map(|(page, square)| ((page, square.centre() as u16), Asker::First)),
        }
    }

    /// Whether there is such a triangle: for a quadrant, whether it is not part of two larger ones.
    pub(super) fn exists(self, surface: &Surface, page: Index) -> bool {
        match self.side() {
            Side::Edge(square, _) => surface.is_enabled((page, square.centre() as u16)),
            Side::Quadrant(square, quadrant) => quadrant
                .edges()
                .into_iter()
                .any(|edge| surface.is_enabled((page, square.edge(edge) as u16))),
        }
    }
}

fn first(square: PageSquare) -> u16 {
    let index = square_index(
        square.level,
        usize::from(square.column),
        usize::from(square.row),
    );
    8 * index as u16
}

/// Tells the entry of an item that counts from those that do not: whichever bears another stamp is
/// void. So an item has one entry in all queues together, without being searched for in them.
///
/// Stamps recur after a while. A void entry that then counts costs a test too many: when it is
/// taken out, the item is tested and gets a new entry, which voids all others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Stamp {
    /// Which of the notes that its page has had.
    notes: u8,
    /// Which of the entries that the item has had.
    entry: u8,
}

/// What is noted of an item.
#[derive(Debug, Clone, Copy, Default)]
struct Note {
    /// Its entry that counts.
    entry: u8,
    exists: bool,
    asked: bool,
    /// Found in this update to need what is not resident.
    blocked: bool,
}

/// What is noted of a page's items; kept for pages of which some exist.
#[derive(Debug)]
pub(super) struct Notes {
    number: u8,
    notes: [Note; ITEMS],
    existing: u16,
}

impl Notes {
    /// Notes of a page; `number` should differ from that of others that it has had.
    pub(super) fn new(number: u8) -> Box<Notes> {
        Box::new(Notes {
            number,
            notes: [Note::default(); ITEMS],
            existing: 0,
        })
    }

    pub(super) fn exists(&self, item: Item) -> bool {
        self.notes[item.index()].exists
    }

    pub(super) fn is_asked(&self, item: Item) -> bool {
        self.notes[item.index()].asked
    }

    pub(super) fn set_asked(&mut self, item: Item, asked: bool) {
        self.notes[item.index()].asked = asked;
    }

    pub(super) fn is_blocked(&self, item: Item) -> bool {
        self.notes[item.index()].blocked
    }

    pub(super) fn set_blocked(&mut self, item: Item, blocked: bool) {
        self.notes[item.index()].blocked = blocked;
    }

    /// Notes that an item has come to exist or does no more. Whether it is news.
    pub(super) fn set_exists(&mut self, item: Item, exists: bool) -> bool {
        let note = &mut self.notes[item.index()];
        if note.exists == exists {
            return false;
        }
        note.exists = exists;
        note.blocked = false;
        note.entry = note.entry.wrapping_add(1);
        match exists {
            true => self.existing += 1,
            false => self.existing -= 1,
        }
        true
    }

    pub(super) fn any_exist(&self) -> bool {
        self.existing > 0
    }

    /// Voids whatever entry an item has; gives the stamp of the next.
    pub(super) fn renew(&mut self, item: Item) -> Stamp {
        let note = &mut self.notes[item.index()];
        note.entry = note.entry.wrapping_add(1);
        Stamp {
            notes: self.number,
            entry: note.entry,
        }
    }

    /// Whether an entry with this stamp counts.
    pub(super) fn counts(&self, item: Item, stamp: Stamp) -> bool {
        let note = &self.notes[item.index()];
        note.exists && note.entry == stamp.entry && self.number == stamp.notes
    }

    pub(super) fn existing(&self) -> impl Iterator<Item = Item> + '_ {
        (0..ITEMS)
            .map(Item::from_index)
            .filter(|&item| self.exists(item))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_item_is_numbered_as_what_it_is() {
        for i in 0..ITEMS {
            let item = Item::from_index(i);
            let back = match item.side() {
                Side::Edge(square, edge) => Item::edge(square, edge),
                Side::Quadrant(square, quadrant) => Item::quadrant(square, quadrant),
            };
            assert_eq!(back, item);
        }
    }
}
