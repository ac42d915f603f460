//! A line between two virtual network cards: frames are read from one, held back as a [`Shaper`]
//! says, and written to the other.
//!
//! It does what the kernel's `netem` does, which not every kernel has. What lies at its ends is
//! the kernel's own TCP.

use super::shaper::{Cell, Shaper};
use anyhow::{Context, Result};
use std::fs::File;
use std::io::{Read, Write};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// What precedes each frame of a tap: a header for offloads, which stay unused.
const HEADER_BYTES: usize = 10;
/// A longer frame cannot come out of a tap.
const LONGEST_READ: usize = 70_000;

/// Both directions of a line.
#[derive(Debug)]
pub struct Relay {
    began: Instant,
    ways: [Way; 2],
}

#[derive(Debug, Clone)]
struct Way {
    shaper: Arc<Mutex<Shaper>>,
    carried: Arc<AtomicU64>,
}

impl Relay {
    /// Begins to carry frames between two taps. Its threads end with the process.
    ///
    /// # Errors
    /// If there is no thread for it.
    pub fn start(ends: [File; 2], cell: Cell) -> Result<Relay> {
        let way = || Way {
            shaper: Arc::new(Mutex::new(Shaper::new(cell, 0))),
            carried: Arc::default(),
        };
        let relay = Relay {
            began: Instant::now(),
            ways: [way(), way()],
        };
        let [a, b] = &ends;
        for (from, to, way) in [(a, b, &relay.ways[0]), (b, a, &relay.ways[1])] {
            let (from, to) = (from.try_clone()?, to.try_clone()?);
            let (way, began) = (way.clone(), relay.began);
            let (sender, frames) = channel();
            thread("line-in", move || take(from, &way, began, &sender))?;
            thread("line-out", move || give(to, began, &frames))?;
        }
        Ok(relay)
    }

    /// Becomes another line, idle. What is under way still arrives.
    pub fn set(&self, cell: Cell, seed: u64) {
        for (way, number) in self.ways.iter().zip(0..) {
            if let Ok(mut shaper) = way.shaper.lock() {
                *shaper = Shaper::new(cell, seed.wrapping_mul(2).wrapping_add(number));
            }
        }
    }

    /// Bytes that were put on the line from its first end to its second, and back: with all
    /// headers, and what TCP sent again, but not what was lost before the line.
    pub fn carried(&self) -> [u64; 2] {
        [0, 1].map(|i| self.ways[i].carried.load(Ordering::Relaxed))
    }
}

fn thread(name: &str, run: impl FnOnce() + Send + 'static) -> Result<()> {
    std::thread::Builder::new()
        .name(name.into())
        .spawn(move || {
            hurry();
            run();
        })
        .context("cannot start a thread for the line")?;
    Ok(())
}

/// Asks the system to run this thread before others: a late frame would be a slower line. If it
/// does not, the line is less even on a busy machine.
fn hurry() {
    let id = std::fs::read_link("/proc/thread-self").ok();
    if let Some(id) = id.as_ref().and_then(|path| path.file_name()) {
        let _ = Command::new("renice")
            .args(["-n", "-20", "-p"])
            .arg(id)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
    }
}

fn take(mut from: File, way: &Way, began: Instant, frames: &Sender<(Duration, Vec<u8>)>) {
    let mut buffer = vec![0; LONGEST_READ];
    while let Ok(bytes) = from.read(&mut buffer) {
        let length = bytes.saturating_sub(HEADER_BYTES);
        let Ok(mut shaper) = way.shaper.lock() else {
            return;
        };
        if let Some(at) = shaper.send(began.elapsed(), length) {
            way.carried.fetch_add(length as u64, Ordering::Relaxed);
            if frames.send((at, buffer[..bytes].to_vec())).is_err() {
                return;
            }
        }
    }
}

fn give(mut to: File, began: Instant, frames: &Receiver<(Duration, Vec<u8>)>) {
    for (at, frame) in frames {
        if let Some(left) = at.checked_sub(began.elapsed()) {
            std::thread::sleep(left);
        }
        // A card that is down takes nothing, as a plug that was pulled.
        let _ = to.write(&frame);
    }
}
