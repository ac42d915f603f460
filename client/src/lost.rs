//! Pages that do not come, and those that were refused: which of them are wanted once more.

use escarp_proto::geometry::PageId;
use std::collections::{HashMap, VecDeque};

/// Pages remembered. Older ones are forgotten first, and wanted again as if nothing had been.
const MOST: usize = 1 << 16;

/// The pages of a session that are not simply wanted. Bounded.
#[derive(Debug, Default)]
pub(crate) struct Lost {
    pages: HashMap<PageId, State>,
    order: VecDeque<PageId>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// Refused once, and wanted again. The next refusal is the last, even if parts of it fit.
    Again,
    /// Not wanted any more.
    Missing,
}

impl Lost {
    /// The page does not come.
    pub(crate) fn miss(&mut self, page: PageId) {
        self.set(page, State::Missing);
    }

    /// The page was refused. Whether it is wanted once more.
    pub(crate) fn refuse(&mut self, page: PageId) -> bool {
        let again = !self.pages.contains_key(&page);
        let state = match again {
            true => State::Again,
            false => State::Missing,
        };
        self.set(page, state);
        again
    }

    /// Whether the page is not wanted any more.
    pub(crate) fn is_missing(&self, page: PageId) -> bool {
        self.pages.get(&page) == Some(&State::Missing)
    }

    fn set(&mut self, page: PageId, state: State) {
        if self.pages.insert(page, state).is_none() {
            self.order.push_back(page);
        }
        if self.order.len() > MOST
            && let Some(oldest) = self.order.pop_front()
        {
            self.pages.remove(&oldest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refused_page_is_wanted_once_more_and_then_missing() {
        let mut lost = Lost::default();
        assert!(lost.refuse(PageId::ROOT) && !lost.is_missing(PageId::ROOT));
        for _ in 0..3 {
            assert!(!lost.refuse(PageId::ROOT) && lost.is_missing(PageId::ROOT));
        }
    }

    #[test]
    fn what_is_remembered_is_bounded() {
        let mut lost = Lost::default();
        let page = |i: u32| PageId::new(16, i % 4096, i / 4096).unwrap();
        for i in 0..2 * MOST as u32 {
            lost.miss(page(i));
        }
        assert_eq!((lost.pages.len(), lost.order.len()), (MOST, MOST));
        assert!(!lost.is_missing(page(0)));
        assert!(lost.is_missing(page(2 * MOST as u32 - 1)));
    }
}
