//! What a client shows, moment by moment, from a question to its answer.

use anyhow::Result;
use escarp_client::stages::StageTimes;
use escarp_proto::view::View;
use serde::{Deserialize, Serialize};
use std::time::{Duration, Instant};

/// A moment at which something had changed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Moment {
    /// Seconds since the beginning of the leg.
    pub time_s: f64,
    /// The bound that the client states, pixels; absent while it has none.
    pub bound_px: Option<f64>,
    /// Bytes received since then: messages, and heads of HTTP.
    pub bytes: u64,
}

/// From connecting, or from a teleport, until all is there.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Leg {
    /// When the server had said what the dataset is, seconds.
    pub opened_s: Option<f64>,
    /// When the bound was within 8 px.
    pub within_8_px_s: Option<f64>,
    /// When the bound was within the tolerance.
    pub converged_s: Option<f64>,
    /// Bytes received until then.
    pub converged_bytes: u64,
    /// When nothing more was to come; absent if time was up before.
    pub settled_s: Option<f64>,
    /// Bytes received in all.
    pub bytes: u64,
    /// Those of them that are parts of pages; absent where it was not counted.
    pub page_bytes: Option<u64>,
    /// Bytes of the parts that the final mesh uses, less those that were there before; absent
    /// where it was not counted.
    pub used_bytes: Option<u64>,
    /// What pages took to decode and link until the bound was within the tolerance, seconds.
    pub decode_s: f64,
    /// All moments.
    pub moments: Vec<Moment>,
}

impl Leg {
    /// Notes a moment, and what decoding took for it.
    pub fn note(&mut self, moment: Moment, tolerance_px: f64, decoded: Duration) {
        let new = self
            .moments
            .last()
            .is_none_or(|last| (last.bound_px, last.bytes) != (moment.bound_px, moment.bytes));
        if self.converged_s.is_none() {
            self.decode_s += decoded.as_secs_f64();
        }
        if let Some(px) = moment.bound_px {
            if px <= 8.0 {
                self.within_8_px_s.get_or_insert(moment.time_s);
            }
            if px <= tolerance_px && self.converged_s.is_none() {
                self.converged_s = Some(moment.time_s);
                self.converged_bytes = moment.bytes;
            }
        }
        self.bytes = moment.bytes;
        if new {
            self.moments.push(moment);
        }
    }

    /// The bound at a time, pixels; infinite while there is none.
    pub fn bound_at(&self, time_s: f64) -> f64 {
        let before = self.moments.iter().take_while(|m| m.time_s <= time_s);
        before
            .last()
            .and_then(|m| m.bound_px)
            .unwrap_or(f64::INFINITY)
    }
}

/// Where a client stands after a frame.
#[derive(Debug, Clone, Copy)]
pub struct Stand {
    /// The bound that it states, pixels; absent while it has none.
    pub bound_px: Option<f64>,
    /// Bytes received since it began.
    pub bytes: u64,
    /// What pages took to decode and link.
    pub decoded: Duration,
    /// Whether it is known what the dataset is.
    pub open: bool,
    /// Whether nothing more is to come for the view.
    pub settled: bool,
}

/// The stages that follow from what arrives; the others are of every frame.
pub fn decoding(times: &StageTimes) -> Duration {
    Duration::from_secs_f32((times.decode_ms + times.link_ms).max(0.0) / 1e3)
}

/// A client that can be watched.
pub trait Looking {
    /// Looks, with all that has arrived.
    ///
    /// # Errors
    /// If there is no use in going on.
    fn frame(&mut self, view: &View) -> Result<Stand>;

    /// Waits for something to arrive, or for the next frame.
    ///
    /// # Errors
    /// If there is no use in going on.
    fn rest(&mut self) -> Result<()>;
}

/// When a leg ends, if its time is not up before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Until {
    /// When nothing more is to come.
    Settled,
    /// When the bound is within the tolerance, or nothing more is to come.
    Converged,
}

/// Looks at a view until all is there or time is up. Time counts from `began`, bytes from
/// `bytes_before`.
///
/// # Errors
/// Those of the client.
pub fn look(
    client: &mut impl Looking,
    view: &View,
    began: Instant,
    bytes_before: u64,
    (until, limit): (Until, Duration),
    leg: &mut Leg,
) -> Result<()> {
    loop {
        let stand = client.frame(view)?;
        let time = began.elapsed();
        let moment = Moment {
            time_s: time.as_secs_f64(),
            bound_px: stand.bound_px,
            bytes: stand.bytes - bytes_before,
        };
        if stand.open {
            leg.opened_s.get_or_insert(moment.time_s);
        }
        leg.note(moment, view.max_screen_error_px.into(), stand.decoded);
        if stand.settled {
            leg.settled_s = Some(time.as_secs_f64());
        }
        let enough = until == Until::Converged && leg.converged_s.is_some();
        if stand.settled || enough || time > limit {
            return Ok(());
        }
        client.rest()?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_leg_knows_when_its_bound_was_small_enough_first() {
        let mut leg = Leg::default();
        let at = [
            (0.1, None, 10),
            (0.2, Some(30.0), 20),
            (0.3, Some(8.0), 30),
            (0.4, Some(8.0), 30),
            (0.5, Some(1.9), 40),
            (0.6, Some(1.5), 50),
        ];
        for (time_s, bound_px, bytes) in at {
            let moment = Moment {
                time_s,
                bound_px,
                bytes,
            };
            leg.note(moment, 2.0, Duration::from_millis(10));
        }
        assert_eq!(leg.within_8_px_s, Some(0.3));
        assert_eq!((leg.converged_s, leg.converged_bytes), (Some(0.5), 40));
        assert_eq!(leg.bytes, 50);
        assert!((leg.decode_s - 0.05).abs() < 1e-9, "until it converged");
        assert_eq!(leg.moments.len(), 5, "nothing changed at 0.4");
        assert_eq!(leg.bound_at(0.45), 8.0);
        assert_eq!(leg.bound_at(0.15), f64::INFINITY);
    }
}
