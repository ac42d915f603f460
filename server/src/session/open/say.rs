//! What is said without reading records.

use super::Open;
use escarp_proto::wire::{Miss, PROTOCOL, ServerMessage, Welcome};

/// A message that waits to be sent, small: manifests are added when it goes.
#[derive(Debug)]
pub(super) enum Reply {
    Welcome,
    GenChange,
    Miss(Miss),
    Pong(u64),
}

impl Open {
    /// The next message that needs no record.
    pub(in crate::session) fn poll_control(&mut self) -> Option<ServerMessage> {
        if let Some(reply) = self.replies.pop_front() {
            return Some(match reply {
                Reply::Welcome => ServerMessage::Welcome(self.welcome()),
                Reply::GenChange => self.gen_change(),
                Reply::Miss(miss) => ServerMessage::Miss(miss),
                Reply::Pong(number) => ServerMessage::Pong(number),
            });
        }
        let idle = self.idle_owed && self.is_done();
        self.idle_owed &= !idle;
        idle.then(|| {
            self.stats.idles += 1;
            ServerMessage::Idle {
                view_sequence: self.views.current().map_or(0, |(sequence, ..)| sequence),
            }
        })
    }

    /// Whether nothing waits but what lies ahead of the view.
    fn is_done(&self) -> bool {
        let selected = !(self.select_due && self.uncovered);
        self.queue.is_empty() && self.pushes.is_done() && selected && self.haves.is_empty()
    }

    fn welcome(&self) -> Welcome {
        Welcome {
            version: PROTOCOL,
            capabilities: self.capabilities,
            manifest: self.published.source().manifest_json().to_vec(),
            limits: self.announced,
        }
    }

    fn gen_change(&self) -> ServerMessage {
        let source = self.published.source();
        ServerMessage::GenChange {
            generation: source.manifest().generation,
            manifest: source.manifest_json().to_vec(),
        }
    }
}
