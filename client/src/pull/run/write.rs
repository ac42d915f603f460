//! The pages of the new dataset, tile by tile and then upwards, written as they are made.

use super::super::PullError;
use super::super::build::{Built, Made, MadePages, Tally, build_above};
use super::super::plan::{Fate, children, slot_corners};
use super::super::spool::{Records, Spool};
use super::{PullReport, Work};
use crate::net::Url;
use escarp_dataset::{DatasetWriter, FamilyBytes, FamilyId};
use escarp_proto::geometry::{PAGE_LEVELS, PageId, Slot};
use escarp_proto::page::{ChildSlot, Range, implied_cell};
use rayon::prelude::*;

/// Tiles of a single page that share a journal.
const SMALL_TILES: usize = 64;

impl Work<'_> {
    pub(super) fn write(mut self, url: &Url, error_m: f64) -> Result<PullReport, PullError> {
        let Some(part) = self.part.take() else {
            return Err(PullError::Usage("nothing is to be written".into()));
        };
        let mut writer = DatasetWriter::create(&part.dataset(), true)?;
        self.part = Some(part);
        let mut made = self.tiles(&mut writer)?;
        let mut level = self.tile_level();
        while level > self.plan.frame.base {
            level -= PAGE_LEVELS;
            made = self.level(level, made, &mut writer)?;
        }
        let root = self.root(made, &mut writer)?;
        if root.slot == ChildSlot::Empty {
            return Err(PullError::Usage(
                "there is no data within the bounds".into(),
            ));
        }
        let manifest = self.new_manifest(url, error_m);
        let storage_error_m = manifest.storage_error_m;
        let published = writer.publish(manifest)?;
        let received = self.fetcher.received;
        if let Some(part) = self.part.take() {
            part.publish()?;
        }
        Ok(PullReport {
            pages: received.pages,
            bytes: received.bytes,
            stored_pages: published.pages,
            samples: self.plan.frame.samples,
            storage_error_m,
        })
    }

    /// All tiles, one after the other. What was made of them, by page of the old grid.
    fn tiles(&mut self, writer: &mut DatasetWriter) -> Result<MadePages, PullError> {
        let tiles = self.stored(self.tile_level());
        let together = match tiles.first() {
            Some(tile) if tile.level() + 2 * PAGE_LEVELS == self.finest() => 1,
            _ => SMALL_TILES,
        };
        self.tiles = [0, tiles.len()];
        let mut made = MadePages::new();
        for (number, stretch) in tiles.chunks(together).enumerate() {
            let (mut spool, mut records) = self.stretch(1 + number)?;
            for &tile in stretch {
                let own = self.tile(tile, &mut records, spool.as_mut(), writer)?;
                made.insert(tile, own);
                self.tiles[0] += 1;
            }
        }
        Ok(made)
    }

    fn tile(
        &mut self,
        tile: PageId,
        records: &mut Records,
        mut spool: Option<&mut Spool>,
        writer: &mut DatasetWriter,
    ) -> Result<Made, PullError> {
        let middle = self.open_tile(tile, records, spool.as_deref_mut())?;
        let parents = self.parents(tile);
        let finest: Vec<PageId> = parents.iter().copied().flat_map(children).collect();
        self.get(&finest, records, spool)?;
        let (plan, codec, here) = (&self.plan, self.codec, &*records);
        let of_parents: Vec<(PageId, Built)> = parents
            .par_iter()
            .map(|&parent| Ok((parent, plan.build_parent(parent, here, codec)?)))
            .collect::<Result<_, PullError>>()?;
        let mut below = MadePages::new();
        for (parent, built) in of_parents {
            below.insert(parent, self.take(built, writer)?);
        }
        let own = match below.remove(&tile) {
            Some(own) => own,
            None => self.built(tile, &below, writer)?,
        };
        finest.iter().for_each(|page| drop(records.remove(page)));
        middle
            .iter()
            .for_each(|page| drop(self.plan.nodes.remove(page)));
        Ok(own)
    }

    fn take(&mut self, built: Built, writer: &mut DatasetWriter) -> Result<Made, PullError> {
        self.tally = self.tally.and(built.tally);
        if let Some(family) = &built.family {
            writer.append(family)?;
        }
        Ok(built.made)
    }

    /// A page of the plan, from what was made of those below it.
    fn built(
        &mut self,
        page: PageId,
        below: &MadePages,
        writer: &mut DatasetWriter,
    ) -> Result<Made, PullError> {
        let missing = || PullError::Contradiction(format!("page {page} is not known"));
        let node = self.plan.nodes.get(&page).ok_or_else(missing)?;
        let built = self
            .plan
            .build(node, self.codec, |child| below.get(&child).cloned())?;
        self.take(built, writer)
    }

    fn level(
        &mut self,
        level: u8,
        below: MadePages,
        writer: &mut DatasetWriter,
    ) -> Result<MadePages, PullError> {
        let mut made = MadePages::new();
        for page in self.stored(level) {
            made.insert(page, self.built(page, &below, writer)?);
        }
        Ok(made)
    }

    /// From the base pages up to the root of the new grid.
    fn root(&mut self, mut base: MadePages, writer: &mut DatasetWriter) -> Result<Made, PullError> {
        let frame = self.plan.frame;
        let mut renamed = MadePages::new();
        for page in frame.pages(frame.base) {
            let made = match (self.plan.fate(page), page.parent()) {
                (Fate::Implied(error), Some((parent, slot))) => {
                    let Some(above) = self.plan.above.get(&parent) else {
                        continue;
                    };
                    let corners = slot_corners(slot).map(|corner| above.height(corner));
                    let heights = corners.into_iter().fold(Range::EMPTY, Range::with);
                    let samples = self.plan.owned(page);
                    self.tally = self.tally.and(Tally {
                        error,
                        heights,
                        samples,
                    });
                    Some(Made {
                        slot: implied_cell(corners, frame.levels_from(page.level())),
                        record: None,
                    })
                }
                _ => base.remove(&page),
            };
            if let (Some(made), Some(new)) = (made, frame.renamed(page)) {
                renamed.insert(new, made);
            }
        }
        let mut append = |family: &FamilyBytes| Ok(writer.append(family)?);
        let mut top = build_above(&self.plan, self.codec, renamed, &mut append)?;
        let root = top.remove(&PageId::ROOT);
        let root =
            root.ok_or_else(|| PullError::Usage("there is no data within the bounds".into()))?;
        let record = root.record.clone().unwrap_or_default();
        let family = FamilyBytes::encode(FamilyId::ROOT, &[(Slot::from_index(0), record)]);
        if let Some(family) = family {
            writer.append(&family)?;
        }
        Ok(root)
    }
}
