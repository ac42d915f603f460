//! What the server is told of the pages that are here: Have and Evict, in the order of the events.

use escarp_proto::wire::{ClientMessage, Have};
use std::collections::{HashSet, VecDeque};

/// Dropped chunks remembered. Of older ones the server hears when their pages do not come.
pub(super) const MAX_STRAYS: usize = 1 << 14;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Claim {
    Have(Have),
    Evict(u64),
}

impl Claim {
    fn page(&self) -> u64 {
        match self {
            Claim::Have(have) => have.page,
            Claim::Evict(page) => *page,
        }
    }
}

/// See the module. Each is said once, and both of one page in order.
#[derive(Debug, Default)]
pub(super) struct Claims {
    queue: VecDeque<Claim>,
    /// So many Haves that list nothing go first.
    answers: u32,
    strays: Strays,
}

impl Claims {
    pub(super) fn have(&mut self, have: Have) {
        self.queue.push_back(Claim::Have(have));
    }

    /// Answers a GenChange, before all else: what follows is of that generation. Each has its own
    /// answer, as the server counts them.
    pub(super) fn answer_change(&mut self) {
        self.answers = self.answers.saturating_add(1);
    }

    pub(super) fn evict(&mut self, page: u64) {
        self.queue.push_back(Claim::Evict(page));
    }

    /// The next message: of one kind, with at most so many pages.
    pub(super) fn poll(&mut self, most: usize) -> Option<ClientMessage> {
        if self.answers > 0 {
            self.answers -= 1;
            return Some(ClientMessage::Have(Vec::new()));
        }
        let is_have = |claim: &Claim| matches!(claim, Claim::Have(_));
        let first = is_have(self.queue.front()?);
        let alike = self.queue.iter().take(most);
        let count = alike.take_while(|&claim| is_have(claim) == first).count();
        let mut run: Vec<Claim> = self.queue.drain(..count).collect();
        // Sorted keys take fewer bytes.
        run.sort_by_key(Claim::page);
        Some(match first {
            true => {
                let haves = run.into_iter().filter_map(|claim| match claim {
                    Claim::Have(have) => Some(have),
                    Claim::Evict(_) => None,
                });
                ClientMessage::Have(haves.collect())
            }
            false => {
                let pages = run.into_iter().filter_map(|claim| match claim {
                    Claim::Evict(page) => Some(page),
                    Claim::Have(_) => None,
                });
                ClientMessage::Evict(pages.collect())
            }
        })
    }

    /// The server believes that parts are here which were dropped. It need not know before the page
    /// is wanted: a page that does not fit would come again at once.
    pub(super) fn note_stray(&mut self, page: u64) {
        self.strays.note(page);
    }

    /// Whether the server has to be told of the page before it is wanted; from now on not.
    pub(super) fn take_stray(&mut self, page: u64) -> bool {
        self.strays.pages.remove(&page)
    }

    pub(super) fn has_strays(&self) -> bool {
        !self.strays.pages.is_empty()
    }

    /// The server has forgotten all pages.
    pub(super) fn forget_pages(&mut self) {
        *self = Claims {
            answers: self.answers,
            ..Claims::default()
        };
    }

    /// The session has ended.
    pub(super) fn clear(&mut self) {
        *self = Claims::default();
    }

    #[cfg(test)]
    pub(super) fn strays(&self) -> usize {
        self.strays.order.len()
    }
}

/// Pages of dropped chunks. Bounded.
#[derive(Debug, Default)]
struct Strays {
    pages: HashSet<u64>,
    order: VecDeque<u64>,
}

impl Strays {
    fn note(&mut self, page: u64) {
        if self.pages.insert(page) {
            self.order.push_back(page);
        }
        if self.order.len() > MAX_STRAYS
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
    fn claims_keep_their_order_and_are_said_in_runs_of_one_kind() {
        let mut claims = Claims::default();
        let have = |page| Have {
            page,
            revision: 1,
            parts: 0,
        };
        claims.evict(1);
        claims.have(have(1));
        claims.have(have(2));
        claims.have(have(3));
        claims.evict(2);
        let said: Vec<ClientMessage> = std::iter::from_fn(|| claims.poll(2)).collect();
        let expected = [
            ClientMessage::Evict(vec![1]),
            ClientMessage::Have(vec![have(1), have(2)]),
            ClientMessage::Have(vec![have(3)]),
            ClientMessage::Evict(vec![2]),
        ];
        assert_eq!(said, expected);
    }

    #[test]
    fn strays_are_bounded_and_the_newest_are_kept() {
        let mut claims = Claims::default();
        (0..3 * MAX_STRAYS as u64).for_each(|page| claims.note_stray(page));
        assert_eq!(claims.strays(), MAX_STRAYS);
        assert!(!claims.take_stray(0) && claims.take_stray(3 * MAX_STRAYS as u64 - 1));
        assert!(!claims.take_stray(3 * MAX_STRAYS as u64 - 1));
    }
}
