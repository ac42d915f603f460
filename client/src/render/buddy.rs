//! A buddy allocator: which parts of a block are taken. Freed halves join again.

use std::collections::BTreeSet;

/// Places in a block of `2^orders` units, given out in runs of a power of two.
///
/// Invariant: no two free runs of one order are buddies, for they would have been joined.
#[derive(Debug)]
pub struct Buddy {
    /// Starts of the free runs of `2^order` units, by order.
    free: Vec<BTreeSet<u32>>,
}

impl Buddy {
    /// A block of `2^order` free units.
    pub fn new(order: u8) -> Buddy {
        let mut free = vec![BTreeSet::new(); usize::from(order) + 1];
        free[usize::from(order)].insert(0);
        Buddy { free }
    }

    /// The start of a run of `2^order` units, now taken; `None` if no such run is free.
    pub fn take(&mut self, order: u8) -> Option<u32> {
        let order = usize::from(order);
        let found = (order..self.free.len()).find(|&o| !self.free[o].is_empty())?;
        let start = self.free[found].pop_first()?;
        for half in order..found {
            self.free[half].insert(start + (1 << half));
        }
        Some(start)
    }

    /// Gives back a run that [`take`](Self::take) gave out with this order.
    pub fn give(&mut self, mut start: u32, order: u8) {
        let mut order = usize::from(order);
        while order + 1 < self.free.len() && self.free[order].remove(&(start ^ (1 << order))) {
            start &= !(1 << order);
            order += 1;
        }
        self.free[order].insert(start);
    }
}

/// The smallest order whose runs hold this many units.
pub fn order_of(units: u32) -> u8 {
    units.max(1).next_power_of_two().trailing_zeros() as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn runs_never_overlap_and_all_join_again(
            steps in prop::collection::vec((0u8..6, any::<prop::sample::Index>(), any::<bool>()), 1..200),
        ) {
            let mut buddy = Buddy::new(8);
            let mut taken: Vec<(u32, u8)> = Vec::new();
            for (order, pick, give) in steps {
                if give && !taken.is_empty() {
                    let (start, order) = taken.swap_remove(pick.index(taken.len()));
                    buddy.give(start, order);
                } else if let Some(start) = buddy.take(order) {
                    let end = start + (1 << order);
                    prop_assert!(end <= 256);
                    prop_assert!(taken.iter().all(|&(s, o)| end <= s || s + (1 << o) <= start));
                    taken.push((start, order));
                }
            }
            for (start, order) in taken {
                buddy.give(start, order);
            }
            prop_assert_eq!(buddy.take(8), Some(0));
        }
    }

    #[test]
    fn an_order_holds_its_units() {
        assert_eq!([0, 1, 2, 3, 32, 33].map(order_of), [0, 0, 1, 2, 5, 6]);
    }
}
