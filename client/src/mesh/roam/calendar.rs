//! When to look at a triangle again: a radix heap over the way of the eye (Ahuja, Mehlhorn,
//! Orlin, Tarjan, "Faster Algorithms for the Shortest Path Problem", 1990).
//!
//! Keys only ever lie ahead, so that entries can wait in buckets by the highest bit in which their
//! key differs from the present. Each entry moves to a lower bucket a few times at most, and in
//! sequence; there are no comparisons, and no heap to sift.

use super::super::surface::Index;
use super::item::{Item, Stamp};

/// A triangle that need not be looked at until the eye has come this far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Entry {
    /// Bits of the way, metres: of numbers from zero up they sort as the numbers do.
    key: u64,
    pub(super) page: Index,
    pub(super) item: Item,
    /// Stamp of the item; another one makes the entry void.
    pub(super) stamp: Stamp,
}

impl Entry {
    /// An entry that is due when the eye has gone `way_m`, at least zero, in all.
    pub(super) fn new(way_m: f64, page: Index, item: Item, stamp: Stamp) -> Entry {
        Entry {
            key: way_m.max(0.0).to_bits(),
            page,
            item,
            stamp,
        }
    }
}

const _: () = assert!(size_of::<Entry>() == 16);

/// Entries that an empty bucket keeps room for.
const ROOM: usize = 1024;

/// Entries by when they are due.
#[derive(Debug)]
pub(super) struct Calendar {
    now: u64,
    /// By how many of the low bits of a key hold the highest that differs from `now`.
    buckets: Vec<Vec<Entry>>,
}

impl Calendar {
    pub(super) fn new() -> Calendar {
        Calendar {
            now: 0,
            buckets: vec![Vec::new(); 65],
        }
    }

    /// Forgets all entries, and begins at zero.
    pub(super) fn clear(&mut self) {
        self.now = 0;
        self.buckets.iter_mut().for_each(Vec::clear);
    }

    pub(super) fn len(&self) -> usize {
        self.buckets.iter().map(Vec::len).sum()
    }

    pub(super) fn memory_bytes(&self) -> usize {
        let entries: usize = self.buckets.iter().map(Vec::capacity).sum();
        entries * size_of::<Entry>()
    }

    pub(super) fn push(&mut self, entry: Entry) {
        // What is due already is due at the next opportunity.
        let key = entry.key.max(self.now);
        self.buckets[bucket(key, self.now)].push(entry);
    }

    /// Goes on to `way_m`, not before the present, and takes out what is due by then.
    pub(super) fn advance(&mut self, way_m: f64, due: &mut Vec<Entry>) {
        let to = way_m.max(0.0).to_bits().max(self.now);
        let last = bucket(to, self.now);
        self.now = to;
        for bucket in &mut self.buckets[..last] {
            due.append(bucket);
            bucket.shrink_to(ROOM);
        }
        let mut parted = std::mem::take(&mut self.buckets[last]);
        for entry in parted.drain(..) {
            match entry.key <= to {
                true => due.push(entry),
                false => self.push(entry),
            }
        }
        // Pushed entries went to lower buckets. A little room stays, for the next ones.
        if parted.capacity() <= ROOM {
            self.buckets[last] = parted;
        }
    }

    /// Keeps only what is still of use.
    pub(super) fn retain(&mut self, keep: impl Fn(&Entry) -> bool) {
        for bucket in &mut self.buckets {
            bucket.retain(&keep);
            bucket.shrink_to(ROOM.max(bucket.len() * 5 / 4));
        }
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Entry> {
        self.buckets.iter().flatten()
    }
}

fn bucket(key: u64, now: u64) -> usize {
    (u64::BITS - (key ^ now).leading_zeros()) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn entry(way_m: f64, page: Index) -> Entry {
        Entry::new(way_m, page, Item::from_index(0), Stamp::default())
    }

    proptest! {
        #[test]
        fn what_comes_out_is_what_is_due(
            steps in prop::collection::vec((prop::collection::vec(0.0f64..40.0, 0..6), 0.0f64..9.0), 1..60),
        ) {
            let mut calendar = Calendar::new();
            let mut plain: Vec<(f64, Index)> = Vec::new();
            let (mut now_m, mut next) = (0.0, 0);
            for (ahead, step_m) in steps {
                for ahead_m in ahead {
                    calendar.push(entry(now_m + ahead_m, next));
                    plain.push((now_m + ahead_m, next));
                    next += 1;
                }
                now_m += step_m;
                let mut due = Vec::new();
                calendar.advance(now_m, &mut due);
                let mut found: Vec<Index> = due.iter().map(|entry| entry.page).collect();
                found.sort_unstable();
                let expected: Vec<Index> =
                    plain.iter().filter(|(key, _)| *key <= now_m).map(|&(_, page)| page).collect();
                plain.retain(|(key, _)| *key > now_m);
                prop_assert_eq!(found, expected);
                prop_assert_eq!(calendar.len(), plain.len());
            }
        }
    }
}
