//! A dataset as a source of heights, and as a GeoTIFF.

mod source;
#[cfg(test)]
mod tests;

pub use source::DatasetSource;

use crate::dem::{DemInfo, DemSource, Encoding};

/// How a dataset's heights are written so that none is lost: as whole metres where they are that,
/// else as the shortest float from which each stored height is found again.
pub fn encoding_for(info: &DemInfo, range_m: [f64; 2]) -> Encoding {
    let [lo, hi] = range_m;
    if info.sample_type.is_integer() && info.height_step_m == 1.0 {
        // One value is kept for holes.
        return match lo > f64::from(i16::MIN) && hi <= f64::from(i16::MAX) {
            true => Encoding::I16,
            false => Encoding::I32,
        };
    }
    // A float of 24 digits tells steps apart, with one digit to spare, up to 2^23 of them.
    let steps = lo.abs().max(hi.abs()) / info.height_step_m;
    if info.sample_type.is_integer() && steps < f64::from(1 << 23) {
        return Encoding::F32;
    }
    Encoding::F64
}

/// Lowest and highest height of a dataset with some room for heights between its samples, metres.
pub fn range_m(source: &DatasetSource, placed: &dyn DemSource) -> [f64; 2] {
    let manifest = source.manifest();
    let [lo, hi] = manifest.height_range.unwrap_or([0, 0]);
    let [lo, hi] = [lo, hi].map(|units| f64::from(units) * manifest.georef.quantum_m);
    match placed.resampling() {
        None => [lo, hi],
        // Cubic interpolation goes beyond its samples by less than their range.
        Some(_) => [lo - (hi - lo), hi + (hi - lo)],
    }
}
