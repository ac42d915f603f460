//! What the link knows of pages: those here, and those that do not come.

use escarp_proto::geometry::{GridLevels, PageId};
use escarp_proto::page::last_part;
use escarp_proto::wire::{Have, Want};
use std::collections::{HashMap, HashSet, VecDeque};
use std::time::Duration;

/// Pages remembered as not to be asked for. Older ones are forgotten first, and asked again.
pub(super) const MAX_MISSES: usize = 1 << 16;

/// The pages whose parts were delivered and not evicted since.
#[derive(Debug, Default)]
pub(super) struct Held {
    pages: HashMap<u64, Parts>,
    /// Known from the first Welcome on.
    grid: Option<GridLevels>,
}

#[derive(Debug, Clone, Copy)]
struct Parts {
    revision: u32,
    /// Parts here, from the first.
    count: u8,
}

impl Held {
    /// What of a wish is still to be asked for. Parts that were delivered may not be linked into
    /// the mesh tree yet, so that it wishes for them once more; and a wish for more parts than the
    /// page has would never be fulfilled.
    pub(super) fn missing(&self, want: &Want) -> Option<Want> {
        let count = self.pages.get(&want.page).map_or(0, |parts| parts.count);
        let first_part = want.first_part.max(count);
        let last_part = want.last_part.min(self.last_part(want.page));
        (first_part <= last_part).then_some(Want {
            first_part,
            last_part,
            ..*want
        })
    }

    /// Last part of a page by its place in the grid.
    pub(super) fn last_part(&self, key: u64) -> u8 {
        let finest = |grid: GridLevels| PageId::from_key(key).is_some_and(|p| grid.is_finest(p));
        last_part(self.grid.is_some_and(finest))
    }

    /// Whether parts of this revision can be joined to those here.
    pub(super) fn joins(&self, page: u64, revision: u32) -> bool {
        self.pages
            .get(&page)
            .is_none_or(|parts| parts.revision == revision)
    }

    pub(super) fn add(&mut self, page: u64, revision: u32, last_part: u8) {
        let count = last_part.saturating_add(1);
        self.pages.insert(page, Parts { revision, count });
    }

    pub(super) fn remove(&mut self, page: u64) -> bool {
        self.pages.remove(&page).is_some()
    }

    /// Forgets all pages; those to come belong to this grid.
    pub(super) fn start(&mut self, grid: GridLevels) {
        self.pages.clear();
        self.grid = Some(grid);
    }

    pub(super) fn len(&self) -> usize {
        self.pages.len()
    }

    /// All of them, for Have.
    pub(super) fn list(&self) -> Vec<Have> {
        let have = |(&page, parts): (&u64, &Parts)| Have {
            page,
            revision: parts.revision,
            parts: parts.count,
        };
        self.pages.iter().map(have).collect()
    }
}

/// The pages that are not to be asked for: in this session, or for a while. Bounded.
#[derive(Debug, Default)]
pub(super) struct Misses {
    lost: HashSet<u64>,
    lost_order: VecDeque<u64>,
    busy: HashSet<u64>,
    /// Oldest first, as every delay is the same.
    busy_order: VecDeque<(Duration, u64)>,
}

impl Misses {
    pub(super) fn blocks(&self, page: u64) -> bool {
        self.lost.contains(&page) || self.busy.contains(&page)
    }

    /// Not to be asked for in this session.
    pub(super) fn lose(&mut self, page: u64) {
        if self.lost.insert(page) {
            self.lost_order.push_back(page);
        }
        if self.lost_order.len() > MAX_MISSES
            && let Some(oldest) = self.lost_order.pop_front()
        {
            self.lost.remove(&oldest);
        }
    }

    /// Not to be asked for before this time.
    pub(super) fn delay(&mut self, page: u64, until: Duration) {
        if self.busy.insert(page) {
            self.busy_order.push_back((until, page));
        }
        if self.busy_order.len() > MAX_MISSES
            && let Some((_, oldest)) = self.busy_order.pop_front()
        {
            self.busy.remove(&oldest);
        }
    }

    /// Frees the pages whose delay is over.
    pub(super) fn expire(&mut self, now: Duration) {
        while let Some((until, page)) = self.busy_order.front().copied()
            && until <= now
        {
            self.busy_order.pop_front();
            self.busy.remove(&page);
        }
    }

    /// When the next delay is over.
    pub(super) fn next_timeout(&self) -> Option<Duration> {
        self.busy_order.front().map(|(until, _)| *until)
    }

    pub(super) fn clear(&mut self) {
        *self = Misses::default();
    }

    #[cfg(test)]
    pub(super) fn len(&self) -> usize {
        self.lost_order.len() + self.busy_order.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn misses_are_bounded_and_delays_end() {
        let mut misses = Misses::default();
        for page in 0..2 * MAX_MISSES as u64 {
            misses.lose(page);
            misses.delay(page, Duration::from_secs(1));
        }
        assert_eq!(misses.len(), 2 * MAX_MISSES);
        assert_eq!(
            (misses.lost.len(), misses.busy.len()),
            (MAX_MISSES, MAX_MISSES)
        );
        assert!(!misses.blocks(0) && misses.blocks(2 * MAX_MISSES as u64 - 1));
        misses.expire(Duration::from_secs(1));
        assert!(misses.busy.is_empty() && misses.next_timeout().is_none());
    }
}
