//! What records are read for: pages to send, and to look up; and which go next.

use super::Open;
use crate::limits::LOOKUPS_PER_FRAME;
use crate::session::chunk::{PAGES_OVERHEAD, arranged, chunk_of, encoded_len, frame_bytes};
use crate::session::cover::{self, Cover};
use crate::session::push::Piece;
use crate::session::queue::Wish;
use escarp_proto::geometry::PageId;
use escarp_proto::page::MAX_RECORD_BYTES;
use escarp_proto::select::Look;
use escarp_proto::wire::{Chunk, Class, Have, Scope, ServerMessage};

/// Where the next parts come from.
#[derive(Debug, Clone, Copy)]
enum Next {
    Wanted(Wish),
    Pushed(Piece),
}

impl Open {
    /// Whether a selection is due.
    pub(in crate::session) fn selects(&self) -> bool {
        self.select_due
    }

    /// Whether there may be records to read: pages to send, or to look up.
    pub(in crate::session) fn has_pages(&self) -> bool {
        !self.haves.is_empty() || self.select_due || !self.stalled && self.next().is_some()
    }

    /// The next message that needs records, if there is one after all; or does a part of what
    /// must be done before it.
    pub(in crate::session) fn poll_reading(&mut self) -> Option<ServerMessage> {
        if let Some(haves) = self.haves.pop_front() {
            return Some(ServerMessage::Stale(self.have(&haves)));
        }
        if std::mem::take(&mut self.select_due) {
            self.select();
        }
        self.poll_pages()
    }

    /// Notes what the client has, unless that is of before. Keys of what is not of the current
    /// generation.
    fn have(&mut self, haves: &[Have]) -> Vec<u64> {
        let mut stale = Vec::new();
        for have in haves {
            let page = PageId::from_key(have.page);
            match page.filter(|&page| self.is_current(page, have.revision)) {
                // It may have been evicted since, and is said again if not.
                Some(_) if self.changes > 0 => {}
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
    fn poll_pages(&mut self) -> Option<ServerMessage> {
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
