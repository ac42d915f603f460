//! A session after its Hello: views and wishes in, pages out.

use super::ahead::Ahead;
use super::chunk::{PAGES_OVERHEAD, arranged, chunk_of, encoded_len, frame_bytes};
use super::cover::{self, Cover};
use super::held::Held;
use super::push::{Piece, Pushes};
use super::queue::{WantQueue, Wish};
use super::stats::SessionStats;
use super::views::ViewGate;
use crate::limits::{LOOKUPS_PER_FRAME, Limits};
use crate::published::Published;
use escarp_proto::geometry::PageId;
use escarp_proto::page::MAX_RECORD_BYTES;
use escarp_proto::select::Look;
use escarp_proto::view::View;
use escarp_proto::wire::{
    Chunk, Class, ClientMessage, ErrorCode, Have, Hello, Miss, MissReason, PROTOCOL, PeerError,
    Scope, ServerMessage, SessionLimits, Want, Welcome, capability,
};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

/// After a selection, so many times as long as it took none is made,
const SELECTION_REST: u32 = 4;
/// but no longer than this.
const LONGEST_REST: Duration = Duration::from_millis(250);

/// A message that waits to be sent, small: manifests are added when it goes.
#[derive(Debug)]
enum Reply {
    Welcome,
    GenChange,
    Miss(Miss),
    Pong(u64),
}

/// Where the next parts come from.
#[derive(Debug, Clone, Copy)]
enum Next {
    Wanted(Wish),
    Pushed(Piece),
}

/// The part of a session that exists between Hello and its end.
pub(super) struct Open {
    published: Arc<Published>,
    codecs: u32,
    capabilities: u64,
    announced: SessionLimits,
    replies: VecDeque<Reply>,
    /// Said to be held, and not yet looked up.
    haves: VecDeque<Vec<Have>>,
    pub(super) queue: WantQueue,
    pushes: Pushes,
    ahead: Ahead,
    /// Room for pieces.
    most_pieces: usize,
    /// The dataset has changed; what the client says before its next Have is of before.
    awaits_have: bool,
    /// The newest view is not selected for yet, or not to its end.
    select_due: bool,
    /// The newest view may need more than was selected before.
    uncovered: bool,
    /// The selection had no room for all needs.
    unfinished: bool,
    /// The views for which nothing need be selected.
    cover: Option<Cover>,
    /// Bytes sent before the newest selection.
    sent_before: u64,
    pub(super) views: ViewGate,
    pub(super) held: Held,
    allowed_bytes: u64,
    sent_bytes: u64,
    /// The first wish does not fit the credit; nothing goes until either changes.
    stalled: bool,
    /// An Idle is due when the queue runs empty.
    idle_owed: bool,
    stats: SessionStats,
}

impl Open {
    pub(super) fn new(published: Arc<Published>, hello: &Hello, limits: &Limits) -> Open {
        let count = |limit: usize| u32::try_from(limit).unwrap_or(u32::MAX);
        let offered = match limits.pushed_pages {
            0 => capability::KNOWN & !capability::PUSH,
            _ => capability::KNOWN,
        };
        Open {
            published,
            codecs: hello.codecs,
            capabilities: hello.capabilities & offered,
            announced: SessionLimits {
                wanted_pages: count(limits.wanted_pages),
                views_per_second: limits.views_per_second,
                held_pages: count(limits.held_pages),
            },
            replies: VecDeque::from([Reply::Welcome]),
            haves: VecDeque::new(),
            queue: WantQueue::new(limits.wanted_pages),
            pushes: Pushes::default(),
            ahead: Ahead::new(limits.look_ahead),
            most_pieces: limits.pushed_pages,
            awaits_have: false,
            select_due: false,
            uncovered: false,
            unfinished: false,
            cover: None,
            sent_before: 0,
            views: ViewGate::new(limits.views_per_second),
            held: Held::new(limits.held_pages),
            allowed_bytes: hello.credit_bytes,
            sent_bytes: 0,
            stalled: false,
            idle_owed: false,
            stats: SessionStats::default(),
        }
    }

    /// Replies that wait.
    #[cfg(test)]
    pub(super) fn replies(&self) -> usize {
        self.replies.len()
    }

    /// Whether there is room for another message: one list of pages said to be held is looked up
    /// before the next is read.
    pub(super) fn can_receive(&self, limits: &Limits) -> bool {
        self.replies.len() < limits.queued_replies && self.haves.is_empty()
    }

    /// A selection has taken so long: the next one waits, so that selecting takes only a part of the
    /// time, however many sessions there are.
    pub(super) fn selected(&mut self, took: Duration, now: Duration) {
        self.views
            .rest(now + (took * SELECTION_REST).min(LONGEST_REST));
    }

    /// Figures since Hello.
    pub(super) fn stats(&self) -> SessionStats {
        SessionStats {
            waiting: (self.queue.len() + self.pushes.len()) as u64,
            held_pages: self.held.len() as u64,
            is_stalled: self.stalled,
            ..self.stats
        }
    }

    fn pushes(&self) -> bool {
        self.capabilities & capability::PUSH != 0
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
            ClientMessage::View {
                sequence,
                view,
                scope,
            } => self.view(sequence, view, scope, now)?,
            ClientMessage::Want(_) if self.awaits_have => {}
            ClientMessage::Want(wants) => wants.iter().for_each(|want| self.want(want)),
            ClientMessage::Cancel(keys) => self.cancel(&keys)?,
            ClientMessage::Credit { total_bytes } => self.credit(total_bytes)?,
            ClientMessage::Have(haves) => {
                for have in &haves {
                    page_of(have.page)?;
                }
                self.awaits_have = false;
                self.cover = None;
                self.haves.push_back(haves);
            }
            ClientMessage::Evict(keys) => {
                for key in keys {
                    self.held.evict(page_of(key)?);
                }
                if let Some(cover) = &mut self.cover {
                    cover.evicted(now);
                }
            }
            ClientMessage::Ping(number) => self.replies.push_back(Reply::Pong(number)),
        }
        Ok(())
    }

    fn view(
        &mut self,
        sequence: u32,
        view: View,
        scope: Scope,
        now: Duration,
    ) -> Result<(), PeerError> {
        view.check()
            .map_err(|error| protocol(format!("View {sequence}: {error}")))?;
        if !self.views.receive((sequence, view, scope)) {
            return Err(protocol(format!(
                "View {sequence} does not follow its forerunner"
            )));
        }
        match self.awaits_have {
            true => self.views.forget(),
            false => self.advance(now),
        }
        Ok(())
    }

    /// Looks at a waiting view if its time has come.
    pub(super) fn advance(&mut self, now: Duration) {
        if self.views.advance(now) {
            self.stats.views += 1;
            self.idle_owed = true;
            if self.pushes() && !self.is_covered(cover::LEAD_S, now) {
                self.uncovered = !self.is_covered(0.0, now);
                if !self.select_due {
                    self.ahead.turn(now, self.pushes.shows_all());
                }
                self.select_due = true;
            }
        }
    }

    /// Whether the newest selection holds for the view that is looked at, and goes on doing so for
    /// so long.
    fn is_covered(&self, seconds: f64, now: Duration) -> bool {
        let in_order = !self.pushes.is_done();
        let (Some(cover), Some((_, view, scope))) = (&self.cover, self.views.current()) else {
            return false;
        };
        let eye_m = view.eye_after(seconds);
        cover.holds(&View { eye_m, ..view }, scope, in_order, now)
    }

    /// The dataset has been published anew: from here on, all is of that.
    ///
    /// # Errors
    /// What to end the session with, if the client cannot read it.
    pub(super) fn change(&mut self, published: Arc<Published>) -> Result<(), PeerError> {
        if Arc::ptr_eq(&self.published, &published) {
            return Ok(());
        }
        let codec = published.source().manifest().codec;
        if !knows(self.codecs, codec) {
            let text = format!("the new generation needs codec {codec}");
            return Err(PeerError::new(ErrorCode::Version, text));
        }
        // The same generation, opened again: nothing has changed for the client.
        let is_same = published.source().generation_id() == self.published.source().generation_id();
        self.published = published;
        if is_same {
            return Ok(());
        }
        let of_both = |reply: &Reply| matches!(reply, Reply::Welcome | Reply::Pong(_));
        let welcomed = !matches!(self.replies.front(), Some(Reply::Welcome));
        self.replies.retain(of_both);
        // Welcome has the newest manifest when it goes.
        if welcomed {
            self.replies.push_back(Reply::GenChange);
            self.awaits_have = true;
        }
        // Each Have is answered, whatever became of its pages.
        self.queue.clear();
        self.pushes.clear();
        self.held.clear();
        self.views.forget();
        self.cover = None;
        self.select_due = false;
        self.idle_owed = false;
        self.stalled = false;
        Ok(())
    }

    fn want(&mut self, want: &Want) {
        self.idle_owed = true;
        self.stalled = false;
        let levels = self.published.source().manifest().grid_levels;
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

    /// The next message that needs no record.
    pub(super) fn poll_control(&mut self) -> Option<ServerMessage> {
        if let Some(reply) = self.replies.pop_front() {
            return Some(match reply {
                Reply::Welcome => ServerMessage::Welcome(self.welcome()),
                Reply::GenChange => self.gen_change(),
                Reply::Miss(miss) => ServerMessage::Miss(miss),
                Reply::Pong(number) => ServerMessage::Pong(number),
            });
        }
        let idle = self.idle_owed && self.is_done();
        self.idle_owed &= !idle;
        idle.then(|| {
            self.stats.idles += 1;
            ServerMessage::Idle {
                view_sequence: self.views.current().map_or(0, |(sequence, ..)| sequence),
            }
        })
    }

    /// Whether nothing waits but what lies ahead of the view.
    fn is_done(&self) -> bool {
        let selected = !(self.select_due && self.uncovered);
        self.queue.is_empty() && self.pushes.is_done() && selected && self.haves.is_empty()
    }

    fn welcome(&self) -> Welcome {
        Welcome {
            version: PROTOCOL,
            capabilities: self.capabilities,
            manifest: self.published.source().manifest_json().to_vec(),
            limits: self.announced,
        }
    }

    fn gen_change(&self) -> ServerMessage {
        let source = self.published.source();
        ServerMessage::GenChange {
            generation: source.manifest().generation,
            manifest: source.manifest_json().to_vec(),
        }
    }

    /// Whether a selection is due.
    pub(super) fn selects(&self) -> bool {
        self.select_due
    }

    /// Whether there may be records to read: pages to send, or to look up.
    pub(super) fn has_pages(&self) -> bool {
        !self.haves.is_empty() || self.select_due || !self.stalled && self.next().is_some()
    }

    /// The next message that needs records, if there is one after all; or does a part of what
    /// must be done before it.
    pub(super) fn poll_reading(&mut self) -> Option<ServerMessage> {
        if let Some(haves) = self.haves.pop_front() {
            return Some(ServerMessage::Stale(self.have(&haves)));
        }
        if std::mem::take(&mut self.select_due) {
            self.select();
        }
        self.poll_pages()
    }

    /// Notes what the client has. Keys of what is not of the current generation.
    fn have(&mut self, haves: &[Have]) -> Vec<u64> {
        let mut stale = Vec::new();
        for have in haves {
            let page = PageId::from_key(have.page);
            match page.filter(|&page| self.is_current(page, have.revision)) {
                Some(page) => {
                    self.held.insert(page, have.parts);
                }
                None => stale.push(have.page),
            }
        }
        stale
    }

    fn is_current(&self, page: PageId, revision: u32) -> bool {
        let source = self.published.source();
        let holds = source.manifest().grid_levels.holds(page);
        // What cannot be read cannot be compared; the client has it, and may keep it no longer.
        holds
            && source
                .revision(page)
                .is_ok_and(|found| found == Some(revision))
    }

    /// Selects for the newest view, and for where the eye is going.
    fn select(&mut self) {
        let Some((_, view, scope)) = self.views.current() else {
            return;
        };
        let eyes = cover::way(&view, self.pushes.shows_all());
        let Open {
            published,
            pushes,
            held,
            most_pieces,
            ..
        } = self;
        let look = Look {
            view: &view,
            eyes,
            scope,
        };
        let (replaced, lists_all) = published.select(look, |needs, is_all| {
            (pushes.replace(needs, held, *most_pieces), is_all)
        });
        let is_all = replaced.is_all && lists_all;
        self.cover = is_all.then(|| Cover::new(&view, scope, eyes));
        self.stats.cancelled_pieces += replaced.dropped as u64;
        self.stats.selections += 1;
        self.unfinished = !replaced.is_all;
        self.sent_before = self.sent_bytes;
        if let Some(later) = self.ahead.view(&view) {
            let Open {
                published,
                pushes,
                held,
                most_pieces,
                ..
            } = self;
            let look = Look {
                view: &later,
                eyes: cover::stretch(cover::end(&view), later.eye_m),
                scope: Scope::InView,
            };
            published.select(look, |needs, _| {
                pushes.replace_ahead(needs, held, *most_pieces);
            });
        }
        self.stalled = false;
    }

    /// What goes next: wishes of the client and of the server in one order.
    fn next(&self) -> Option<Next> {
        let wanted = self.queue.first();
        // Whether it may go must be known before its length is.
        let ahead = self
            .ahead
            .may_send(self.sent_bytes, MAX_RECORD_BYTES as u64);
        let pushed = self.pushes.first(ahead);
        match (wanted, pushed) {
            (Some((rank, wish)), Some(piece)) => Some(match rank.is_before(piece) {
                true => Next::Wanted(wish),
                false => Next::Pushed(*piece),
            }),
            (Some((_, wish)), None) => Some(Next::Wanted(wish)),
            (None, piece) => piece.copied().map(Next::Pushed),
        }
    }

    /// Fills a frame with the most urgent chunks. The order is strict: a chunk that does not fit
    /// ends the frame, and one that exceeds the credit waits, so that large pages do not starve.
    pub(super) fn poll_pages(&mut self) -> Option<ServerMessage> {
        let mut room = frame_bytes(self.sent_bytes) - PAGES_OVERHEAD;
        let mut chunks = Vec::new();
        for _ in 0..LOOKUPS_PER_FRAME {
            let Some(next) = self.next().filter(|_| !self.stalled) else {
                break;
            };
            let Some(wish) = self.lacking(next) else {
                self.remove(next);
                continue;
            };
            match chunk_of(self.published.source().as_ref(), wish) {
                Err(reason) => {
                    self.remove(next);
                    if let Next::Wanted(_) = next {
                        self.miss(wish.page.key(), reason);
                    }
                }
                Ok(chunk) if self.left_bytes() < chunk.bytes.len() as u64 => {
                    self.stalled = true;
                    self.stats.credit_stalls += 1;
                }
                Ok(chunk) if encoded_len(&chunk) > room && !chunks.is_empty() => break,
                Ok(chunk) => {
                    room = room.saturating_sub(encoded_len(&chunk));
                    self.remove(next);
                    self.spend(next, wish.page, &chunk);
                    chunks.push(chunk);
                }
            }
        }
        // The next selection goes on where this one ended, unless it would find nothing else.
        if self.unfinished && self.pushes.is_done() {
            self.unfinished = false;
            self.select_due = self.sent_bytes > self.sent_before;
            self.uncovered = true;
        }
        (!chunks.is_empty()).then(|| ServerMessage::Pages(arranged(chunks)))
    }

    /// What of the next parts the client has not: nothing of a page that could not be remembered,
    /// if it is not wanted.
    fn lacking(&self, next: Next) -> Option<Wish> {
        let (mut wish, pushed) = match next {
            Next::Wanted(wish) => (wish, false),
            Next::Pushed(piece) => (piece.wish(), true),
        };
        let lacks = self.held.next_part(wish.page);
        // What is pushed goes on from what the client has by now; what is wanted from where the
        // client says, unless that was sent meanwhile.
        wish.first_part = match pushed {
            true => lacks,
            false => wish.first_part.max(lacks),
        };
        let fits = !pushed || self.held.fits(wish.page);
        (fits && wish.first_part <= wish.last_part).then_some(wish)
    }

    fn remove(&mut self, next: Next) {
        match next {
            Next::Wanted(wish) => self.queue.remove(wish.page),
            Next::Pushed(piece) => self.pushes.remove_first(piece.class),
        }
    }

    fn left_bytes(&self) -> u64 {
        self.allowed_bytes - self.sent_bytes
    }

    fn spend(&mut self, next: Next, page: PageId, chunk: &Chunk) {
        let bytes = chunk.bytes.len() as u64;
        if self.held.was_evicted(page) {
            self.stats.repeated_bytes += bytes;
        }
        self.sent_bytes += bytes;
        debug_assert!(self.sent_bytes <= self.allowed_bytes);
        self.held.sent(page, chunk.first_part, chunk.last_part);
        let stats = &mut self.stats;
        stats.pieces += 1;
        match next {
            Next::Wanted(_) => stats.wanted_bytes += bytes,
            Next::Pushed(Piece {
                class: Class::Predicted,
                ..
            }) => {
                self.ahead.spend(bytes);
                stats.predicted_bytes += bytes;
            }
            Next::Pushed(_) => stats.pushed_bytes += bytes,
        }
    }
}

/// Whether a bit mask of codecs has this one.
pub(super) fn knows(codecs: u32, codec: u8) -> bool {
    codecs.checked_shr(codec.into()).unwrap_or(0) & 1 != 0
}

fn page_of(key: u64) -> Result<PageId, PeerError> {
    PageId::from_key(key).ok_or_else(|| protocol(format!("{key:#x} is no page's key")))
}

fn protocol(text: impl Into<String>) -> PeerError {
    PeerError::new(ErrorCode::Protocol, text)
}
