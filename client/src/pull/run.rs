//! The work in its order: manifest, coarse pages, then tile by tile; published at the end.

use super::PullError;
use super::build::{Built, Made, MadePages, Tally, build_above};
use super::fetch::{Fetcher, Received};
use super::frame::{Bounds, Frame, Region};
use super::plan::{Fate, Plan, children, slot_corners};
use super::spool::{Records, Spool};
use crate::net::Url;
use escarp_dataset::{DatasetWriter, FamilyBytes, FamilyId};
use escarp_proto::geometry::{PAGE_LEVELS, PageId, Slot};
use escarp_proto::manifest::{FileCheck, Manifest, Tolerance};
use escarp_proto::page::{ChildSlot, Codec, MAX_SPAN, Page, Range, implied_cell};
use rayon::prelude::*;
use std::path::PathBuf;
use std::time::Duration;

mod folder;
use folder::Part;

/// Tiles of pages that `--dry-run` looks at; of more, evenly spread ones stand for all.
const SAMPLED_TILES: usize = 16;
/// Finest pages whose length stands for that of all.
const SAMPLED_PAGES: usize = 64;
/// Tiles of a single page that share a journal.
const SMALL_TILES: usize = 64;

/// What to pull, and where to.
#[derive(Debug, Clone)]
pub struct PullOptions {
    /// The region; `None` for all of the data.
    pub bounds: Option<Bounds>,
    /// How far heights may be from the server's, straight up or down, metres.
    pub error_m: f64,
    /// The folder to be written; it must not be there yet.
    pub output: PathBuf,
    /// Only estimate; nothing is written.
    pub dry_run: bool,
    /// A server from which no page comes for so long is given up.
    pub patience: Duration,
    /// Proof of access, if the server asks for one.
    pub token: Option<String>,
}

/// What was pulled, or would be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PullReport {
    /// Pages received, or estimated.
    pub pages: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Pages that the new dataset stores; 0 in a dry run.
    pub stored_pages: u64,
    /// Samples of the new dataset, columns and rows.
    pub samples: [u32; 2],
    /// Heights are no further than this from the sources', metres, rounded up.
    pub storage_error_m: f64,
}

/// How far the work has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Pages received.
    pub pages: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Tiles finished.
    pub tiles: usize,
    /// Of so many.
    pub all_tiles: usize,
}

/// Pulls a region. `tell` hears of progress.
///
/// # Errors
/// [`PullError`]; what was received is kept beside the target, for the next call with the same
/// options, unless the options are at fault.
pub fn pull(
    url: &Url,
    options: &PullOptions,
    tell: &mut dyn FnMut(Progress),
) -> Result<PullReport, PullError> {
    let error_m = options.error_m;
    if !(error_m.is_finite() && error_m >= 0.0) {
        return Err(PullError::Usage(format!(
            "an error of {error_m} m, allowed is 0 and more"
        )));
    }
    folder::check_target(&options.output)?;
    let mut fetcher = Fetcher::new(url, options.token.clone(), options.patience);
    let manifest = fetcher.manifest()?;
    let codec = Codec::from_u8(manifest.codec).unwrap_or(Codec::Dense);
    let region = match &options.bounds {
        Some(bounds) => Region::of(bounds, &manifest)?,
        None => Region::of(&all_of(&manifest), &manifest)?,
    };
    let frame = Frame::new(region, &manifest)?;
    let most = quanta(error_m, manifest.georef.quantum_m);
    let part = match options.dry_run {
        true => None,
        false => Some(Part::open(&options.output, url, &manifest, &region, most)?),
    };
    let mut work = Work {
        plan: Plan::new(frame, most),
        manifest: &manifest,
        codec,
        fetcher,
        part,
        rows: Records::new(),
        tally: Tally::NOTHING,
        tiles: [0, 0],
        tell,
    };
    work.coarse()?;
    match options.dry_run {
        true => work.estimate(),
        false => work.write(url, error_m),
    }
}

fn all_of(manifest: &Manifest) -> Bounds {
    let [[west, east], [south, north], _] = manifest.extent_m();
    // Of a single row or column there is no rectangle.
    let wider = |from: f64, to: f64, by: f64| if from < to { to } else { from + by };
    let [dx, dy] = manifest.georef.sample_spacing_m;
    Bounds {
        sides: [west, south, wider(west, east, dx), wider(south, north, dy)],
        is_lonlat: false,
    }
}

/// The most quanta that are no more than so many metres.
fn quanta(error_m: f64, quantum_m: f64) -> u32 {
    let most = (error_m / quantum_m).floor().min(f64::from(MAX_SPAN)) as u32;
    // The quotient may have been rounded up.
    match f64::from(most) * quantum_m > error_m {
        true => most - 1,
        false => most,
    }
}

struct Work<'a> {
    plan: Plan,
    manifest: &'a Manifest,
    codec: Codec,
    fetcher: Fetcher,
    part: Option<Part>,
    /// Records of the parents of finest pages, as long as tiles beside may need them.
    rows: Records,
    tally: Tally,
    /// Done, and all.
    tiles: [usize; 2],
    tell: &'a mut dyn FnMut(Progress),
}

impl Work<'_> {
    fn finest(&self) -> u8 {
        self.plan.frame.old.finest_page_level()
    }

    /// Level of the pages that are tiles of the work: two levels above the finest.
    fn tile_level(&self) -> u8 {
        let above = self.finest().saturating_sub(2 * PAGE_LEVELS);
        above.max(self.plan.frame.base)
    }

    /// All pages down to the tiles; they stay in memory.
    fn coarse(&mut self) -> Result<(), PullError> {
        let (mut spool, mut records) = self.stretch(0)?;
        let mut level = 0;
        while level <= self.tile_level() {
            let pages = self.plan.frame.pages(level);
            self.get(&pages, &mut records, spool.as_mut())?;
            for page in pages {
                self.place(page, &mut records)?;
            }
            level += PAGE_LEVELS;
        }
        Ok(())
    }

    /// The journal of a stretch of the work, and what it has; nothing in a dry run.
    fn stretch(&self, number: usize) -> Result<(Option<Spool>, Records), PullError> {
        match &self.part {
            None => Ok((None, Records::new())),
            Some(part) => {
                let (spool, records) = Spool::open(part.folder(), number)?;
                Ok((Some(spool), records))
            }
        }
    }

    /// Fetches those pages that have to come from the server and are not here.
    fn get(
        &mut self,
        pages: &[PageId],
        records: &mut Records,
        spool: Option<&mut Spool>,
    ) -> Result<(), PullError> {
        let is_missing =
            |page: &PageId| self.plan.fate(*page) == Fate::Fetched && !records.contains_key(page);
        let missing: Vec<PageId> = pages.iter().copied().filter(is_missing).collect();
        let [tiles, all_tiles] = self.tiles;
        let tell = &mut *self.tell;
        self.fetcher
            .fetch(&missing, records, spool, &mut |received: Received| {
                tell(Progress {
                    pages: received.pages,
                    bytes: received.bytes,
                    tiles,
                    all_tiles,
                });
            })
    }

    /// Puts a page into the plan, if it counts there.
    fn place(&mut self, id: PageId, records: &mut Records) -> Result<(), PullError> {
        if id.level() < self.plan.frame.base {
            let page = match self.plan.fate(id) {
                Fate::Fetched => self.plan.decode(id, records)?,
                _ => match self.made_above(id) {
                    Some(page) => page,
                    None => return Ok(()),
                },
            };
            self.plan.above.insert(id, page);
        } else if let Some(node) = self.plan.planned(id, records)? {
            self.plan.nodes.insert(id, node);
        }
        Ok(())
    }

    fn made_above(&self, id: PageId) -> Option<Page> {
        let (parent, slot) = id.parent()?;
        let above = self.plan.above.get(&parent);
        above?.implied_child(slot, self.plan.frame.old)
    }

    fn stored(&self, level: u8) -> Vec<PageId> {
        let pages = self.plan.frame.pages(level).into_iter();
        pages
            .filter(|&page| self.plan.fate(page).is_stored())
            .collect()
    }

    /// The pages one level below a tile, and those around them, on which theirs depend.
    fn middle(&self, tile: PageId) -> Vec<PageId> {
        if tile.level() + 2 * PAGE_LEVELS != self.finest() {
            return Vec::new();
        }
        let square = tile.square();
        let level = tile.level() + PAGE_LEVELS;
        let range = |at: u32| (16 * at).saturating_sub(1)..16 * at + 17;
        let row = |y| range(square.x).filter_map(move |x| PageId::new(level, x, y));
        range(square.y).flat_map(row).collect()
    }

    /// The parents of finest pages in a tile.
    fn parents(&self, tile: PageId) -> Vec<PageId> {
        match self.finest() - tile.level() {
            0 => Vec::new(),
            PAGE_LEVELS => vec![tile],
            _ => children(tile)
                .filter(|&page| self.plan.fate(page).is_stored())
                .collect(),
        }
    }

    /// Gets what the finest pages of a tile depend on. The pages that were put into the plan.
    fn open_tile(
        &mut self,
        tile: PageId,
        records: &mut Records,
        spool: Option<&mut Spool>,
    ) -> Result<Vec<PageId>, PullError> {
        let middle = self.middle(tile);
        for page in &middle {
            if let Some(record) = self.rows.get(page) {
                records.insert(*page, record.clone());
            }
        }
        self.get(&middle, records, spool)?;
        for page in &middle {
            self.place(*page, records)?;
        }
        for page in &middle {
            if let Some(record) = records.remove(page) {
                self.rows.insert(*page, record);
            }
        }
        // Tiles come by rows: those before the row of this one are done.
        let first = middle.first().map_or(0, |page| page.square().y);
        self.rows.retain(|page, _| page.square().y >= first);
        Ok(middle)
    }

    /// How much there is to pull, by looking at some of the tiles.
    fn estimate(mut self) -> Result<PullReport, PullError> {
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

    /// The error of heights against the sources, with so many quanta on top, metres, rounded up.
    fn storage_error_m(&self, quanta: u32) -> f64 {
        let own = f64::from(quanta) * self.manifest.georef.quantum_m;
        match quanta {
            0 => self.manifest.storage_error_m,
            _ => (self.manifest.storage_error_m + own) * (1.0 + 4.0 * f64::EPSILON),
        }
    }

    fn write(mut self, url: &Url, error_m: f64) -> Result<PullReport, PullError> {
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

    /// The server's manifest, with what is different now.
    fn new_manifest(&self, url: &Url, error_m: f64) -> Manifest {
        let (old, frame) = (self.manifest, &self.plan.frame);
        let is_whole = frame.shift == [0, 0] && frame.samples == old.samples;
        let heights = self.tally.heights;
        let storage_error_m = self.storage_error_m(self.tally.error);
        let mut sources = old.sources.clone();
        let filled = old.filled.map_or(String::new(), |filled| {
            format!(", where {} samples are no data but fill", filled.samples)
        });
        sources.push(format!("{url}, generation {}{filled}", old.generation));
        Manifest {
            grid_levels: frame.new,
            samples: frame.samples,
            valid_samples: match is_whole {
                true => old.valid_samples,
                false => self.tally.samples,
            },
            height_range: (!heights.is_empty()).then_some([heights.lo, heights.hi]),
            georef: frame.georef(&old.georef),
            storage_error_m,
            codec: self.codec as u8,
            pages: 0,
            segments: Vec::new(),
            index: FileCheck {
                bytes: 0,
                crc32c: 0,
            },
            sources,
            filled: None,
            tolerances: self.tolerances(error_m, storage_error_m),
            ..old.clone()
        }
    }

    /// What the server's dataset says of regions stored coarser, with the pull's own error.
    fn tolerances(&self, error_m: f64, storage_error_m: f64) -> Vec<Tolerance> {
        let mut all = self.manifest.tolerances.clone();
        if self.tally.error == 0 {
            return all;
        }
        let own_m = storage_error_m - self.manifest.storage_error_m;
        for tolerance in &mut all {
            tolerance.tolerance_m += error_m;
            let largest_m = (tolerance.largest_error_m + own_m) * (1.0 + 4.0 * f64::EPSILON);
            tolerance.largest_error_m = largest_m;
        }
        if all.iter().all(|tolerance| tolerance.region.is_some()) {
            all.push(Tolerance {
                tolerance_m: error_m,
                region: None,
                largest_error_m: storage_error_m,
            });
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metres_become_no_more_quanta_than_they_have() {
        assert_eq!(quanta(0.0, 0.1), 0);
        assert_eq!(quanta(1.0, 1.0), 1);
        assert_eq!(quanta(0.999, 1.0), 0);
        for quantum in [0.1, 0.3, 1e-3, 7.0] {
            for n in 0..1000 {
                let found = quanta(f64::from(n) * quantum, quantum);
                assert!(f64::from(found) * quantum <= f64::from(n) * quantum);
                assert!(found + 1 >= n, "{found} of {n}");
            }
        }
        assert_eq!(quanta(1e300, 1e-9), MAX_SPAN);
    }
}
