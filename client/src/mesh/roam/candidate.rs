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

/// Priorities between which a decision may fall. A triangle that is split, with a priority above,
/// or is not, with one below, need not be in a queue until the eye has moved so far that its
/// priority may have come inside.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Band {
    pub(super) lo: f64,
    pub(super) hi: f64,
}

/// How far a band goes to either side of where the last decision fell.
const WIDTH: f64 = 1.08;
/// Part of it, within which the decision may move before the band follows.
const MARGIN: f64 = 1.03;

impl Band {
    /// One priority decides, and stays as it is.
    pub(super) fn at(priority: f64) -> Band {
        Band {
            lo: priority,
            hi: priority,
        }
    }

    /// Anything above a priority may be decided.
    pub(super) fn above(least: f64) -> Band {
        Band {
            lo: least,
            hi: f64::INFINITY,
        }
    }

    /// The band around a priority, as far as it lies above `least`.
    pub(super) fn around(priority: f64, least: f64) -> Band {
        // Where even an infinite error must be borne, the band is where all finite ones are less.
        let priority = priority.min(1e300);
        Band {
            lo: (priority / WIDTH).max(least),
            hi: priority * WIDTH,
        }
    }

    /// Whether this band will do for decisions above `least` that fall around a priority.
    pub(super) fn suits(&self, priority: f64, least: f64) -> bool {
        let narrow = self.hi <= self.lo * WIDTH * WIDTH * MARGIN;
        let below = self.lo <= least || self.lo * MARGIN <= priority;
        narrow && below && priority * MARGIN <= self.hi
    }

    /// Whether all of another band lies inside.
    pub(super) fn holds(&self, other: &Band) -> bool {
        self.lo <= other.lo && other.hi <= self.hi
    }

    pub(super) fn has(&self, priority: f64) -> bool {
        self.lo <= priority && priority <= self.hi
    }
}
