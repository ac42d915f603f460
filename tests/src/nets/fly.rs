//! Steady flight over a line: bytes a second, and frames that the line could not keep within the
//! tolerance.

use super::client::{Client, Kind};
use super::lab::{End, Lab, SERVER, beside};
use super::places::{Ground, Way};
use super::server::Server;
use super::shaper::Cell;
use super::watch::{Leg, Looking, Until, look};
use crate::report::tables::Table;
use anyhow::{Context, Result, ensure};
use escarp_client::flight::Path as Flight;
use escarp_tiles::dataset::Dataset;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::time::{Duration, Instant};

/// Pictures a second.
const FPS: f64 = 30.0;

/// What a client shall fly.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct FlyJob {
    /// How it gets its pages.
    pub kind: Kind,
    /// The dataset's address.
    pub url: String,
    /// The flight. It begins when all is there for its first frame.
    pub flight: Flight,
    /// Whether the server is told the velocity, by which it predicts.
    pub predicts: bool,
    /// Longest time for the first frame, seconds.
    pub limit_s: f64,
}

/// What a flight was like.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Flown {
    /// Seconds of flight.
    pub seconds: f64,
    /// Frames that were made.
    pub frames: u64,
    /// Frames for which the client was too slow.
    pub skipped: u64,
    /// Frames whose bound exceeded the tolerance.
    pub stalled: u64,
    /// The longest time for which it did, seconds.
    pub longest_s: f64,
    /// The largest bound, pixels; absent if there was none at times.
    pub worst_px: Option<f64>,
    /// Bytes received in flight.
    pub bytes: u64,
}

/// Adds up frames.
#[derive(Debug, Default)]
struct Tally {
    flown: Flown,
    /// Since when the bound has exceeded the tolerance.
    since: Option<f64>,
}

impl Tally {
    fn note(&mut self, time_s: f64, bound_px: Option<f64>, tolerance_px: f64) {
        let px = bound_px.unwrap_or(f64::INFINITY);
        let worst = self.flown.worst_px.unwrap_or(match self.flown.frames {
            0 => 0.0,
            _ => f64::INFINITY,
        });
        self.flown.frames += 1;
        self.flown.worst_px = Some(worst.max(px)).filter(|px| px.is_finite());
        if px > tolerance_px {
            self.flown.stalled += 1;
            self.since.get_or_insert(time_s);
        } else {
            self.end(time_s);
        }
    }

    /// The frame at this time is within the tolerance again, or there is none.
    fn end(&mut self, time_s: f64) {
        if let Some(since) = self.since.take() {
            self.flown.longest_s = self.flown.longest_s.max(time_s - since);
        }
    }
}

/// Flies.
///
/// # Errors
/// If the server cannot be reached, or refuses.
pub fn work(job: &FlyJob) -> Result<Flown> {
    let limit = Duration::from_secs_f64(job.limit_s);
    let mut client = Client::open(job.kind, &job.url)?;
    let view = |frame| {
        let mut view = job.flight.view(job.flight.frame_time_s(frame));
        if !job.predicts {
            view.velocity_m_s = [0.0; 3];
        }
        view
    };
    let mut leg = Leg::default();
    let end = (Until::Settled, limit);
    look(&mut client, &view(0), Instant::now(), 0, end, &mut leg)?;
    ensure!(
        leg.settled_s.is_some(),
        "the first frame took longer than {limit:?}"
    );
    let tolerance_px = f64::from(job.flight.error_px);
    let began = Instant::now();
    let (mut tally, mut frame, frames) = (Tally::default(), 0, job.flight.frames());
    while frame < frames {
        let stand = client.frame(&view(frame))?;
        tally.note(began.elapsed().as_secs_f64(), stand.bound_px, tolerance_px);
        tally.flown.bytes = stand.bytes - leg.bytes;
        let next = ((began.elapsed().as_secs_f64() * FPS).ceil() as u64).max(frame + 1);
        tally.flown.skipped += next.min(frames) - frame - 1;
        frame = next;
        let due = Duration::from_secs_f64(frame as f64 / FPS);
        if let Some(left) = due.checked_sub(began.elapsed()) {
            std::thread::sleep(left);
        }
    }
    tally.flown.seconds = began.elapsed().as_secs_f64();
    tally.end(tally.flown.seconds);
    Ok(tally.flown)
}

/// What is flown.
#[derive(Debug, Clone)]
pub struct FlightPlan {
    /// The line.
    pub line: Cell,
    /// Speeds, metres a second.
    pub speeds: Vec<f64>,
    /// Clients, and whether the server is told the velocity.
    pub clients: Vec<(Kind, bool)>,
    /// Longest flight, seconds.
    pub seconds: f64,
    /// The tolerance, pixels.
    pub error_px: f32,
    /// Flights of each.
    pub repeats: u32,
}

/// One flight of one client.
#[derive(Debug, Clone, Serialize)]
pub struct Flight1 {
    /// Metres a second.
    pub speed_m_s: f64,
    /// The client.
    pub kind: Kind,
    /// Whether the server was told the velocity.
    pub predicts: bool,
    /// What it was like.
    pub flown: Flown,
}

/// Flies over a dataset.
///
/// # Errors
/// What a lab needs, and what a client says that fails.
pub fn measure(folder: &Path, plan: &FlightPlan, step: &dyn Fn(&str)) -> Result<Vec<Flight1>> {
    let dataset = Dataset::open(folder).with_context(|| format!("{}", folder.display()))?;
    let lab = Lab::new()?;
    let mut command = lab.command(End::Server, &beside("escarp-server")?);
    command
        .arg(folder)
        .args(["--listen", &format!("{SERVER}:8787")]);
    let server = Server::start(command)?;
    let mut flights = Vec::new();
    for &speed_m_s in &plan.speeds {
        let way = Way {
            from: [0.3, 0.3],
            course_deg: 45.0,
            speed_m_s,
            seconds: plan.seconds,
            error_px: plan.error_px,
        };
        let flight = Ground::new(&dataset).flight(way, FPS)?;
        for &(kind, predicts) in &plan.clients {
            for repeat in 0..plan.repeats {
                step(&format!("{speed_m_s} m/s, {kind}, prediction {predicts}"));
                lab.line.set(plan.line, repeat.into());
                let job = FlyJob {
                    kind,
                    url: server.url.clone(),
                    flight: flight.clone(),
                    predicts,
                    limit_s: 60.0,
                };
                let flown = lab.measure("line-flight", &job)?;
                flights.push(Flight1 {
                    speed_m_s,
                    kind,
                    predicts,
                    flown,
                });
            }
        }
    }
    Ok(flights)
}

/// A row for each flight.
pub fn table(flights: &[Flight1]) -> Table {
    let mut table = Table::new(&[
        "m/s",
        "client",
        "prediction",
        "seconds",
        "frames",
        "skipped",
        "stalled %",
        "longest s",
        "worst px",
        "kB/s",
    ]);
    for one in flights {
        let flown = &one.flown;
        let frames = flown.frames.max(1) as f64;
        table.rows.push(vec![
            one.speed_m_s.to_string(),
            one.kind.to_string(),
            if one.predicts { "on" } else { "off" }.into(),
            format!("{:.0}", flown.seconds),
            flown.frames.to_string(),
            flown.skipped.to_string(),
            format!("{:.1}", 100.0 * flown.stalled as f64 / frames),
            format!("{:.2}", flown.longest_s),
            flown
                .worst_px
                .map_or("none".into(), |px| format!("{px:.1}")),
            format!("{:.1}", flown.bytes as f64 / flown.seconds.max(1e-3) / 1e3),
        ]);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stalls_are_frames_beyond_the_tolerance_and_last_until_the_next_one_within() {
        let mut tally = Tally::default();
        let frames = [(0.0, 1.0), (0.1, 2.5), (0.2, 3.0), (0.5, 2.0), (0.6, 2.1)];
        for (time_s, px) in frames {
            tally.note(time_s, Some(px), 2.0);
        }
        tally.end(0.7);
        let flown = tally.flown;
        assert_eq!(
            (flown.frames, flown.stalled, flown.worst_px),
            (5, 3, Some(3.0))
        );
        assert!((flown.longest_s - 0.4).abs() < 1e-9);
    }

    #[test]
    fn a_frame_without_a_bound_is_a_stall_without_a_worst_bound() {
        let mut tally = Tally::default();
        tally.note(0.0, Some(1.0), 2.0);
        tally.note(0.1, None, 2.0);
        tally.note(0.2, Some(1.0), 2.0);
        assert_eq!((tally.flown.stalled, tally.flown.worst_px), (1, None));
    }
}
