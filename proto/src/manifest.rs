//! The manifest of a dataset: JSON on disk, and the same bytes in Welcome and over HTTP.

use crate::geometry::GridLevels;
use crate::georef::Georef;
use crate::page::MAX_HEIGHT;
use serde::{Deserialize, Serialize};

/// The format's name in a manifest.
pub const FORMAT: &str = "escarp";
/// The format's version.
pub const VERSION: u32 = 1;
/// No manifest is longer.
pub const MAX_MANIFEST_BYTES: usize = 1 << 20;

/// What a dataset is, and where its parts are.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Always [`FORMAT`].
    pub format: String,
    /// Always [`VERSION`].
    pub version: u32,
    /// Counts publications, from 1.
    pub generation: u64,
    /// Depth of the grid.
    pub grid_levels: GridLevels,
    /// Columns and rows of samples in the grid's south-west corner that the sources cover.
    pub samples: [u32; 2],
    /// Samples with data.
    pub valid_samples: u64,
    /// Lowest and highest height, in quanta; absent if there is no data.
    pub height_range: Option<[i32; 2]>,
    /// From grid to world.
    pub georef: Georef,
    /// The largest difference of a stored sample from its source, metres, rounded up.
    pub storage_error_m: f64,
    /// Codec of the records.
    pub codec: u8,
    /// Pages that have a record.
    pub pages: u64,
    /// The segments, in the order of their numbers from 0.
    pub segments: Vec<Segment>,
    /// Length in bytes and CRC-32C of the index.
    pub index: FileCheck,
    /// Where the data came from, for people: the names of the input files.
    pub sources: Vec<String>,
}

/// A file of page records.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Segment {
    /// Its name in the dataset's folder.
    pub file: String,
    /// Its length.
    pub bytes: u64,
}

/// Length and checksum of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileCheck {
    /// Bytes.
    pub bytes: u64,
    /// CRC-32C.
    pub crc32c: u32,
}

impl Manifest {
    /// Reads and checks a manifest.
    ///
    /// # Errors
    /// A sentence that says what was found and what is allowed.
    pub fn from_json(json: &[u8]) -> Result<Manifest, String> {
        if json.len() > MAX_MANIFEST_BYTES {
            return Err(format!(
                "manifest of {} bytes, allowed are {MAX_MANIFEST_BYTES}",
                json.len()
            ));
        }
        let manifest: Manifest =
            serde_json::from_slice(json).map_err(|error| format!("not a manifest: {error}"))?;
        manifest.check()?;
        Ok(manifest)
    }

    /// The manifest as readable JSON.
    pub fn to_json(&self) -> Vec<u8> {
        serde_json::to_vec_pretty(self).unwrap_or_default()
    }

    fn check(&self) -> Result<(), String> {
        if self.format != FORMAT || self.version != VERSION {
            let (format, version) = (&self.format, self.version);
            return Err(format!(
                "format {format} {version}, allowed is {FORMAT} {VERSION}"
            ));
        }
        let most = self.grid_levels.cells_per_side() + 1;
        if self.samples.iter().any(|&n| n == 0 || n > most) {
            return Err(format!(
                "{:?} samples, allowed are 1..={most}",
                self.samples
            ));
        }
        if let Some([lo, hi]) = self.height_range
            && (lo > hi || lo < -MAX_HEIGHT || hi > MAX_HEIGHT)
        {
            return Err(format!("heights {lo}..={hi}, allowed are -2^30..=2^30"));
        }
        if !(self.storage_error_m.is_finite() && self.storage_error_m >= 0.0) {
            return Err(format!("storage error {} m", self.storage_error_m));
        }
        if self.codec != 0 {
            return Err(format!("codec {}, allowed is 0", self.codec));
        }
        self.georef.check()
    }

    /// World coordinates `[[min, max]; 3]` of the data, metres.
    pub fn extent_m(&self) -> [[f64; 2]; 3] {
        let [lo, hi] = self.height_range.unwrap_or([0, 0]);
        let [width, height] = self.samples;
        let (min, max) = (
            self.georef.world(0, 0, lo),
            self.georef.world(width - 1, height - 1, hi),
        );
        [[min[0], max[0]], [min[1], max[1]], [min[2], max[2]]]
    }
}
