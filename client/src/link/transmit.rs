//! What the client says, in the order of urgency, and when it has to.

use super::gate::patience;
use super::{Barrier, Link, LinkState};
use escarp_proto::page::Codec;
use escarp_proto::wire::{ClientMessage, Hello, MAX_LIST, PROTOCOL, capability};
use std::time::Duration;

/// Items in one message: few enough that the line is soon free for what is more urgent.
pub(super) const ITEMS_A_MESSAGE: usize = 1024;

/// A server that is at work sends something of it more often.
const SILENT: Duration = Duration::from_secs(10);

const _: () = assert!(ITEMS_A_MESSAGE <= MAX_LIST);

impl Link {
    /// The next message to send, or `None`. Hello first, and without waiting for its answer Have
    /// and View; once the session is open: Credit, Have and Evict, Cancel, View, Want, Ping. Lists
    /// are cut so that each message is within the server's limits.
    pub fn poll_transmit(&mut self, now: Duration) -> Option<Vec<u8>> {
        let message = match self.state {
            LinkState::Greeting { .. } => self
                .next_greeting()
                .or_else(|| self.next_claim())
                .or_else(|| self.next_view(now)),
            LinkState::Open { .. } => self.next_message(now),
            _ => None,
        }?;
        let bytes = message.encode();
        self.stats.sent_bytes += bytes.len() as u64;
        Some(bytes)
    }

    fn next_greeting(&mut self) -> Option<ClientMessage> {
        std::mem::take(&mut self.hello_due).then(|| {
            self.push_asked = self.push_wanted;
            ClientMessage::Hello(Hello {
                oldest: PROTOCOL,
                newest: PROTOCOL,
                capabilities: match self.push_asked {
                    true => capability::PUSH,
                    false => 0,
                },
                codecs: Codec::KNOWN,
                dataset: self.config.dataset.clone(),
                credit_bytes: self.credit.granted(),
                token: self.config.token.clone(),
            })
        })
    }

    /// Claims before View and Want, which rest on them; Cancel before Want, which may have the same
    /// page anew.
    fn next_message(&mut self, now: Duration) -> Option<ClientMessage> {
        let credit = self.credit.due();
        credit
            .map(|total_bytes| ClientMessage::Credit { total_bytes })
            .or_else(|| self.next_claim())
            .or_else(|| {
                let pages = self.flights.poll_cancels(ITEMS_A_MESSAGE)?;
                Some(ClientMessage::Cancel(pages))
            })
            .or_else(|| self.next_view(now))
            .or_else(|| self.next_wants(now))
            .or_else(|| self.keep_alive.ping_due(now).map(ClientMessage::Ping))
    }

    /// Behind the last Have goes a Ping: its Pong shows that all have been answered.
    fn next_claim(&mut self) -> Option<ClientMessage> {
        self.claims.poll(ITEMS_A_MESSAGE).or_else(|| {
            let due = self.barrier == Barrier::Due;
            due.then(|| {
                let number = self.keep_alive.next_number();
                self.barrier = Barrier::Sent(number);
                ClientMessage::Ping(number)
            })
        })
    }

    /// Nothing is wanted before it is known what of an older generation is still of use.
    fn next_wants(&mut self, now: Duration) -> Option<ClientMessage> {
        if self.confirming {
            return None;
        }
        self.claim_strays();
        self.next_claim().or_else(|| {
            let wants = self.flights.poll_wants(ITEMS_A_MESSAGE, now)?;
            Some(ClientMessage::Want(wants))
        })
    }

    fn next_view(&mut self, now: Duration) -> Option<ClientMessage> {
        self.view_at().filter(|&at| at <= now)?;
        self.views.due(now, self.limits.views_per_second)
    }

    /// When the newest view is due, if it is not sent yet.
    pub(super) fn view_at(&self) -> Option<Duration> {
        self.views.pending_at()
    }

    /// Of pages that are about to be wanted, the server is told first what is really here.
    fn claim_strays(&mut self) {
        if !self.claims.has_strays() {
            return;
        }
        for page in self.flights.untold() {
            if self.claims.take_stray(page) {
                self.claim_anew(page);
            }
        }
    }

    /// When the link has something to do, since program start, if no message comes and nothing
    /// is set before. `None`: never.
    pub fn next_timeout(&self) -> Option<Duration> {
        match self.state {
            LinkState::Waiting { retry_at } => Some(retry_at),
            LinkState::Greeting { since } => Some(since + self.config.welcome_timeout),
            LinkState::Open { .. } => {
                let own = self.keep_alive.next_timeout();
                let gate = (!self.deferred.is_empty())
                    .then(|| self.gate.opens_at(self.keep_alive.round_trip()))
                    .flatten();
                let others = [
                    self.view_at(),
                    self.misses.next_timeout(),
                    self.swallowed_at(),
                    gate,
                ];
                Some(others.into_iter().flatten().fold(own, Duration::min))
            }
            LinkState::Connecting | LinkState::Refused => None,
        }
    }

    /// When a page that the server swallowed is asked for again: it has been idle, or has sent no
    /// chunk, for too long.
    pub(super) fn swallowed_at(&self) -> Option<Duration> {
        let (quiet, patience) = self.quiet();
        self.flights.swallowed_at(quiet, patience)
    }

    /// Since when the server has done nothing, and how long that may last.
    pub(super) fn quiet(&self) -> (Duration, Duration) {
        match self.idle_at {
            Some(at) => (at, 2 * patience(self.keep_alive.round_trip())),
            None => (self.chunk_at, SILENT),
        }
    }
}
