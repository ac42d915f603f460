//! A session after its Hello: wishes in, pages out.

use super::cache::CacheModel;
use super::chunk::{PAGES_OVERHEAD, chunk_of, encoded_len};
use super::queue::WantQueue;
use super::views::ViewGate;
use crate::limits::{LOOKUPS_PER_FRAME, Limits};
use crate::source::PageSource;
use escarp_proto::geometry::PageId;
use escarp_proto::wire::{
    Chunk, ClientMessage, ErrorCode, Have, Hello, Miss, MissReason, PAGES_FRAME, PROTOCOL,
    PeerError, ServerMessage, SessionLimits, Want, Welcome,
};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

/// A message that waits to be sent, small: Welcome's manifest is added when it goes.
#[derive(Debug)]
enum Reply {
    Welcome,
    Miss(Miss),
    Pong(u64),
}

/// The part of a session that exists between Hello and its end.
pub(super) struct Open {
    source: Arc<dyn PageSource>,
    announced: SessionLimits,
    replies: VecDeque<Reply>,
    pub(super) queue: WantQueue,
    pub(super) views: ViewGate,
    pub(super) cache: CacheModel,
    allowed_bytes: u64,
    sent_bytes: u64,
    /// The first wish does not fit the credit; nothing goes until either changes.
    stalled: bool,
    /// An Idle is due when the queue runs empty.
    idle_owed: bool,
}

impl Open {
    pub(super) fn new(source: Arc<dyn PageSource>, hello: &Hello, limits: &Limits) -> Open {
        Open {
            source,
            announced: SessionLimits {
                wanted_pages: u32::try_from(limits.wanted_pages).unwrap_or(u32::MAX),
                views_per_second: limits.views_per_second,
                held_pages: u32::try_from(limits.cached_pages).unwrap_or(u32::MAX),
            },
            replies: VecDeque::from([Reply::Welcome]),
            queue: WantQueue::new(limits.wanted_pages),
            views: ViewGate::new(limits.views_per_second),
            cache: CacheModel::new(limits.cached_pages),
            allowed_bytes: hello.credit_bytes,
            sent_bytes: 0,
            stalled: false,
            idle_owed: false,
        }
    }

    /// Replies that wait.
    pub(super) fn replies(&self) -> usize {
        self.replies.len()
    }

    /// Handles one message.
    ///
    /// # Errors
    /// What to end the session with.
    pub(super) fn handle(
        &mut self,
        message: ClientMessage,
        now: Duration,
    ) -> Result<(), PeerError> {
        match message {
            ClientMessage::Hello(_) => return Err(protocol("a second Hello")),
            // The session has ended before an Error gets here.
            ClientMessage::Error(_) => {}
            ClientMessage::View { sequence, view, .. } => {
                view.check()
                    .map_err(|error| protocol(format!("View {sequence}: {error}")))?;
                if !self.views.receive((sequence, view)) {
                    return Err(protocol(format!(
                        "View {sequence} does not follow its forerunner"
                    )));
                }
                self.advance(now);
            }
            ClientMessage::Want(wants) => wants.iter().for_each(|want| self.want(want)),
            ClientMessage::Cancel(keys) => self.cancel(&keys)?,
            ClientMessage::Credit { total_bytes } => self.credit(total_bytes)?,
            ClientMessage::Have(haves) => self.have(&haves)?,
            ClientMessage::Evict(keys) => {
                for key in keys {
                    self.cache.evict(page_of(key)?);
                }
            }
            ClientMessage::Ping(number) => self.replies.push_back(Reply::Pong(number)),
        }
        Ok(())
    }

    /// Looks at a waiting view if its time has come.
    pub(super) fn advance(&mut self, now: Duration) {
        self.idle_owed |= self.views.advance(now);
    }

    fn want(&mut self, want: &Want) {
        self.idle_owed = true;
        self.stalled = false;
        let levels = self.source.manifest().grid_levels;
        let page = want.page_id().filter(|&page| levels.holds(page));
        match page {
            Some(page) if want.first_part <= want.last_part => {
                if !self.queue.insert(page, want) {
                    self.miss(want.page, MissReason::Busy);
                }
            }
            _ => self.miss(want.page, MissReason::NotFound),
        }
    }

    fn miss(&mut self, page: u64, reason: MissReason) {
        self.replies.push_back(Reply::Miss(Miss { page, reason }));
    }

    fn cancel(&mut self, keys: &[u64]) -> Result<(), PeerError> {
        self.stalled = false;
        for &key in keys {
            // A wish for what is no page was answered by Miss; to cancel it is no error.
            if let Some(page) = PageId::from_key(key) {
                self.queue.remove(page);
            }
        }
        Ok(())
    }

    fn credit(&mut self, total_bytes: u64) -> Result<(), PeerError> {
        if total_bytes < self.allowed_bytes {
            let had = self.allowed_bytes;
            return Err(protocol(format!(
                "Credit falls from {had} to {total_bytes} bytes"
            )));
        }
        self.allowed_bytes = total_bytes;
        self.stalled = false;
        Ok(())
    }

    fn have(&mut self, haves: &[Have]) -> Result<(), PeerError> {
        for have in haves {
            self.cache.have(page_of(have.page)?, *have);
        }
        Ok(())
    }

    /// The next message that needs no record.
    pub(super) fn poll_control(&mut self) -> Option<ServerMessage> {
        if let Some(reply) = self.replies.pop_front() {
            return Some(match reply {
                Reply::Welcome => ServerMessage::Welcome(self.welcome()),
                Reply::Miss(miss) => ServerMessage::Miss(miss),
                Reply::Pong(number) => ServerMessage::Pong(number),
            });
        }
        let idle = self.idle_owed && self.queue.is_empty();
        self.idle_owed &= !idle;
        idle.then(|| ServerMessage::Idle {
            view_sequence: self.views.current().map_or(0, |(sequence, _)| sequence),
        })
    }

    fn welcome(&self) -> Welcome {
        Welcome {
            version: PROTOCOL,
            capabilities: 0,
            manifest: self.source.manifest_json().to_vec(),
            limits: self.announced,
        }
    }

    /// Whether there may be pages to send.
    pub(super) fn has_pages(&self) -> bool {
        !self.queue.is_empty() && !self.stalled
    }

    /// Fills a frame with the most urgent chunks. The order is strict: a chunk that does not fit
    /// ends the frame, and one that exceeds the credit waits, so that large pages do not starve.
    pub(super) fn poll_pages(&mut self) -> Option<ServerMessage> {
        let mut room = PAGES_FRAME - PAGES_OVERHEAD;
        let mut chunks = Vec::new();
        for _ in 0..LOOKUPS_PER_FRAME {
            let Some(wish) = self.queue.first().filter(|_| !self.stalled) else {
                break;
            };
            match chunk_of(self.source.as_ref(), wish) {
                Err(reason) => {
                    self.queue.remove(wish.page);
                    self.miss(wish.page.key(), reason);
                }
                Ok(chunk) if self.left_bytes() < chunk.bytes.len() as u64 => self.stalled = true,
                Ok(chunk) if encoded_len(&chunk) > room => break,
                Ok(chunk) => {
                    room -= encoded_len(&chunk);
                    self.queue.remove(wish.page);
                    self.spend(wish.page, &chunk);
                    chunks.push(chunk);
                }
            }
        }
        (!chunks.is_empty()).then_some(ServerMessage::Pages(chunks))
    }

    fn left_bytes(&self) -> u64 {
        self.allowed_bytes - self.sent_bytes
    }

    fn spend(&mut self, page: PageId, chunk: &Chunk) {
        self.sent_bytes += chunk.bytes.len() as u64;
        debug_assert!(self.sent_bytes <= self.allowed_bytes);
        self.cache.sent(page, chunk);
    }
}

fn page_of(key: u64) -> Result<PageId, PeerError> {
    PageId::from_key(key).ok_or_else(|| protocol(format!("{key:#x} is no page's key")))
}

fn protocol(text: impl Into<String>) -> PeerError {
    PeerError::new(ErrorCode::Protocol, text)
}
