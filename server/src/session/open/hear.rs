//! What the client says.

use super::Open;
use super::say::Reply;
use crate::session::cover;
use escarp_proto::geometry::PageId;
use escarp_proto::view::View;
use escarp_proto::wire::{ClientMessage, ErrorCode, Miss, MissReason, PeerError, Scope, Want};
use std::time::Duration;

impl Open {
    /// Handles one message.
    ///
    /// # Errors
    /// What to end the session with.
    pub(in crate::session) fn handle(
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
            ClientMessage::Want(_) if self.changes > 0 => {}
            ClientMessage::Want(wants) => wants.iter().for_each(|want| self.want(want)),
            ClientMessage::Cancel(keys) => self.cancel(&keys)?,
            ClientMessage::Credit { total_bytes } => self.credit(total_bytes)?,
            ClientMessage::Have(haves) => {
                for have in &haves {
                    page_of(have.page)?;
                }
                if haves.is_empty() {
                    self.changes = self.changes.saturating_sub(1);
                }
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
        match self.changes {
            0 => self.advance(now),
            _ => self.views.forget(),
        }
        Ok(())
    }

    /// Looks at a waiting view if its time has come.
    pub(in crate::session) fn advance(&mut self, now: Duration) {
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

    pub(super) fn miss(&mut self, page: u64, reason: MissReason) {
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
}

fn page_of(key: u64) -> Result<PageId, PeerError> {
    PageId::from_key(key).ok_or_else(|| protocol(format!("{key:#x} is no page's key")))
}

fn protocol(text: impl Into<String>) -> PeerError {
    PeerError::new(ErrorCode::Protocol, text)
}
