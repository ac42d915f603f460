//! One bottom-up pass from rows of heights to a published dataset.
//!
//! The finest pages are made band by band, 256 rows of cells at a time, from north to south as
//! the rows come. Each band's families are encoded on all cores. What a band leaves behind is one
//! height and one child slot a page: the samples and slots of the level above, a 256th in size.
//! The levels above are then made in the same way from memory. The next band is read meanwhile.
//! Memory is bounded by two bands and a few bytes for each finest page; nothing is written but the dataset itself.

mod above;
mod band;
mod checkpoint;
mod level;
mod quantise;
mod regions;
mod rows;

pub(crate) use above::Slots;
pub(crate) use band::Band;
pub(crate) use level::{FAMILY_CELLS, Level};
pub(crate) use quantise::HOLE;
pub use quantise::{Quantum, choose_quantum};
pub use regions::{Coarsened, Tolerances, Wish};
pub(crate) use rows::{Rows, SourceRows};

use crate::dataset::{DatasetError, DatasetWriter, FilledRun, FilledRuns};
use crate::dem::{self, DemError, DemSource, Fills};
use crate::frame::{georef_of, scale_error_percent};
use above::MemoryRows;
use checkpoint::Checkpoints;
use escarp_proto::geometry::{GridLevels, MAX_GRID_LEVELS};
use escarp_proto::manifest::{FORMAT, FileCheck, Manifest, VERSION};
use escarp_proto::page::{Codec, PageError};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// No dataset has more samples, holes included: a few bytes are kept for 256 of them.
pub const MAX_SAMPLES: u64 = 1 << 36;

/// Samples between two checkpoints: a few seconds of work.
pub const CHECKPOINT_SAMPLES: u64 = 1 << 26;

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
#[derive(Debug, Clone, PartialEq)]
pub struct BuildOptions {
    /// Metres a unit of stored height.
    pub quantum: Quantum,
    /// How records are coded.
    pub codec: Codec,
    /// Replace what is published under the same name.
    pub overwrite: bool,
    /// Go on with what an unfinished build left behind, if it left anything.
    pub resume: bool,
    /// What else decides the result, in words: a build goes on only with the work of one that
    /// said the same.
    pub identity: Vec<String>,
    /// Go on although lines of `identity` that start with `input` differ: the user vouches that
    /// what was read before is the same, as when a bad block was repaired.
    pub accept_changed: bool,
    /// Samples between two checkpoints. The result does not depend on it.
    pub checkpoint_samples: u64,
}

impl Default for BuildOptions {
    fn default() -> Self {
        BuildOptions {
            quantum: Quantum::Natural,
            codec: Codec::Dense,
            overwrite: false,
            resume: false,
            identity: Vec::new(),
            accept_changed: false,
            checkpoint_samples: CHECKPOINT_SAMPLES,
        }
    }
}

/// What a build is about to say of itself: rows of the finest level done, and rows in all.
pub type Progress<'a> = &'a (dyn Fn(u64, u64) + Sync);

/// Builds and publishes a dataset from a source, using the current rayon thread pool.
///
/// # Errors
/// [`BuildError`]; what was published before stays. If the build had come to a checkpoint, and
/// another try may do better, its files stay for [`BuildOptions::resume`].
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
    let grid = GridLevels::covering(info.width, info.height).ok_or_else(|| {
        unfit(format!(
            "{} x {} samples, allowed are 2^{MAX_GRID_LEVELS} + 1 a side",
            info.width, info.height
        ))
    })?;
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
        codec: options.codec as u8,
        pages: 0,
        segments: Vec::new(),
        index: FileCheck {
            bytes: 0,
            crc32c: 0,
        },
        sources,
        vertical: info.vertical.clone(),
        scale_error_percent: scale_error_percent(&info),
        resampling: None,
        filled: None,
        tolerances: Vec::new(),
    };
    manifest.check().map_err(unfit)?;
    let mut writer = match options.resume {
        true => DatasetWriter::reopen(folder, options.overwrite)?,
        false => DatasetWriter::create(folder, options.overwrite)?,
    };
    let size = [info.width, info.height];
    let finest = Level::new(grid, grid.finest_page_level(), size, options.codec);
    let mut checkpoints = Checkpoints::open(&mut writer, &manifest, &options, finest)?;
    let mut rows = SourceRows::new(source, quantum_m);
    let written = write_pages(finest, &mut rows, &mut writer, &mut checkpoints, progress);
    if let Err(BuildError::Unfit { .. } | BuildError::Page(_)) = &written {
        // The same input will not do better next time.
        writer.keep_unfinished(false);
    }
    written?;
    let stored = checkpoints.stored();
    if stored.valid_samples == 0 {
        writer.keep_unfinished(false);
        return Err(unfit("no sample has data: every one is a hole".into()));
    }
    manifest.filled = match source.fills() {
        Some(fills) => writer.write_filled(&grid_runs(fills, info.height))?,
        None => None,
    };
    manifest.valid_samples = stored.valid_samples;
    manifest.height_range = stored.range;
    source.finish()?;
    manifest.resampling = source.resampling();
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
    finest: Level,
    rows: &mut SourceRows<'_>,
    writer: &mut DatasetWriter,
    checkpoints: &mut Checkpoints,
    progress: Progress<'_>,
) -> Result<(), BuildError> {
    let mut level = finest;
    let mut left = level.run(rows, None, writer, checkpoints, progress)?;
    while let Some(above) = level.above() {
        level = above;
        let slots = Some(&left.slots);
        left = level.run(
            &mut MemoryRows::new(&left),
            slots,
            writer,
            checkpoints,
            &|_, _| {},
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::SynthSource;
    use std::collections::BTreeMap;
    use std::fs;

    /// All files of a dataset of synthetic terrain, made by so many threads.
    fn made_by(jobs: usize) -> BTreeMap<String, Vec<u8>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("made.escarp");
        let pool = rayon::ThreadPoolBuilder::new().num_threads(jobs);
        let mut source = SynthSource::new(900, 3);
        let built = pool.build().unwrap().install(|| {
            let options = BuildOptions::default();
            build(&mut source, &path, Vec::new(), options, &|_, _| {})
        });
        assert_eq!(built.unwrap().valid_samples, 810_000);
        let files = fs::read_dir(&path).unwrap().map(|file| file.unwrap());
        files
            .map(|file| {
                let name = file.file_name().into_string().unwrap();
                (name, fs::read(file.path()).unwrap())
            })
            .collect()
    }

    #[test]
    fn the_bytes_are_the_same_whatever_the_number_of_threads() {
        let one = made_by(1);
        assert!(one["seg-1-0"].len() > 100_000);
        for jobs in [2, 3, 7] {
            assert!(made_by(jobs) == one, "{jobs} threads make other bytes");
        }
    }
}
