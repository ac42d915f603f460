//! One direction of a line, without sockets or clock: when a frame arrives, or that it does not.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;
use std::time::Duration;

/// The longest Ethernet frame without tags, bytes.
pub const FRAME_BYTES: usize = 1514;
/// A line's queue holds at least so many of the longest frames.
const LEAST_QUEUE_FRAMES: usize = 32;
/// A line's queue holds what the line carries in this time, or in a round trip if that is longer.
const LEAST_QUEUE: Duration = Duration::from_millis(100);

/// A line: the same both ways.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// From either end to the other and back, milliseconds; half of it each way.
    pub round_trip_ms: f64,
    /// Megabits a second, each way, Ethernet headers counted.
    pub mbit_s: f64,
    /// Share of frames that are lost, each way, percent.
    pub loss_percent: f64,
}

impl Cell {
    /// Half a round trip.
    pub fn delay(&self) -> Duration {
        Duration::from_secs_f64(self.round_trip_ms / 2e3)
    }

    /// Time that so many bytes take on the line.
    pub fn carrying(&self, bytes: u64) -> Duration {
        Duration::from_secs_f64(bytes as f64 * 8.0 / (self.mbit_s * 1e6))
    }

    /// What may wait before the line; the rest is dropped, as a router does.
    pub fn queue_bytes(&self) -> usize {
        let time = LEAST_QUEUE.max(2 * self.delay()).as_secs_f64();
        let carried = self.mbit_s * 1e6 / 8.0 * time;
        (carried as usize).max(LEAST_QUEUE_FRAMES * FRAME_BYTES)
    }
}

impl fmt::Display for Cell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}ms,{}Mbit/s,{}%",
            self.round_trip_ms, self.mbit_s, self.loss_percent
        )
    }
}

impl FromStr for Cell {
    type Err = String;

    /// `50ms,10Mbit/s,1%`.
    fn from_str(text: &str) -> Result<Cell, String> {
        let error = || {
            format!(
                "{text:?} is no line; allowed are round trips of 0ms to 5000ms, 0.01Mbit/s to \
                 10000Mbit/s and losses of 0% to 50%, such as 50ms,10Mbit/s,1%"
            )
        };
        let mut fields = text.split(',');
        let mut field = |unit: &str, least: f64, most: f64| {
            let number = fields.next()?.strip_suffix(unit)?.parse::<f64>().ok()?;
            (least..=most).contains(&number).then_some(number)
        };
        let cell = Cell {
            round_trip_ms: field("ms", 0.0, 5e3).ok_or_else(error)?,
            mbit_s: field("Mbit/s", 0.01, 1e4).ok_or_else(error)?,
            loss_percent: field("%", 0.0, 50.0).ok_or_else(error)?,
        };
        fields.next().is_none().then_some(cell).ok_or_else(error)
    }
}

/// One direction of a line.
#[derive(Debug, Clone)]
pub struct Shaper {
    cell: Cell,
    free_at: Duration,
    random: u64,
}

impl Shaper {
    /// An idle direction. Which frames are lost follows from the seed.
    pub fn new(cell: Cell, seed: u64) -> Shaper {
        Shaper {
            cell,
            free_at: Duration::ZERO,
            random: seed,
        }
    }

    /// When a frame that is sent now arrives; `None` if it is lost, or the queue is full. Frames
    /// arrive in the order in which they are sent. Times are since any moment, and do not fall.
    pub fn send(&mut self, now: Duration, bytes: usize) -> Option<Duration> {
        let begins = self.free_at.max(now);
        let queued = (begins - now).as_secs_f64() * self.cell.mbit_s * 1e6 / 8.0;
        if queued + bytes as f64 > self.cell.queue_bytes() as f64 || self.is_lost() {
            return None;
        }
        self.free_at = begins + self.cell.carrying(bytes as u64);
        Some(self.free_at + self.cell.delay())
    }

    /// SplitMix64 (Steele, Lea, Flood: "Fast splittable pseudorandom number generators", 2014).
    fn is_lost(&mut self) -> bool {
        self.random = self.random.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.random;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        let fraction = ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64;
        fraction * 100.0 < self.cell.loss_percent
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SLOW: Cell = Cell {
        round_trip_ms: 50.0,
        mbit_s: 1.0,
        loss_percent: 0.0,
    };

    #[test]
    fn a_line_is_read_as_it_is_written() {
        for text in [
            "0ms,1Mbit/s,0%",
            "50ms,0.5Mbit/s,1%",
            "200ms,100Mbit/s,0.1%",
        ] {
            let cell: Cell = text.parse().expect("a line");
            assert_eq!(cell.to_string(), text);
        }
        for text in [
            "",
            "50ms",
            "50ms,1Mbit/s",
            "-1ms,1Mbit/s,0%",
            "1ms,1Mbit/s,0%,0",
        ] {
            assert!(text.parse::<Cell>().is_err(), "{text}");
        }
    }

    #[test]
    fn a_frame_takes_its_length_over_the_bandwidth_and_half_a_round_trip() {
        let mut shaper = Shaper::new(SLOW, 1);
        let ms = |ms: u64| Duration::from_millis(ms);
        assert_eq!(shaper.send(ms(7), 1250), Some(ms(7 + 10 + 25)));
        assert_eq!(shaper.send(ms(7), 1250), Some(ms(7 + 20 + 25)), "it waits");
        assert_eq!(shaper.send(ms(100), 125), Some(ms(100 + 1 + 25)), "idle");
    }

    #[test]
    fn what_does_not_fit_the_queue_is_dropped_and_the_line_is_never_faster_than_it_may_be() {
        let mut shaper = Shaper::new(SLOW, 1);
        let sent = (0..1000).filter_map(|_| shaper.send(Duration::ZERO, FRAME_BYTES));
        let arrived: Vec<Duration> = sent.collect();
        let bytes = arrived.len() * FRAME_BYTES;
        assert_eq!(arrived.len(), LEAST_QUEUE_FRAMES);
        let last = arrived.last().expect("some arrive");
        assert_eq!(*last, SLOW.carrying(bytes as u64) + SLOW.delay());
    }

    #[test]
    fn about_as_many_frames_are_lost_as_the_line_says_and_the_same_for_a_seed() {
        let cell = Cell {
            loss_percent: 1.0,
            mbit_s: 1e4,
            ..SLOW
        };
        let lost = |seed| {
            let mut shaper = Shaper::new(cell, seed);
            let at = |i: u64| Duration::from_millis(i);
            (0..100_000)
                .filter(|&i| shaper.send(at(i), 100).is_none())
                .collect::<Vec<_>>()
        };
        let some = lost(5);
        assert!((800..1200).contains(&some.len()), "{}", some.len());
        assert_eq!(some, lost(5));
        assert_ne!(some, lost(6));
    }
}
