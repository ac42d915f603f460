//! The newest view, looked at no more often than announced.

use escarp_proto::view::View;
use escarp_proto::wire::Scope;
use std::time::Duration;

/// A view, before it its sequence number, and what of the terrain is of use.
pub(super) type Numbered = (u32, View, Scope);

/// Lets a view through at most once an interval in the long run; of those that come sooner, keeps
/// the newest. Views that come once an interval, more or less, pass when they come: one that was
/// late does not hold up the next, if half an interval lies between them.
#[derive(Debug)]
pub(super) struct ViewGate {
    interval: Duration,
    opens: Duration,
    newest_received: u32,
    waiting: Option<Numbered>,
    current: Option<Numbered>,
}

impl ViewGate {
    pub(super) fn new(views_per_second: u32) -> ViewGate {
        ViewGate {
            interval: Duration::from_secs(1) / views_per_second.max(1),
            opens: Duration::ZERO,
            newest_received: 0,
            waiting: None,
            current: None,
        }
    }

    /// Takes a view in. `false` if its sequence number did not grow; then nothing changes.
    pub(super) fn receive(&mut self, view: Numbered) -> bool {
        let grows = view.0 > self.newest_received;
        if grows {
            self.newest_received = view.0;
            self.waiting = Some(view);
        }
        grows
    }

    /// Makes the waiting view the current one if its time has come; whether it did.
    pub(super) fn advance(&mut self, now: Duration) -> bool {
        if now < self.opens {
            return false;
        }
        let Some(view) = self.waiting.take() else {
            return false;
        };
        self.current = Some(view);
        self.opens = (self.opens + self.interval).max(now + self.interval / 2);
        true
    }

    /// When a waiting view will become current.
    pub(super) fn deadline(&self) -> Option<Duration> {
        self.waiting.map(|_| self.opens)
    }

    /// Looks at no other view before this time.
    pub(super) fn rest(&mut self, until: Duration) {
        self.opens = self.opens.max(until);
    }

    /// Looks at nothing until the next view comes.
    pub(super) fn forget(&mut self) {
        self.waiting = None;
        self.current = None;
    }

    /// The view that is looked at.
    pub(super) fn current(&self) -> Option<Numbered> {
        self.current
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn view() -> View {
        View {
            eye_m: [0.0; 3],
            direction: [0.0, 1.0, 0.0],
            velocity_m_s: [0.0; 3],
            fov_y: 1.0,
            viewport_px: [640, 480],
            max_screen_error_px: 2.0,
        }
    }

    #[test]
    fn views_that_come_as_often_as_they_may_more_or_less_are_looked_at_when_they_come() {
        let mut gate = ViewGate::new(20);
        for number in 1..200u32 {
            let late = number * 7919 % 23;
            let now = MS * (50 * number + late);
            assert!(gate.receive((number, view(), Scope::All)));
            assert!(gate.advance(now), "{number}, {late} ms late");
        }
    }

    #[test]
    fn of_views_that_come_too_often_no_more_than_announced_are_looked_at() {
        let mut gate = ViewGate::new(20);
        let mut passed = 0;
        for number in 1..10_000u32 {
            gate.receive((number, view(), Scope::All));
            passed += u32::from(gate.advance(MS * number));
        }
        assert!((199..=201).contains(&passed), "{passed} in 10 s");
    }
}
