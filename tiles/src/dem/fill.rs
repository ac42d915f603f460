//! Voids filled on request: those that data encloses, up to a size.
//!
//! A void is a connected set of samples without data, diagonal neighbours included. One that
//! reaches the border of the source is no void but the outside, and stays as it is: a fill never
//! moves the outline of the data. An enclosed one takes the heights of a membrane that hangs in
//! its rim (`membrane`).
//!
//! All voids are found, and filled, in one reading of the source before the first row is given
//! (`voids`), so that heights do not depend on the bands that are asked for. Memory is that of
//! the voids that are being followed, and of the heights that were filled.

mod membrane;
mod voids;

use super::{DemError, DemInfo, DemSource, Grain, OverlapReport};
use escarp_proto::manifest::Resampling;
use rayon::prelude::*;
use std::ops::Range;
use voids::{Void, Voids};

/// The largest void that can be asked to be filled, in samples.
pub const MAX_FILL_SAMPLES: u32 = 1 << 22;

/// The largest void that is filled if nothing else is said, in samples: 512 x 512.
pub const DEFAULT_FILL_SAMPLES: u32 = 1 << 18;

/// What voids and their fills may take in memory.
const MOST_BYTES: usize = 384 << 20;

/// Rows that are read at a time while voids are looked for.
const SEARCH_ROWS: u32 = 64;

/// Filled samples of one row, next to each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FilledRun {
    /// Row of the source, from the north.
    pub row: u32,
    /// The first column.
    pub column: u32,
    /// Samples.
    pub length: u32,
}

/// What was filled.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Fills {
    /// Filled samples, by row, then column.
    pub runs: Vec<FilledRun>,
    /// Filled samples in all.
    pub samples: u64,
    /// Filled voids.
    pub voids: u64,
    /// Enclosed voids that were too large, and stay holes.
    pub left: u64,
}

/// A source with its enclosed voids filled.
pub struct Filled {
    source: Box<dyn DemSource>,
    fills: Fills,
    /// Where each run's heights start.
    starts: Vec<usize>,
    heights: Vec<f64>,
}

impl Filled {
    /// Reads the whole source once, and fills each enclosed void of at most `max_samples`
    /// samples. `progress` is told of rows done, and rows in all.
    ///
    /// # Errors
    /// [`DemError::Usage`] for `max_samples` beyond [`MAX_FILL_SAMPLES`]; [`DemError::Limits`] if
    /// the voids take too much memory; what reading the source says.
    pub fn new(
        mut source: Box<dyn DemSource>,
        max_samples: u32,
        progress: &dyn Fn(u64, u64),
    ) -> Result<Filled, DemError> {
        let info = source.info().clone();
        if !(1..=MAX_FILL_SAMPLES).contains(&max_samples) {
            let what = format!("filling voids of up to {max_samples} samples");
            let hint = format!("give 1 to {MAX_FILL_SAMPLES}");
            return Err(DemError::usage(&info.path, what, hint));
        }
        let step_m = info.sample_type.is_integer().then_some(info.height_step_m);
        let mut voids = Voids::new(info.width, info.height, max_samples);
        let mut found = Found::default();
        let mut band = vec![0.0; SEARCH_ROWS.min(info.height) as usize * info.width as usize];
        for first in (0..info.height).step_by(SEARCH_ROWS as usize) {
            let rows = SEARCH_ROWS.min(info.height - first);
            let band = &mut band[..rows as usize * info.width as usize];
            source.read_rows(first, rows, band)?;
            for heights in band.chunks_exact(info.width as usize) {
                voids.push_row(heights);
            }
            found.fill(voids.take_closed(), step_m);
            let bytes = voids.bytes() + found.bytes();
            if bytes > MOST_BYTES {
                let what = "the memory for its voids (fill smaller ones only: --fill N)";
                let (bytes, most) = (bytes as u64, MOST_BYTES as u64);
                return Err(DemError::limits(&info.path, what, bytes, most, "bytes"));
            }
            progress(u64::from(first + rows), u64::from(info.height));
        }
        Ok(found.finish(source, voids.too_large()))
    }
}

impl DemSource for Filled {
    fn info(&self) -> &DemInfo {
        self.source.info()
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.source.read_rows(first_row, rows, out)?;
        let width = self.source.info().width as usize;
        let runs = &self.fills.runs;
        let start = runs.partition_point(|run| run.row < first_row);
        let end = runs.partition_point(|run| run.row < first_row + rows);
        for (run, &from) in runs[start..end].iter().zip(&self.starts[start..end]) {
            let to = (run.row - first_row) as usize * width + run.column as usize;
            let length = run.length as usize;
            out[to..to + length].copy_from_slice(&self.heights[from..from + length]);
        }
        Ok(())
    }

    fn grains(&mut self, first_row: u32, rows: u32, out: &mut [Grain]) -> Result<(), DemError> {
        self.source.grains(first_row, rows, out)
    }

    fn is_nested(&self) -> bool {
        self.source.is_nested()
    }

    fn finish(&mut self) -> Result<(), DemError> {
        self.source.finish()
    }

    fn resampling(&self) -> Option<Resampling> {
        self.source.resampling()
    }

    fn overlaps(&self) -> Option<OverlapReport> {
        self.source.overlaps()
    }

    fn data_columns(&self, first_row: u32, rows: u32) -> Vec<Range<u32>> {
        // Only enclosed voids are filled, but a rim and its void may lie in different bands.
        let runs = &self.fills.runs;
        let at = runs.partition_point(|run| run.row < first_row);
        match runs.get(at) {
            Some(run) if run.row < first_row + rows => {
                std::iter::once(0..self.info().width).collect()
            }
            _ => self.source.data_columns(first_row, rows),
        }
    }

    fn fills(&self) -> Option<&Fills> {
        Some(&self.fills)
    }
}

/// Filled voids, in the order in which they were closed.
#[derive(Default)]
struct Found {
    runs: Vec<(FilledRun, usize)>,
    heights: Vec<f64>,
    voids: u64,
}

impl Found {
    fn bytes(&self) -> usize {
        self.runs.len() * size_of::<(FilledRun, usize)>() + self.heights.len() * size_of::<f64>()
    }

    /// Fills voids, small ones on all cores.
    fn fill(&mut self, voids: Vec<Void>, step_m: Option<f64>) {
        let filled: Vec<Vec<f64>> = voids
            .par_iter()
            .map(|void| membrane::fill(void, step_m))
            .collect();
        for (void, heights) in voids.iter().zip(filled) {
            let mut from = self.heights.len();
            self.heights.extend(heights);
            self.voids += 1;
            for run in void.runs() {
                self.runs.push((*run, from));
                from += run.length as usize;
            }
        }
    }

    fn finish(mut self, source: Box<dyn DemSource>, left: u64) -> Filled {
        self.runs
            .sort_unstable_by_key(|(run, _)| (run.row, run.column));
        let (runs, starts) = self.runs.into_iter().unzip();
        Filled {
            source,
            fills: Fills {
                runs,
                samples: self.heights.len() as u64,
                voids: self.voids,
                left,
            },
            starts,
            heights: self.heights,
        }
    }
}

#[cfg(test)]
mod tests;
