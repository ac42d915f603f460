//! The session's core under virtual time, on a fake dataset.

mod end;
mod example;
mod hostile;
mod order;
mod push;
mod time;
mod wants;

use super::*;
use crate::source::PageSource;
use crate::tests::fake::FakeSource;
use escarp_proto::page::revision;
use escarp_proto::wire::{Chunk, Class, Have, Miss, Scope, Want, capability};
use std::sync::LazyLock;

/// One for all tests: its records are made once.
pub(super) static SOURCE: LazyLock<Arc<FakeSource>> = LazyLock::new(|| Arc::new(FakeSource::new()));

pub(super) const SECOND: Duration = Duration::from_secs(1);

/// A session and what a client would do with it.
pub(super) struct Peer {
    pub session: Session,
    pub now: Duration,
}

pub(super) fn hello(credit_bytes: u64) -> Hello {
    Hello {
        oldest: escarp_proto::wire::PROTOCOL,
        newest: escarp_proto::wire::PROTOCOL,
        capabilities: 0,
        codecs: 1,
        dataset: "fake".into(),
        credit_bytes,
        token: None,
    }
}

pub(super) fn have(page: PageId, parts: u8) -> Have {
    Have {
        page: page.key(),
        revision: revision(page, &SOURCE.stored(page)),
        parts,
    }
}

pub(super) fn want(page: PageId, class: Class, priority: f32) -> Want {
    Want {
        page: page.key(),
        first_part: 0,
        last_part: 5,
        class,
        priority,
    }
}

/// The stored pages of the middle level.
pub(super) fn stored_pages() -> Vec<PageId> {
    let places = (0..16).flat_map(|y| (0..13).map(move |x| (x, y)));
    places.map(|(x, y)| PageId::new(4, x, y).unwrap()).collect()
}

pub(super) fn view() -> View {
    View {
        eye_m: [0.0, 0.0, 100.0],
        direction: [0.0, 1.0, 0.0],
        velocity_m_s: [0.0; 3],
        fov_y: 1.0,
        viewport_px: [1280, 720],
        max_screen_error_px: 2.0,
    }
}

impl Peer {
    /// Before Hello.
    pub fn new(limits: Limits) -> Peer {
        let catalog = Catalog::default();
        catalog.add("fake", SOURCE.clone()).unwrap();
        Peer::of(catalog, limits)
    }

    pub fn of(catalog: Catalog, limits: Limits) -> Peer {
        Peer {
            session: Session::new(Arc::new(catalog), limits),
            now: Duration::ZERO,
        }
    }

    /// After Welcome.
    pub fn open(credit_bytes: u64) -> Peer {
        Peer::open_with(credit_bytes, Limits::default())
    }

    pub fn open_with(credit_bytes: u64, limits: Limits) -> Peer {
        let mut peer = Peer::new(limits);
        peer.say(ClientMessage::Hello(hello(credit_bytes)));
        assert!(matches!(peer.hear(), Some(ServerMessage::Welcome(_))));
        peer
    }

    /// After Welcome, with what a View needs sent unasked.
    pub fn pushed(credit_bytes: u64, limits: Limits) -> Peer {
        let mut peer = Peer::new(limits);
        peer.say(ClientMessage::Hello(Hello {
            capabilities: capability::PUSH,
            ..hello(credit_bytes)
        }));
        let Some(ServerMessage::Welcome(welcome)) = peer.hear() else {
            panic!("no welcome")
        };
        assert_eq!(welcome.capabilities, capability::PUSH);
        peer
    }

    pub fn look(&mut self, sequence: u32, view: View) {
        self.say(ClientMessage::View {
            sequence,
            view,
            scope: Scope::All,
        });
    }

    pub fn say(&mut self, message: ClientMessage) {
        self.session.handle_message(&message.encode(), self.now);
    }

    pub fn hear(&mut self) -> Option<ServerMessage> {
        let bytes = self.session.poll_message()?;
        Some(ServerMessage::decode(&bytes).unwrap())
    }

    pub fn hear_all(&mut self) -> Vec<ServerMessage> {
        std::iter::from_fn(|| self.hear()).collect()
    }

    /// Everything that comes, sorted by kind.
    pub fn harvest(&mut self) -> Harvest {
        let mut harvest = Harvest::default();
        for message in self.hear_all() {
            match message {
                ServerMessage::Pages(chunks) => harvest.chunks.extend(chunks),
                ServerMessage::Miss(miss) => harvest.misses.push(miss),
                ServerMessage::Idle { view_sequence } => harvest.idles.push(view_sequence),
                ServerMessage::Error(error) => harvest.errors.push(error),
                other => panic!("{other:?}"),
            }
        }
        harvest
    }

    /// Lets time pass, and does what is due.
    pub fn pass(&mut self, time: Duration) {
        self.now += time;
        self.session.handle_timeout(self.now);
    }
}

#[derive(Debug, Default)]
pub(super) struct Harvest {
    pub chunks: Vec<Chunk>,
    pub misses: Vec<Miss>,
    pub idles: Vec<u32>,
    pub errors: Vec<PeerError>,
}
