//! What the client has, as far as the server knows.

use escarp_proto::geometry::PageId;
use escarp_proto::page::SLOT_PART;
use foldhash::fast::RandomState;
use std::collections::HashSet;
use std::hash::{Hash, Hasher};

/// A key has 61 bits: 8 for a level of at most 28, of which 5 are used, and 56 for the place.
const PARTS_AT: u32 = 61;
const KEY: u64 = (1 << PARTS_AT) - 1;

/// Stands for a part where the client had a page, and evicted it.
const EVICTED: u8 = 7;

const _: () = assert!(SLOT_PART < EVICTED);

/// The server's model of its client's cache: parts of pages, of the current generation. Bounded;
/// what does not fit is not remembered. Evicted pages are, while there is room, so that what is
/// sent again can be counted.
#[derive(Debug)]
pub(super) struct Held {
    limit: usize,
    /// Pages that are not evicted.
    count: usize,
    pages: HashSet<Entry, RandomState>,
}

/// A page's key and, in the upper bits, its last part: 8 bytes a page, as there are many pages in
/// a session, and many sessions.
#[derive(Debug, Clone, Copy)]
struct Entry(u64);

impl Entry {
    fn new(page: PageId, last_part: u8) -> Entry {
        Entry(page.key() & KEY | u64::from(last_part) << PARTS_AT)
    }

    const fn last_part(self) -> u8 {
        (self.0 >> PARTS_AT) as u8
    }
}

impl PartialEq for Entry {
    fn eq(&self, other: &Entry) -> bool {
        self.0 & KEY == other.0 & KEY
    }
}

impl Eq for Entry {}

impl Hash for Entry {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (self.0 & KEY).hash(state);
    }
}

impl Held {
    pub(super) fn new(limit: usize) -> Held {
        Held {
            limit,
            count: 0,
            pages: HashSet::default(),
        }
    }

    /// The client has parts `0..=last_part` of a page, and no more. `false` if there is no room to
    /// remember that.
    pub(super) fn insert(&mut self, page: PageId, last_part: u8) -> bool {
        if !self.fits(page) {
            return false;
        }
        let entry = Entry::new(page, last_part.min(SLOT_PART));
        let known = self.pages.replace(entry);
        self.count += usize::from(known.is_none_or(|known| known.last_part() == EVICTED));
        if self.pages.len() > self.limit {
            self.pages.retain(|entry| entry.last_part() != EVICTED);
        }
        true
    }

    /// Whether there is room for a page.
    pub(super) fn fits(&self, page: PageId) -> bool {
        self.count < self.limit || self.last_part(page).is_some()
    }

    /// Parts `first_part..=last_part` are on their way. They add to what the client has only if
    /// they join on to that.
    pub(super) fn sent(&mut self, page: PageId, first_part: u8, last_part: u8) {
        let next = self.next_part(page);
        if first_part <= next {
            self.insert(page, last_part.max(next.saturating_sub(1)));
        }
    }

    pub(super) fn evict(&mut self, page: PageId) {
        if self.last_part(page).is_some() {
            self.count -= 1;
            self.pages.replace(Entry::new(page, EVICTED));
        }
    }

    /// Forgets everything.
    pub(super) fn clear(&mut self) {
        *self = Held::new(self.limit);
    }

    /// The last part of a page that the client has.
    pub(super) fn last_part(&self, page: PageId) -> Option<u8> {
        self.find(page).filter(|&part| part != EVICTED)
    }

    /// The first part of a page that the client has not.
    pub(super) fn next_part(&self, page: PageId) -> u8 {
        self.last_part(page).map_or(0, |last| last + 1)
    }

    /// Whether the client had a page, and has it no longer, as far as that is remembered.
    pub(super) fn was_evicted(&self, page: PageId) -> bool {
        self.find(page) == Some(EVICTED)
    }

    fn find(&self, page: PageId) -> Option<u8> {
        self.pages
            .get(&Entry::new(page, 0))
            .map(|entry| entry.last_part())
    }

    /// Pages that the client has.
    pub(super) fn len(&self) -> usize {
        self.count
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::HashMap;

    fn page() -> impl Strategy<Value = PageId> {
        (0..3u8, 0..16u32, 0..16u32).prop_map(|(depth, x, y)| {
            let side = 1 << (4 * depth);
            PageId::new(4 * depth, x % side, y % side).unwrap()
        })
    }

    proptest! {
        #[test]
        fn the_model_is_a_map_from_page_to_part(
            steps in prop::collection::vec((page(), 0..6u8, 0..6u8, 0..4u8), 0..200),
        ) {
            let mut held = Held::new(usize::MAX);
            let mut map: HashMap<PageId, u8> = HashMap::new();
            for (page, first, last, what) in steps {
                match what {
                    0 => {
                        held.evict(page);
                        map.remove(&page);
                    }
                    1 => {
                        held.insert(page, last);
                        map.insert(page, last);
                    }
                    _ => {
                        held.sent(page, first, last.max(first));
                        let had = map.get(&page).copied();
                        if had.map_or(0, |had| had + 1) >= first {
                            map.insert(page, had.unwrap_or(0).max(last.max(first)));
                        }
                    }
                }
                prop_assert_eq!(held.last_part(page), map.get(&page).copied());
                prop_assert_eq!(held.len(), map.len());
            }
            for (page, last) in map {
                prop_assert_eq!(held.last_part(page), Some(last));
            }
        }
    }

    #[test]
    fn the_deepest_pages_keep_their_key_beside_the_part() {
        let side = 1 << 24;
        let deepest = PageId::new(24, side - 1, side - 1).unwrap();
        let mut held = Held::new(1);
        assert!(held.insert(deepest, SLOT_PART));
        assert_eq!(held.last_part(deepest), Some(SLOT_PART));
        assert!(!held.insert(PageId::ROOT, 0), "beyond the limit");
        assert!(held.insert(deepest, 1), "no more than there was");
    }
}
