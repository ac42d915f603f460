//! What the link knows of pages: those here, and those that do not come.

use escarp_proto::geometry::{GridLevels, PageId};
use escarp_proto::page::{MAX_RECORD_BYTES, last_part};
use escarp_proto::wire::{Chunk, Have, Want};
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
    /// Their bytes, at most those of the longest record.
    bytes: u16,
    /// Said by Have, and the server may still answer that it is stale.
    announced: bool,
    /// It came before the manifest changed the last time.
    before: bool,
}

const _: () = assert!(MAX_RECORD_BYTES <= u16::MAX as usize);

impl Held {
    /// What of a wish is still to be asked for. Parts that were delivered may not be linked into
    /// the mesh tree yet, so that it wishes for them once more; and a wish for more parts than the
    /// page has would never be fulfilled.
    pub(super) fn missing(&self, want: &Want) -> Option<Want> {
        let first_part = match self.count(want.page) {
            // What the wish counts on has gone.
            0 => 0,
            count => want.first_part.max(count),
        };
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

    /// Whether a chunk continues what is here of its page, or begins one of which nothing is: no
    /// part missing or twice, of one revision, and no longer than a record may be.
    pub(super) fn continues(&self, chunk: &Chunk) -> bool {
        let page = PageId::from_key(chunk.page);
        page.zip(self.grid).is_some_and(|(id, grid)| grid.holds(id))
            && chunk.first_part == self.count(chunk.page)
            && (chunk.first_part..=self.last_part(chunk.page)).contains(&chunk.last_part)
            && self.joins(chunk.page, chunk.revision)
            && self.has_room(chunk)
    }

    /// Whether a page stays within the longest record with this chunk.
    pub(super) fn has_room(&self, chunk: &Chunk) -> bool {
        let here = self.pages.get(&chunk.page).map_or(0, |parts| parts.bytes);
        usize::from(here) + chunk.bytes.len() <= MAX_RECORD_BYTES
    }

    /// Parts that are here.
    pub(super) fn count(&self, page: u64) -> u8 {
        self.pages.get(&page).map_or(0, |parts| parts.count)
    }

    /// Takes note of a chunk that [has room](Self::has_room).
    pub(super) fn add(&mut self, chunk: &Chunk) {
        let parts = self.pages.entry(chunk.page).or_insert(Parts {
            revision: chunk.revision,
            count: 0,
            bytes: 0,
            announced: false,
            before: false,
        });
        parts.revision = chunk.revision;
        parts.count = chunk.last_part.saturating_add(1);
        parts.bytes = parts.bytes.saturating_add(chunk.bytes.len() as u16);
        // It came as a continuation, so the server's revision is ours.
        parts.announced = false;
    }

    pub(super) fn has(&self, page: u64) -> bool {
        self.pages.contains_key(&page)
    }

    pub(super) fn revision(&self, page: u64) -> Option<u32> {
        self.pages.get(&page).map(|parts| parts.revision)
    }

    /// Whether the server may still say that the page is stale.
    pub(super) fn is_announced(&self, page: u64) -> bool {
        self.pages.get(&page).is_some_and(|parts| parts.announced)
    }

    /// The server says that its revision is another one. Whether that is news.
    pub(super) fn is_stale(&mut self, page: u64) -> bool {
        self.is_announced(page) && self.remove(page)
    }

    /// All pages that are here are of before a change.
    pub(super) fn age(&mut self) {
        let pages = self.pages.values_mut();
        pages.for_each(|parts| parts.before = true);
    }

    /// The pages of before the last change, by key.
    pub(super) fn of_before(&self) -> Vec<PageId> {
        let pages = self.pages.iter().filter(|(_, parts)| parts.before);
        let mut pages: Vec<PageId> = pages
            .filter_map(|(&key, _)| PageId::from_key(key))
            .collect();
        pages.sort_unstable();
        pages
    }

    /// All that was said by Have has been answered.
    pub(super) fn confirm(&mut self) {
        self.pages
            .values_mut()
            .for_each(|parts| parts.announced = false);
    }

    /// Of a page there are only so many parts; how many bytes they have is not known any more.
    pub(super) fn cut(&mut self, page: u64, count: u8) {
        match self.pages.get_mut(&page) {
            Some(_) if count == 0 => drop(self.pages.remove(&page)),
            Some(parts) => parts.count = parts.count.min(count),
            None => {}
        }
    }

    pub(super) fn remove(&mut self, page: u64) -> bool {
        self.pages.remove(&page).is_some()
    }

    /// Pages to come belong to this grid.
    pub(super) fn start(&mut self, grid: GridLevels) {
        self.grid = Some(grid);
    }

    pub(super) fn len(&self) -> usize {
        self.pages.len()
    }

    /// All of them, by key; they count as announced from now on.
    pub(super) fn announce_all(&mut self) -> Vec<Have> {
        let mut pages: Vec<u64> = self.pages.keys().copied().collect();
        pages.sort_unstable();
        pages
            .iter()
            .filter_map(|&page| self.announce(page))
            .collect()
    }

    /// A page for Have, if it is here.
    pub(super) fn announce(&mut self, page: u64) -> Option<Have> {
        let parts = self.pages.get_mut(&page)?;
        parts.announced = true;
        Some(Have {
            page,
            revision: parts.revision,
            parts: parts.count.saturating_sub(1),
        })
    }

    /// Forgets all pages; gives which there were.
    pub(super) fn clear(&mut self) -> Vec<u64> {
        self.pages.drain().map(|(page, _)| page).collect()
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
