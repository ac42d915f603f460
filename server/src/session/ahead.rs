//! Looking ahead: what the view will need soon, by the eye's velocity.
//!
//! Only while the server keeps up: if the needs of the last view were not all sent when the next
//! one came, the eye is faster than the line, and what lies ahead would come too late anyway.

use escarp_proto::view::View;
use std::time::Duration;

/// What lies ahead is selected this often: it changes little from view to view.
const INTERVAL: Duration = Duration::from_millis(200);
/// Of all bytes, at most one in so many is sent on a guess.
const SHARE: u64 = 4;

/// How far ahead, and how much of it.
#[derive(Debug)]
pub(super) struct Ahead {
    horizon: Duration,
    next_at: Duration,
    due: bool,
    bytes: u64,
}

impl Ahead {
    /// Looks so far ahead; not at all if that is 0.
    pub(super) fn new(horizon: Duration) -> Ahead {
        Ahead {
            horizon,
            next_at: Duration::ZERO,
            due: false,
            bytes: 0,
        }
    }

    /// A new view is looked at. `keeps_up`: all that the one before needs in view has been sent.
    pub(super) fn turn(&mut self, now: Duration, keeps_up: bool) {
        self.due = keeps_up && now >= self.next_at;
        if self.due {
            self.next_at = now + INTERVAL;
        }
    }

    /// The view to select for, once, if it is time for it and the eye moves.
    pub(super) fn view(&mut self, view: &View) -> Option<View> {
        let moves = view.velocity_m_s.iter().any(|&v| v != 0.0);
        let due = std::mem::take(&mut self.due);
        (due && moves && !self.horizon.is_zero()).then(|| self.later(view))
    }

    fn later(&self, view: &View) -> View {
        let eye_m = view.eye_after(self.horizon.as_secs_f64());
        View { eye_m, ..*view }
    }

    /// Whether so many bytes more may go on a guess, after so many in all.
    pub(super) fn may_send(&self, sent_bytes: u64, bytes: u64) -> bool {
        SHARE * (self.bytes + bytes) <= sent_bytes + bytes
    }

    pub(super) fn spend(&mut self, bytes: u64) {
        self.bytes += bytes;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(velocity_m_s: [f32; 3]) -> View {
        View {
            eye_m: [10.0, 20.0, 30.0],
            direction: [0.0, 1.0, 0.0],
            velocity_m_s,
            fov_y: 1.0,
            viewport_px: [640, 480],
            max_screen_error_px: 2.0,
        }
    }

    #[test]
    fn the_view_ahead_is_where_the_eye_will_be() {
        let mut ahead = Ahead::new(Duration::from_secs(2));
        ahead.turn(Duration::ZERO, true);
        let later = ahead.view(&view([1.0, 0.0, -5.0])).unwrap();
        assert_eq!(later.eye_m, [12.0, 20.0, 20.0]);
        assert_eq!(later.direction, [0.0, 1.0, 0.0]);
        assert_eq!(ahead.view(&view([1.0; 3])), None, "once a turn");
    }

    #[test]
    fn nothing_is_ahead_of_an_eye_at_rest_or_faster_than_the_line_or_too_soon() {
        let mut ahead = Ahead::new(Duration::from_secs(1));
        ahead.turn(Duration::ZERO, true);
        assert_eq!(ahead.view(&view([0.0; 3])), None);
        ahead.turn(INTERVAL, false);
        assert_eq!(ahead.view(&view([1.0; 3])), None);
        ahead.turn(INTERVAL, true);
        assert!(ahead.view(&view([1.0; 3])).is_some());
        ahead.turn(INTERVAL + INTERVAL / 2, true);
        assert_eq!(ahead.view(&view([1.0; 3])), None);
    }

    #[test]
    fn velocities_beyond_all_measure_still_make_a_view() {
        let mut ahead = Ahead::new(Duration::from_secs(2));
        ahead.turn(Duration::ZERO, true);
        let later = ahead.view(&view([f32::MAX, -f32::MAX, 0.0])).unwrap();
        assert_eq!(later.check(), Ok(()));
    }

    #[test]
    fn guesses_stay_within_a_quarter_of_all_bytes() {
        let mut ahead = Ahead::new(Duration::from_secs(1));
        let (mut sent, mut guessed) = (0, 0);
        for step in 0..10_000u64 {
            let bytes = 1 + step * 7919 % 300;
            if ahead.may_send(sent, bytes) {
                ahead.spend(bytes);
                guessed += bytes;
                sent += bytes;
            }
            assert!(4 * guessed <= sent);
            sent += bytes;
        }
        assert!(guessed > 0);
    }
}
