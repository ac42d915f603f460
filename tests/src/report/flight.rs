//! Which frames of a flight are flown.

use anyhow::{Context, Result};
use escarp_client::flight::{Path as Flight, default_path};
use escarp_proto::manifest::Manifest;
use escarp_proto::view::View;
use std::path::Path;

/// Windows of a flight: frames that follow each other, and a leap to the next window.
#[derive(Debug, Clone)]
pub struct Windows {
    /// The flight.
    pub flight: Flight,
    /// First frame of each window.
    starts: Vec<u64>,
    /// Frames of each.
    length: u64,
}

/// A frame of a flight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// When, seconds.
    pub time_s: f64,
    /// No frame before it in its window: the eye has leapt there.
    pub leap: bool,
    /// The mesh of this frame is to be measured.
    pub measured: bool,
}

/// Reads a flight, or takes the usual one.
///
/// # Errors
/// If the file cannot be read, or is no flight.
pub fn open(path: Option<&Path>, manifest: &Manifest) -> Result<Flight> {
    let Some(path) = path else {
        return Ok(default_path(manifest));
    };
    let json = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    Flight::from_json(&json).with_context(|| format!("{} is no flight", path.display()))
}

impl Windows {
    /// `count` windows of `length` frames, evenly over a flight; all of it if it is not longer.
    pub fn over(flight: Flight, count: u64, length: u64) -> Windows {
        let frames = flight.frames();
        let (starts, length) = match frames <= count * length {
            true => (vec![0], frames),
            false => {
                let last = frames - length;
                let start = |i: u64| last * i / (count - 1).max(1);
                ((0..count).map(start).collect(), length)
            }
        };
        Windows {
            flight,
            starts,
            length,
        }
    }

    /// All frames, in order. Of each window the last one is measured, and the one in its middle.
    pub fn frames(&self) -> Vec<Frame> {
        let frame = |start: u64, i: u64| Frame {
            time_s: self.flight.frame_time_s(start + i),
            leap: i == 0,
            measured: i + 1 == self.length || (self.length > 4 && i == self.length / 2),
        };
        let starts = self.starts.iter();
        starts
            .flat_map(|&start| (0..self.length).map(move |i| frame(start, i)))
            .collect()
    }

    /// The view of a frame with a tolerance in pixels.
    pub fn view(&self, time_s: f64, error_px: f32) -> View {
        View {
            max_screen_error_px: error_px,
            ..self.flight.view(time_s)
        }
    }
}
