//! When to want pages of a server that pushes: not while what they are is on its way unasked.

use std::time::Duration;

/// A server that has said nothing for so long is waited for no longer, if two round trips are less.
const LEAST_PATIENCE: Duration = Duration::from_millis(250);
/// However busy the server is, wishes wait no longer than this.
const MOST_PATIENCE: Duration = Duration::from_secs(3);

/// Holds wishes back while the server owes an answer to a View, and gives signs of working on it.
/// Not for ever: a server may not see what is lacking, or send something else.
#[derive(Debug, Default)]
pub(super) struct Gate {
    /// The last sign of the server's work on a View that it has not answered by Idle.
    at_work: Option<Duration>,
    /// Since when there has been a wish that waits.
    waiting: Option<Duration>,
}

impl Gate {
    /// There is a View that the server has not answered.
    pub(super) fn on_view(&mut self, now: Duration) {
        self.at_work.get_or_insert(now);
    }

    /// A chunk came.
    pub(super) fn on_chunk(&mut self, now: Duration) {
        if let Some(at) = &mut self.at_work {
            *at = now;
        }
    }

    /// Idle came, for the newest View or an older one.
    pub(super) fn on_idle(&mut self, newest: bool, now: Duration) {
        self.at_work = (!newest).then_some(now);
    }

    /// When it opens without a word from the server; `None`: it is open.
    pub(super) fn opens_at(&self, round_trip: Duration) -> Option<Duration> {
        let quiet = self.at_work? + patience(round_trip);
        let most = MOST_PATIENCE.max(8 * round_trip);
        Some(self.waiting.map_or(quiet, |since| quiet.min(since + most)))
    }

    /// Whether wishes are to wait now.
    pub(super) fn holds_back(&mut self, any: bool, round_trip: Duration, now: Duration) -> bool {
        if !any || self.at_work.is_none() {
            self.waiting = None;
            return false;
        }
        self.waiting.get_or_insert(now);
        self.opens_at(round_trip).is_some_and(|at| now < at)
    }
}

/// How long a server that owes something may be silent.
pub(super) fn patience(round_trip: Duration) -> Duration {
    LEAST_PATIENCE.max(2 * round_trip)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn wishes_wait_for_idle_or_silence_and_never_longer_than_the_most() {
        let mut gate = Gate::default();
        let holds = |gate: &mut Gate, now| gate.holds_back(true, ms(20), ms(now));
        assert!(!holds(&mut gate, 0));
        gate.on_view(ms(0));
        assert!(holds(&mut gate, 0) && holds(&mut gate, 249));
        gate.on_chunk(ms(249));
        assert!(holds(&mut gate, 498) && !holds(&mut gate, 499));
        gate.on_idle(false, ms(500));
        assert!(holds(&mut gate, 500));
        gate.on_idle(true, ms(600));
        assert!(!holds(&mut gate, 600));
        gate.on_view(ms(1000));
        let held = (1000..20_000).filter(|&now| {
            gate.on_chunk(ms(now));
            holds(&mut gate, now)
        });
        assert_eq!(held.count(), 3000);
    }

    #[test]
    fn patience_grows_with_the_round_trip() {
        let mut gate = Gate::default();
        gate.on_view(ms(0));
        assert!(gate.holds_back(true, ms(600), ms(1199)));
        assert!(!gate.holds_back(true, ms(600), ms(1200)));
        assert_eq!(gate.opens_at(ms(600)), Some(ms(1200)));
    }
}
