//! From metres to integer heights.

use super::BuildError;
use crate::dem::DemSource;
use escarp_proto::page::MAX_HEIGHT;

/// Stands for a hole among integer heights.
pub(crate) const HOLE: i32 = i32::MIN;

/// Metres a unit of stored height.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Quantum {
    /// The source's own step where it has one; a centimetre for floating-point heights.
    Natural,
    /// This many metres.
    Metres(f64),
    /// One that loses nothing: the source's own step, or for floating-point heights the largest
    /// power of two that divides them all.
    Lossless,
}

/// The default for floating-point heights, metres.
const CENTIMETRE: f64 = 0.01;
/// Rows that are read at a time while looking for a lossless quantum.
const SEARCH_ROWS: u32 = 64;

/// Metres a unit of stored height, for a source.
///
/// # Errors
/// [`BuildError::Unfit`] if a given quantum is not a positive number, or if no quantum is
/// lossless within 31 bits; [`BuildError::Dem`] if the source cannot be read.
pub fn choose_quantum(source: &mut dyn DemSource, wish: Quantum) -> Result<f64, BuildError> {
    let info = source.info();
    let step = info.sample_type.is_integer().then_some(info.height_step_m);
    match (wish, step) {
        (Quantum::Metres(m), _) if m.is_normal() && m > 0.0 => Ok(m),
        (Quantum::Metres(m), _) => Err(BuildError::Unfit {
            path: info.path.clone(),
            why: format!("a quantum of {m} m, allowed are positive numbers"),
        }),
        (_, Some(step)) => Ok(step.abs()),
        (Quantum::Natural, None) => Ok(CENTIMETRE),
        (Quantum::Lossless, None) => exact_power_of_two(source),
    }
}

/// Exponent of the lowest bit set in a number.
fn lowest_bit(v: f64) -> Option<i32> {
    let bits = v.to_bits();
    let exponent = (bits >> 52 & 0x7ff) as i32;
    let mantissa = bits & ((1 << 52) - 1) | u64::from(exponent > 0) << 52;
    (mantissa != 0).then(|| exponent.max(1) - 1075 + mantissa.trailing_zeros() as i32)
}

fn exact_power_of_two(source: &mut dyn DemSource) -> Result<f64, BuildError> {
    let info = source.info().clone();
    let mut lowest = 0;
    let mut largest: f64 = 0.0;
    let mut band = vec![0.0; (SEARCH_ROWS * info.width) as usize];
    for first in (0..info.height).step_by(SEARCH_ROWS as usize) {
        let rows = SEARCH_ROWS.min(info.height - first);
        let band = &mut band[..(rows * info.width) as usize];
        source.read_rows(first, rows, band)?;
        for v in band.iter().filter(|v| !v.is_nan()) {
            lowest = lowest_bit(*v).map_or(lowest, |bit| bit.min(lowest));
            largest = largest.max(v.abs());
        }
    }
    let quantum = 2f64.powi(lowest);
    if largest / quantum <= f64::from(MAX_HEIGHT) {
        return Ok(quantum);
    }
    Err(BuildError::Unfit {
        path: info.path,
        why: format!(
            "heights up to {largest} m in steps of 2^{lowest} m need more than 31 bits, so they \
             cannot be stored without loss; give --quantum"
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lowest_bit_of_a_number_divides_it() {
        assert_eq!(lowest_bit(0.0), None);
        assert_eq!(lowest_bit(1.0), Some(0));
        assert_eq!(lowest_bit(-0.75), Some(-2));
        assert_eq!(lowest_bit(96.0), Some(5));
        assert_eq!(lowest_bit(f64::from(0.1f32)), Some(-27));
    }
}
