//! One budget: what is measured against it, and which way the tolerance should go.

use std::collections::VecDeque;

/// What a budget asks of the tolerance, as steps of its logarithm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Ask {
    /// Coarser, by this.
    Raise(f64),
    /// As it is.
    Hold,
    /// It may be finer, by this.
    Lower(f64),
}

/// What differs between counts, which are exact, and times, which are noisy.
#[derive(Debug, Clone, Copy)]
struct Tuning {
    /// Shares of the budget: below this the tolerance may fall, and to this it rises or falls.
    low: f64,
    aim: f64,
    /// The most that it rises in a frame.
    rise: f64,
    /// Share of the way to the aim that it falls in a frame.
    gain: f64,
    /// Measurements after a change that count for nothing: the change itself costs time.
    blank: u32,
    /// Measurements of which the middle one counts.
    window: usize,
    /// Logarithm of a change that shows that the terrain in view is another.
    other: f64,
}

const COUNT: Tuning = Tuning {
    low: 0.84,
    aim: 0.92,
    rise: std::f64::consts::LN_2,
    gain: 0.5,
    blank: 0,
    window: 1,
    other: 0.05,
};
const TIME: Tuning = Tuning {
    low: 0.65,
    aim: 0.82,
    rise: 0.26,
    gain: 0.5,
    blank: 1,
    window: 5,
    other: 0.35,
};

/// The exponent of the model before anything is known, and what it may come to.
const EXPONENT: f64 = 1.0;
const EXPONENTS: [f64; 2] = [0.3, 2.5];
/// Weight of that guess, and what of earlier weight each measurement leaves.
const PRIOR: f64 = 0.02;
const MEMORY: f64 = 0.9;
/// How far above a tolerance that was too fine the next one is tried, as a logarithm.
const MARGIN: f64 = 0.01;

/// See the module.
#[derive(Debug, Clone)]
pub(super) struct Gauge {
    budget: f64,
    tuning: Tuning,
    recent: VecDeque<f64>,
    /// Level and value of the last frame that counted.
    last: Option<(f64, f64)>,
    /// Sums of the model: of squared steps, and of steps by falls of the value's logarithm.
    squares: f64,
    products: f64,
    floor: Option<Floor>,
}

/// A level that proved too fine.
#[derive(Debug, Clone, Copy)]
struct Floor {
    level: f64,
    /// Level and value of a frame since then, which tell whether it is still so.
    seen: Option<(f64, f64)>,
}

impl Gauge {
    pub(super) fn of_count(budget: f64) -> Gauge {
        Gauge::new(budget, COUNT)
    }

    pub(super) fn of_time(budget_ms: f64) -> Gauge {
        Gauge::new(budget_ms, TIME)
    }

    fn new(budget: f64, tuning: Tuning) -> Gauge {
        Gauge {
            budget,
            tuning,
            recent: VecDeque::with_capacity(tuning.window),
            last: None,
            squares: PRIOR,
            products: PRIOR * EXPONENT,
            floor: None,
        }
    }

    /// Frames without a change after which there is none to come.
    pub(super) fn patience(&self) -> u32 {
        self.tuning.blank + 2 * self.tuning.window as u32
    }

    /// Takes the value of a frame at a level that has been held for so many frames.
    pub(super) fn observe(&mut self, level: f64, held: u32, value: f64) -> Ask {
        if held == 0 {
            self.recent.clear();
        }
        // Before there is a mesh nothing is known; nor of a frame that changed the tolerance.
        if !(value.is_finite() && value > 0.0) || held < self.tuning.blank {
            return Ask::Hold;
        }
        if self.recent.len() == self.tuning.window {
            self.recent.pop_front();
        }
        self.recent.push_back(value);
        if self.recent.len() < self.tuning.window {
            return Ask::Hold;
        }
        let value = middle(&self.recent);
        let before = self.last.replace((level, value));
        self.learn(before, (level, value));
        self.judge(before, (level, value), held)
    }

    /// What a coarsening brought tells of the model. What a refinement brings comes with its
    /// pages, later, and so tells nothing.
    fn learn(&mut self, before: Option<(f64, f64)>, (level, value): (f64, f64)) {
        let Some((old_level, old_value)) = before.filter(|&(old, _)| level > old) else {
            return;
        };
        let (step, fall) = (level - old_level, (old_value / value).ln());
        self.squares = self.squares * MEMORY + step * step;
        self.products = self.products * MEMORY + step * fall;
    }

    fn exponent(&self) -> f64 {
        (self.products / self.squares).clamp(EXPONENTS[0], EXPONENTS[1])
    }

    fn judge(&mut self, before: Option<(f64, f64)>, (level, value): (f64, f64), held: u32) -> Ask {
        let tuning = self.tuning;
        let to_aim = (value / (self.budget * tuning.aim)).ln() / self.exponent();
        if value > self.budget {
            // The level before was within the budget: the mesh has jumped over it.
            let back = before
                .filter(|&(old, value)| old > level && value <= self.budget)
                .map(|(old, _)| old - level);
            self.floor = Some(Floor {
                level: level + back.unwrap_or(MARGIN),
                seen: None,
            });
            return Ask::Raise(back.unwrap_or(to_aim).clamp(MARGIN, tuning.rise));
        }
        self.watch_floor(level, value, held);
        if value >= self.budget * tuning.low {
            return Ask::Hold;
        }
        let room = self
            .floor
            .map_or(f64::INFINITY, |floor| level - floor.level);
        match (-to_aim * tuning.gain).min(room) {
            step if step > 0.0 => Ask::Lower(step),
            _ => Ask::Hold,
        }
    }

    /// Forgets the floor once another value at the same level shows that the view is another.
    fn watch_floor(&mut self, level: f64, value: f64, held: u32) {
        let Some(floor) = &mut self.floor else {
            return;
        };
        let seen = floor.seen.filter(|&(seen, _)| seen == level);
        let other = self.tuning.other;
        if seen.is_some_and(|(_, then)| (value / then).ln().abs() > other) {
            self.floor = None;
        } else if seen.is_none() && held > 0 {
            // The first frame still has what the last tolerance left behind.
            floor.seen = Some((level, value));
        }
    }
}

/// The middle one of some values, of which there is at least one.
fn middle(values: &VecDeque<f64>) -> f64 {
    let mut sorted: Vec<f64> = values.iter().copied().collect();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}
