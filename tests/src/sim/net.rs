//! The connections between clients and the server, and the client's end of them.

use super::pipe::{Found, Frame, Line, Pipe};
use super::random::Random;
use super::script::Cut;
use escarp_client::link::Link;
use escarp_client::net::Carrier;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// A connection, by its place among all that there were.
pub type ConnectionId = usize;

/// All connections.
#[derive(Debug)]
pub struct Net {
    /// Time of the world.
    pub now: Duration,
    /// Whether something listens.
    pub listening: bool,
    /// The clients' machines.
    pub machines: Vec<Machine>,
    /// Every connection that there was.
    pub connections: Vec<Connection>,
    seed: u64,
}

/// A client's machine and its line.
#[derive(Debug, Clone)]
pub struct Machine {
    /// The line of connections to come.
    pub line: Line,
    /// How fast it reads, if slowly, bytes a second.
    pub reads: Option<f64>,
    /// It sleeps.
    pub asleep: bool,
}

/// What a client's network thread has for its program.
#[derive(Debug)]
enum News {
    Connected,
    Message(Vec<u8>),
    Ended(&'static str),
}

/// A connection.
#[derive(Debug)]
pub struct Connection {
    /// Whose it is.
    pub client: usize,
    /// From the client.
    pub up: Pipe,
    /// To the client.
    pub down: Pipe,
    /// When the server sees it.
    pub accepted: Duration,
    established: Duration,
    greeted: bool,
    /// Whether the client still has its end.
    open: bool,
    /// Whether it came about.
    refused: bool,
    /// Whether the server has taken it.
    pub taken: bool,
    inbox: VecDeque<News>,
}

impl Net {
    /// Without connections.
    pub fn new(seed: u64, machines: Vec<Machine>) -> Net {
        Net {
            now: Duration::ZERO,
            listening: true,
            machines,
            connections: Vec::new(),
            seed,
        }
    }

    fn connect(&mut self, client: usize) -> ConnectionId {
        let id = self.connections.len();
        let line = self.machines[client].line;
        let pipe = |way: u64| {
            let random = Random::new(self.seed, 2 * id as u64 + way + 2);
            Pipe::new(line, random)
        };
        self.connections.push(Connection {
            client,
            up: pipe(0),
            down: pipe(1),
            // Handshakes of TCP and of WebSocket.
            accepted: self.now + 3 * line.delay,
            established: self.now + 4 * line.delay,
            greeted: false,
            open: true,
            refused: !self.listening,
            taken: false,
            inbox: VecDeque::new(),
        });
        id
    }

    /// Lets the clients' network threads work: they read, and answer pings.
    pub fn pump(&mut self) {
        let (now, listening) = (self.now, self.listening);
        for connection in &mut self.connections {
            let machine = &self.machines[connection.client];
            if !machine.asleep && connection.open {
                connection.pump(now, listening, machine.reads);
            }
        }
    }

    /// When something arrives next, at either end.
    pub fn next_event(&self) -> Option<Duration> {
        let of = |connection: &Connection| {
            let asleep = self.machines[connection.client].asleep;
            let down = (connection.down.next_arrival()).filter(|_| connection.open && !asleep);
            let up = connection.up.next_arrival().filter(|_| connection.taken);
            let opens = match (connection.greeted || asleep, connection.taken) {
                (false, _) => Some(connection.established),
                (_, false) => Some(connection.accepted),
                _ => None,
            };
            let opens = opens.filter(|&at| connection.open && at > self.now);
            [down, up, opens].into_iter().flatten().min()
        };
        self.connections.iter().filter_map(of).min()
    }

    /// Cuts a client's connection, if it has one.
    pub fn cut(&mut self, client: usize, cut: Cut) {
        let now = self.now;
        let newest = self.connections.iter_mut().rev();
        let mut own = newest.filter(|connection| connection.client == client && connection.open);
        if let Some(connection) = own.next() {
            let pipes = [
                (&mut connection.up, cut.up),
                (&mut connection.down, cut.down),
            ];
            for (pipe, after) in pipes {
                if let Some(bytes) = after {
                    pipe.cut_after(bytes, cut.silently, now);
                }
            }
        }
    }

    /// Makes a client's line another one, also that of its connections.
    pub fn set_line(&mut self, client: usize, line: Line) {
        self.machines[client].line = line;
        let own = self.connections.iter_mut();
        for connection in own.filter(|connection| connection.client == client) {
            connection.up.line = line;
            connection.down.line = line;
        }
    }
}

impl Connection {
    fn pump(&mut self, now: Duration, listening: bool, reads: Option<f64>) {
        if !self.greeted {
            if now < self.established {
                return;
            }
            self.greeted = true;
            self.refused |= !listening;
            let news = match self.refused {
                true => News::Ended("nothing listens"),
                false => News::Connected,
            };
            self.inbox.push_back(news);
        }
        for found in self.down.receive(now, reads) {
            match found {
                Found::Frame(Frame::Binary(bytes)) => self.inbox.push_back(News::Message(bytes)),
                Found::Frame(Frame::Ping) => self.up.send(&Frame::Pong, now),
                Found::Frame(Frame::Pong) => {}
                Found::Frame(Frame::Close) => self.leave("closed", now),
                Found::End => self.leave("lost", now),
            }
        }
    }

    /// The client's end is no more.
    fn leave(&mut self, why: &'static str, now: Duration) {
        if std::mem::replace(&mut self.open, false) {
            self.inbox.push_back(News::Ended(why));
            self.up.end(now);
        }
    }

    /// Whether a server could take it now.
    pub fn can_be_taken(&self, now: Duration) -> bool {
        !self.taken && !self.refused && self.open && self.accepted <= now
    }
}

/// A client's end, as its program drives it.
pub struct Socket {
    net: Arc<Mutex<Net>>,
    client: usize,
    current: Option<ConnectionId>,
}

impl Socket {
    /// Not connected.
    pub fn new(net: Arc<Mutex<Net>>, client: usize) -> Socket {
        let current = None;
        Socket {
            net,
            client,
            current,
        }
    }

    fn close(&mut self, net: &mut Net) {
        if let Some(id) = self.current.take() {
            let now = net.now;
            net.connections[id].leave("left", now);
        }
    }
}

impl Carrier for Socket {
    fn drive(&mut self, link: &mut Link, now: Duration) {
        let shared = self.net.clone();
        let mut net = lock(&shared);
        while let Some(id) = self.current
            && let Some(news) = net.connections[id].inbox.pop_front()
        {
            match news {
                News::Connected => link.on_connected(now),
                News::Message(bytes) => {
                    // The link says itself why it gave up.
                    let _ = link.handle_message(&bytes, now);
                    if !link.has_socket() {
                        self.close(&mut net);
                    }
                }
                News::Ended(why) => {
                    self.current = None;
                    link.on_disconnected(now, why);
                }
            }
        }
        link.handle_timeout(now);
        if !link.has_socket() {
            self.close(&mut net);
        }
        if link.poll_connect(now) {
            self.close(&mut net);
            self.current = Some(net.connect(self.client));
        }
        let world = net.now;
        while let Some(id) = self.current
            && net.connections[id].up.has_room()
            && let Some(bytes) = link.poll_transmit(now)
        {
            net.connections[id].up.send(&Frame::Binary(bytes), world);
        }
    }
}

impl Drop for Socket {
    fn drop(&mut self) {
        let shared = self.net.clone();
        self.close(&mut lock(&shared));
    }
}

/// The net, also after a panic in another thread.
pub fn lock(net: &Mutex<Net>) -> MutexGuard<'_, Net> {
    net.lock().unwrap_or_else(PoisonError::into_inner)
}
