//! A link against a small scripted server, under virtual time.

mod generations;
mod hostile;
mod push;
mod sessions;
mod wants;

use super::{Event, Link, LinkConfig};
use escarp_proto::geometry::{GridLevels, PageId};
use escarp_proto::georef::{Georef, Plane};
use escarp_proto::manifest::{FORMAT, FileCheck, Manifest, VERSION};
use escarp_proto::view::View;
use escarp_proto::wire::{
    Chunk, Class, ClientMessage, ErrorCode, Have, PROTOCOL, PeerError, ServerMessage,
    SessionLimits, Want, Welcome, capability,
};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

pub fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// The page with this number among those of level 8.
pub fn page(number: u32) -> PageId {
    PageId::new(8, number % 256, number / 256).unwrap()
}

pub fn want(number: u32, class: Class, priority: f32) -> Want {
    Want {
        page: page(number).key(),
        first_part: 0,
        last_part: 5,
        class,
        priority,
    }
}

/// Wishes for these pages, in this order of urgency.
pub fn wants(numbers: impl IntoIterator<Item = u32>) -> Vec<Want> {
    let priorities = (0..).map(|rank| 1e6 - rank as f32);
    let wish = |(number, priority)| want(number, Class::InView, priority);
    numbers.into_iter().zip(priorities).map(wish).collect()
}

pub fn chunk(number: u32, first_part: u8, last_part: u8) -> Chunk {
    Chunk {
        page: page(number).key(),
        revision: 7,
        first_part,
        last_part,
        bytes: vec![first_part; 100],
    }
}

pub fn view(x: f64) -> View {
    View {
        eye_m: [x, 0.0, 100.0],
        direction: [0.0, 1.0, 0.0],
        velocity_m_s: [0.0; 3],
        fov_y: 1.0,
        viewport_px: [640, 480],
        max_screen_error_px: 2.0,
    }
}

pub fn manifest(generation: u64) -> Manifest {
    Manifest {
        format: FORMAT.into(),
        version: VERSION,
        generation,
        grid_levels: GridLevels::new(16).unwrap(),
        samples: [4097, 4097],
        valid_samples: 1,
        height_range: Some([0, 100]),
        georef: Georef {
            origin_m: [0.0; 2],
            sample_spacing_m: [1.0; 2],
            quantum_m: 0.1,
            plane: Plane::Local,
        },
        storage_error_m: 0.05,
        codec: 0,
        pages: 1,
        segments: vec![],
        index: FileCheck {
            bytes: 1,
            crc32c: 1,
        },
        sources: vec![],
        vertical: None,
        scale_error_percent: None,
        resampling: None,
        filled: None,
        tolerances: Vec::new(),
    }
}

pub fn welcome(generation: u64) -> ServerMessage {
    ServerMessage::Welcome(Welcome {
        version: PROTOCOL,
        capabilities: 0,
        manifest: manifest(generation).to_json(),
        limits: SessionLimits {
            wanted_pages: 4096,
            views_per_second: 20,
            held_pages: 4096,
        },
    })
}

/// The same of a server that pushes.
pub fn push_welcome(generation: u64) -> ServerMessage {
    let ServerMessage::Welcome(welcome) = welcome(generation) else {
        unreachable!()
    };
    ServerMessage::Welcome(Welcome {
        capabilities: capability::PUSH,
        ..welcome
    })
}

pub fn gen_change(generation: u64) -> ServerMessage {
    ServerMessage::GenChange {
        generation,
        manifest: manifest(generation).to_json(),
    }
}

pub fn refusal(code: ErrorCode) -> ServerMessage {
    let text = "because".to_owned();
    ServerMessage::Error(PeerError { code, text })
}

/// The messages that a link sends now.
pub fn said(link: &mut Link, now: Duration) -> Vec<ClientMessage> {
    let bytes = std::iter::from_fn(|| link.poll_transmit(now));
    bytes
        .map(|bytes| ClientMessage::decode(&bytes).unwrap())
        .collect()
}

pub fn events(link: &mut Link) -> Vec<Event> {
    std::iter::from_fn(|| link.poll_event()).collect()
}

pub fn tell(link: &mut Link, message: &ServerMessage, now: Duration) {
    link.handle_message(&message.encode(), now).unwrap();
}

/// A link whose session has just opened, with nothing left to say or to take.
pub fn open_link(config: LinkConfig) -> Link {
    opened(config, &welcome(1))
}

/// The same with a server that pushes.
pub fn push_link(config: LinkConfig) -> Link {
    opened(config, &push_welcome(1))
}

fn opened(config: LinkConfig, welcome: &ServerMessage) -> Link {
    let mut link = Link::new(config);
    assert!(link.poll_connect(ms(0)));
    link.on_connected(ms(0));
    said(&mut link, ms(0));
    tell(&mut link, welcome, ms(0));
    said(&mut link, ms(0));
    events(&mut link);
    link
}

/// What the server's side of a session knows.
#[derive(Default)]
pub struct Server {
    pub generation: u64,
    pub wanted: BTreeMap<u64, Want>,
    pub have: Vec<Have>,
    pub views: Vec<u32>,
    pub credit: u64,
    pub sent: u64,
    pub greeted: bool,
    /// Pages sent, in order, over all sessions.
    pub log: Vec<u64>,
    /// Parts sent in one chunk.
    pub parts_a_chunk: u8,
    pub silent: bool,
}

impl Server {
    pub fn new() -> Server {
        Server {
            generation: 1,
            parts_a_chunk: 6,
            ..Server::default()
        }
    }

    /// Forgets the session.
    pub fn drop_session(&mut self) {
        let old = std::mem::take(self);
        *self = Server {
            generation: old.generation,
            log: old.log,
            parts_a_chunk: old.parts_a_chunk,
            ..Server::default()
        };
    }

    /// Of all its pages.
    fn revision(&self) -> u32 {
        6 + self.generation as u32
    }

    fn hear(&mut self, message: ClientMessage) -> Option<ServerMessage> {
        assert_eq!(
            matches!(message, ClientMessage::Hello(_)),
            !self.greeted,
            "{message:?}"
        );
        match message {
            ClientMessage::Hello(hello) => {
                self.greeted = true;
                self.credit = hello.credit_bytes;
                return Some(welcome(self.generation));
            }
            ClientMessage::Want(wants) => {
                self.wanted
                    .extend(wants.into_iter().map(|want| (want.page, want)));
            }
            ClientMessage::Cancel(pages) => self.wanted.retain(|page, _| !pages.contains(page)),
            ClientMessage::Credit { total_bytes } => {
                assert!(total_bytes > self.credit, "a grant that does not rise");
                self.credit = total_bytes;
            }
            ClientMessage::Have(have) => {
                let stale = have.iter().filter(|have| have.revision != self.revision());
                let stale = stale.map(|have| have.page).collect();
                self.have.extend(have);
                return Some(ServerMessage::Stale(stale));
            }
            ClientMessage::View { sequence, .. } => self.views.push(sequence),
            ClientMessage::Ping(number) => return Some(ServerMessage::Pong(number)),
            ClientMessage::Evict(_) | ClientMessage::Error(_) => {}
        }
        None
    }

    /// The most urgent parts, if the credit allows.
    fn push(&mut self) -> Option<ServerMessage> {
        let urgency = |a: &&Want, b: &&Want| {
            a.class
                .cmp(&b.class)
                .then(b.priority.total_cmp(&a.priority))
        };
        let want = *self.wanted.values().min_by(urgency)?;
        let last = want.last_part.min(want.first_part + self.parts_a_chunk - 1);
        let chunk = Chunk {
            page: want.page,
            revision: self.revision(),
            first_part: want.first_part,
            last_part: last,
            bytes: vec![0; 1000],
        };
        if self.sent + 1000 > self.credit {
            return None;
        }
        self.sent += 1000;
        self.log.push(want.page);
        match last == want.last_part {
            true => drop(self.wanted.remove(&want.page)),
            false => self.wanted.get_mut(&want.page)?.first_part = last + 1,
        }
        Some(ServerMessage::Pages(vec![chunk]))
    }
}

/// A link and a server with a line of constant delay between them.
pub struct World {
    pub link: Link,
    pub server: Server,
    pub now: Duration,
    pub delay: Duration,
    to_server: VecDeque<(Duration, Vec<u8>)>,
    to_client: VecDeque<(Duration, Vec<u8>)>,
    pub events: Vec<Event>,
    /// Whether attempts to connect succeed.
    pub reachable: bool,
}

impl World {
    pub fn new(config: LinkConfig) -> World {
        World {
            link: Link::new(config),
            server: Server::new(),
            now: ms(0),
            delay: ms(50),
            to_server: VecDeque::new(),
            to_client: VecDeque::new(),
            events: Vec::new(),
            reachable: true,
        }
    }

    /// The line breaks, with all that is on it.
    pub fn cut(&mut self) {
        self.to_server.clear();
        self.to_client.clear();
        self.server.drop_session();
        self.link.on_disconnected(self.now, "cut");
    }

    /// Ten milliseconds: the server may send one chunk.
    pub fn step(&mut self) {
        self.now += ms(10);
        self.run_server();
        while let Some(bytes) = arrived(&mut self.to_client, self.now) {
            self.link.handle_message(&bytes, self.now).unwrap();
        }
        self.link.handle_timeout(self.now);
        if self.link.poll_connect(self.now) {
            match self.reachable {
                true => self.link.on_connected(self.now),
                false => self.link.on_disconnected(self.now, "no server"),
            }
        }
        while let Some(bytes) = self.link.poll_transmit(self.now) {
            self.to_server.push_back((self.now + self.delay, bytes));
        }
        self.events.extend(events(&mut self.link));
    }

    fn run_server(&mut self) {
        while let Some(bytes) = arrived(&mut self.to_server, self.now) {
            let answer = self.server.hear(ClientMessage::decode(&bytes).unwrap());
            self.answer(answer);
        }
        let chunk = self.server.push();
        self.answer(chunk);
    }

    fn answer(&mut self, message: Option<ServerMessage>) {
        if let Some(message) = message.filter(|_| !self.server.silent) {
            self.to_client
                .push_back((self.now + self.delay, message.encode()));
        }
    }

    /// Steps until the condition holds.
    pub fn run_until(&mut self, what: &str, mut done: impl FnMut(&mut World) -> bool) {
        for _ in 0..100_000 {
            if done(self) {
                return;
            }
            self.step();
        }
        panic!("never: {what}");
    }

    /// Pages that came in whole, in order.
    pub fn complete(&self) -> Vec<u64> {
        let last = |event: &Event| match event {
            Event::Chunk(chunk) if chunk.last_part == 5 => Some(chunk.page),
            _ => None,
        };
        self.events.iter().filter_map(last).collect()
    }
}

fn arrived(line: &mut VecDeque<(Duration, Vec<u8>)>, now: Duration) -> Option<Vec<u8>> {
    let due = line.front().is_some_and(|(at, _)| *at <= now);
    due.then(|| line.pop_front())
        .flatten()
        .map(|(_, bytes)| bytes)
}
