//! What is said of many legs: medians, and what the best possible would have taken.

use super::client::Kind;
use super::shaper::Cell;
use super::watch::Leg;
use serde::Serialize;

/// One cell, one kind of client, all repeats.
#[derive(Debug, Clone, Serialize)]
pub struct Outcome {
    /// The line.
    pub cell: Cell,
    /// The client.
    pub kind: Kind,
    /// The legs of each repeat.
    pub runs: Vec<Vec<Leg>>,
}

/// The figures of a leg, medians over the repeats.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Figures {
    /// When the session was open, seconds; 0 if it was before.
    pub opened_s: f64,
    /// Until the bound was within 8 px; absent if it never was.
    pub within_8_px_s: Option<f64>,
    /// Until the bound was within the tolerance.
    pub converged_s: Option<f64>,
    /// Bytes received until then, or at the end.
    pub bytes: u64,
    /// What pages took to decode and link until then, seconds.
    pub decode_s: f64,
    /// `1.5 RTT + bytes / bandwidth + decode`.
    pub target_s: f64,
    /// `converged_s` over `target_s`.
    pub ratio: Option<f64>,
    /// The same, counted from when the session was open.
    pub ratio_open: Option<f64>,
    /// Bytes of page parts received over those that the final mesh uses.
    pub over_used: Option<f64>,
}

/// `1.5 RTT + bytes / bandwidth + decode`, seconds.
pub fn target_s(cell: &Cell, bytes: u64, decode_s: f64) -> f64 {
    1.5 * cell.round_trip_ms / 1e3 + cell.carrying(bytes).as_secs_f64() + decode_s
}

/// The middle of some values; absent ones count as larger than all. Of an even number, the larger
/// one.
pub fn median(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let mut values: Vec<f64> = values.map(|v| v.unwrap_or(f64::INFINITY)).collect();
    values.sort_by(f64::total_cmp);
    let middle = values.get(values.len() / 2).copied();
    middle.filter(|v| v.is_finite())
}

impl Outcome {
    /// The figures of a leg.
    pub fn figures(&self, leg: usize) -> Option<Figures> {
        let legs: Vec<&Leg> = self.runs.iter().filter_map(|run| run.get(leg)).collect();
        let middle = |of: &dyn Fn(&Leg) -> Option<f64>| median(legs.iter().map(|leg| of(leg)));
        let bytes = middle(&|leg| {
            Some(match leg.converged_s {
                Some(_) => leg.converged_bytes,
                None => leg.bytes,
            } as f64)
        })? as u64;
        let decode_s = middle(&|leg| Some(leg.decode_s))?;
        let target_s = target_s(&self.cell, bytes, decode_s);
        let opened_s = middle(&|leg| Some(leg.opened_s.unwrap_or(0.0)))?;
        let converged_s = middle(&|leg| leg.converged_s);
        Some(Figures {
            opened_s,
            within_8_px_s: middle(&|leg| leg.within_8_px_s),
            converged_s,
            bytes,
            decode_s,
            target_s,
            ratio: converged_s.map(|s| s / target_s),
            ratio_open: converged_s.map(|s| (s - opened_s) / target_s),
            over_used: middle(&|leg| Some(leg.page_bytes? as f64 / leg.used_bytes?.max(1) as f64)),
        })
    }

    /// The run whose leg took the middle time: the one to draw.
    pub fn middle_run(&self, leg: usize) -> Option<&Leg> {
        let mut legs: Vec<&Leg> = self.runs.iter().filter_map(|run| run.get(leg)).collect();
        let time = |leg: &Leg| leg.converged_s.unwrap_or(f64::INFINITY);
        legs.sort_by(|a, b| time(a).total_cmp(&time(b)));
        legs.get(legs.len() / 2).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CELL: Cell = Cell {
        round_trip_ms: 200.0,
        mbit_s: 8.0,
        loss_percent: 0.0,
    };

    #[test]
    fn the_target_is_one_and_a_half_round_trips_the_bytes_and_the_computing() {
        assert!((target_s(&CELL, 500_000, 0.1) - (0.3 + 0.5 + 0.1)).abs() < 1e-9);
    }

    #[test]
    fn a_median_is_a_value_of_the_middle_and_absent_if_most_are() {
        assert_eq!(
            median([Some(3.0), Some(1.0), Some(2.0)].into_iter()),
            Some(2.0)
        );
        assert_eq!(median([None, Some(1.0), Some(2.0)].into_iter()), Some(2.0));
        assert_eq!(median([None, None, Some(2.0)].into_iter()), None);
        assert_eq!(median(std::iter::empty()), None);
    }

    #[test]
    fn figures_are_medians_and_count_from_connecting_and_from_the_open_session() {
        let leg = |opened, converged| Leg {
            opened_s: Some(opened),
            converged_s: Some(converged),
            converged_bytes: 100_000,
            decode_s: 0.1,
            page_bytes: Some(110),
            used_bytes: Some(100),
            ..Leg::default()
        };
        let outcome = Outcome {
            cell: CELL,
            kind: Kind::Pull,
            runs: vec![
                vec![leg(0.4, 1.0)],
                vec![leg(0.6, 9.0)],
                vec![leg(0.5, 1.1)],
            ],
        };
        let figures = outcome.figures(0).expect("a leg");
        assert_eq!(figures.converged_s, Some(1.1));
        assert!((figures.target_s - 0.5).abs() < 1e-9);
        assert!((figures.ratio.expect("one") - 2.2).abs() < 1e-9);
        assert!((figures.ratio_open.expect("one") - 1.2).abs() < 1e-9);
        assert!((figures.over_used.expect("one") - 1.1).abs() < 1e-9);
        assert_eq!(
            outcome.middle_run(0).and_then(|leg| leg.converged_s),
            Some(1.1)
        );
        assert!(outcome.figures(1).is_none());
    }
}
