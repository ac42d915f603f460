//! The band of priorities in which decisions fall, and how it follows them.

use super::priority::STEADY;
use super::{Pass, Roam};

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

impl Roam {
    /// What is to be decided lies beyond the band.
    pub(super) fn widen(&mut self, pass: &mut Pass<'_>) {
        self.band = Band::above(self.scale.least);
        self.test_all(pass);
    }

    /// Puts the band around the priority at which the last decision fell.
    pub(super) fn set_band(&mut self, pass: &mut Pass<'_>) {
        let least = self.scale.least;
        let at_limit = self
            .limits
            .triangles
            .is_some_and(|most| self.triangles >= most - most / 5);
        if !at_limit && self.scale.steady >= STEADY {
            return self.change_band(pass, self.tolerance_band());
        }
        let around = pass.floor.map_or(least, |floor| floor.priority.max(least));
        // Far from the limit, or while the tolerance changes, it may come down.
        let lowest = if self.scale.steady < STEADY {
            0.0
        } else {
            least
        };
        if !self.band.suits(around, lowest) {
            self.change_band(pass, Band::around(around, lowest));
        }
    }

    pub(super) fn change_band(&mut self, pass: &mut Pass<'_>, band: Band) {
        if self.band == band {
            return;
        }
        let inside = self.band.holds(&band);
        self.band = band;
        match inside {
            // What was beyond the wider band is beyond this one.
            true => self.test_queues(pass),
            false => self.test_all(pass),
        }
    }
}
