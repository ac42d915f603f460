//! What a session adds to the server's metrics.

use crate::metrics::{Metrics, Share};
use crate::session::SessionStats;
use std::time::Duration;

/// A read of records that takes longer has waited for the disk: in memory it takes microseconds.
const COLD: Duration = Duration::from_millis(5);

/// Follows the figures of one session.
pub(super) struct Tally<'a> {
    metrics: &'a Metrics,
    before: SessionStats,
    waiting: Share,
    /// When the newest view was looked at, until it is answered by Idle.
    viewed: Option<Duration>,
    /// Since when there has been no credit.
    stalled: Option<Duration>,
}

impl<'a> Tally<'a> {
    pub(super) fn new(metrics: &'a Metrics) -> Tally<'a> {
        Tally {
            metrics,
            before: SessionStats::default(),
            waiting: Share::of(&metrics.queue_pages),
            viewed: None,
            stalled: None,
        }
    }

    /// Takes over what has changed; `read` is how long the last reading of records took, if there
    /// was one. How long a selection took, if there was one.
    pub(super) fn note(
        &mut self,
        stats: &SessionStats,
        read: Option<Duration>,
        now: Duration,
    ) -> Option<Duration> {
        let before = std::mem::replace(&mut self.before, *stats);
        self.waiting
            .set(usize::try_from(stats.waiting).unwrap_or(usize::MAX));
        self.count_bytes(&before, stats);
        if stats.views > before.views {
            self.viewed = Some(now);
        }
        if let Some(read) = read {
            self.note_read(&before, stats, read, now);
        }
        if stats.idles > before.idles
            && let Some(viewed) = self.viewed.take()
        {
            let took = now.saturating_sub(viewed).as_secs_f64();
            self.metrics.target_error_seconds.observe(took);
        }
        self.note_stall(&before, stats, now);
        read.filter(|_| stats.selections > before.selections)
    }

    fn count_bytes(&self, before: &SessionStats, stats: &SessionStats) {
        let metrics = self.metrics;
        let pulled = stats.wanted_bytes - before.wanted_bytes;
        let pushed = stats.pushed_bytes - before.pushed_bytes;
        let predicted = stats.predicted_bytes - before.predicted_bytes;
        metrics.pulled_bytes.inc_by(pulled);
        metrics.pushed_bytes.inc_by(pushed);
        metrics.predicted_bytes.inc_by(predicted);
        metrics.useful_bytes.inc_by(pulled + pushed);
        metrics.sent_bytes.inc_by(pulled + pushed + predicted);
        let repeated = stats.repeated_bytes - before.repeated_bytes;
        metrics.repeated_bytes.inc_by(repeated);
        let cancelled = stats.cancelled_pieces - before.cancelled_pieces;
        metrics
            .cancelled_bytes
            .inc_by(cancelled * stats.bytes_a_piece());
    }

    fn note_read(
        &self,
        before: &SessionStats,
        stats: &SessionStats,
        read: Duration,
        now: Duration,
    ) {
        let metrics = self.metrics;
        let pieces = stats.pieces - before.pieces;
        metrics.reads.inc_by(pieces);
        if stats.selections > before.selections {
            metrics.selection_seconds.observe(read.as_secs_f64());
        } else if read >= COLD {
            metrics.cold_reads.inc();
        }
        if let Some(viewed) = self.viewed.filter(|_| pieces > 0) {
            let age = now.saturating_sub(viewed);
            metrics.queue_age_seconds.observe(age.as_secs_f64());
        }
    }

    fn note_stall(&mut self, before: &SessionStats, stats: &SessionStats, now: Duration) {
        let begun = stats.credit_stalls - before.credit_stalls;
        self.metrics.credit_stalls.inc_by(begun);
        match (self.stalled, stats.is_stalled) {
            (None, true) => self.stalled = Some(now),
            (Some(since), false) => {
                let took = now.saturating_sub(since).as_secs_f64();
                self.metrics.credit_stall_seconds.observe(took);
                self.stalled = None;
            }
            _ => {}
        }
    }

    /// The dataset has changed under the session.
    pub(super) fn generation_changed(&self) {
        self.metrics.generation_changes.inc();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_session_sends_is_counted_once() {
        let metrics = Metrics::new();
        let mut tally = Tally::new(&metrics);
        let mut stats = SessionStats {
            views: 1,
            selections: 1,
            ..SessionStats::default()
        };
        let second = Duration::from_secs(1);
        tally.note(&stats, None, second);
        stats.pushed_bytes = 100;
        stats.predicted_bytes = 10;
        stats.wanted_bytes = 1;
        stats.pieces = 3;
        tally.note(&stats, Some(second), 2 * second);
        stats.idles = 1;
        stats.cancelled_pieces = 2;
        tally.note(&stats, None, 3 * second);
        tally.note(&stats, None, 4 * second);
        assert_eq!(metrics.sent_bytes.get(), 111);
        assert_eq!(metrics.useful_bytes.get(), 101);
        assert_eq!(metrics.cancelled_bytes.get(), 2 * 37);
        assert_eq!((metrics.reads.get(), metrics.cold_reads.get()), (3, 1));
    }

    #[test]
    fn what_waits_in_a_session_is_gone_with_it() {
        let metrics = Metrics::new();
        let mut tally = Tally::new(&metrics);
        let stats = SessionStats {
            waiting: 7,
            ..SessionStats::default()
        };
        tally.note(&stats, None, Duration::ZERO);
        assert_eq!(metrics.queue_pages.get(), 7);
        drop(tally);
        assert_eq!(metrics.queue_pages.get(), 0);
    }
}
