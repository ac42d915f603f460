//! `--dry-run`: how much there is to pull, by a part of it.

use super::super::PullError;
use super::super::fetch::Received;
use super::super::plan::{Fate, children};
use super::super::spool::Records;
use super::{PullReport, Work};
use escarp_proto::geometry::PageId;

/// Tiles of pages that `--dry-run` looks at; of more, evenly spread ones stand for all.
const SAMPLED_TILES: usize = 16;
/// Finest pages whose length stands for that of all.
const SAMPLED_PAGES: usize = 64;

impl Work<'_> {
    /// How much there is to pull, by looking at some of the tiles.
    pub(super) fn estimate(mut self) -> Result<PullReport, PullError> {
        let tiles = self.stored(self.tile_level());
        let step = tiles.len().div_ceil(SAMPLED_TILES).max(1);
        let looked: Vec<PageId> = tiles.iter().copied().step_by(step).collect();
        let before = self.fetcher.received;
        let (mut finest, mut sample) = (0, Vec::new());
        for &tile in &looked {
            let middle = self.open_tile(tile, &mut Records::new(), None)?;
            let below = self.parents(tile).into_iter().flat_map(children);
            let fetched = below.filter(|&page| self.plan.fate(page) == Fate::Fetched);
            for page in fetched {
                finest += 1;
                if sample.len() < SAMPLED_PAGES && finest % 7 == 1 {
                    sample.push(page);
                }
            }
            middle
                .iter()
                .for_each(|page| drop(self.plan.nodes.remove(page)));
        }
        let looked_at = self.fetcher.received;
        let mut records = Records::new();
        self.fetcher
            .fetch(&sample, &mut records, None, &mut |_| {})?;
        let bytes: usize = records.values().map(Vec::len).sum();
        let share = tiles.len() as f64 / looked.len().max(1) as f64;
        let each = bytes as f64 / records.len().max(1) as f64;
        let middle = Received {
            pages: looked_at.pages - before.pages,
            bytes: looked_at.bytes - before.bytes,
        };
        let scaled = |n: f64| (n * share).ceil() as u64;
        Ok(PullReport {
            pages: before.pages + scaled(middle.pages as f64 + f64::from(finest)),
            bytes: before.bytes + scaled(middle.bytes as f64 + f64::from(finest) * each),
            stored_pages: 0,
            samples: self.plan.frame.samples,
            storage_error_m: self.storage_error_m(self.plan.most),
        })
    }
}
