//! A session after its Hello: views and wishes in, pages out.

mod hear;
mod pages;
mod say;

use super::ahead::Ahead;
use super::cover::Cover;
use super::held::Held;
use super::push::Pushes;
use super::queue::WantQueue;
use super::stats::SessionStats;
use super::views::ViewGate;
use crate::limits::Limits;
use crate::published::Published;
use escarp_proto::wire::{ErrorCode, Have, Hello, PeerError, SessionLimits, capability};
use say::Reply;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

/// After a selection, so many times as long as it took none is made,
const SELECTION_REST: u32 = 4;
/// but no longer than this.
const LONGEST_REST: Duration = Duration::from_millis(250);

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
    /// GenChanges that wait to be sent, or that the client has not answered: what it says of pages
    /// until then is of before.
    changes: u32,
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
            changes: 0,
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
        let unsaid = |reply: &Reply| matches!(reply, Reply::GenChange);
        let welcomed = !matches!(self.replies.front(), Some(Reply::Welcome));
        // One that has not gone yet need not go twice.
        self.changes -= self.replies.iter().filter(|&reply| unsaid(reply)).count() as u32;
        self.replies.retain(of_both);
        // Welcome has the newest manifest when it goes.
        if welcomed {
            self.replies.push_back(Reply::GenChange);
            self.changes += 1;
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
}

/// Whether a bit mask of codecs has this one.
pub(super) fn knows(codecs: u32, codec: u8) -> bool {
    codecs.checked_shr(codec.into()).unwrap_or(0) & 1 != 0
}
