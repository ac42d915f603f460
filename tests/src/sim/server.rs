//! The server: its sessions, driven as `escarp-server` drives them, and a witness of what they say.

use super::ground::{GENERATIONS, Ground};
use super::net::{ConnectionId, Net};
use super::pipe::{Found, Frame};
use super::witness::Witness;
use escarp_proto::wire::ErrorCode;
use escarp_server::{Catalog, Limits, PageSource, Session};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

/// The server.
pub struct Server<'a> {
    ground: &'a Ground,
    /// The place of the generation that is published.
    generation: usize,
    limits: Limits,
    catalog: Arc<Catalog>,
    /// The sessions.
    pub served: BTreeMap<ConnectionId, Served<'a>>,
    /// Sessions that there were.
    pub sessions: u64,
}

/// A session and its connection.
pub struct Served<'a> {
    session: Session,
    opened: Duration,
    outgoing: Option<(Frame, Duration)>,
    arrived: VecDeque<Found>,
    heard: Duration,
    pinged: Duration,
    /// What the client was sent.
    pub witness: Witness<'a>,
}

impl<'a> Server<'a> {
    /// Hosts a generation.
    pub fn new(ground: &'a Ground, generation: usize, limits: Limits) -> Server<'a> {
        Server {
            ground,
            generation,
            limits,
            catalog: hosting(ground.source(generation)),
            served: BTreeMap::new(),
            sessions: 0,
        }
    }

    /// Publishes the next generation, if there is one.
    pub fn publish(&mut self) {
        if self.generation + 1 < GENERATIONS {
            self.generation += 1;
            let source = self.ground.source(self.generation);
            for hosted in self.catalog.all() {
                hosted.publish(source.clone());
            }
        }
    }

    /// The number of the generation that is published.
    pub fn published(&self) -> u64 {
        let data = &self.ground.generations[self.generation];
        data.dataset.manifest().generation
    }

    /// Goes down. If it tells its sessions, those that take it in at once know why.
    ///
    /// # Errors
    /// What the server should not have said.
    pub fn stop(&mut self, told: bool, net: &mut Net) -> Result<(), String> {
        if told {
            for served in self.served.values_mut() {
                served
                    .session
                    .close(ErrorCode::ShuttingDown, "the server is going down");
            }
            self.step(net)?;
        }
        for id in std::mem::take(&mut self.served).into_keys() {
            net.connections[id].down.end(net.now);
        }
        net.listening = false;
        // The next process opens the dataset anew.
        self.catalog = hosting(self.ground.source(self.generation));
        Ok(())
    }

    /// Does all that is due.
    ///
    /// # Errors
    /// What the server should not have said.
    pub fn step(&mut self, net: &mut Net) -> Result<(), String> {
        let now = net.now;
        if net.listening {
            for (id, connection) in net.connections.iter_mut().enumerate() {
                if connection.can_be_taken(now) {
                    connection.taken = true;
                    let session = Session::new(self.catalog.clone(), self.limits.clone());
                    let witness = Witness::new(self.ground, &self.limits);
                    self.served.insert(id, Served::new(session, witness, now));
                    self.sessions += 1;
                }
            }
        }
        let mut ended = Vec::new();
        for (&id, served) in &mut self.served {
            let lives = served.step(id, net, &self.limits);
            let lives = lives.map_err(|why| format!("session {id}: {why}"))?;
            if !lives {
                net.connections[id].down.end(now);
                ended.push(id);
            }
        }
        for id in ended {
            self.served.remove(&id);
        }
        Ok(())
    }

    /// When something is due next.
    pub fn next_event(&self, now: Duration) -> Option<Duration> {
        let due = self.served.values().map(|served| served.due(&self.limits));
        due.min().map(|due| due.max(now))
    }
}

fn hosting(source: Arc<dyn PageSource>) -> Arc<Catalog> {
    let catalog = Catalog::default();
    let added = catalog.add("ground", source);
    assert!(added.is_ok(), "the name is one");
    Arc::new(catalog)
}

impl<'a> Served<'a> {
    fn new(session: Session, witness: Witness<'a>, now: Duration) -> Served<'a> {
        Served {
            session,
            opened: now,
            outgoing: None,
            arrived: VecDeque::new(),
            heard: now,
            pinged: now,
            witness,
        }
    }

    /// Whether the session goes on.
    fn step(&mut self, id: ConnectionId, net: &mut Net, limits: &Limits) -> Result<bool, String> {
        let now = net.now;
        let connection = &mut net.connections[id];
        self.session.handle_timeout(now - self.opened);
        if let Some(hosted) = self.session.hosted() {
            self.session.handle_publication(hosted.published());
        }
        loop {
            if self.outgoing.is_some() && connection.down.has_room() {
                if let Some((frame, _)) = self.outgoing.take() {
                    connection.down.send(&frame, now);
                }
                continue;
            }
            if self.outgoing.is_none() {
                if let Some(message) = self.session.poll_message() {
                    self.witness.server_says(&message)?;
                    self.outgoing = Some((Frame::Binary(message), now));
                    continue;
                }
                if self.session.close_reason().is_some() {
                    connection.down.send(&Frame::Close, now);
                    return Ok(false);
                }
                if now >= self.ping_due(limits) {
                    self.pinged = now;
                    self.outgoing = Some((Frame::Ping, now));
                    continue;
                }
            }
            if !self.session.can_receive() {
                break;
            }
            if self.arrived.is_empty() {
                self.arrived.extend(connection.up.receive(now, None));
            }
            match self.arrived.pop_front() {
                Some(Found::Frame(frame)) => self.hear(frame, now)?,
                Some(Found::End) => return Ok(false),
                None => break,
            }
        }
        Ok((self.outgoing.as_ref()).is_none_or(|(_, since)| now < *since + limits.send_timeout))
    }

    fn hear(&mut self, frame: Frame, now: Duration) -> Result<(), String> {
        self.heard = now;
        let time = now - self.opened;
        match frame {
            Frame::Binary(bytes) => {
                self.session.handle_message(&bytes, time);
                self.witness.client_says(&bytes)?;
            }
            Frame::Ping | Frame::Pong => self.session.handle_sign_of_life(time),
            Frame::Close => {}
        }
        Ok(())
    }

    fn ping_due(&self, limits: &Limits) -> Duration {
        self.heard.max(self.pinged) + limits.ping_interval
    }

    fn due(&self, limits: &Limits) -> Duration {
        let own = match &self.outgoing {
            Some((_, since)) => *since + limits.send_timeout,
            None => self.ping_due(limits),
        };
        let session = self.session.poll_timeout();
        session.map_or(own, |time| own.min(self.opened + time))
    }

    /// Whether nothing is left to do.
    pub fn is_at_rest(&self) -> bool {
        self.outgoing.is_none() && self.arrived.is_empty() && !self.session.has_pages()
    }
}
