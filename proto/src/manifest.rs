//! The manifest of a dataset: JSON on disk, and the same bytes in Welcome and over HTTP.

use crate::geometry::GridLevels;
use crate::georef::Georef;
use crate::page::{Codec, MAX_HEIGHT};
use crate::view::FARTHEST_EYE_M;
use serde::{Deserialize, Serialize};

/// The format's name in a manifest.
pub const FORMAT: &str = "escarp";
/// The format's version.
pub const VERSION: u32 = 1;
/// No manifest is longer.
pub const MAX_MANIFEST_BYTES: usize = 1 << 20;
/// No file of filled samples is longer.
pub const MAX_FILLED_BYTES: u64 = 1 << 28;

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
    /// Codec of the records, as a [`Codec`]'s number.
    pub codec: u8,
    /// Pages that have a record.
    pub pages: u64,
    /// The segments, in the order of their numbers from 0.
    pub segments: Vec<Segment>,
    /// Length in bytes and CRC-32C of the index.
    pub index: FileCheck,
    /// Where the data came from, for people: the names of the input files.
    pub sources: Vec<String>,
    /// What heights are above, such as `EGM96 height (EPSG:5773)`, where that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vertical: Option<String>,
    /// Largest error of horizontal distances in the world's plane, in per cent of the distance on
    /// the ground, over the data's extent; absent where the CRS cannot be transformed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale_error_percent: Option<f64>,
    /// What it cost to bring the sources to this grid; absent if their samples are its.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resampling: Option<Resampling>,
    /// Samples that are no data but fill, and the file that says which; absent if nothing was
    /// filled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filled: Option<Filled>,
    /// What was stored coarser than given, and by how much; the first that holds a place counts.
    /// Empty if everything is stored as given.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub tolerances: Vec<Tolerance>,
}

/// How sources were brought to another grid, and what that cost.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Resampling {
    /// CRS of the sources.
    pub from_crs: String,
    /// Distance of the sources' samples, in the units of their CRS, east and north.
    pub from_spacing: [f64; 2],
    /// `linear` or `cubic`.
    pub interpolation: String,
    /// Source samples compared with the surface of the grid.
    pub compared: u64,
    /// Source samples inside the grid at which it has no surface: beside holes and borders.
    pub uncovered: u64,
    /// Largest difference of a source sample, straight up or down, metres, rounded up.
    pub largest_difference_m: f64,
    /// Root of the mean square of the differences, metres.
    pub rms_difference_m: f64,
    /// How far from its place a height may have been taken, metres, rounded up. Differences of
    /// datums that the transform does not know are not in it.
    pub horizontal_error_m: f64,
}

/// Samples that are no data but fill.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Filled {
    /// How many; they count as samples with data, too.
    pub samples: u64,
    /// Length in bytes and CRC-32C of the file that says which.
    pub file: FileCheck,
}

/// How much coarser a region is stored than given.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tolerance {
    /// The most that was allowed, metres.
    pub tolerance_m: f64,
    /// The file that outlines the region; absent for everything else.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub region: Option<String>,
    /// The largest difference of a stored sample in the region from its source, metres, rounded
    /// up.
    pub largest_error_m: f64,
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

    /// Checks every field against its range.
    ///
    /// # Errors
    /// A sentence that says what was found and what is allowed.
    pub fn check(&self) -> Result<(), String> {
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
        let samples = u64::from(self.samples[0]) * u64::from(self.samples[1]);
        if self.valid_samples > samples {
            let found = self.valid_samples;
            return Err(format!(
                "{found} samples with data, allowed are 0..={samples}"
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
        if Codec::from_u8(self.codec).is_none() {
            return Err(format!("codec {}, allowed are 0 and 1", self.codec));
        }
        self.check_changes()?;
        self.georef.check()?;
        self.check_extent()
    }

    /// What is said of samples that are not as given.
    fn check_changes(&self) -> Result<(), String> {
        if let Some(Filled { samples, file }) = self.filled
            && (samples > self.valid_samples || file.bytes > MAX_FILLED_BYTES)
        {
            return Err(format!(
                "{samples} filled samples in {} bytes, allowed are {} in {MAX_FILLED_BYTES}",
                file.bytes, self.valid_samples
            ));
        }
        let is_length = |metres: f64| metres.is_finite() && metres >= 0.0;
        let is_sound = |t: &&Tolerance| is_length(t.tolerance_m) && is_length(t.largest_error_m);
        match self.tolerances.iter().find(|t| !is_sound(t)) {
            None => Ok(()),
            Some(t) => Err(format!(
                "a tolerance of {} m with an error of {} m",
                t.tolerance_m, t.largest_error_m
            )),
        }
    }

    /// No corner of the grid may lie where no eye may be: beyond, differences of coordinates lose
    /// the metre, and at last are no numbers any more.
    fn check_extent(&self) -> Result<(), String> {
        let cells = self.grid_levels.cells_per_side();
        let corners = [
            self.georef.world(0, 0, -MAX_HEIGHT),
            self.georef.world(cells, cells, MAX_HEIGHT),
        ];
        match corners
            .into_iter()
            .flatten()
            .find(|v| v.is_nan() || v.abs() > FARTHEST_EYE_M)
        {
            None => Ok(()),
            Some(found) => Err(format!(
                "a corner of the grid at {found:e} m, allowed are coordinates within {FARTHEST_EYE_M:e} m"
            )),
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::georef::Plane;

    fn manifest() -> Manifest {
        Manifest {
            format: FORMAT.into(),
            version: VERSION,
            generation: 1,
            grid_levels: GridLevels::new(8).unwrap(),
            samples: [200, 100],
            valid_samples: 20_000,
            height_range: Some([-5, 900]),
            georef: Georef {
                origin_m: [5e5, 5e6],
                sample_spacing_m: [10.0, 12.0],
                quantum_m: 0.1,
                plane: Plane::Local,
            },
            storage_error_m: 0.05,
            codec: 0,
            pages: 3,
            segments: Vec::new(),
            index: FileCheck {
                bytes: 0,
                crc32c: 0,
            },
            sources: vec!["a.tif".into()],
            vertical: None,
            scale_error_percent: None,
            resampling: None,
            filled: None,
            tolerances: Vec::new(),
        }
    }

    #[test]
    fn a_manifest_comes_back_from_its_json() {
        assert_eq!(Manifest::from_json(&manifest().to_json()), Ok(manifest()));
        let mut changed = manifest();
        changed.filled = Some(Filled {
            samples: 9,
            file: FileCheck {
                bytes: 30,
                crc32c: 5,
            },
        });
        changed.tolerances = vec![Tolerance {
            tolerance_m: 5.0,
            region: Some("road.geojson".into()),
            largest_error_m: 4.5,
        }];
        assert_eq!(Manifest::from_json(&changed.to_json()), Ok(changed));
    }

    #[test]
    fn every_field_out_of_range_is_refused_by_name() {
        let refusal = |change: fn(&mut Manifest)| {
            let mut broken = manifest();
            change(&mut broken);
            Manifest::from_json(&broken.to_json()).unwrap_err()
        };
        assert!(refusal(|m| m.version = 2).contains("format"));
        assert!(refusal(|m| m.samples = [0, 5]).contains("samples"));
        assert!(refusal(|m| m.samples = [258, 5]).contains("samples"));
        assert!(refusal(|m| m.height_range = Some([4, 3])).contains("heights"));
        assert!(refusal(|m| m.storage_error_m = -1.0).contains("storage error"));
        assert!(refusal(|m| m.codec = 9).contains("codec"));
        let filled = |samples, bytes| Filled {
            samples,
            file: FileCheck { bytes, crc32c: 0 },
        };
        let mut broken = manifest();
        for wrong in [filled(20_001, 9), filled(1, 1 << 29)] {
            broken.filled = Some(wrong);
            let refusal = Manifest::from_json(&broken.to_json()).unwrap_err();
            assert!(refusal.contains("filled samples"), "{refusal}");
        }
        assert!(
            refusal(|m| {
                m.tolerances = vec![Tolerance {
                    tolerance_m: -1.0,
                    region: None,
                    largest_error_m: 0.0,
                }]
            })
            .contains("tolerance")
        );
        assert!(refusal(|m| m.georef.quantum_m = 0.0).contains("quantum"));
        assert!(refusal(|m| m.georef.sample_spacing_m[1] = 1e300).contains("spacing"));
        assert!(refusal(|m| m.georef.origin_m[0] = -1e13).contains("corner"));
        let deep = String::from_utf8(manifest().to_json()).unwrap();
        let deep = deep.replace("\"grid_levels\": 8", "\"grid_levels\": 9");
        assert!(
            Manifest::from_json(deep.as_bytes())
                .unwrap_err()
                .contains("grid levels")
        );
        assert!(Manifest::from_json(b"{").is_err());
    }
}
