//! When a test can come out differently.
//!
//! A test holds an error against a distance over the threshold: both in metres of error, and the
//! second, `d`, is all that changes. From one view to the next it changes by no more than the
//! eye's step over the threshold, and the threshold's own change times `d`:
//!
//! ```text
//! d'  is within  d * (1 +- |old threshold / new threshold - 1|)  +-  step / new threshold
//! ```
//!
//! Both are added up, by an [`Odometer`]. A test whose two sides differ by `slack` cannot come
//! out differently while `travel + weight * scaling` has grown by less, where `weight` is the
//! largest `d` meanwhile. No direction of view is in it: turning the head makes nothing due.

use super::sight::Sides;
use super::squares::{At, PAGE_SQUARES};
use escarp_proto::georef::WorldBox;
use escarp_proto::view::Tests;

/// The odometer counts in these parts of a metre of error, so that its sums are exact.
const TRAVEL_STEP: f64 = 1.0 / (1u64 << 30) as f64;
const MOST_TRAVEL: f64 = (1u64 << 22) as f64;
const SCALING_STEP: f64 = 1.0 / (1u64 << 42) as f64;
const MOST_SCALING: f64 = (1u64 << 10) as f64;

/// How far the eye has come, and how much the threshold has changed.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Odometer {
    last: Option<Tests>,
    travel: f64,
    scaling: f64,
}

impl Odometer {
    /// Goes on to a view. Whether what is due can be told by what was noted before; else all is.
    pub(super) fn go(&mut self, tests: &Tests) -> bool {
        let last = self.last.replace(*tests);
        let Some(last) = last else {
            return false;
        };
        let steps = (0..3).map(|axis| (tests.eye_m[axis] - last.eye_m[axis]).abs());
        let step_m = steps.fold(0.0, f64::max);
        let scaled = (last.threshold / tests.threshold - 1.0).abs();
        self.travel += up(step_m / tests.threshold, TRAVEL_STEP);
        self.scaling += up(scaled, SCALING_STEP);
        let goes_on = self.travel < MOST_TRAVEL && self.scaling < MOST_SCALING;
        if !goes_on {
            (self.travel, self.scaling) = (0.0, 0.0);
        }
        goes_on
    }
}

/// The next multiple of a power of two, more than what rounding took away.
fn up(value: f64, step: f64) -> f64 {
    (value * (1.0 + 1e-12) / step).ceil() * step
}

/// A reading of the odometer from which on something is due.
#[derive(Debug, Clone, Copy)]
pub(super) struct Due {
    at: f64,
    since: f64,
    weight: f64,
}

impl Due {
    pub(super) const NOW: Due = Due {
        at: f64::NEG_INFINITY,
        since: 0.0,
        weight: 0.0,
    };

    pub(super) fn is_now(&self, odometer: &Odometer) -> bool {
        odometer.travel + self.weight * (odometer.scaling - self.since) >= self.at
    }

    /// The earlier of two, that is never later than either.
    pub(super) fn or(self, other: Due, odometer: &Odometer) -> Due {
        let at = |due: Due| due.at - due.weight * (odometer.scaling - due.since);
        Due {
            at: at(self).min(at(other)) - TRAVEL_STEP,
            since: odometer.scaling,
            weight: self.weight.max(other.weight),
        }
    }
}

/// When which of a page's squares are due.
#[derive(Debug, Clone)]
pub(super) struct PageDue {
    /// Readings of the odometer that all else counts from.
    travel: f64,
    scaling: f64,
    /// Metres of error a step of the codes.
    unit: f32,
    weight: f32,
    /// When the first of the enabled squares is due, metres of error.
    first: f32,
    /// When a square is due, in units, rounded down.
    codes: [u8; PAGE_SQUARES],
}

/// Units from the eye to the farthest of a page. A quarter of that way at most lies between two
/// visits of a page: so distances stay below the weight.
const UNITS: f64 = 256.0;
const MOST_UNITS: f64 = UNITS / 4.0;
/// The page's distance, and its coded range's, and a quarter more.
const WEIGHT: f64 = 1.35;

impl PageDue {
    /// Of a page of which nothing is known.
    pub(super) const NOW: PageDue = PageDue {
        travel: 0.0,
        scaling: 0.0,
        unit: 0.0,
        weight: 0.0,
        first: f32::NEG_INFINITY,
        codes: [0; PAGE_SQUARES],
    };

    fn moved(&self, odometer: &Odometer) -> f64 {
        let scaled = f64::from(self.weight) * (odometer.scaling - self.scaling);
        odometer.travel - self.travel + scaled
    }

    /// When the page's own squares are due.
    pub(super) fn due(&self) -> Due {
        Due {
            at: self.travel + f64::from(self.first) - TRAVEL_STEP,
            since: self.scaling,
            weight: f64::from(self.weight),
        }
    }

    /// Begins a visit: counts from here where the units no longer fit.
    pub(super) fn visit(&mut self, odometer: &Odometer, tests: &Tests, bounds: &WorldBox) -> Visit {
        let moved = self.moved(odometer);
        let far = farthest_m(bounds, tests.eye_m) / tests.threshold;
        let unit = far / UNITS;
        let old = f64::from(self.unit);
        let fits = moved < MOST_UNITS / 2.0 * old && (unit / 2.0..unit * 2.0).contains(&old);
        if fits {
            return Visit::at(moved, old);
        }
        let unit = unit as f32;
        // A page that was not in the mesh may have been farther away than its weight allows for.
        if moved >= MOST_UNITS * old {
            self.codes = [0; PAGE_SQUARES];
        }
        for code in &mut self.codes {
            let left = f64::from(*code) * old - moved;
            *code = whole_units(left, f64::from(unit));
        }
        (self.travel, self.scaling) = (odometer.travel, odometer.scaling);
        (self.unit, self.weight) = (unit, (far * WEIGHT) as f32);
        Visit::at(0.0, f64::from(unit))
    }

    pub(super) fn is_due(&self, at: At, visit: &Visit) -> bool {
        self.codes[at] <= visit.units
    }

    /// A square was tested; nothing of it changes until `slack` more, in metres of error.
    pub(super) fn tested(&mut self, at: At, slack: f64, visit: &mut Visit) {
        let due = visit.moved + slack;
        self.codes[at] = whole_units(due, visit.unit);
        visit.first = visit.first.min(due);
    }

    /// A square was passed over.
    pub(super) fn passed(&self, at: At, visit: &mut Visit) {
        visit.passed = visit.passed.min(self.codes[at]);
    }

    pub(super) fn end(&mut self, visit: &Visit) {
        let passed = f64::from(visit.passed).min(MOST_UNITS) * visit.unit;
        let near = visit.first.min(passed) as f32;
        self.first = near.next_down();
    }
}

/// A visit of a page.
#[derive(Debug, Clone, Copy)]
pub(super) struct Visit {
    moved: f64,
    unit: f64,
    units: u8,
    /// When the first of the squares that were tested is due.
    first: f64,
    /// The least code of those that were passed over.
    passed: u8,
}

impl Visit {
    fn at(moved: f64, unit: f64) -> Visit {
        Visit {
            moved,
            unit,
            units: whole_units(moved, unit),
            first: f64::INFINITY,
            passed: u8::MAX,
        }
    }
}

/// Units, rounded down, so that nothing is late. Grows.
fn whole_units(value: f64, unit: f64) -> u8 {
    // What is not a number, or below zero, becomes zero.
    (value / unit) as u8
}

fn farthest_m(bounds: &WorldBox, eye_m: [f64; 3]) -> f64 {
    let along = |axis: usize| {
        let below = eye_m[axis] - bounds.min[axis];
        let above = bounds.max[axis] - eye_m[axis];
        below.max(above)
    };
    along(0).max(along(1)).max(along(2))
}

/// The least difference of the two sides of those tests, in metres of error, less what rounding
/// may take, now and as the eye goes on; tests of no error have none.
pub(super) fn slack(tests: &Tests, sides: &Sides, made: std::ops::Range<usize>) -> f64 {
    let eye_m = tests
        .eye_m
        .iter()
        .fold(0.0f64, |most, at| most.max(at.abs()));
    let mut least = f64::INFINITY;
    for test in made {
        let (reach, distance) = (sides.reach_m[test], sides.distance_m[test]);
        if reach > 0.0 {
            let rounded = (eye_m + reach + distance) * ROUNDING;
            least = least.min((reach - distance).abs() - rounded);
        }
    }
    (least / tests.threshold * (1.0 - 1e-12)).max(0.0)
}

/// Many times what sums and differences of a few lengths lose, relative to the longest.
const ROUNDING: f64 = 16.0 * f64::EPSILON;
