//! What a client wants, most urgent first.
//!
//! Invariant: `order` and `ranks` hold the same pages, at most `limit`.

use super::push::Piece;
use escarp_proto::geometry::PageId;
use escarp_proto::wire::{Class, Want};
use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap};

/// Parts of a page that a client waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Wish {
    pub page: PageId,
    pub first_part: u8,
    pub last_part: u8,
}

/// Place in the queue, smallest first: class, then priority, then arrival.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Rank {
    class: Class,
    priority: Reverse<u32>,
    arrival: u64,
}

impl Rank {
    /// Whether it goes before a piece that nobody asked for.
    pub(super) fn is_before(self, piece: &Piece) -> bool {
        (self.class, self.priority) <= (piece.class, Reverse(ordered(piece.excess)))
    }
}

/// A bounded priority queue with one wish a page.
#[derive(Debug)]
pub(super) struct WantQueue {
    limit: usize,
    order: BTreeMap<Rank, Wish>,
    ranks: HashMap<PageId, Rank>,
    arrivals: u64,
}

impl WantQueue {
    pub(super) fn new(limit: usize) -> WantQueue {
        WantQueue {
            limit,
            order: BTreeMap::new(),
            ranks: HashMap::new(),
            arrivals: 0,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.order.len()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.order.is_empty()
    }

    /// Puts a wish in its place, instead of an older one for the page. `false` if the queue is
    /// full.
    pub(super) fn insert(&mut self, page: PageId, want: &Want) -> bool {
        if self.len() >= self.limit && !self.ranks.contains_key(&page) {
            return false;
        }
        self.remove(page);
        self.arrivals += 1;
        let rank = Rank {
            class: want.class,
            priority: Reverse(ordered(want.priority)),
            arrival: self.arrivals,
        };
        let wish = Wish {
            page,
            first_part: want.first_part,
            last_part: want.last_part,
        };
        self.ranks.insert(page, rank);
        self.order.insert(rank, wish);
        true
    }

    /// Takes a page's wish out, if there is one.
    pub(super) fn remove(&mut self, page: PageId) {
        if let Some(rank) = self.ranks.remove(&page) {
            self.order.remove(&rank);
        }
    }

    /// The most urgent wish, and its place.
    pub(super) fn first(&self) -> Option<(Rank, Wish)> {
        self.order
            .first_key_value()
            .map(|(rank, wish)| (*rank, *wish))
    }

    /// Takes all wishes out.
    pub(super) fn clear(&mut self) {
        self.order.clear();
        self.ranks.clear();
    }
}

/// A number that sorts as the priority does. NaN counts as 0, and so does -0.
fn ordered(priority: f32) -> u32 {
    let priority = if priority.is_nan() {
        0.0
    } else {
        priority + 0.0
    };
    let bits = priority.to_bits();
    let negative = bits >> 31 == 1;
    if negative { !bits } else { bits | 1 << 31 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn priorities_sort_as_numbers_and_nan_is_zero() {
        let rising = [
            f32::NEG_INFINITY,
            -1.0,
            0.0,
            f32::MIN_POSITIVE,
            1.0,
            f32::INFINITY,
        ];
        assert!(
            rising
                .windows(2)
                .all(|pair| ordered(pair[0]) < ordered(pair[1]))
        );
        for zero in [f32::NAN, -f32::NAN, -0.0] {
            assert_eq!(ordered(zero), ordered(0.0));
        }
    }
}
