//! A remote terrain whose server is in the same thread: every step brings some messages, in an
//! order that does not change, and the server can publish anew in between.

use crate::liar;
use escarp_client::link::{Link, LinkConfig};
use escarp_client::net::Carrier;
use escarp_client::remote::{ClientOptions, RemoteTerrain};
use escarp_proto::geometry::PageId;
use escarp_proto::wire::{
    ClientMessage, Have, PROTOCOL, ServerMessage, SessionLimits, Want, Welcome,
};
use escarp_tiles::dataset::Dataset;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

/// What the server knows, and has done.
pub struct Served {
    dataset: Arc<Dataset>,
    wants: BTreeMap<u64, Want>,
    replies: VecDeque<ServerMessage>,
    idle_owed: bool,
    view: u32,
    credit: u64,
    sent: u64,
    /// Chunks that it sends a step.
    pub chunks_a_step: usize,
    /// How often a part of a revision of a page was sent.
    pub parts_sent: HashMap<(u64, u32, u8), u32>,
    /// Whether the line stands.
    pub connected: bool,
}

impl Served {
    fn new(dataset: Dataset) -> Served {
        Served {
            dataset: Arc::new(dataset),
            wants: BTreeMap::new(),
            replies: VecDeque::new(),
            idle_owed: false,
            view: 0,
            credit: 0,
            sent: 0,
            chunks_a_step: 3,
            parts_sent: HashMap::new(),
            connected: true,
        }
    }

    /// The data is another from here on.
    pub fn publish(&mut self, dataset: Dataset) {
        self.dataset = Arc::new(dataset);
        self.wants.clear();
        (self.view, self.idle_owed) = (0, false);
        self.replies.push_back(ServerMessage::GenChange {
            generation: self.dataset.manifest().generation,
            manifest: self.dataset.manifest_json().to_vec(),
        });
    }

    fn hear(&mut self, message: ClientMessage) {
        match message {
            ClientMessage::Hello(hello) => {
                self.wants.clear();
                (self.credit, self.sent) = (hello.credit_bytes, 0);
                (self.view, self.idle_owed) = (0, false);
                self.replies = VecDeque::from([self.welcome()]);
            }
            ClientMessage::View { sequence, .. } => (self.view, self.idle_owed) = (sequence, true),
            ClientMessage::Want(wants) => {
                self.idle_owed = true;
                self.wants
                    .extend(wants.iter().map(|want| (want.page, *want)));
            }
            ClientMessage::Cancel(pages) => self.wants.retain(|page, _| !pages.contains(page)),
            ClientMessage::Credit { total_bytes } => self.credit = total_bytes,
            ClientMessage::Have(haves) => {
                let stale = haves.iter().filter(|have| !self.is_current(have));
                let stale = stale.map(|have| have.page).collect();
                self.replies.push_back(ServerMessage::Stale(stale));
            }
            ClientMessage::Ping(number) => self.replies.push_back(ServerMessage::Pong(number)),
            ClientMessage::Evict(_) | ClientMessage::Error(_) => {}
        }
    }

    fn welcome(&self) -> ServerMessage {
        ServerMessage::Welcome(Welcome {
            version: PROTOCOL,
            capabilities: 0,
            manifest: self.dataset.manifest_json().to_vec(),
            limits: SessionLimits {
                wanted_pages: 1024,
                views_per_second: 20,
                held_pages: 1 << 20,
            },
        })
    }

    fn is_current(&self, have: &Have) -> bool {
        let page = PageId::from_key(have.page).filter(|&page| self.dataset.grid().holds(page));
        let record = page.and_then(|page| self.dataset.record(page).ok().flatten());
        record.is_some_and(|record| record.revision == have.revision)
    }

    /// The next message: replies, then chunks as urgency and credit allow, then Idle.
    fn next(&mut self, chunks: &mut usize) -> Option<ServerMessage> {
        if let Some(reply) = self.replies.pop_front() {
            return Some(reply);
        }
        let first = self.wants.values().min_by(|a, b| {
            let priority = b.priority.total_cmp(&a.priority);
            a.class.cmp(&b.class).then(priority)
        });
        let Some(&want) = first else {
            return std::mem::take(&mut self.idle_owed).then_some(ServerMessage::Idle {
                view_sequence: self.view,
            });
        };
        if *chunks == 0 {
            return None;
        }
        let chunk = liar::chunk(&self.dataset, &want).expect("a page that there is");
        if self.sent + chunk.bytes.len() as u64 > self.credit {
            return None;
        }
        *chunks -= 1;
        self.sent += chunk.bytes.len() as u64;
        self.wants.remove(&want.page);
        for part in chunk.first_part..=chunk.last_part {
            let sent = self.parts_sent.entry((chunk.page, chunk.revision, part));
            *sent.or_insert(0) += 1;
        }
        Some(ServerMessage::Pages(vec![chunk]))
    }
}

struct Wire(Arc<Mutex<Served>>);

impl Carrier for Wire {
    fn drive(&mut self, link: &mut Link, now: Duration) {
        let mut served = self.0.lock().expect("one thread");
        link.handle_timeout(now);
        if !served.connected {
            link.on_disconnected(now, "cut");
            return;
        }
        if link.poll_connect(now) {
            link.on_connected(now);
        }
        while let Some(bytes) = link.poll_transmit(now) {
            let message = ClientMessage::decode(&bytes).expect("a message");
            served.hear(message);
        }
        let mut chunks = served.chunks_a_step;
        while link.has_socket()
            && let Some(message) = served.next(&mut chunks)
        {
            let taken = link.handle_message(&message.encode(), now);
            taken.expect("an honest server");
        }
    }
}

/// A client and its server.
pub struct Carried {
    /// The client.
    pub client: RemoteTerrain,
    served: Arc<Mutex<Served>>,
    /// The time, since the client's start.
    pub now: Duration,
}

impl Carried {
    /// A client that has not connected yet.
    pub fn new(dataset: Dataset, options: ClientOptions) -> Carried {
        let served = Arc::new(Mutex::new(Served::new(dataset)));
        let wire = Box::new(Wire(Arc::clone(&served)));
        Carried {
            client: RemoteTerrain::over(wire, LinkConfig::new(""), options),
            served,
            now: Duration::ZERO,
        }
    }

    /// The server.
    ///
    /// # Panics
    /// If a step has panicked.
    pub fn served(&self) -> MutexGuard<'_, Served> {
        self.served.lock().expect("one thread")
    }
}
