//! A new generation of a dataset in which a part is different. What did not change is shared with
//! the generation before; the cost follows the patch, not the dataset.
//!
//! The result is that of building anew from the merged inputs: finest pages are made anew where a
//! sample changed, and of the pages above those whose samples or child slots changed because of
//! it, up to the root. A level's pages are made by the code that builds them.

mod compact;
mod extremes;
mod fills;
mod finest;
mod mend;
pub(crate) mod old;
mod place;

pub use compact::{CompactReport, compact};

use crate::build::{BuildError, FAMILY_CELLS, Level, Progress, Rows, SourceRows};
use crate::dataset::{Dataset, DatasetWriter, FilledRun, FilledRuns};
use crate::dem::DemSource;
use escarp_proto::manifest::Manifest;
use escarp_proto::page::Codec;
use escarp_proto::page::Range;
use extremes::{End, extreme};
use fills::fills_of_row;
use finest::{Finest, Patch, PatchBand, Sums, Wish, families, mend_finest};
use mend::{Change, Mended, mend_above, reached};
use place::{Rectangle, place, rectangle};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// What is to change.
pub struct Edit<'a> {
    /// Heights that replace those of the dataset; of several, the one named first counts. Holes
    /// of a patch leave the dataset as it is.
    pub patches: Vec<&'a mut dyn DemSource>,
    /// Rectangles `[west, south, east, north]`, in units of the dataset's coordinate system, that
    /// become holes where no patch has data.
    pub remove: Vec<[f64; 4]>,
    /// Names of the patches, for the manifest.
    pub sources: Vec<String>,
}

/// What an update did.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct UpdateReport {
    /// The published generation: a new one, or the old one if nothing changed.
    pub generation: u64,
    /// Samples that changed.
    pub changed: u64,
    /// Of these, how many were holes.
    pub added: u64,
    /// Of these, how many are holes now.
    pub removed: u64,
    /// Records that were made anew.
    pub pages: u64,
    /// Families that were written.
    pub families: u64,
    /// Bytes of records that were written.
    pub bytes: u64,
}

/// Publishes a new generation of a dataset with some samples changed, using the current rayon
/// thread pool. The generations before stay on disk for their readers.
///
/// # Errors
/// [`BuildError`]; what was published before stays.
pub fn update(
    dataset: &Dataset,
    edit: Edit<'_>,
    progress: Progress<'_>,
) -> Result<UpdateReport, BuildError> {
    let removed = removed(dataset, &edit)?;
    let mut patches = Vec::new();
    for source in edit.patches {
        let place = place(dataset.manifest(), source.info())?;
        let fills = placed_fills(source, place);
        let rows = SourceRows::new(source, dataset.manifest().georef.quantum_m);
        patches.push(Patch { place, rows, fills });
    }
    let mut run = Run {
        dataset,
        writer: DatasetWriter::extend(dataset)?,
        pages: 0,
        families: 0,
        filled: dataset.filled()?,
        fills: Vec::new(),
    };
    let manifest = dataset.manifest();
    let [width, height] = manifest.samples;
    let finest = Level::new(
        manifest.grid_levels,
        manifest.grid_levels.finest_page_level(),
        [width, height],
        // A manifest with another codec is refused when it is read.
        Codec::from_u8(manifest.codec).unwrap_or(Codec::Dense),
    );
    let reach: Vec<Rectangle> = patches.iter().map(|patch| patch.place).collect();
    let reach = [reach, removed.clone()].concat();
    let (sums, change) = run.finest(&finest, &mut patches, &removed, &reach, progress)?;
    let mut report = UpdateReport {
        generation: manifest.generation,
        changed: sums.changed,
        added: sums.added,
        removed: sums.removed,
        pages: 0,
        families: 0,
        bytes: 0,
    };
    let filled = run.filled(&reach);
    if sums.changed == 0 && filled == run.filled {
        return Ok(report);
    }
    run.above(finest, change)?;
    let mut next = manifest.clone();
    let valid_samples = manifest.valid_samples.checked_add(sums.added);
    let valid_samples = valid_samples.and_then(|all| all.checked_sub(sums.removed));
    next.valid_samples = valid_samples.ok_or_else(|| BuildError::Unfit {
        path: dataset.folder().to_path_buf(),
        why: format!(
            "its manifest says {} samples with data, but {} were removed",
            manifest.valid_samples, sums.removed
        ),
    })?;
    next.height_range = range(dataset, &sums, &reach)?;
    if next.height_range.is_none() {
        return Err(BuildError::Unfit {
            path: dataset.folder().to_path_buf(),
            why: "no sample would have data any more".into(),
        });
    }
    for stored in patches.iter().filter_map(|patch| patch.rows.stored()) {
        next.storage_error_m = next.storage_error_m.max(stored.largest_error_m);
    }
    next.filled = run.writer.write_filled(&filled)?;
    add_sources(&mut next, edit.sources);
    (report.pages, report.families) = (run.pages, run.families);
    report.bytes = run.writer.bytes();
    report.generation = run.writer.publish_beside(next)?.generation;
    Ok(report)
}

/// Samples of a patch that are fill, in the grid of the dataset.
fn placed_fills(source: &dyn DemSource, place: Rectangle) -> Arc<FilledRuns> {
    let runs = source.fills().map_or(&[][..], |fills| &fills.runs);
    let placed = runs.iter().map(|run| FilledRun {
        y: place.y[1] - run.row,
        x: place.x[0] + run.column,
        length: run.length,
    });
    Arc::new(FilledRuns::new(placed.collect()))
}

/// The rectangles that are to be removed.
fn removed(dataset: &Dataset, edit: &Edit<'_>) -> Result<Vec<Rectangle>, BuildError> {
    let found = edit.remove.iter().map(|&bounds| {
        rectangle(dataset.manifest(), bounds).ok_or_else(|| BuildError::Unfit {
            path: dataset.folder().to_path_buf(),
            why: format!(
                "no sample lies within {bounds:?}; give west, south, east, north in units of the \
                 dataset's coordinate system"
            ),
        })
    });
    found.collect()
}

/// Names of inputs that a manifest keeps.
const MOST_SOURCES: usize = 256;

fn add_sources(manifest: &mut Manifest, more: Vec<String>) {
    for source in more {
        if manifest.sources.len() < MOST_SOURCES && !manifest.sources.contains(&source) {
            manifest.sources.push(source);
        }
    }
}

/// Lowest and highest height after the change.
fn range(
    dataset: &Dataset,
    sums: &Sums,
    reach: &[Rectangle],
) -> Result<Option<[i32; 2]>, BuildError> {
    let mut range = sums.range;
    if let Some([lo, hi]) = dataset.manifest().height_range {
        // A sample with the lowest height is left, or others must be looked at.
        let ends = [(End::Lowest, lo), (End::Highest, hi)];
        for ((end, height), is_gone) in ends.into_iter().zip(sums.extremes) {
            let found = match is_gone && !(range.lo <= height && height <= range.hi) {
                true => extreme(dataset, end, reach)?,
                false => Some(height),
            };
            range = found.map_or(range, |height| range.with(height));
        }
    }
    Ok((!range.is_empty()).then_some([range.lo, range.hi]))
}

struct Run<'a> {
    dataset: &'a Dataset,
    writer: DatasetWriter,
    pages: u64,
    families: u64,
    /// Samples that were fill before.
    filled: FilledRuns,
    /// Samples in rows within reach that are fill now.
    fills: Vec<FilledRun>,
}

impl Run<'_> {
    /// Samples that are fill now.
    fn filled(&self, reach: &[Rectangle]) -> FilledRuns {
        let is_touched = |y: u32| reach.iter().any(|r| r.y[0] <= y && y <= r.y[1]);
        let before = self.filled.runs().iter();
        let untouched = before.filter(|run| !is_touched(run.y)).copied();
        FilledRuns::new(untouched.chain(self.fills.iter().copied()).collect())
    }

    /// Mends the finest level, a row of families at a time, from north to south.
    fn finest(
        &mut self,
        level: &Level,
        patches: &mut [Patch<'_>],
        removed: &[Rectangle],
        reach: &[Rectangle],
        progress: Progress<'_>,
    ) -> Result<(Sums, Change), BuildError> {
        let (columns, rows) = level.pages();
        let touched: BTreeSet<usize> = reach.iter().flat_map(|r| families(r.y, rows)).collect();
        let [lo, hi] = self.dataset.manifest().height_range.unwrap_or([0, 0]);
        let (mut sums, mut change) = (Sums::NOTHING, Change::default());
        for (done, &row) in touched.iter().rev().enumerate() {
            let bands = patches.iter_mut().map(|patch| patch.band(row));
            let bands: Vec<Option<PatchBand>> = bands.collect::<Result<_, _>>()?;
            let bands: Vec<PatchBand> = bands.into_iter().flatten().collect();
            let wish = Wish {
                patches: &bands,
                removed,
                reach,
                range: Range { lo, hi },
            };
            let [width, height] = self.dataset.manifest().samples;
            for y in own_rows(row, height) {
                if reach.iter().any(|r| r.y[0] <= y && y <= r.y[1]) {
                    let fills = fills_of_row(&wish, &self.filled, y, width);
                    self.fills.extend(fills);
                }
            }
            let own = |r: &&Rectangle| families(r.y, rows).contains(&row);
            let across = reach
                .iter()
                .filter(own)
                .flat_map(|r| families(r.x, columns));
            let across: Vec<usize> = across.collect::<BTreeSet<_>>().into_iter().collect();
            let made = across
                .par_iter()
                .map(|&column| mend_finest(self.dataset, level, (column, row), &wish))
                .collect::<Result<Vec<Option<Finest>>, _>>()?;
            for made in made.into_iter().flatten() {
                sums = sums.merge(made.sums);
                change.samples.extend(made.corners);
                if let Some(mended) = made.mended {
                    self.take(mended, &mut change)?;
                }
            }
            progress(done as u64 + 1, touched.len() as u64);
        }
        Ok((sums, change))
    }

    /// Mends all levels above the finest, as far as the change reaches.
    fn above(&mut self, finest: Level, mut change: Change) -> Result<(), BuildError> {
        let mut level = finest;
        while let Some(above) = level.above() {
            level = above;
            let reached: BTreeMap<_, _> = reached(&level, &change);
            let families: Vec<_> = reached.iter().collect();
            let made = families
                .par_iter()
                .map(|(at, pages)| mend_above(self.dataset, &level, **at, pages, &change))
                .collect::<Result<Vec<Mended>, _>>()?;
            let mut next = Change {
                samples: corners(&change),
                ..Change::default()
            };
            for mended in made {
                self.take(mended, &mut next)?;
            }
            change = next;
        }
        Ok(())
    }

    /// Writes a family, and notes what the level above has to know.
    fn take(&mut self, mended: Mended, change: &mut Change) -> Result<(), BuildError> {
        change.slots.extend(mended.slots);
        let Some(bytes) = mended.bytes else {
            return Ok(());
        };
        self.pages += mended.pages_changed;
        self.families += 1;
        self.writer.replace(mended.family, mended.pages_before)?;
        match bytes {
            Some(bytes) => Ok(self.writer.append(&bytes)?),
            None => Ok(()),
        }
    }
}

/// Rows of samples that count as those of a row of families, not of the one to its north.
fn own_rows(row: usize, height: u32) -> std::ops::Range<u32> {
    let cells = FAMILY_CELLS as u32;
    let first = row as u32 * cells;
    match first + cells + 1 >= height {
        true => first..height,
        false => first..first + cells,
    }
}

/// The changed samples that the level above has as well, in its own columns and rows.
fn corners(change: &Change) -> std::collections::HashMap<(u32, u32), i32> {
    let side = escarp_proto::geometry::PAGE_CELLS as u32;
    let shared = change
        .samples
        .iter()
        .filter(|((x, y), _)| x % side == 0 && y % side == 0);
    shared
        .map(|(&(x, y), &height)| ((x / side, y / side), height))
        .collect()
}
