//! Error against the seconds since connecting, over a line of given bandwidth and delay.
//!
//! The server's session and the client's link, both without sockets or clock, talk in virtual
//! time. The line has a queue, a bandwidth and a delay, the same both ways. TCP's and WebSocket's
//! handshakes are two round trips before the first message; loss and TCP's slow start are not
//! modelled. The client draws 60 frames a second, and takes no time for it.

use super::measure::surface::FullSurface;
use super::measure::tally::Promise;
use super::measure::triangles;
use anyhow::{Result, bail};
use escarp_client::link::{Event, Link, LinkConfig};
use escarp_client::mesh::MeshOptions;
use escarp_client::terrain::Terrain;
use escarp_proto::geometry::PageId;
use escarp_proto::view::View;
use escarp_server::{Catalog, Limits, PageSource, Session};
use serde::{Serialize, Serializer};
use std::collections::VecDeque;
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

const TICK: Duration = Duration::from_millis(1);
const TICKS_A_FRAME: u32 = 16;
/// A message waits in the server while so much is queued before the line.
const SOCKET_BUFFER: Duration = Duration::from_millis(20);
/// Memory for the client's pages, bytes.
const MEMORY_BYTES: usize = 1 << 30;
/// Overhead of TCP, IP and WebSocket a message, bytes, at least.
const OVERHEAD_BYTES: usize = 56;

/// A line to a server.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Bits a second, each way.
    pub bits_per_s: f64,
    /// From either end to the other, milliseconds.
    pub delay_ms: f64,
}

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}Mbit/s@{}ms", self.bits_per_s / 1e6, self.delay_ms)
    }
}

impl FromStr for Line {
    type Err = String;

    /// `10Mbit/s@50ms`: bandwidth, and the delay of one way.
    fn from_str(text: &str) -> Result<Line, String> {
        let error = || {
            format!(
                "{text:?} is no line; allowed are 0.01Mbit/s@0ms to 10000Mbit/s@5000ms, \
                 such as 10Mbit/s@50ms"
            )
        };
        let (rate, delay) = text.split_once('@').ok_or_else(error)?;
        let rate = rate.strip_suffix("Mbit/s").ok_or_else(error)?;
        let delay = delay.strip_suffix("ms").ok_or_else(error)?;
        let megabits: f64 = rate.parse().map_err(|_| error())?;
        let delay_ms: f64 = delay.parse().map_err(|_| error())?;
        let allowed = (0.01..=1e4).contains(&megabits) && (0.0..=5e3).contains(&delay_ms);
        allowed
            .then_some(Line {
                bits_per_s: megabits * 1e6,
                delay_ms,
            })
            .ok_or_else(error)
    }
}

impl Serialize for Line {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// A moment of a cold start.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Moment {
    /// Seconds since the client began to connect.
    pub time_s: f64,
    /// The bound that the client states, pixels; absent while it has none.
    pub bound_px: Option<f64>,
    /// The largest deviation, measured, pixels; absent where it was not measured.
    pub measured_px: Option<f64>,
    /// Bytes received, messages whole.
    pub bytes: u64,
    /// Triangles of the mesh.
    pub triangles: u64,
}

/// A cold start over a line.
#[derive(Debug, Clone, Serialize)]
pub struct ColdStart {
    /// The line.
    pub line: Line,
    /// The tolerance, pixels.
    pub error_px: f32,
    /// When a bound could be stated first, seconds.
    pub first_bound_s: Option<f64>,
    /// When the bound was within 8 px.
    pub within_8_px_s: Option<f64>,
    /// When the bound was within the tolerance.
    pub converged_s: Option<f64>,
    /// Bytes received until then, or at the end.
    pub bytes: u64,
    /// Largest deviation measured over the bound stated at that moment.
    pub max_over_stated: f64,
    /// Moments at which something had changed.
    pub moments: Vec<Moment>,
}

/// One direction of a line.
#[derive(Debug, Default)]
struct Pipe {
    free_at: Duration,
    under_way: VecDeque<(Duration, Vec<u8>)>,
}

impl Pipe {
    fn send(&mut self, line: &Line, now: Duration, message: Vec<u8>) {
        let bits = 8.0 * (message.len() + OVERHEAD_BYTES) as f64;
        let took = Duration::from_secs_f64(bits / line.bits_per_s);
        self.free_at = self.free_at.max(now) + took;
        let delay = Duration::from_secs_f64(line.delay_ms / 1e3);
        self.under_way.push_back((self.free_at + delay, message));
    }

    fn has_room(&self, now: Duration) -> bool {
        self.free_at <= now + SOCKET_BUFFER
    }

    fn receive(&mut self, now: Duration) -> Option<Vec<u8>> {
        self.under_way.front().filter(|(at, _)| *at <= now)?;
        self.under_way.pop_front().map(|(_, message)| message)
    }
}

/// A client and a server, and the line between them.
struct Pair {
    line: Line,
    /// When the server opened the session, whose time counts from there.
    opened: Duration,
    session: Session,
    link: Link,
    terrain: Option<Terrain>,
    up: Pipe,
    down: Pipe,
}

impl Pair {
    fn new(source: Arc<dyn PageSource>, line: Line, opened: Duration) -> Result<Pair> {
        let catalog = Catalog::default();
        catalog.add("terrain", source)?;
        Ok(Pair {
            line,
            opened,
            session: Session::new(Arc::new(catalog), Limits::default()),
            link: Link::new(LinkConfig::new("terrain")),
            terrain: None,
            up: Pipe::default(),
            down: Pipe::default(),
        })
    }

    /// Lets messages arrive, and new ones leave.
    fn carry(&mut self, now: Duration) -> Result<()> {
        while self.session.can_receive()
            && let Some(message) = self.up.receive(now)
        {
            self.session.handle_message(&message, now - self.opened);
        }
        self.session.handle_timeout(now - self.opened);
        while self.down.has_room(now)
            && let Some(message) = self.session.poll_message()
        {
            self.down.send(&self.line, now, message);
        }
        while let Some(message) = self.down.receive(now) {
            self.link.handle_message(&message, now)?;
        }
        self.link.handle_timeout(now);
        while self.up.has_room(now)
            && let Some(message) = self.link.poll_transmit(now)
        {
            self.up.send(&self.line, now, message);
        }
        if let Some(reason) = self.session.close_reason() {
            bail!("the session ended: {reason:?}");
        }
        Ok(())
    }

    /// A frame of the client: the excess of the bound over the tolerance, and triangles.
    fn frame(&mut self, view: &View, now: Duration) -> Result<(f64, u64, bool)> {
        while let Some(event) = self.link.poll_event() {
            match (event, &mut self.terrain) {
                (Event::Welcome { manifest, .. }, _) => {
                    self.terrain =
                        Some(Terrain::new(manifest, MEMORY_BYTES, MeshOptions::default()));
                }
                (Event::Chunk(chunk), Some(terrain)) => terrain.receive(chunk),
                (Event::Miss(miss), Some(terrain)) => {
                    if let Some(page) = PageId::from_key(miss.page) {
                        terrain.miss(page);
                    }
                }
                _ => {}
            }
        }
        let Some(terrain) = &mut self.terrain else {
            return Ok((f64::INFINITY, 0, false));
        };
        self.link.set_view(view, now)?;
        let step = terrain.update(view);
        self.link.evict(&step.dropped);
        self.link.discard(&step.orphans);
        self.link.set_wants(terrain.wants(), now);
        let settled = terrain.wants().is_empty() && self.link.stats().in_flight_pages == 0;
        Ok((step.excess, step.triangles, settled))
    }
}

/// Connects over a line, and looks at one view until all is there or time is up.
///
/// # Errors
/// If the protocol fails, or the dataset is damaged.
pub fn cold_start(
    surface: &FullSurface<'_>,
    source: Arc<dyn PageSource>,
    line: Line,
    view: &View,
    limit: Duration,
    measurements: usize,
) -> Result<ColdStart> {
    let round_trip = Duration::from_secs_f64(2.0 * line.delay_ms / 1e3);
    let connected = 2 * round_trip;
    let mut pair = Pair::new(source, line, connected)?;
    let asked_px = f64::from(view.max_screen_error_px);
    let mut out = ColdStart {
        line,
        error_px: view.max_screen_error_px,
        first_bound_s: None,
        within_8_px_s: None,
        converged_s: None,
        bytes: 0,
        max_over_stated: 0.0,
        moments: Vec::new(),
    };
    pair.link.poll_connect(Duration::ZERO);
    pair.link.on_connected(connected);
    let mut now = connected;
    let mut last_bytes = u64::MAX;
    let mut next_measured_s = 0.0;
    for tick in 0u32.. {
        pair.carry(now)?;
        if tick % TICKS_A_FRAME == 0 {
            let (excess, triangles, settled) = pair.frame(view, now)?;
            let bytes = pair.link.stats().received_bytes;
            let time_s = now.as_secs_f64();
            let bound = (excess.is_finite() && triangles > 0).then_some(asked_px * excess.max(1.0));
            out.note(bound, asked_px, time_s);
            if bytes != last_bytes || settled {
                let mut moment = Moment {
                    time_s,
                    bound_px: bound,
                    measured_px: None,
                    bytes,
                    triangles,
                };
                if bound.is_some() && (time_s >= next_measured_s || settled) {
                    let promise = Promise::of(asked_px, excess);
                    out.measure(&mut moment, surface, &pair, view, promise)?;
                    // Evenly on a scale of logarithms.
                    next_measured_s = time_s * 10f64.powf(1.0 / measurements.max(1) as f64);
                }
                out.moments.push(moment);
                out.bytes = bytes;
                last_bytes = bytes;
            }
            if settled || now > limit {
                break;
            }
        }
        now += TICK;
    }
    Ok(out)
}

impl ColdStart {
    fn note(&mut self, bound_px: Option<f64>, asked_px: f64, time_s: f64) {
        let Some(px) = bound_px else {
            return;
        };
        self.first_bound_s.get_or_insert(time_s);
        if px <= 8.0 {
            self.within_8_px_s.get_or_insert(time_s);
        }
        if px <= asked_px {
            self.converged_s.get_or_insert(time_s);
        }
    }

    fn measure(
        &mut self,
        moment: &mut Moment,
        surface: &FullSurface<'_>,
        pair: &Pair,
        view: &View,
        promise: Promise,
    ) -> Result<()> {
        if let Some(terrain) = &pair.terrain {
            let tally = surface.measure(&triangles(terrain.tree()), view, promise)?;
            moment.measured_px = Some(tally.max_px);
            self.max_over_stated = self.max_over_stated.max(tally.max_ratio);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_read_as_it_is_written_and_nonsense_is_refused() {
        let line: Line = "10Mbit/s@50ms".parse().unwrap();
        assert_eq!((line.bits_per_s, line.delay_ms), (1e7, 50.0));
        assert_eq!(line.to_string(), "10Mbit/s@50ms");
        for text in [
            "",
            "10",
            "0Mbit/s@1ms",
            "NaNMbit/s@1ms",
            "1Mbit/s@-1ms",
            "1Mbit/s@infms",
        ] {
            let error = text.parse::<Line>().unwrap_err();
            assert!(error.contains("allowed"), "{text}: {error}");
        }
    }

    #[test]
    fn a_pipe_delivers_in_order_after_bandwidth_and_delay() {
        let line: Line = "1Mbit/s@10ms".parse().unwrap();
        let mut pipe = Pipe::default();
        let ms = Duration::from_millis;
        // 1000 bytes with overhead take 8 ms.
        pipe.send(&line, ms(0), vec![1; 1000 - OVERHEAD_BYTES]);
        pipe.send(&line, ms(0), vec![2; 1000 - OVERHEAD_BYTES]);
        assert_eq!(pipe.receive(ms(17)), None);
        assert_eq!(pipe.receive(ms(18)).map(|m| m[0]), Some(1));
        assert_eq!(pipe.receive(ms(25)), None);
        assert_eq!(pipe.receive(ms(26)).map(|m| m[0]), Some(2));
        assert!(pipe.has_room(ms(0)));
        pipe.send(&line, ms(0), vec![3; 1000 - OVERHEAD_BYTES]);
        assert!(!pipe.has_room(ms(0)) && pipe.has_room(ms(4)));
    }
}
