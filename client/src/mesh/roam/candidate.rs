//! What stands in the split queue and the merge queue.

use super::super::surface::Index;
use super::item::{Item, Stamp};
use std::cmp::Ordering;

/// A triangle whose turn to be split or merged may come in this update.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    /// Its priority: how many times over the tolerance its error is.
    pub(super) excess: f64,
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
        let excess = self.excess.total_cmp(&other.excess);
        excess.then(place(other).cmp(&place(self)))
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
    /// The tolerance decides.
    pub(super) const TOLERANCE: Band = Band { lo: 1.0, hi: 1.0 };
    /// Anything may be decided.
    pub(super) const ALL: Band = Band {
        lo: 1.0,
        hi: f64::INFINITY,
    };

    /// The band around a priority, at least 1.
    pub(super) fn around(excess: f64) -> Band {
        // Where even an infinite error must be borne, the band is where all finite ones are less.
        let excess = excess.clamp(1.0, 1e300);
        Band {
            lo: (excess / WIDTH).max(1.0),
            hi: excess * WIDTH,
        }
    }

    /// Whether this band will do for decisions that fall around a priority.
    pub(super) fn suits(&self, excess: f64) -> bool {
        let narrow = self.hi <= self.lo * WIDTH * WIDTH * MARGIN;
        let below = self.lo == 1.0 || self.lo * MARGIN <= excess;
        narrow && below && excess * MARGIN <= self.hi
    }

    /// Whether all of another band lies inside.
    pub(super) fn holds(&self, other: &Band) -> bool {
        self.lo <= other.lo && other.hi <= self.hi
    }
}
