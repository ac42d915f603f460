//! What stands in the split queue and the merge queue.

use super::super::surface::Index;
use super::item::{Item, Stamp};
use std::cmp::Ordering;

/// A triangle whose turn to be split or merged may come in this update.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    /// How large its error is on the screen.
    pub(super) priority: f64,
    /// [`PageId::key`](escarp_proto::geometry::PageId::key) of its page, so that the order does not
    /// depend on when a page came.
    pub(super) key: u64,
    pub(super) page: Index,
    pub(super) item: Item,
    pub(super) stamp: Stamp,
}

/// By priority; of equal ones, the coarser is the greater, so that a triangle comes before those
/// that it is split into.
impl Ord for Candidate {
    fn cmp(&self, other: &Candidate) -> Ordering {
        let place = |candidate: &Candidate| (candidate.key, candidate.item);
        let priority = self.priority.total_cmp(&other.priority);
        priority.then(place(other).cmp(&place(self)))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Candidate) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Candidate) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Candidate {}
