//! What the server says. Safe on untrusted input.

use super::event::tame;
use super::flights::Verdict;
use super::{Event, Link, LinkError, LinkState};
use escarp_proto::manifest::Manifest;
use escarp_proto::wire::{
    Chunk, ErrorCode, Miss, MissReason, PROTOCOL, PeerError, ServerMessage, Welcome,
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
                chunks.into_iter().for_each(|chunk| self.on_chunk(chunk))
            }
            ServerMessage::Miss(miss) => self.on_miss(miss, now),
            ServerMessage::GenChange { generation, .. } => {
                self.events.push_latest(Event::GenChange { generation });
            }
            ServerMessage::Idle { view_sequence } => {
                self.events.push_latest(Event::Idle { view_sequence });
            }
            // Nothing that may be stale is said to be held before its manifest is the same.
            ServerMessage::Stale(_) => {}
            ServerMessage::Pong(number) => self.keep_alive.pong(number, now),
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
        let changed = self.manifest.as_deref() != Some(&manifest);
        if changed {
            self.forget_pages(&manifest);
        }
        let manifest = match self.manifest.take() {
            Some(same) if !changed => same,
            _ => Arc::new(manifest),
        };
        self.manifest = Some(Arc::clone(&manifest));
        self.limits = welcome.limits;
        self.open(now);
        self.events
            .push_latest(Event::Welcome { manifest, changed });
        Ok(())
    }

    fn open(&mut self, now: Duration) {
        self.state = LinkState::Open { since: now };
        self.trouble = None;
        self.stats.sessions += 1;
        self.keep_alive.start(now);
        self.outgoing.haves = self.held.list();
    }

    /// Another dataset, or generation: what is here and was wished for belongs to the old one.
    fn forget_pages(&mut self, manifest: &Manifest) {
        self.held.start(manifest.grid_levels);
        self.flights.clear();
        self.misses.clear();
        let dropped = self.events.forget_pages(|_| true);
        self.credit.taken(dropped);
    }

    fn on_chunk(&mut self, chunk: Chunk) {
        let bytes = chunk.bytes.len() as u64;
        self.stats.page_bytes += bytes;
        self.credit.received(bytes);
        match self.flights.take(&chunk, &mut self.held) {
            Verdict::Taken => self.events.push_page(Event::Chunk(chunk)),
            Verdict::Stray => {
                self.stats.dropped_chunks += 1;
                self.credit.taken(bytes);
            }
            // The revision of a page does not change within a session, and parts come as asked
            // for: the server, or the disk below it, is at fault, and asking again would bring
            // the same.
            Verdict::Unusable => {
                self.stats.dropped_chunks += 1;
                self.credit.taken(bytes);
                self.lose(chunk.page, MissReason::Damaged);
            }
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
