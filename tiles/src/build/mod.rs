//! One bottom-up pass from rows of heights to a published dataset.
//!
//! The finest pages are made band by band, 256 rows of cells at a time, from north to south as
//! the rows come. Each band's families are encoded on all cores. What a band leaves behind is one
//! height and one child slot a page: the samples and slots of the level above, a 256th in size.
//! The levels above are then made in the same way from memory. Memory is bounded by two bands and
//! a few bytes for each finest page; nothing is written but the dataset itself.

mod level;
mod quantise;
mod regions;
mod rows;

pub use quantise::{Quantum, choose_quantum};
pub use regions::{Coarsened, Tolerances, Wish};

use crate::dataset::{DatasetError, DatasetWriter, FilledRun, FilledRuns};
use crate::dem::{self, DemError, DemSource, Fills};
use crate::frame::georef_of;
use escarp_proto::geometry::GridLevels;
use escarp_proto::manifest::{FORMAT, FileCheck, Manifest, VERSION};
use escarp_proto::page::PageError;
use level::{Level, MemoryRows};
use rows::{SourceRows, Stored};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// No dataset has more samples, holes included: a few bytes are kept for 256 of them.
pub const MAX_SAMPLES: u64 = 1 << 36;

/// Why a build stopped. Nothing is published then.
#[derive(Debug, Error)]
pub enum BuildError {
    /// The input cannot be read.
    #[error(transparent)]
    Dem(#[from] DemError),
    /// The dataset cannot be written.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// A page cannot be made.
    #[error(transparent)]
    Page(#[from] PageError),
    /// The data does not fit what a dataset can hold.
    #[error("{}: {why}", path.display())]
    Unfit {
        /// The input.
        path: PathBuf,
        /// What was found, and what is allowed.
        why: String,
    },
}

/// How to build.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BuildOptions {
    /// Metres a unit of stored height.
    pub quantum: Quantum,
    /// Replace what is published under the same name.
    pub overwrite: bool,
}

/// What a build is about to say of itself: rows of the finest level done, and rows in all.
pub type Progress<'a> = &'a (dyn Fn(u64, u64) + Sync);

/// Builds and publishes a dataset from a source, using the current rayon thread pool.
///
/// # Errors
/// [`BuildError`]; what was published before stays.
pub fn build(
    source: &mut dyn DemSource,
    folder: &Path,
    sources: Vec<String>,
    options: BuildOptions,
    progress: Progress<'_>,
) -> Result<Manifest, BuildError> {
    let info = source.info().clone();
    let unfit = |why: String| BuildError::Unfit {
        path: info.path.clone(),
        why,
    };
    let grid = GridLevels::covering(info.width, info.height)
        .ok_or_else(|| unfit(format!("{} x {} samples", info.width, info.height)))?;
    if u64::from(info.width) * u64::from(info.height) > MAX_SAMPLES {
        return Err(unfit(format!(
            "{} x {} samples, allowed are {MAX_SAMPLES} in all; are the inputs of one area?",
            info.width, info.height
        )));
    }
    let quantum_m = choose_quantum(source, options.quantum)?;
    let mut manifest = Manifest {
        format: FORMAT.into(),
        version: VERSION,
        generation: 0,
        grid_levels: grid,
        samples: [info.width, info.height],
        valid_samples: 0,
        height_range: None,
        georef: georef_of(&info, quantum_m),
        storage_error_m: 0.0,
        codec: 0,
        pages: 0,
        segments: Vec::new(),
        index: FileCheck {
            bytes: 0,
            crc32c: 0,
        },
        sources,
        filled: None,
        tolerances: Vec::new(),
    };
    manifest.check().map_err(unfit)?;
    let mut writer = DatasetWriter::create(folder, options.overwrite)?;
    let stored = write_pages(source, &manifest, &mut writer, progress)?;
    if stored.valid_samples == 0 {
        return Err(unfit("no sample has data: every one is a hole".into()));
    }
    manifest.filled = match source.fills() {
        Some(fills) if fills.samples > 0 => {
            Some(writer.write_filled(&grid_runs(fills, info.height))?)
        }
        _ => None,
    };
    manifest.valid_samples = stored.valid_samples;
    manifest.height_range = stored.range;
    manifest.tolerances = source.tolerances();
    let moved_m = manifest.tolerances.iter().map(|t| t.largest_error_m);
    manifest.storage_error_m = stored.largest_error_m + moved_m.fold(0.0, f64::max);
    if !manifest.tolerances.is_empty() && quantum_m.fract() != 0.0 {
        // Differences of heights in such steps are rounded when they are taken.
        let largest = stored.range.map_or(0, |[lo, hi]| lo.abs().max(hi.abs()));
        manifest.storage_error_m += f64::from(largest) * quantum_m * 4.0 * f64::EPSILON;
    }
    Ok(writer.publish(manifest)?)
}

/// Filled samples by grid rows, which are counted from the south.
fn grid_runs(fills: &Fills, height: u32) -> FilledRuns {
    let run = |run: &dem::FilledRun| FilledRun {
        y: height - 1 - run.row,
        x: run.column,
        length: run.length,
    };
    FilledRuns::new(fills.runs.iter().map(run).collect())
}

/// Makes the pages of all levels, finest first.
fn write_pages(
    source: &mut dyn DemSource,
    manifest: &Manifest,
    writer: &mut DatasetWriter,
    progress: Progress<'_>,
) -> Result<Stored, BuildError> {
    let (grid, [width, height]) = (manifest.grid_levels, manifest.samples);
    let mut rows = SourceRows::new(source, manifest.georef.quantum_m);
    let mut level = Level::new(grid, grid.finest_page_level(), width, height);
    let mut left = level.run(&mut rows, writer, progress)?;
    let stored = rows.summary();
    while let Some(above) = level.above(&left) {
        level = above;
        left = level.run(&mut MemoryRows::new(left), writer, &|_, _| {})?;
    }
    Ok(stored)
}
