//! What the client has, as far as the server knows. Pulling does not need it; pushing will.

use escarp_proto::geometry::PageId;
use escarp_proto::wire::{Chunk, Have};
use std::collections::HashMap;

/// The server's model of its client's cache. Bounded: what does not fit is not remembered, so it
/// would at worst be sent twice.
#[derive(Debug)]
pub(super) struct CacheModel {
    limit: usize,
    pages: HashMap<PageId, Held>,
}

/// Parts `0..=last_part` of one revision.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Held {
    pub revision: u32,
    pub last_part: u8,
}

impl CacheModel {
    pub(super) fn new(limit: usize) -> CacheModel {
        CacheModel {
            limit,
            pages: HashMap::new(),
        }
    }

    /// The client says that it has a page.
    pub(super) fn have(&mut self, page: PageId, have: Have) {
        let held = Held {
            revision: have.revision,
            last_part: have.parts,
        };
        self.insert(page, held);
    }

    /// A chunk is on its way. It adds to what the client has only if it joins on to that.
    pub(super) fn sent(&mut self, page: PageId, chunk: &Chunk) {
        let joins = |held: &&Held| {
            held.revision == chunk.revision && chunk.first_part <= held.last_part.saturating_add(1)
        };
        let before = self
            .pages
            .get(&page)
            .filter(joins)
            .map(|held| held.last_part);
        if chunk.first_part > 0 && before.is_none() {
            return;
        }
        let held = Held {
            revision: chunk.revision,
            last_part: before.unwrap_or(0).max(chunk.last_part),
        };
        self.insert(page, held);
    }

    pub(super) fn evict(&mut self, page: PageId) {
        self.pages.remove(&page);
    }

    pub(super) fn get(&self, page: PageId) -> Option<Held> {
        self.pages.get(&page).copied()
    }

    #[cfg(test)]
    pub(super) fn len(&self) -> usize {
        self.pages.len()
    }

    fn insert(&mut self, page: PageId, held: Held) {
        if self.pages.len() < self.limit || self.pages.contains_key(&page) {
            self.pages.insert(page, held);
        }
    }
}
