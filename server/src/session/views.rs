//! The newest view, looked at no more often than announced.

use escarp_proto::view::View;
use escarp_proto::wire::Scope;
use std::time::Duration;

/// A view, before it its sequence number, and what of the terrain is of use.
pub(super) type Numbered = (u32, View, Scope);

/// Lets a view through at most once an interval; of those that come sooner, keeps the newest.
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
        self.opens = now + self.interval;
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
