//! The work in its order: manifest, coarse pages, then tile by tile; published at the end.

use super::PullError;
use super::build::Tally;
use super::fetch::{Fetcher, Received};
use super::frame::{Bounds, Frame, Region};
use super::plan::{Fate, Plan, children};
use super::spool::{Records, Spool};
use crate::net::Url;
use escarp_proto::geometry::{PAGE_LEVELS, PageId};
use escarp_proto::manifest::Manifest;
use escarp_proto::page::{Codec, MAX_SPAN, Page};
use std::path::PathBuf;
use std::time::Duration;

mod describe;
mod estimate;
mod folder;
mod write;

use folder::Part;

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
