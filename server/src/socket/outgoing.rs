//! The writing half of a socket, one message at a time.

use axum::extract::ws::{Message, WebSocket};
use futures_util::stream::SplitSink;
use futures_util::{Sink, SinkExt};
use std::future::poll_fn;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::time::{Instant, timeout_at};

/// Sends one message after the other. A message counts as sent when the system has all of it, so
/// that the next one is chosen as late as possible.
pub(super) struct Outgoing {
    sink: SplitSink<WebSocket, Message>,
    message: Option<Message>,
    /// When the message under way was started.
    since: Option<Instant>,
}

impl Outgoing {
    pub(super) fn new(sink: SplitSink<WebSocket, Message>) -> Outgoing {
        Outgoing {
            sink,
            message: None,
            since: None,
        }
    }

    /// Since when a message has been under way, if one is.
    pub(super) fn since(&self) -> Option<Instant> {
        self.since
    }

    /// Starts a message. None may be under way.
    pub(super) fn start(&mut self, message: Message) {
        debug_assert!(self.since.is_none());
        self.message = Some(message);
        self.since = Some(Instant::now());
    }

    /// Ready when the message under way is sent. May be dropped and called again at any time.
    pub(super) async fn progress(&mut self) -> Result<(), axum::Error> {
        poll_fn(|context| self.poll(context)).await
    }

    fn poll(&mut self, context: &mut Context<'_>) -> Poll<Result<(), axum::Error>> {
        if self.message.is_some() {
            ready!(Pin::new(&mut self.sink).poll_ready(context))?;
        }
        if let Some(message) = self.message.take() {
            Pin::new(&mut self.sink).start_send(message)?;
        }
        ready!(self.sink.poll_flush_unpin(context))?;
        self.since = None;
        Poll::Ready(Ok(()))
    }

    /// Sends a last message, within a time.
    pub(super) async fn finish(&mut self, message: Message, within: Duration) {
        // The session is over: if the client is gone, nothing is lost.
        let _ = timeout_at(Instant::now() + within, self.sink.send(message)).await;
    }
}
