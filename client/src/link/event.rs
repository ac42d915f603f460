//! What a link tells its caller: events, errors, figures.

use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;
use escarp_proto::wire::{Chunk, ErrorCode, MAX_TEXT, Miss, WireError};
use std::collections::VecDeque;
use std::mem::discriminant;
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;

/// What happened.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// A session is open.
    Welcome {
        /// What the dataset is.
        manifest: Arc<Manifest>,
        /// The manifest is the first one, or differs from the last one: as with
        /// [`GenChange`](Event::GenChange).
        changed: bool,
    },
    /// Parts of a page, wanted or pushed, that continue what was delivered of it.
    Chunk(Chunk),
    /// A page that was wanted and does not come in this session: not found, or damaged.
    Miss(Miss),
    /// The server has nothing queued or in flight.
    Idle {
        /// The newest View that it knew then, or 0; see [`view_sequence`].
        ///
        /// [`view_sequence`]: super::Link::view_sequence
        view_sequence: u32,
    },
    /// The data has a new generation: chunks from here on are of it, and may not be mixed with
    /// pages of before. Which of these it has, too, [`Confirmed`](Event::Confirmed) tells.
    GenChange {
        /// What the dataset is now.
        manifest: Arc<Manifest>,
    },
    /// After a changed manifest: which pages of before are pages of the new generation, unchanged;
    /// others are not.
    Confirmed {
        /// Those that the link [held](super::Link::holds) when it heard that. By now it may be told
        /// of another generation, which is a later event.
        same: Vec<PageId>,
    },
    /// The server ended the session, and said why.
    Refused {
        /// It would do so again, so the link does not connect any more.
        fatal: bool,
        /// Why, for programs.
        code: ErrorCode,
        /// Why, for people, without control characters but line ends. For
        /// [`ErrorCode::NoDataset`]: the names of the datasets there are, one a line.
        text: String,
    },
    /// The connection was lost, or did not come about. It is tried again.
    Disconnected {
        /// Why, for people.
        text: String,
        /// When it is tried again, since program start.
        retry_at: Duration,
    },
}

impl Event {
    /// Page bytes that it carries.
    pub(super) fn page_bytes(&self) -> u64 {
        match self {
            Event::Chunk(chunk) => chunk.bytes.len() as u64,
            _ => 0,
        }
    }
}

/// Why a session was given up.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum LinkError {
    /// Not a message.
    #[error("from the server: {0}")]
    Wire(#[from] WireError),
    /// Welcome carries no valid manifest.
    #[error("in Welcome: {0}")]
    Manifest(String),
    /// GenChange carries no valid manifest.
    #[error("in GenChange: {0}")]
    Generation(String),
    /// Welcome chose a version that was not offered.
    #[error("in Welcome: protocol version {found}, allowed is {allowed}")]
    Version {
        /// What it says.
        found: u16,
        /// What was offered.
        allowed: u16,
    },
    /// A message that may not come now.
    #[error("from the server: {message} may not come {when}")]
    Order {
        /// Its name.
        message: &'static str,
        /// What the session was at.
        when: &'static str,
    },
}

/// Figures of a link, since it was made if not said otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LinkStats {
    /// Length of all messages received, bytes.
    pub received_bytes: u64,
    /// Page bytes among them, also those dropped.
    pub page_bytes: u64,
    /// Length of all messages sent, bytes.
    pub sent_bytes: u64,
    /// Pages asked for and not here yet, now.
    pub in_flight_pages: usize,
    /// Chunks and misses that wait for [`poll_event`](super::Link::poll_event), now.
    pub waiting_events: usize,
    /// Pages of which the link delivered parts that were not evicted since, now.
    pub held_pages: usize,
    /// Round trip, smoothed, from Ping to Pong, in this session or the last one.
    pub round_trip_ms: Option<f64>,
    /// Sessions opened.
    pub sessions: u64,
    /// Times the connection was lost, or did not come about.
    pub disconnects: u64,
    /// Chunks that were not asked for, or do not fit what is here.
    pub dropped_chunks: u64,
    /// Chunks taken that were not asked for.
    pub pushed_chunks: u64,
    /// Pages that were asked for once more, as nothing came.
    pub asked_again: u64,
    /// Times the server was too busy for a page.
    pub busy: u64,
}

impl LinkStats {
    /// Sessions opened after the first.
    pub const fn reconnects(&self) -> u64 {
        self.sessions.saturating_sub(1)
    }
}

/// Events not yet taken. Bounded: of events about pages there are only those that were in flight,
/// and of each other kind the newest.
#[derive(Debug, Default)]
pub(super) struct Events {
    queue: VecDeque<Event>,
    pages: usize,
}

impl Events {
    /// Adds a chunk or a miss.
    pub(super) fn push_page(&mut self, event: Event) {
        self.pages += 1;
        self.queue.push_back(event);
    }

    /// Adds an event of another kind, in place of an older one of that kind.
    pub(super) fn push_latest(&mut self, event: Event) {
        self.queue
            .retain(|old| discriminant(old) != discriminant(&event) || is_change(old));
        self.queue.push_back(event);
    }

    /// Adds the news of a changed manifest. If the caller has not taken an older one, it never
    /// hears of what came in between: chunks of a generation that it skips. Their pages and first
    /// parts.
    pub(super) fn push_generation(&mut self, event: Event) -> Vec<Chunk> {
        let skipped = match self.queue.iter().position(is_change) {
            Some(at) => self.queue.split_off(at),
            None => VecDeque::new(),
        };
        self.queue.push_back(event);
        self.count_pages();
        let chunks = skipped.into_iter().filter_map(|event| match event {
            Event::Chunk(chunk) => Some(chunk),
            _ => None,
        });
        chunks.collect()
    }

    fn count_pages(&mut self) {
        let pages = self.queue.iter().filter(|event| page_of(event).is_some());
        self.pages = pages.count();
    }

    pub(super) fn pop(&mut self) -> Option<Event> {
        let event = self.queue.pop_front()?;
        if page_of(&event).is_some() {
            self.pages -= 1;
        }
        Some(event)
    }

    /// Chunks and misses not yet taken.
    pub(super) fn pages(&self) -> usize {
        self.pages
    }

    /// Drops the events about the pages that `which` names. Page bytes among them.
    pub(super) fn forget_pages(&mut self, which: impl Fn(u64) -> bool) -> u64 {
        let mut bytes = 0;
        if self.pages > 0 {
            self.queue.retain(|event| {
                let keep = !page_of(event).is_some_and(&which);
                bytes += if keep { 0 } else { event.page_bytes() };
                keep
            });
            self.count_pages();
        }
        bytes
    }

    #[cfg(test)]
    pub(super) fn len(&self) -> usize {
        self.queue.len()
    }
}

/// Whether what follows is of another generation than what was before.
fn is_change(event: &Event) -> bool {
    matches!(
        event,
        Event::Welcome { changed: true, .. } | Event::GenChange { .. }
    )
}

fn page_of(event: &Event) -> Option<u64> {
    match event {
        Event::Chunk(chunk) => Some(chunk.page),
        Event::Miss(miss) => Some(miss.page),
        _ => None,
    }
}

/// A peer's text made fit for a terminal: bounded, and without control characters but line ends.
pub(super) fn tame(text: &str) -> String {
    let clean = |c: char| if c.is_control() && c != '\n' { ' ' } else { c };
    text.chars().take(MAX_TEXT).map(clean).collect()
}
