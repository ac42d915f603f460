//! Drives one session's core over one socket.
//!
//! Messages are read while a frame is being written, and the next frame is chosen only when the
//! last one has gone, so that a Cancel takes effect between frames. Records are read on the
//! blocking pool: a fault in mapped memory must not hold up the other sessions.

use super::Phase;
use super::early::Early;
use super::outgoing::Outgoing;
use super::tally::Tally;
use super::turns::Turns;
use crate::catalog::Stand;
use crate::limits::Limits;
use crate::metrics::Metrics;
use crate::session::{CloseReason, Session};
use axum::body::Bytes;
use axum::extract::ws::{CloseFrame, Message, WebSocket, close_code};
use escarp_proto::wire::{ErrorCode, PeerError};
use futures_util::StreamExt;
use futures_util::stream::SplitStream;
use std::error::Error;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Semaphore, watch};
use tokio::time::{Instant, sleep_until, timeout};
use tokio_tungstenite::tungstenite;

/// Longest text of a close frame, bytes (RFC 6455, section 5.5, less the code).
const CLOSE_TEXT: usize = 123;

/// Serves a session to its end; `None` if its connection was lost.
pub(super) async fn drive(
    socket: WebSocket,
    session: Session,
    early: Early,
    limits: &Limits,
    phase: watch::Receiver<Phase>,
    turns: Arc<Semaphore>,
    metrics: &Metrics,
) -> Option<CloseReason> {
    tracing::debug!("opened");
    let (sink, incoming) = socket.split();
    let now = Instant::now();
    let mut driver = Driver {
        session: Some(session),
        early,
        outgoing: Outgoing::new(sink),
        incoming,
        reading: true,
        turns: Turns::new(turns),
        limits,
        phase,
        stand: None,
        tally: Tally::new(metrics),
        started: now,
        heard: now,
        pinged: now,
    };
    match driver.run().await {
        End::Closed(reason) => {
            let totals = driver.totals();
            tracing::info!(?reason, took = ?now.elapsed(), totals, "closed");
            driver.farewell(&reason).await;
            Some(reason)
        }
        End::Lost(why) => {
            let totals = driver.totals();
            tracing::info!(why, took = ?now.elapsed(), totals, "lost");
            None
        }
    }
}

/// How a session ended.
enum End {
    /// By a message of either side.
    Closed(CloseReason),
    /// With its connection.
    Lost(String),
}

struct Driver<'a> {
    /// Away only while records are read for it.
    session: Option<Session>,
    /// Messages that came with the handshake.
    early: Early,
    outgoing: Outgoing,
    incoming: SplitStream<WebSocket>,
    /// Whether the client's side is still open.
    reading: bool,
    turns: Turns,
    limits: &'a Limits,
    phase: watch::Receiver<Phase>,
    /// Of the dataset that is looked at, once there is one.
    stand: Option<watch::Receiver<Stand>>,
    tally: Tally<'a>,
    started: Instant,
    heard: Instant,
    pinged: Instant,
}

impl Driver<'_> {
    async fn run(&mut self) -> End {
        loop {
            self.begin();
            let end = match self.fill().await {
                Ok(()) => self.wait().await,
                end => end,
            };
            if let Err(end) = end {
                return end;
            }
        }
    }

    /// What the session came to, in a line of the log.
    fn totals(&self) -> String {
        let stats = self.session.as_ref().map(Session::stats);
        let stats = stats.unwrap_or_default();
        format!(
            "{} bytes: {} pushed, {} wanted, {} ahead, {} again; {} views",
            stats.sent_bytes(),
            stats.pushed_bytes,
            stats.wanted_bytes,
            stats.predicted_bytes,
            stats.repeated_bytes,
            stats.views
        )
    }

    /// Handles what came with the handshake, as far as the session takes it.
    fn begin(&mut self) {
        let now = self.now();
        while self.session().is_some_and(|session| session.can_receive())
            && let Some(message) = self.early.pop_front()
            && let Some(session) = self.session()
        {
            session.handle_message(&message, now);
            self.watch();
        }
    }

    /// Starts the next message, if there is one and the last one has gone.
    async fn fill(&mut self) -> Result<(), End> {
        if self.outgoing.since().is_some() {
            return Ok(());
        }
        // Whoever waits for a turn still hears, so that it will be for the newest view. Whoever
        // writes does not wait: others would wait for its client.
        let selects = self.session().is_some_and(|session| session.selects());
        let may_read = !selects || self.turns.come();
        let (mut session, message, read) = next_message(self.session.take(), may_read).await?;
        if may_read || message.is_some() {
            self.turns.leave();
        }
        let reason = session.close_reason().cloned();
        let now = self.now();
        if let Some(took) = self.tally.note(&session.stats(), read, now) {
            session.selected(took, now);
        }
        self.session = Some(session);
        match (message, reason) {
            (Some(message), _) => self.outgoing.start(Message::Binary(message.into())),
            (None, Some(reason)) => return Err(End::Closed(reason)),
            (None, None) if Instant::now() >= self.ping_due() => {
                self.pinged = Instant::now();
                self.outgoing.start(Message::Ping(Bytes::new()));
            }
            (None, None) => {}
        }
        Ok(())
    }

    /// Waits for whatever happens next, and handles it.
    async fn wait(&mut self) -> Result<(), End> {
        let deadline = self.deadline();
        let ready = self.early.is_empty();
        let receive =
            self.reading && ready && self.session().is_some_and(|session| session.can_receive());
        let writing = self.outgoing.since().is_some();
        let waits = self.turns.is_waiting();
        tokio::select! {
            sent = self.outgoing.progress(), if writing => sent.map_err(|error| lost(&error)),
            message = self.incoming.next(), if receive => self.handle(message),
            () = self.turns.wait(), if waits => Ok(()),
            () = sleep_until(deadline) => self.handle_timeout(),
            changed = self.phase.changed() => {
                // The sender lives as long as the server: without it, everything stops.
                let phase = changed.map_or(Phase::Stopped, |()| *self.phase.borrow());
                self.handle_phase(phase)
            }
            () = changed(&mut self.stand) => self.handle_stand(),
        }
    }

    fn session(&mut self) -> Option<&mut Session> {
        self.session.as_mut()
    }

    /// What the session's core takes for the time.
    fn now(&self) -> Duration {
        self.started.elapsed()
    }

    fn ping_due(&self) -> Instant {
        self.heard.max(self.pinged) + self.limits.ping_interval
    }

    fn deadline(&self) -> Instant {
        let timeout = self.session.as_ref().and_then(Session::poll_timeout);
        let other = match self.outgoing.since() {
            Some(since) => since + self.limits.send_timeout,
            None => self.ping_due(),
        };
        timeout.map_or(other, |timeout| other.min(self.started + timeout))
    }

    fn handle_timeout(&mut self) -> Result<(), End> {
        let stalled = self.outgoing.since().map(|since| since.elapsed());
        if stalled.is_some_and(|stalled| stalled >= self.limits.send_timeout) {
            return Err(End::Lost("the client does not read".into()));
        }
        let now = self.now();
        if let Some(session) = self.session() {
            session.handle_timeout(now);
        }
        Ok(())
    }

    fn handle_phase(&mut self, phase: Phase) -> Result<(), End> {
        match (phase, self.session()) {
            (Phase::Stopped, _) => return Err(End::Lost("not ended in time".into())),
            (Phase::Draining, Some(session)) => {
                session.close(ErrorCode::ShuttingDown, "the server is going down");
            }
            _ => {}
        }
        Ok(())
    }

    /// Begins to watch the dataset that the session is about.
    fn watch(&mut self) {
        let hosted = self.session.as_ref().and_then(Session::hosted);
        if let (None, Some(hosted)) = (&self.stand, hosted) {
            let mut stand = hosted.subscribe();
            // It may have changed since Hello.
            stand.mark_changed();
            self.stand = Some(stand);
        }
    }

    /// The dataset has been published anew, or is hosted no longer.
    fn handle_stand(&mut self) -> Result<(), End> {
        let stand = self.stand.as_mut();
        let stand = stand.map(|stand| stand.borrow_and_update().clone());
        if let (Some(stand), Some(session)) = (stand, self.session()) {
            match stand.hosted {
                true => {
                    session.handle_publication(stand.published);
                    self.tally.generation_changed();
                }
                false => session.handle_removal(),
            }
        }
        Ok(())
    }

    fn handle(&mut self, message: Option<Result<Message, axum::Error>>) -> Result<(), End> {
        self.heard = Instant::now();
        let now = self.now();
        let Some(session) = self.session.as_mut() else {
            return Ok(());
        };
        match message {
            Some(Ok(Message::Binary(bytes))) => {
                session.handle_message(&bytes, now);
                self.watch();
            }
            Some(Ok(Message::Ping(_) | Message::Pong(_))) => session.handle_sign_of_life(now),
            Some(Ok(Message::Text(_))) => {
                session.close(
                    ErrorCode::Protocol,
                    "a text message; all messages are binary",
                );
            }
            // Whoever says so with a close frame has ended the session, for whatever reason.
            Some(Ok(Message::Close(frame))) => {
                return Err(End::Closed(CloseReason::Client(PeerError {
                    code: ErrorCode::ShuttingDown,
                    text: frame.map_or_else(String::new, |frame| frame.reason.to_string()),
                })));
            }
            None => return Err(End::Lost("the client closed the connection".into())),
            Some(Err(error)) => {
                // Either the connection is gone, or a frame is broken or far too long; then the
                // client can still be told.
                self.reading = false;
                let code = match error.source().and_then(|error| error.downcast_ref()) {
                    Some(tungstenite::Error::Capacity(_)) => ErrorCode::Limit,
                    _ => ErrorCode::Protocol,
                };
                session.close(code, &error.to_string());
            }
        }
        Ok(())
    }

    /// Closes the connection, and gives the client time to read why: a socket that is closed with
    /// unread bytes in it is reset, and takes what was sent with it.
    async fn farewell(&mut self, reason: &CloseReason) {
        let within = self.limits.close_timeout;
        let close = Message::Close(Some(close_frame(reason)));
        self.outgoing.finish(close, within).await;
        if self.reading {
            let drained = async { while let Some(Ok(_)) = self.incoming.next().await {} };
            // Whether the client answers or not, the session is over.
            let _ = timeout(within, drained).await;
        }
    }
}

/// A session, its next message, and how long reading records for it took.
type Next = (Session, Option<Vec<u8>>, Option<Duration>);

/// The session's next message, read on the blocking pool if records are needed, and if that may
/// be done now.
async fn next_message(session: Option<Session>, may_read: bool) -> Result<Next, End> {
    let Some(mut session) = session else {
        return Err(End::Lost("a record could not be read".into()));
    };
    let control = session.poll_control();
    if control.is_some() || !may_read || !session.has_pages() {
        return Ok((session, control, None));
    }
    let read = tokio::task::spawn_blocking(move || {
        let began = Instant::now();
        let message = session.poll_message();
        (session, message, Some(began.elapsed()))
    });
    read.await
        .map_err(|error| End::Lost(format!("reading records: {error}")))
}

/// Ready when a dataset changed; never while there is none, or none any more.
async fn changed(stand: &mut Option<watch::Receiver<Stand>>) {
    let changed = match stand {
        Some(stand) => stand.changed().await.is_ok(),
        None => false,
    };
    if !changed {
        *stand = None;
        std::future::pending().await
    }
}

fn lost(error: &axum::Error) -> End {
    End::Lost(error.to_string())
}

fn close_frame(reason: &CloseReason) -> CloseFrame {
    let (code, text) = match reason {
        CloseReason::Client(_) => (close_code::NORMAL, ""),
        CloseReason::Server(PeerError { code, text }) => (close_code_of(*code), text.as_str()),
    };
    CloseFrame {
        code,
        reason: text[..text.floor_char_boundary(CLOSE_TEXT)].into(),
    }
}

fn close_code_of(code: ErrorCode) -> u16 {
    match code {
        ErrorCode::Protocol => close_code::PROTOCOL,
        ErrorCode::ShuttingDown => close_code::AWAY,
        ErrorCode::Internal => close_code::ERROR,
        ErrorCode::Version | ErrorCode::NoDataset | ErrorCode::Limit | ErrorCode::Denied => {
            close_code::POLICY
        }
    }
}
