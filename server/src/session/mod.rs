//! The protocol's core: one session, without socket, thread or clock. `proto/PROTOCOL.md` is the
//! specification.
//!
//! The caller's part, in any order and as often as it likes:
//!
//! 1. Give each message to [`handle_message`](Session::handle_message), while
//!    [`can_receive`](Session::can_receive).
//! 2. Send what [`poll_message`](Session::poll_message) returns, one at a time: the next one is
//!    chosen only when it is asked for, so that a Cancel takes effect between frames.
//! 3. Call [`handle_timeout`](Session::handle_timeout) at [`poll_timeout`](Session::poll_timeout).
//! 4. Stop when [`close_reason`](Session::close_reason) is there and `poll_message` gives nothing.
//!
//! Times are counted from the session's start, and never fall.

mod ahead;
mod chunk;
mod cover;
mod held;
mod open;
mod push;
mod queue;
mod stats;
mod views;

#[cfg(test)]
mod tests;

use crate::access::{Caller, Denied};
use crate::catalog::{Catalog, Hosted};
use crate::limits::Limits;
use crate::published::Published;
use escarp_proto::geometry::PageId;
use escarp_proto::view::View;
use escarp_proto::wire::{
    ClientMessage, ErrorCode, Hello, MAX_TEXT, PROTOCOL, PeerError, ServerMessage,
};
use open::{Open, knows};
pub use stats::SessionStats;
use std::sync::Arc;
use std::time::Duration;

/// One client's session.
///
/// Safe on untrusted input: any bytes are either followed or end the session, and what it holds
/// stays within [`Limits`].
pub struct Session {
    catalog: Arc<Catalog>,
    limits: Limits,
    caller: Caller,
    heard: Duration,
    hosted: Option<Arc<Hosted>>,
    stats_at_end: Option<SessionStats>,
    state: State,
}

enum State {
    /// Waits for Hello.
    Opening,
    Open(Box<Open>),
    Closed {
        reason: CloseReason,
        said: bool,
    },
}

/// Who ended a session, and why.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CloseReason {
    /// The client, by an Error.
    Client(PeerError),
    /// This server; its Error is the last message.
    Server(PeerError),
}

impl Session {
    /// A session at time 0 that waits for its client's Hello.
    pub fn new(catalog: Arc<Catalog>, limits: Limits) -> Session {
        Session {
            catalog,
            limits,
            caller: Caller::default(),
            heard: Duration::ZERO,
            hosted: None,
            stats_at_end: None,
            state: State::Opening,
        }
    }

    /// The same for a caller who may not see everything. Its Hello may have another token.
    #[must_use]
    pub fn for_caller(mut self, caller: Caller) -> Session {
        self.caller = caller;
        self
    }

    /// Handles a binary message. After the end, does nothing.
    pub fn handle_message(&mut self, bytes: &[u8], now: Duration) {
        self.handle_sign_of_life(now);
        if !self.can_receive() {
            return self.close(ErrorCode::Limit, "more messages than replies are taken for");
        }
        match ClientMessage::decode(bytes) {
            Ok(ClientMessage::Error(error)) => self.end(CloseReason::Client(error)),
            Ok(message) => {
                if let Err(PeerError { code, text }) = self.handle(message, now) {
                    self.close(code, &text);
                }
            }
            Err(error) => self.close(error.code(), &error.to_string()),
        }
    }

    /// The client has shown that it is there, say by answering a ping of the transport.
    pub fn handle_sign_of_life(&mut self, now: Duration) {
        self.heard = self.heard.max(now);
    }

    /// Whether a message may be handled now: not while too many replies wait to be sent.
    pub fn can_receive(&self) -> bool {
        match &self.state {
            State::Open(open) => open.can_receive(&self.limits),
            State::Opening | State::Closed { .. } => true,
        }
    }

    fn handle(&mut self, message: ClientMessage, now: Duration) -> Result<(), PeerError> {
        match (&mut self.state, message) {
            (State::Open(open), message) => open.handle(message, now),
            (State::Closed { .. }, _) => Ok(()),
            (State::Opening, ClientMessage::Hello(hello)) => {
                let hosted = self.dataset_of(&hello)?;
                let open = Open::new(hosted.published(), &hello, &self.limits);
                self.hosted = Some(hosted);
                self.state = State::Open(Box::new(open));
                Ok(())
            }
            (State::Opening, _) => Err(PeerError::new(
                ErrorCode::Protocol,
                "the first message must be Hello",
            )),
        }
    }

    /// The dataset that a Hello names, if both sides can talk about it.
    fn dataset_of(&mut self, hello: &Hello) -> Result<Arc<Hosted>, PeerError> {
        if !(hello.oldest..=hello.newest).contains(&PROTOCOL) {
            let text = format!(
                "protocol versions {}..={}, this server speaks {PROTOCOL}",
                hello.oldest, hello.newest
            );
            return Err(PeerError::new(ErrorCode::Version, text));
        }
        self.caller = self.caller.clone().with_token(hello.token.as_deref());
        // What is denied must not depend on whether there is such a dataset.
        self.caller.check(&hello.dataset).map_err(denied)?;
        let Some(hosted) = self.catalog.meant(&hello.dataset) else {
            return Err(PeerError::new(ErrorCode::NoDataset, self.names()));
        };
        self.caller.check(hosted.name()).map_err(denied)?;
        let codec = hosted.source().manifest().codec;
        if !knows(hello.codecs, codec) {
            let text = format!(
                "`{}` needs codec {codec}, the client has {:#b}",
                hosted.name(),
                hello.codecs
            );
            return Err(PeerError::new(ErrorCode::Version, text));
        }
        Ok(hosted)
    }

    /// The names of the datasets, one a line, as many as fit an error's text.
    fn names(&self) -> String {
        let mut text = String::new();
        let mut names = self.catalog.names();
        names.retain(|name| self.caller.sees(name));
        for name in names {
            let line = if text.is_empty() { "" } else { "\n" };
            if text.len() + line.len() + name.len() > MAX_TEXT {
                break;
            }
            text.push_str(line);
            text.push_str(&name);
        }
        text
    }

    /// The next message to send. Reads records, so it may block on the disk when
    /// [`has_pages`](Self::has_pages).
    pub fn poll_message(&mut self) -> Option<Vec<u8>> {
        loop {
            let control = self.poll_control();
            if control.is_some() || !self.has_pages() {
                return control;
            }
            // Without a page, either replies wait now, or there is less to do: no endless loop.
            if let State::Open(open) = &mut self.state
                && let Some(message) = open.poll_reading()
            {
                return Some(message.into_bytes());
            }
        }
    }

    /// As [`poll_message`](Self::poll_message), but leaves out Pages, and never blocks.
    pub fn poll_control(&mut self) -> Option<Vec<u8>> {
        match &mut self.state {
            State::Opening => None,
            State::Open(open) => open.poll_control().map(ServerMessage::into_bytes),
            State::Closed { reason, said } => match reason {
                CloseReason::Server(error) if !std::mem::replace(said, true) => {
                    Some(ServerMessage::Error(error.clone()).encode())
                }
                _ => None,
            },
        }
    }

    /// Whether [`poll_message`](Self::poll_message) would make a selection, which takes longer than
    /// anything else: the fewer go on at a time, the sooner each ends, and the less memory they take.
    /// While it waits for its turn, the session may be told of newer views.
    pub fn selects(&self) -> bool {
        matches!(&self.state, State::Open(open) if open.selects())
    }

    /// Whether [`poll_message`](Self::poll_message) would read records.
    pub fn has_pages(&self) -> bool {
        matches!(&self.state, State::Open(open) if open.has_pages())
    }

    /// When to call [`handle_timeout`](Self::handle_timeout), unless something else happens first.
    pub fn poll_timeout(&self) -> Option<Duration> {
        let silent = self.heard + self.limits.idle_timeout;
        match &self.state {
            State::Opening => Some(self.limits.hello_timeout),
            State::Open(open) => Some(
                open.views
                    .deadline()
                    .map_or(silent, |view| view.min(silent)),
            ),
            State::Closed { .. } => None,
        }
    }

    /// Does whatever is due. Harmless when called too early.
    pub fn handle_timeout(&mut self, now: Duration) {
        let silent = self.heard + self.limits.idle_timeout;
        match &mut self.state {
            State::Opening if now >= self.limits.hello_timeout => {
                let text = format!("no Hello within {:?}", self.limits.hello_timeout);
                self.close(ErrorCode::Limit, &text);
            }
            State::Open(_) if now >= silent => {
                let text = format!("nothing heard for {:?}", self.limits.idle_timeout);
                self.close(ErrorCode::Limit, &text);
            }
            State::Open(open) => open.advance(now),
            State::Opening | State::Closed { .. } => {}
        }
    }

    /// Ends the session with an Error, before anything else that waits. After the end, does
    /// nothing.
    pub fn close(&mut self, code: ErrorCode, text: &str) {
        self.end(CloseReason::Server(PeerError::new(code, text)));
    }

    fn end(&mut self, reason: CloseReason) {
        if self.close_reason().is_none() {
            self.stats_at_end = Some(self.stats());
            let said = false;
            self.state = State::Closed { reason, said };
        }
    }

    /// Why the session has ended, if it has.
    pub fn close_reason(&self) -> Option<&CloseReason> {
        match &self.state {
            State::Closed { reason, .. } => Some(reason),
            State::Opening | State::Open(_) => None,
        }
    }

    /// The view that the client looks at, with its sequence number.
    pub fn view(&self) -> Option<(u32, View)> {
        match &self.state {
            State::Open(open) => open
                .views
                .current()
                .map(|(sequence, view, _)| (sequence, view)),
            State::Opening | State::Closed { .. } => None,
        }
    }

    /// Last part of a page that the client has, as far as the server remembers.
    pub fn client_has(&self, page: PageId) -> Option<u8> {
        match &self.state {
            State::Open(open) => open.held.last_part(page),
            State::Opening | State::Closed { .. } => None,
        }
    }

    /// The dataset, once Hello has named it. Its generations are for the caller to watch.
    pub fn hosted(&self) -> Option<&Arc<Hosted>> {
        self.hosted.as_ref()
    }

    /// The dataset has been published anew. From here on, all that is sent is of that generation.
    pub fn handle_publication(&mut self, published: Arc<Published>) {
        if let State::Open(open) = &mut self.state
            && let Err(PeerError { code, text }) = open.change(published)
        {
            self.close(code, &text);
        }
    }

    /// The last [`poll_message`](Self::poll_message) made a selection, and took so long: where
    /// selecting is slow, views are looked at less often.
    pub fn selected(&mut self, took: Duration, now: Duration) {
        if let State::Open(open) = &mut self.state {
            open.selected(took, now);
        }
    }

    /// The dataset is hosted no longer.
    pub fn handle_removal(&mut self) {
        let names = self.names();
        self.close(ErrorCode::NoDataset, &names);
    }

    /// Figures since Hello.
    pub fn stats(&self) -> SessionStats {
        self.stats_at_end.unwrap_or(match &self.state {
            State::Open(open) => open.stats(),
            State::Opening | State::Closed { .. } => SessionStats::default(),
        })
    }
}

fn denied(why: Denied) -> PeerError {
    let text = match why {
        Denied::NoToken => "this dataset needs a token",
        Denied::WrongToken => "the token does not open this dataset",
        Denied::Origin => "web pages of this origin may not use this dataset",
    };
    PeerError::new(ErrorCode::Denied, text)
}
