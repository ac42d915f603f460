//! The native driver of a [`Link`]: a WebSocket on a thread of its own.
//!
//! The thread owns the socket and nothing else. The program's thread calls
//! [`Connection::drive`] in each frame, which moves messages between the two; all channels are
//! bounded, so that a slow network holds messages back in the link, where newer ones replace them,
//! and a fast server is held back by the socket.

mod credentials;
mod failure;
mod thread;
mod tls;
mod url;

#[cfg(test)]
mod tests;

pub use credentials::{Credentials, TOKEN_VARIABLE, TokenError};
pub use url::{DEFAULT_PORT, Url, UrlError};

use crate::link::Link;
use escarp_proto::wire::early_value;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::thread::JoinHandle;
use std::time::Duration;
use thread::{Attempt, News, Plan, Report, Worker};
use tokio::sync::{mpsc, watch};

/// Called on the network's thread when there is something for [`Connection::drive`]. It must not
/// block, nor wait for a thread that drops the connection.
pub type Waker = Box<dyn Fn() + Send>;

/// Messages on their way to the socket. Few: those in the link can still be replaced.
const OUTGOING_MESSAGES: usize = 8;
/// Reports on their way to the program; their bytes are bounded apart.
const REPORTS: usize = 256;
/// Reports taken in one turn, so that a flood cannot hold a frame up.
const REPORTS_A_TURN: usize = 2 * REPORTS;

/// A number from the system that other programs, and other connections of this one, have not: for
/// [`LinkConfig::seeded`](crate::link::LinkConfig::seeded).
pub fn own_seed() -> u64 {
    // Each has keys of its own, the first of which the system has drawn.
    RandomState::new().build_hasher().finish()
}

/// What moves messages between a link and its server.
pub trait Carrier: Send {
    /// Does all that is due, by the order of calls of [`Link`]. Never blocks.
    fn drive(&mut self, link: &mut Link, now: Duration);
}

impl Carrier for Connection {
    fn drive(&mut self, link: &mut Link, now: Duration) {
        Connection::drive(self, link, now);
    }
}

/// The way to a server. Dropping it closes the socket and ends its thread.
#[derive(Debug)]
pub struct Connection {
    url: Url,
    /// Which attempt to connect the thread shall be at; `None`: no socket.
    wanted: Option<watch::Sender<Option<Plan>>>,
    attempt: Attempt,
    /// Whether `attempt` is being made, or stands.
    active: bool,
    outgoing: mpsc::Sender<(Attempt, Vec<u8>)>,
    reports: mpsc::Receiver<(Attempt, Report)>,
    thread: Option<JoinHandle<()>>,
}

impl Connection {
    /// Starts the thread. It connects when a link that is driven says so.
    pub fn open(url: Url) -> Connection {
        Connection::with_waker(url, Box::new(|| {}))
    }

    /// As [`open`](Self::open), with a callback for event loops that sleep.
    pub fn with_waker(url: Url, waker: Waker) -> Connection {
        let (wanted, wanted_here) = watch::channel(None);
        let (outgoing, outgoing_here) = mpsc::channel(OUTGOING_MESSAGES);
        let (reports_here, reports) = mpsc::channel(REPORTS);
        let worker = Worker {
            url: url.clone(),
            wanted: wanted_here,
            outgoing: outgoing_here,
            reports: reports_here,
            waker,
        };
        // Without a thread the channels are closed, and every attempt fails with a message.
        let thread = std::thread::Builder::new()
            .name("escarp-net".into())
            .spawn(move || worker.run())
            .ok();
        Connection {
            url,
            wanted: Some(wanted),
            attempt: 0,
            active: false,
            outgoing,
            reports,
            thread,
        }
    }

    /// The server's address.
    pub const fn url(&self) -> &Url {
        &self.url
    }

    /// Moves messages both ways, starts to connect when the link says so, closes the socket when
    /// it gave the session up, and tells it of failures, whose reasons are then in
    /// [`Link::trouble`]. Never blocks. Call it in each frame, when woken, and at
    /// [`Link::next_timeout`], always with the same link; `now` is the time since program start.
    pub fn drive(&mut self, link: &mut Link, now: Duration) {
        self.receive(link, now);
        link.handle_timeout(now);
        if self.active && !link.has_socket() {
            self.want(None);
        }
        if link.poll_connect(now) {
            self.connect(link, now);
        }
        self.transmit(link, now);
    }

    fn receive(&mut self, link: &mut Link, now: Duration) {
        for _ in 0..REPORTS_A_TURN {
            let Ok((attempt, report)) = self.reports.try_recv() else {
                return;
            };
            // Reports of a socket that was given up are late.
            if self.active && attempt == self.attempt {
                self.pass_on(report, link, now);
            }
        }
    }

    fn pass_on(&mut self, report: Report, link: &mut Link, now: Duration) {
        match report.news {
            News::Message(bytes) => {
                // The link has given up the session on an error, and says why itself.
                let _ = link.handle_message(&bytes, now);
                if !link.has_socket() {
                    self.want(None);
                }
            }
            News::Ended(why) => {
                self.active = false;
                link.on_disconnected(now, &why);
            }
        }
    }

    /// Starts to connect. What the link says first goes with the handshake: it need not wait for
    /// that.
    fn connect(&mut self, link: &mut Link, now: Duration) {
        self.attempt += 1;
        self.active = true;
        link.on_connected(now);
        let plan = Plan {
            attempt: self.attempt,
            early: self.early(link, now).into(),
        };
        if !self.want(Some(plan)) {
            self.active = false;
            link.on_disconnected(now, "the network thread has ended");
        }
    }

    /// The first messages, as many as fit into an address. One that does not goes its usual way.
    fn early(&mut self, link: &mut Link, now: Duration) -> Vec<Vec<u8>> {
        let mut early: Vec<Vec<u8>> = Vec::new();
        while let Ok(place) = self.outgoing.try_reserve()
            && let Some(bytes) = link.poll_transmit(now)
        {
            early.push(bytes);
            if early_value(&early).is_none() {
                let bytes = early.pop().unwrap_or_default();
                place.send((self.attempt, bytes));
                break;
            }
        }
        early
    }

    /// Tells the thread which attempt to be at. False if it has ended.
    fn want(&mut self, plan: Option<Plan>) -> bool {
        self.active = plan.is_some();
        self.wanted
            .as_ref()
            .is_some_and(|wanted| wanted.send(plan).is_ok())
    }

    fn transmit(&mut self, link: &mut Link, now: Duration) {
        while self.active
            && let Ok(place) = self.outgoing.try_reserve()
            && let Some(bytes) = link.poll_transmit(now)
        {
            place.send((self.attempt, bytes));
        }
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        // Closing the channel ends the thread's waiting, wherever it is.
        self.wanted = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
