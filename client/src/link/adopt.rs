//! What the caller has from elsewhere: from an earlier run, on disk.

use super::{Link, LinkState};
use escarp_proto::manifest::Manifest;
use escarp_proto::wire::Chunk;
use std::sync::Arc;

impl Link {
    /// Before the first session: the manifest of an earlier run. If the server has another one by
    /// now, Welcome says that it has changed, as after a connection that was lost.
    pub fn resume(&mut self, manifest: Arc<Manifest>) {
        if self.manifest.is_none() && self.stats.sessions == 0 {
            self.held.start(manifest.grid_levels);
            self.manifest = Some(manifest);
        }
    }

    /// Parts of a page that the caller has by itself: they count as delivered, and the server is
    /// told by Have. Whether they continue what is here; if not, they are not to be used.
    pub fn adopt(&mut self, chunk: &Chunk) -> bool {
        if !self.held.continues(chunk) {
            return false;
        }
        self.flights.cancel(chunk.page);
        self.held.add(chunk);
        let told = matches!(
            self.state,
            LinkState::Greeting { .. } | LinkState::Open { .. }
        );
        if told && let Some(have) = self.held.announce(chunk.page) {
            self.claims.have(have);
        }
        true
    }
}
