//! What the new dataset says of itself.

use super::Work;
use crate::net::Url;
use escarp_proto::manifest::{FileCheck, Manifest, Tolerance};

impl Work<'_> {
    /// The error of heights against the sources, with so many quanta on top, metres, rounded up.
    pub(super) fn storage_error_m(&self, quanta: u32) -> f64 {
        let own = f64::from(quanta) * self.manifest.georef.quantum_m;
        match quanta {
            0 => self.manifest.storage_error_m,
            _ => (self.manifest.storage_error_m + own) * (1.0 + 4.0 * f64::EPSILON),
        }
    }

    /// The server's manifest, with what is different now.
    pub(super) fn new_manifest(&self, url: &Url, error_m: f64) -> Manifest {
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
