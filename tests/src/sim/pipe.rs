//! One direction of a connection: a stream of bytes with bandwidth, delay, jitter and loss.
//!
//! Loss is delay, as under TCP: a segment that is lost comes again after a while, and those behind
//! it wait for it. A stream can be cut at any byte.

use super::random::Random;
use std::collections::VecDeque;
use std::time::Duration;

/// Bytes of a segment.
const SEGMENT: usize = 1400;
/// Bytes before a frame's payload: its kind and its length.
const HEAD: usize = 5;
/// Least wait for a lost segment to be sent again (Linux's TCP).
const RETRANSMIT: Duration = Duration::from_millis(200);

/// What a line does to bytes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Bytes a second.
    pub bytes_per_s: f64,
    /// From either end to the other.
    pub delay: Duration,
    /// More delay, at most.
    pub jitter: Duration,
    /// Share of the segments that are lost once.
    pub loss: f64,
    /// Bytes that may be under way or unread before the sender has to wait.
    pub buffer: usize,
}

/// What WebSocket carries.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Frame {
    /// A message of the protocol.
    Binary(Vec<u8>),
    /// Is the other side there?
    Ping,
    /// It is.
    Pong,
    /// The connection ends.
    Close,
}

impl Frame {
    fn encode(&self) -> Vec<u8> {
        let (kind, payload): (u8, &[u8]) = match self {
            Frame::Binary(bytes) => (0, bytes),
            Frame::Ping => (1, &[]),
            Frame::Pong => (2, &[]),
            Frame::Close => (3, &[]),
        };
        let length = (payload.len() as u32).to_le_bytes();
        [&[kind], &length[..], payload].concat()
    }

    /// The first frame of some bytes, taken from them, if it is whole.
    fn take(bytes: &mut Vec<u8>) -> Option<Frame> {
        let head: [u8; HEAD] = bytes.get(..HEAD)?.try_into().ok()?;
        let length = u32::from_le_bytes([head[1], head[2], head[3], head[4]]) as usize;
        if bytes.len() < HEAD + length {
            return None;
        }
        let payload = bytes.drain(..HEAD + length).skip(HEAD).collect();
        Some(match head[0] {
            0 => Frame::Binary(payload),
            1 => Frame::Ping,
            2 => Frame::Pong,
            _ => Frame::Close,
        })
    }
}

/// What a reader finds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Found {
    /// A whole frame.
    Frame(Frame),
    /// The end of the stream.
    End,
}

/// One direction.
#[derive(Debug)]
pub struct Pipe {
    /// What the line is like now.
    pub line: Line,
    random: Random,
    under_way: VecDeque<(Duration, Vec<u8>)>,
    /// Bytes under way or unread.
    queued: usize,
    /// Bytes read of a frame that is not whole.
    partial: Vec<u8>,
    free_at: Duration,
    last_arrival: Duration,
    accepted: u64,
    /// The byte from which on nothing passes, and whether the reader is told.
    cut: Option<(u64, bool)>,
    ended: Option<Duration>,
    reader_may_read_at: Duration,
}

impl Pipe {
    /// An open pipe.
    pub fn new(line: Line, random: Random) -> Pipe {
        Pipe {
            line,
            random,
            under_way: VecDeque::new(),
            queued: 0,
            partial: Vec::new(),
            free_at: Duration::ZERO,
            last_arrival: Duration::ZERO,
            accepted: 0,
            cut: None,
            ended: None,
            reader_may_read_at: Duration::ZERO,
        }
    }

    /// Whether a sender need not wait.
    pub fn has_room(&self) -> bool {
        self.queued < self.line.buffer
    }

    /// Cuts the stream after so many more bytes. If silently, the reader is not told.
    pub fn cut_after(&mut self, bytes: u64, silently: bool, now: Duration) {
        if self.cut.is_none() {
            self.cut = Some((self.accepted + bytes, silently));
            self.notice_cut(now);
        }
    }

    /// Sends a frame.
    pub fn send(&mut self, frame: &Frame, now: Duration) {
        if self.ended.is_some() {
            return;
        }
        let bytes = frame.encode();
        for segment in bytes.chunks(SEGMENT) {
            let before_cut = self.cut_at().saturating_sub(self.accepted);
            let passes = segment.len().min(before_cut as usize);
            self.accepted += segment.len() as u64;
            // What a dead line swallows fills the sender's buffer all the same.
            self.queued += segment.len();
            if passes > 0 {
                let arrival = self.arrival(segment.len(), now);
                self.under_way
                    .push_back((arrival, segment[..passes].to_vec()));
            }
        }
        self.notice_cut(now);
    }

    fn cut_at(&self) -> u64 {
        self.cut.map_or(u64::MAX, |(at, _)| at)
    }

    fn arrival(&mut self, bytes: usize, now: Duration) -> Duration {
        let took = Duration::from_secs_f64(bytes as f64 / self.line.bytes_per_s);
        self.free_at = self.free_at.max(now) + took;
        let mut arrival = self.free_at + self.line.delay;
        arrival += self.line.jitter.mul_f64(self.random.share());
        while self.random.chance(self.line.loss) {
            arrival += RETRANSMIT + 2 * self.line.delay;
        }
        self.last_arrival = self.last_arrival.max(arrival);
        self.last_arrival
    }

    fn notice_cut(&mut self, now: Duration) {
        if let Some((at, false)) = self.cut
            && self.accepted >= at
            && self.ended.is_none()
        {
            self.end(now);
        }
    }

    /// Ends the stream behind what was sent.
    pub fn end(&mut self, now: Duration) {
        let silent = self.cut.is_some_and(|(_, silently)| silently);
        if self.ended.is_none() && !silent {
            self.ended = Some(self.last_arrival.max(now + self.line.delay));
        }
    }

    /// What has come by now, at most so many bytes a second. In order; the end comes last.
    pub fn receive(&mut self, now: Duration, bytes_per_s: Option<f64>) -> Vec<Found> {
        let mut found = Vec::new();
        while self.reader_may_read_at <= now
            && self.under_way.front().is_some_and(|(at, _)| *at <= now)
        {
            let Some((_, bytes)) = self.under_way.pop_front() else {
                break;
            };
            if let Some(rate) = bytes_per_s {
                let took = Duration::from_secs_f64(bytes.len() as f64 / rate);
                self.reader_may_read_at = now + took;
            }
            self.queued -= bytes.len();
            self.partial.extend(bytes);
            while let Some(frame) = Frame::take(&mut self.partial) {
                found.push(Found::Frame(frame));
            }
        }
        if self.under_way.is_empty() && self.ended.is_some_and(|at| at <= now) {
            found.push(Found::End);
        }
        found
    }

    /// When there is something to receive next.
    pub fn next_arrival(&self) -> Option<Duration> {
        let bytes = self.under_way.front().map(|(at, _)| *at);
        let next = bytes.or(self.ended)?;
        Some(next.max(self.reader_may_read_at))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINE: Line = Line {
        bytes_per_s: 1e5,
        delay: Duration::from_millis(10),
        jitter: Duration::ZERO,
        loss: 0.0,
        buffer: 4000,
    };

    fn pipe(line: Line) -> Pipe {
        Pipe::new(line, Random::new(1, 2))
    }

    fn message(number: u8, bytes: usize) -> Frame {
        Frame::Binary(vec![number; bytes - HEAD])
    }

    #[test]
    fn frames_arrive_in_order_after_bandwidth_and_delay_and_fill_the_buffer() {
        let mut pipe = pipe(LINE);
        let ms = Duration::from_millis;
        // 1000 bytes take 10 ms.
        pipe.send(&message(1, 1000), ms(0));
        pipe.send(&message(2, 3000), ms(0));
        assert!(!pipe.has_room() && pipe.next_arrival() == Some(ms(20)));
        assert_eq!(pipe.receive(ms(19), None), []);
        assert_eq!(pipe.receive(ms(20), None), [Found::Frame(message(1, 1000))]);
        assert!(pipe.has_room());
        pipe.end(ms(20));
        assert_eq!(
            pipe.receive(ms(50), None),
            [Found::Frame(message(2, 3000)), Found::End]
        );
    }

    #[test]
    fn lost_segments_delay_all_behind_them_and_lose_nothing() {
        let mut pipe = pipe(Line {
            loss: 0.3,
            jitter: Duration::from_millis(30),
            ..LINE
        });
        for number in 0..100 {
            pipe.send(&message(number, 100), Duration::ZERO);
        }
        let mut came = Vec::new();
        for ms in 0..60_000 {
            came.extend(pipe.receive(Duration::from_millis(ms), None));
        }
        let sent: Vec<_> = (0..100).map(|n| Found::Frame(message(n, 100))).collect();
        assert_eq!(came, sent);
    }

    #[test]
    fn a_stream_cut_at_any_byte_gives_the_whole_frames_before_it_and_ends_or_falls_silent() {
        for at in 0..400 {
            for silently in [false, true] {
                let mut pipe = pipe(LINE);
                pipe.cut_after(at, silently, Duration::ZERO);
                for number in 0..4 {
                    pipe.send(&message(number, 100), Duration::ZERO);
                }
                let found = pipe.receive(Duration::from_secs(9), None);
                let whole = (0..(at / 100) as u8).map(|n| Found::Frame(message(n, 100)));
                let end = (!silently).then_some(Found::End);
                assert_eq!(
                    found,
                    whole.chain(end).collect::<Vec<_>>(),
                    "{at} {silently}"
                );
            }
        }
    }

    #[test]
    fn a_slow_reader_reads_slowly() {
        let mut pipe = pipe(LINE);
        pipe.send(&message(1, 4 * SEGMENT), Duration::ZERO);
        let second = Duration::from_secs(1);
        let slow = Some(SEGMENT as f64);
        for elapsed in 1..4 {
            assert_eq!(pipe.receive(elapsed * second, slow), []);
        }
        assert!(pipe.has_room() && pipe.receive(4 * second, slow).len() == 1);
    }
}
