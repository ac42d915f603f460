//! What the client says, in the order of urgency, and when it has to.

use super::{Link, LinkState};
use escarp_proto::page::Codec;
use escarp_proto::wire::{ClientMessage, Have, Hello, MAX_LIST, PROTOCOL};
use std::time::Duration;

/// Items in one message: few enough that the line is soon free for what is more urgent.
pub(super) const ITEMS_A_MESSAGE: usize = 1024;

const _: () = assert!(ITEMS_A_MESSAGE <= MAX_LIST);

/// What is to be said, apart from what the flights and the views know themselves.
#[derive(Debug, Default)]
pub(super) struct Outgoing {
    hello: bool,
    pub(super) haves: Vec<Have>,
    pub(super) evicts: Vec<u64>,
}

impl Outgoing {
    /// Of a session that begins.
    pub(super) fn greeting() -> Outgoing {
        Outgoing {
            hello: true,
            ..Outgoing::default()
        }
    }
}

impl Link {
    /// The next message to send, or `None`. Hello first; once the session is open: Have, Credit,
    /// Evict, Cancel, View, Want, Ping. Lists are cut so that each message is within the
    /// server's limits.
    pub fn poll_transmit(&mut self, now: Duration) -> Option<Vec<u8>> {
        let message = match self.state {
            LinkState::Greeting { .. } => self.next_greeting(),
            LinkState::Open { .. } => self.next_message(now),
            _ => None,
        }?;
        let bytes = message.encode();
        self.stats.sent_bytes += bytes.len() as u64;
        Some(bytes)
    }

    fn next_greeting(&mut self) -> Option<ClientMessage> {
        std::mem::take(&mut self.outgoing.hello).then(|| {
            ClientMessage::Hello(Hello {
                oldest: PROTOCOL,
                newest: PROTOCOL,
                capabilities: 0,
                codecs: Codec::KNOWN,
                dataset: self.config.dataset.clone(),
                credit_bytes: self.credit.granted(),
                token: self.config.token.clone(),
            })
        })
    }

    /// Have before Evict, and Cancel before Want: each pair may speak of the same page.
    fn next_message(&mut self, now: Duration) -> Option<ClientMessage> {
        let out = &mut self.outgoing;
        let views_per_second = self.limits.views_per_second;
        batch(&mut out.haves)
            .map(ClientMessage::Have)
            .or_else(|| {
                let total_bytes = self.credit.due()?;
                Some(ClientMessage::Credit { total_bytes })
            })
            .or_else(|| batch(&mut out.evicts).map(ClientMessage::Evict))
            .or_else(|| {
                self.flights
                    .poll_cancels(ITEMS_A_MESSAGE)
                    .map(ClientMessage::Cancel)
            })
            .or_else(|| self.views.due(now, views_per_second))
            .or_else(|| {
                self.flights
                    .poll_wants(ITEMS_A_MESSAGE)
                    .map(ClientMessage::Want)
            })
            .or_else(|| self.keep_alive.ping_due(now).map(ClientMessage::Ping))
    }

    /// When the link has something to do, since program start, if no message comes and nothing
    /// is set before. `None`: never.
    pub fn next_timeout(&self) -> Option<Duration> {
        match self.state {
            LinkState::Waiting { retry_at } => Some(retry_at),
            LinkState::Greeting { since } => Some(since + self.config.welcome_timeout),
            LinkState::Open { .. } => {
                let own = self.keep_alive.next_timeout();
                let others = [self.views.pending_at(), self.misses.next_timeout()];
                Some(others.into_iter().flatten().fold(own, Duration::min))
            }
            LinkState::Connecting | LinkState::Refused => None,
        }
    }
}

fn batch<T>(items: &mut Vec<T>) -> Option<Vec<T>> {
    let from = items.len().saturating_sub(ITEMS_A_MESSAGE);
    (!items.is_empty()).then(|| items.split_off(from))
}
