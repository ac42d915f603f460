//! The small state machines of one session: credit, keep-alive, views.

use super::LinkConfig;
use escarp_proto::view::{FARTHEST_EYE_M, View};
use escarp_proto::wire::{ClientMessage, PAGES_FRAME, Scope};
use std::time::Duration;

/// A view for which a server has nothing to push: away from all terrain, of one pixel, and with the
/// widest tolerance.
pub(super) const NEEDS_NOTHING: View = View {
    eye_m: [0.0, 0.0, FARTHEST_EYE_M],
    direction: [0.0, 0.0, 1.0],
    velocity_m_s: [0.0; 3],
    fov_y: 0.001,
    viewport_px: [1, 1],
    max_screen_error_px: 1024.0,
};

/// How many page bytes the server may send. Invariants: the grant never falls, and is at most one
/// window beyond what was received and taken by the caller. So a caller that leaves chunks where
/// they are holds back the server, and what waits is at most one window.
#[derive(Debug)]
pub(super) struct Credit {
    window: u64,
    /// Bytes that came and are done with.
    taken: u64,
    /// Bytes that came, and wait for the caller.
    waiting: u64,
    granted: u64,
}

impl Credit {
    /// For a new session. A window below two frames could stop the server for good.
    pub(super) fn new(config: &LinkConfig) -> Credit {
        let window = config.credit_window_bytes.max(2 * PAGES_FRAME as u64);
        Credit {
            window,
            taken: 0,
            waiting: 0,
            granted: window,
        }
    }

    /// The newest grant, bytes since the session began.
    pub(super) fn granted(&self) -> u64 {
        self.granted
    }

    pub(super) fn received(&mut self, bytes: u64) {
        self.waiting = self.waiting.saturating_add(bytes);
    }

    /// Whether the server has sent more than it may.
    pub(super) fn is_overdrawn(&self) -> bool {
        self.taken.saturating_add(self.waiting) > self.granted
    }

    /// Bytes that were received are done with. Those of an earlier session do not count.
    pub(super) fn taken(&mut self, bytes: u64) {
        let bytes = bytes.min(self.waiting);
        self.waiting -= bytes;
        self.taken = self.taken.saturating_add(bytes);
    }

    /// A new grant, once half of the window is used.
    pub(super) fn due(&mut self) -> Option<u64> {
        if self.granted.saturating_sub(self.taken) > self.window / 2 {
            return None;
        }
        self.granted = self.taken.saturating_add(self.window);
        Some(self.granted)
    }
}

/// Ping, Pong, and the verdict that the server is gone.
///
/// Silence counts from a Ping that is unanswered, not from the last message: after a pause of the
/// whole program nothing has been heard either, and the server may be well.
#[derive(Debug)]
pub(super) struct KeepAlive {
    interval: Duration,
    silence: Duration,
    next_ping: Duration,
    unanswered: Option<(u64, Duration)>,
    /// Since when a Ping has been due that the line does not take.
    stuck: Option<Duration>,
    heard: Duration,
    count: u64,
    round_trip_ms: Option<f64>,
}

impl KeepAlive {
    pub(super) fn new(config: &LinkConfig) -> KeepAlive {
        KeepAlive {
            interval: config.ping_interval,
            silence: config.silence_timeout,
            next_ping: Duration::ZERO,
            unanswered: None,
            stuck: None,
            heard: Duration::ZERO,
            count: 0,
            round_trip_ms: None,
        }
    }

    /// A session opens; its first Ping is due at once, so that the round trip is known soon.
    pub(super) fn start(&mut self, now: Duration) {
        (self.unanswered, self.stuck) = (None, None);
        self.heard = now;
        self.next_ping = now;
    }

    pub(super) fn heard(&mut self, now: Duration) {
        self.heard = now;
    }

    pub(super) fn pong(&mut self, number: u64, now: Duration) {
        let Some((_, sent)) = self.unanswered.filter(|(asked, _)| *asked == number) else {
            return;
        };
        self.unanswered = None;
        let ms = now.saturating_sub(sent).as_secs_f64() * 1e3;
        // An eighth of each new measurement, as TCP does (RFC 6298).
        let smooth = self.round_trip_ms.map_or(ms, |old| old + (ms - old) / 8.0);
        self.round_trip_ms = Some(smooth);
    }

    /// A number for a Ping that measures nothing.
    pub(super) fn next_number(&mut self) -> u64 {
        self.count += 1;
        self.count
    }

    pub(super) fn ping_due(&mut self, now: Duration) -> Option<u64> {
        if self.unanswered.is_some() || now < self.next_ping {
            return None;
        }
        self.count += 1;
        self.stuck = None;
        self.unanswered = Some((self.count, now));
        self.next_ping = now + self.interval;
        Some(self.count)
    }

    /// Notes whether a Ping is due that has not been sent. A program that was paused has not
    /// offered one, and its line is not to blame.
    pub(super) fn watch(&mut self, now: Duration) {
        if self.unanswered.is_none() && now >= self.next_ping {
            self.stuck.get_or_insert(now);
        }
    }

    pub(super) fn dead_at(&self) -> Option<Duration> {
        let sent = self.unanswered.map(|(_, sent)| sent).or(self.stuck)?;
        Some(sent.max(self.heard) + self.silence)
    }

    /// When to call again: for the next Ping, or to find the server dead.
    pub(super) fn next_timeout(&self) -> Duration {
        self.dead_at().unwrap_or(self.next_ping)
    }

    /// The smoothed round trip; zero as long as nothing is known.
    pub(super) fn round_trip(&self) -> Duration {
        let ms = self.round_trip_ms.unwrap_or(0.0);
        Duration::try_from_secs_f64(ms / 1e3).unwrap_or(Duration::ZERO)
    }

    pub(super) fn round_trip_ms(&self) -> Option<f64> {
        self.round_trip_ms
    }
}

/// The view that the server should know. The newest wins; it is sent only if it changed, and not
/// more often than allowed.
#[derive(Debug)]
pub(super) struct Views {
    interval: Duration,
    newest: Option<(View, Scope)>,
    sent: Option<(View, Scope)>,
    sequence: u32,
    next_at: Duration,
}

impl Views {
    pub(super) fn new(interval: Duration) -> Views {
        Views {
            interval,
            newest: None,
            sent: None,
            sequence: 0,
            next_at: Duration::ZERO,
        }
    }

    /// Whether it is another view than before.
    pub(super) fn set(&mut self, view: &View, scope: Scope) -> bool {
        let newest = Some((*view, scope));
        std::mem::replace(&mut self.newest, newest) != newest
    }

    /// Whether there is a view that the server knows, or will know.
    pub(super) fn is_any(&self) -> bool {
        self.newest.is_some()
    }

    /// A new server knows no view.
    pub(super) fn forget_session(&mut self) {
        self.sent = None;
        self.next_at = Duration::ZERO;
    }

    /// The server knows no view any more, and is told the newest at its time.
    pub(super) fn forget_sent(&mut self) {
        self.sent = None;
    }

    /// When the newest view may be sent, if it is not yet.
    pub(super) fn pending_at(&self) -> Option<Duration> {
        (self.newest.is_some() && self.newest != self.sent).then_some(self.next_at)
    }

    pub(super) fn due(&mut self, now: Duration, views_per_second: u32) -> Option<ClientMessage> {
        self.pending_at().filter(|&at| at <= now)?;
        let newest = self.newest?;
        let allowed = Duration::from_secs(1) / views_per_second.max(1);
        // 0 means "no view", so the count wraps to 1.
        self.sequence = self.sequence.checked_add(1).unwrap_or(1);
        self.sent = Some(newest);
        self.next_at = now + self.interval.max(allowed);
        let sequence = self.sequence;
        let (view, scope) = newest;
        Some(ClientMessage::View {
            sequence,
            view,
            scope,
        })
    }

    pub(super) fn sequence(&self) -> u32 {
        self.sequence
    }
}
