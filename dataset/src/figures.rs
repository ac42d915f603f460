//! What it took to build a generation: kept beside it for people, in `build-<g>.json`. Nothing
//! depends on it, and two builds that make the same dataset need not agree in it.

use super::{Dataset, DatasetError};
use serde::{Deserialize, Serialize};
use std::fs::{self, File};
use std::io::Read;
use std::path::PathBuf;

/// A longer file is not one of ours.
const MAX_BYTES: u64 = 1 << 16;

/// What it took to build.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Seconds from start to end; of the last run, where a build was resumed.
    pub wall_s: f64,
    /// Seconds of user and system time of all threads.
    pub cpu_s: f64,
    /// Largest resident set, bytes.
    pub peak_memory_bytes: u64,
    /// Threads that did the work.
    pub jobs: usize,
    /// Samples of the dataset, holes included, by `cpu_s`; `None` for a part of a build.
    pub samples_a_cpu_s: Option<f64>,
}

fn path(dataset: &Dataset) -> PathBuf {
    let generation = dataset.manifest().generation;
    dataset.folder().join(format!("build-{generation}.json"))
}

impl Figures {
    /// Keeps the figures beside the generation that is open.
    ///
    /// # Errors
    /// [`DatasetError::Io`] if the system refuses.
    pub fn keep(&self, dataset: &Dataset) -> Result<(), DatasetError> {
        let path = path(dataset);
        let mut json = serde_json::to_string_pretty(self).unwrap_or_default();
        json.push('\n');
        fs::write(&path, json).map_err(DatasetError::io(&path, "write"))
    }

    /// The figures of the generation that is open; `None` where there are none that make sense.
    pub fn of(dataset: &Dataset) -> Option<Figures> {
        let mut json = Vec::new();
        let file = File::open(path(dataset)).ok()?;
        file.take(MAX_BYTES).read_to_end(&mut json).ok()?;
        serde_json::from_slice(&json).ok()
    }
}

impl std::fmt::Display for Figures {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{:.1} s, {:.1} s CPU on {} threads",
            self.wall_s, self.cpu_s, self.jobs
        )?;
        if let Some(speed) = self.samples_a_cpu_s {
            write!(f, ", {:.1} million samples a CPU second", speed / 1e6)?;
        }
        write!(
            f,
            ", peak memory {:.0} MB",
            self.peak_memory_bytes as f64 / 1e6
        )
    }
}
