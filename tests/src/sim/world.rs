//! A run: the script's acts at their times, the machines between them, and peace at the end.

use super::client::{Client, Record};
use super::ground::Ground;
use super::net::{Machine, Net, lock};
use super::pipe::Line;
use super::script::{Act, Script};
use super::server::Server;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// How long it may take until all is at rest, from when nothing happens any more.
const PATIENCE: Duration = Duration::from_secs(400);
/// How long the rest must last to be one.
const REST: Duration = Duration::from_secs(2);
/// The least step of time.
const TICK: Duration = Duration::from_millis(1);
/// Lines in peace are at least so good.
const PEACEFUL: Line = Line {
    bytes_per_s: 5e4,
    delay: Duration::from_millis(300),
    jitter: Duration::from_millis(20),
    loss: 0.0,
    buffer: 1 << 16,
};

/// A run.
pub struct World<'a> {
    net: Arc<Mutex<Net>>,
    server: Server<'a>,
    clients: Vec<Client<'a>>,
    acts: VecDeque<(Duration, Act)>,
    peace: Duration,
    /// What will be over when.
    over: Vec<(Duration, Over)>,
    resting_since: Option<Duration>,
    /// Time of the world.
    pub now: Duration,
}

/// The end of something that lasts.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Over {
    Sleep {
        client: usize,
        began: Duration,
        counts: bool,
    },
    Slow(usize),
    Down,
}

impl<'a> World<'a> {
    /// Before anything has happened.
    pub fn new(ground: &'a Ground, script: &Script) -> World<'a> {
        let machine = |setup: &super::script::Setup| Machine {
            line: setup.line,
            reads: None,
            asleep: false,
        };
        let machines = script.clients.iter().map(machine).collect();
        let clients = script.clients.iter();
        World {
            net: Arc::new(Mutex::new(Net::new(script.seed, machines))),
            server: Server::new(ground, script.generation, script.limits.clone()),
            clients: clients
                .map(|setup| Client::new(ground, setup.clone()))
                .collect(),
            acts: script.acts.clone().into(),
            peace: script.peace,
            over: Vec::new(),
            resting_since: None,
            now: Duration::ZERO,
        }
    }

    /// Runs to the end.
    ///
    /// # Errors
    /// What did not hold.
    pub fn run(&mut self) -> Result<Record, String> {
        while self.now < self.peace {
            self.act()?;
            self.step()?;
            self.advance(self.acts.front().map_or(self.peace, |(at, _)| *at));
        }
        self.make_peace();
        while !self.has_come_to_rest() {
            if self.now > self.peace + PATIENCE {
                let status: Vec<String> = self.clients.iter().map(Client::status).collect();
                return Err(format!("no rest within {PATIENCE:?}: {status:?}"));
            }
            self.step()?;
            self.advance(self.now + REST);
        }
        self.check_rest()?;
        let mut sum = Record::default();
        self.clients
            .iter()
            .for_each(|client| sum.add(&client.record));
        self.check_nothing_is_left()?;
        Ok(sum)
    }

    /// Lets everyone do what is due.
    fn step(&mut self) -> Result<(), String> {
        self.end_what_is_over();
        {
            let mut net = lock(&self.net);
            net.now = self.now;
            net.pump();
            self.server.step(&mut net)?;
        }
        for (number, client) in self.clients.iter_mut().enumerate() {
            if client.next_frame <= self.now {
                let framed = client.frame(&self.net, number, self.now);
                framed.map_err(|why| format!("client {number}: {why}"))?;
            }
        }
        Ok(())
    }

    /// To when something happens next, but no later than this.
    fn advance(&mut self, latest: Duration) {
        let frames = self.clients.iter().map(|client| client.next_frame);
        let over = self.over.iter().map(|(at, _)| *at);
        let arrives = lock(&self.net).next_event();
        let serves = self.server.next_event(self.now);
        let next = frames.chain(over).chain(arrives).chain(serves).min();
        let next = next.unwrap_or(latest).min(latest);
        self.now = next.max(self.now + TICK);
    }

    /// Does the acts whose time has come.
    fn act(&mut self) -> Result<(), String> {
        while let Some((at, _)) = self.acts.front()
            && *at <= self.now
            && let Some((_, act)) = self.acts.pop_front()
        {
            self.perform(act)?;
        }
        Ok(())
    }

    fn perform(&mut self, act: Act) -> Result<(), String> {
        let now = self.now;
        let mut net = lock(&self.net);
        match act {
            Act::Gaze(client, gaze) => self.clients[client].set_gaze(gaze, now),
            Act::Tolerance(client, error_px) => self.clients[client].error_px = error_px,
            Act::Mesh(client, options) => self.clients[client].set_mesh(options),
            Act::Pause(client, time) => {
                let paused = &mut self.clients[client].next_frame;
                *paused = (*paused).max(now + time);
            }
            Act::Suspend(client, time, counts) => {
                let paused = &mut self.clients[client].next_frame;
                *paused = (*paused).max(now + time);
                net.machines[client].asleep = true;
                let began = now;
                let sleep = Over::Sleep {
                    client,
                    began,
                    counts,
                };
                self.over.push((now + time, sleep));
            }
            Act::Jump(client, time) => self.clients[client].jump(time),
            Act::Slow(client, bytes_per_s, time) => {
                net.machines[client].reads = Some(bytes_per_s);
                self.over.push((now + time, Over::Slow(client)));
            }
            Act::Line(client, line) => net.set_line(client, line),
            Act::Cut(client, cut) => net.cut(client, cut),
            Act::Kill(client, time) => {
                drop(net);
                self.clients[client].kill(now + time);
            }
            Act::Publish => self.server.publish(),
            Act::Restart(told, time) => {
                self.server.stop(told, &mut net)?;
                self.over.push((now + time, Over::Down));
            }
        }
        Ok(())
    }

    fn end_what_is_over(&mut self) {
        let now = self.now;
        let (over, goes_on) = self.over.drain(..).partition(|(at, _)| *at <= now);
        self.over = goes_on;
        for (_, over) in over {
            self.end(over);
        }
    }

    fn end(&mut self, over: Over) {
        let lasts = |client: usize, of: &dyn Fn(&Over) -> Option<usize>| {
            self.over.iter().any(|(_, other)| of(other) == Some(client))
        };
        let mut net = lock(&self.net);
        match over {
            Over::Sleep {
                client,
                began,
                counts,
            } => {
                net.machines[client].asleep = lasts(client, &|over| match over {
                    Over::Sleep { client, .. } => Some(*client),
                    _ => None,
                });
                if !counts {
                    self.clients[client].slept(self.now - began);
                }
            }
            Over::Slow(client) => {
                let slow = lasts(client, &|over| match over {
                    Over::Slow(client) => Some(*client),
                    _ => None,
                });
                if !slow {
                    net.machines[client].reads = None;
                }
            }
            Over::Down => net.listening = !self.over.iter().any(|(_, over)| *over == Over::Down),
        }
    }

    /// From here on all goes well, and nobody moves.
    fn make_peace(&mut self) {
        for (_, over) in std::mem::take(&mut self.over) {
            self.end(over);
        }
        let now = self.now;
        let mut net = lock(&self.net);
        net.now = now;
        for number in 0..self.clients.len() {
            let line = net.machines[number].line;
            let line = Line {
                bytes_per_s: line.bytes_per_s.max(PEACEFUL.bytes_per_s),
                delay: line.delay.min(PEACEFUL.delay),
                jitter: line.jitter.min(PEACEFUL.jitter),
                loss: 0.0,
                buffer: line.buffer,
            };
            net.set_line(number, line);
            let client = &mut self.clients[number];
            client.stand(now);
            client.next_frame = client.next_frame.min(now);
        }
    }

    /// Whether nothing has been left to do for a while.
    fn has_come_to_rest(&mut self) -> bool {
        let settled = self.clients.iter().all(Client::is_settled);
        let served = self.server.served.len() == self.clients.len();
        let idle = |session: u32| {
            let mut all = self.server.served.values();
            all.any(|served| served.witness.idle == Some(session) && served.is_at_rest())
        };
        let answered = self.clients.iter();
        let answered = answered.map(Client::view_sequence);
        let rests = settled && served && answered.into_iter().all(|view| view.is_some_and(idle));
        match rests {
            true => self.resting_since = self.resting_since.or(Some(self.now)),
            false => self.resting_since = None,
        }
        (self.resting_since).is_some_and(|since| self.now >= since + REST)
    }

    fn check_rest(&mut self) -> Result<(), String> {
        let now = self.now;
        for (number, client) in self.clients.iter_mut().enumerate() {
            let rest = client.check_rest(now);
            rest.map_err(|why| format!("client {number} at rest: {why}"))?;
            let (shows, published) = (client.generation(), self.server.published());
            if shows != Some(published) {
                return Err(format!(
                    "client {number} shows generation {shows:?}, published is {published}"
                ));
            }
        }
        Ok(())
    }

    /// Without clients there are no sessions.
    fn check_nothing_is_left(&mut self) -> Result<(), String> {
        let now = self.now;
        for client in &mut self.clients {
            client.kill(Duration::MAX);
        }
        self.clients.clear();
        while !self.server.served.is_empty() {
            if self.now > now + PATIENCE {
                let left = self.server.served.len();
                return Err(format!("{left} sessions are left of clients that went"));
            }
            self.step()?;
            self.advance(self.now + REST);
        }
        Ok(())
    }
}
