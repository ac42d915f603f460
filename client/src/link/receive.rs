//! What the server says. Safe on untrusted input.

use super::event::tame;
use super::flights::Verdict;
use super::gate::Gate;
use super::{Barrier, Event, Link, LinkError, LinkState};
use escarp_proto::manifest::Manifest;
use escarp_proto::wire::{
    Chunk, ErrorCode, Miss, MissReason, PROTOCOL, PeerError, ServerMessage, Welcome, capability,
};
use std::sync::Arc;
use std::time::Duration;

impl Link {
    /// Takes a message of the server.
    ///
    /// # Errors
    /// [`LinkError`] if the bytes are no message, or one that may not come now. The link has given
    /// up the session then, as if disconnected: the driver closes the socket.
    pub fn handle_message(&mut self, bytes: &[u8], now: Duration) -> Result<(), LinkError> {
        if !matches!(
            self.state,
            LinkState::Greeting { .. } | LinkState::Open { .. }
        ) {
            // Still under way when the link gave up the session.
            return Ok(());
        }
        self.stats.received_bytes += bytes.len() as u64;
        self.keep_alive.heard(now);
        let result = ServerMessage::decode(bytes)
            .map_err(LinkError::from)
            .and_then(|message| self.handle(message, now));
        if let Err(error) = &result {
            self.on_disconnected(now, &error.to_string());
        }
        result
    }

    fn handle(&mut self, message: ServerMessage, now: Duration) -> Result<(), LinkError> {
        self.check_order(&message)?;
        match message {
            ServerMessage::Welcome(welcome) => self.on_welcome(welcome, now)?,
            ServerMessage::Pages(chunks) => {
                for chunk in chunks {
                    self.on_chunk(chunk, now);
                }
            }
            ServerMessage::Miss(miss) => self.on_miss(miss, now),
            ServerMessage::GenChange { manifest, .. } => self.on_gen_change(&manifest, now)?,
            ServerMessage::Idle { view_sequence } => self.on_idle(view_sequence, now),
            ServerMessage::Stale(pages) => self.on_stale(&pages),
            ServerMessage::Pong(number) => self.on_pong(number, now),
            ServerMessage::Error(error) => self.on_refused(&error, now),
        }
        Ok(())
    }

    fn check_order(&self, message: &ServerMessage) -> Result<(), LinkError> {
        let error = |message, when| Err(LinkError::Order { message, when });
        match (message, self.is_open()) {
            (ServerMessage::Welcome(_), true) => error("Welcome", "twice"),
            (ServerMessage::Pages(_), false) => error("Pages", "before Welcome"),
            (ServerMessage::Miss(_), false) => error("Miss", "before Welcome"),
            (ServerMessage::GenChange { .. }, false) => error("GenChange", "before Welcome"),
            (ServerMessage::Stale(_), false) => error("Stale", "before Welcome"),
            (ServerMessage::Idle { .. }, false) => error("Idle", "before Welcome"),
            _ => Ok(()),
        }
    }

    fn on_welcome(&mut self, welcome: Welcome, now: Duration) -> Result<(), LinkError> {
        if welcome.version != PROTOCOL {
            return Err(LinkError::Version {
                found: welcome.version,
                allowed: PROTOCOL,
            });
        }
        let manifest = Manifest::from_json(&welcome.manifest).map_err(LinkError::Manifest)?;
        self.limits = welcome.limits;
        self.push_agreed = self.push_asked && welcome.capabilities & capability::PUSH != 0;
        self.state = LinkState::Open { since: now };
        self.trouble = None;
        self.stats.sessions += 1;
        self.keep_alive.start(now);
        self.chunk_at = now;
        let changed = self.manifest.as_deref() != Some(&manifest);
        if changed {
            self.start_generation(manifest, |manifest| Event::Welcome {
                manifest,
                changed: true,
            });
        } else if let Some(manifest) = self.manifest.clone() {
            self.events
                .push_latest(Event::Welcome { manifest, changed });
        }
        if self.is_pushing() {
            // What was in flight may come unasked.
            self.gate = Gate::default();
            if self.views.is_any() {
                self.deferred = self.flights.take_untold();
                self.gate.on_view(now);
            }
        }
        Ok(())
    }

    /// The server has forgotten what is here, wanted and looked at.
    fn on_gen_change(&mut self, manifest: &[u8], now: Duration) -> Result<(), LinkError> {
        let manifest = Manifest::from_json(manifest).map_err(LinkError::Generation)?;
        self.flights.forget_session();
        self.views.forget_sent();
        self.gate.on_view(now);
        self.idle_at = None;
        self.start_generation(manifest, |manifest| Event::GenChange { manifest });
        self.claim_all();
        self.claims.answer_change();
        Ok(())
    }

    /// Another dataset, or generation. Pages of before are kept if they may be the same ones.
    fn start_generation(&mut self, manifest: Manifest, event: impl FnOnce(Arc<Manifest>) -> Event) {
        let same_places = self.manifest.as_ref().is_some_and(|old| {
            old.grid_levels == manifest.grid_levels && old.georef == manifest.georef
        });
        if !same_places {
            let gone = self.held.clear();
            gone.into_iter().for_each(|page| self.claims.evict(page));
            self.flights.clear();
        }
        self.held.start(manifest.grid_levels);
        self.misses.clear();
        let manifest = Arc::new(manifest);
        let first = self.manifest.replace(Arc::clone(&manifest)).is_none();
        self.begin_change(event(manifest));
        if first {
            // There is nothing to confirm.
            (self.confirming, self.barrier) = (false, Barrier::None);
        }
    }

    /// Tells the caller that pages may have changed, and takes back what it has not heard of since
    /// the last time.
    fn begin_change(&mut self, event: Event) {
        let skipped = self.events.push_generation(event);
        for chunk in &skipped {
            self.credit.taken(chunk.bytes.len() as u64);
            self.held.cut(chunk.page, chunk.first_part);
            self.claim_anew(chunk.page);
        }
        self.held.age();
        self.confirming = true;
        if self.barrier == Barrier::None || !skipped.is_empty() {
            self.barrier = Barrier::Due;
        }
    }

    fn on_stale(&mut self, pages: &[u64]) {
        let before = self.held.len();
        for &page in pages {
            if self.held.is_stale(page) {
                self.flights.miss(page);
            }
        }
        if self.held.len() < before
            && !self.confirming
            && let Some(manifest) = self.manifest.clone()
        {
            // Its manifest says that nothing has changed; pages are not mixed in any case.
            self.begin_change(Event::GenChange { manifest });
        }
    }

    fn on_pong(&mut self, number: u64, now: Duration) {
        self.keep_alive.pong(number, now);
        if self.barrier == Barrier::Sent(number) {
            self.barrier = Barrier::None;
            self.held.confirm();
            if std::mem::take(&mut self.confirming) {
                let same = self.held.of_before();
                self.events.push_latest(Event::Confirmed { same });
            }
        }
    }

    fn on_idle(&mut self, view_sequence: u32, now: Duration) {
        let newest = view_sequence == self.views.sequence() && !self.view_pending();
        self.gate.on_idle(newest, now);
        self.idle_at = Some(now);
        self.events.push_latest(Event::Idle { view_sequence });
    }

    fn on_chunk(&mut self, chunk: Chunk, now: Duration) {
        let bytes = chunk.bytes.len() as u64;
        self.stats.page_bytes += bytes;
        self.credit.received(bytes);
        self.gate.on_chunk(now);
        (self.idle_at, self.chunk_at) = (None, now);
        match self.flights.take(&chunk, &mut self.held, now) {
            Verdict::Taken => self.events.push_page(Event::Chunk(chunk)),
            Verdict::Unasked if self.takes_pushed(&chunk) => {
                self.held.add(&chunk);
                self.stats.pushed_chunks += 1;
                self.events.push_page(Event::Chunk(chunk));
            }
            Verdict::Unasked | Verdict::Stray => self.drop_chunk(&chunk),
            // The revision of a page does not change within a generation, and parts come as asked
            // for: the server, or the disk below it, is at fault, and asking again would bring
            // the same.
            Verdict::Unusable => {
                self.drop_chunk(&chunk);
                self.lose(chunk.page, MissReason::Damaged);
            }
        }
    }

    /// Whether a chunk that was not asked for is of use. What waits is bounded in bytes by the
    /// credit; chunks of no bytes are bounded in number.
    fn takes_pushed(&self, chunk: &Chunk) -> bool {
        let most = self.config.max_in_flight_pages as u64 + self.config.credit_window_bytes / 32;
        // What was on its way when that ceased to be of use costs nothing more.
        self.push_agreed
            && (self.events.pages() as u64) < most
            && !self.credit.is_overdrawn()
            && !self.misses.blocks(chunk.page)
            && self.held.continues(chunk)
    }

    fn drop_chunk(&mut self, chunk: &Chunk) {
        self.stats.dropped_chunks += 1;
        self.credit.taken(chunk.bytes.len() as u64);
        // The server takes it to be here; of what is here it is right.
        if chunk.last_part >= self.held.count(chunk.page) {
            self.claims.note_stray(chunk.page);
        }
    }

    fn on_miss(&mut self, miss: Miss, now: Duration) {
        match miss.reason {
            MissReason::NotFound | MissReason::Damaged => self.lose(miss.page, miss.reason),
            MissReason::Busy if self.flights.miss(miss.page) => {
                self.misses.delay(miss.page, now + self.config.busy_delay);
                self.stats.busy += 1;
            }
            // A page cancelled meanwhile.
            MissReason::Busy => {}
        }
    }

    /// Only of pages in flight, so that a server cannot fill the memory with others.
    fn lose(&mut self, page: u64, reason: MissReason) {
        if self.flights.miss(page) {
            self.misses.lose(page);
            self.events.push_page(Event::Miss(Miss { page, reason }));
        }
    }

    fn on_refused(&mut self, error: &PeerError, now: Duration) {
        let (code, text) = (error.code, tame(&error.text));
        let fatal = is_fatal(code);
        let why = match code {
            ErrorCode::NoDataset => self.no_dataset(&text),
            _ => format!("the server says: {text}"),
        };
        self.events
            .push_latest(Event::Refused { fatal, code, text });
        if fatal {
            self.refuse(why);
        } else {
            self.on_disconnected(now, &why);
        }
    }

    /// The server names the datasets that it has, one a line.
    fn no_dataset(&self, names: &str) -> String {
        let names = match names.lines().collect::<Vec<_>>().join(", ") {
            none if none.is_empty() => "none".to_owned(),
            some => some,
        };
        match self.config.dataset.as_str() {
            "" => format!("the address names no dataset; the server has: {names}"),
            name => format!("the server has no dataset \"{name}\"; it has: {names}"),
        }
    }
}

/// Whether the server would say the same to the next attempt.
const fn is_fatal(code: ErrorCode) -> bool {
    match code {
        ErrorCode::Version | ErrorCode::NoDataset | ErrorCode::Denied => true,
        ErrorCode::Protocol | ErrorCode::Limit | ErrorCode::ShuttingDown | ErrorCode::Internal => {
            false
        }
    }
}
