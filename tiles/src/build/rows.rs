//! Rows of integer heights, in the order in which a band needs them: from north to south.

use super::BuildError;
use super::quantise::HOLE;
use crate::dem::DemSource;
use escarp_proto::page::MAX_HEIGHT;
use rayon::prelude::*;

/// Samples that are asked of a source at once: 32 MiB of heights.
const READ_SAMPLES: usize = 1 << 22;

/// Heights of grid rows, northern row first.
pub(crate) trait Rows: Send {
    /// Fills rows `first..first + n` (grid rows, from the south) with heights or [`HOLE`],
    /// southern row first, `stride` apart in `out`; all of them lie within the data.
    fn read(
        &mut self,
        first: u32,
        n: u32,
        stride: usize,
        out: &mut [i32],
    ) -> Result<(), BuildError>;

    /// Whether rows `first..first + n` may hold a height: if not, they need not be read.
    fn may_have_data(&self, first: u32, n: u32) -> bool {
        let _ = (first, n);
        true
    }

    /// What was stored of the rows read so far, where that is counted.
    fn stored(&self) -> Option<Stored> {
        None
    }

    /// Goes on counting from what was stored before.
    fn resume(&mut self, _stored: Stored) {}
}

/// What was stored of a source.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Stored {
    pub(crate) valid_samples: u64,
    pub(crate) range: Option<[i32; 2]>,
    /// Rounded up.
    pub(crate) largest_error_m: f64,
}

impl Stored {
    pub(super) const NOTHING: Stored = Stored {
        valid_samples: 0,
        range: None,
        largest_error_m: 0.0,
    };

    fn merge(self, other: Stored) -> Stored {
        let range = match (self.range, other.range) {
            (Some([a, b]), Some([c, d])) => Some([a.min(c), b.max(d)]),
            (range, None) | (None, range) => range,
        };
        Stored {
            valid_samples: self.valid_samples + other.valid_samples,
            range,
            largest_error_m: self.largest_error_m.max(other.largest_error_m),
        }
    }
}

/// A source's rows, in quanta.
pub(crate) struct SourceRows<'a> {
    source: &'a mut dyn DemSource,
    quantum_m: f64,
    band: Vec<f64>,
    stored: Stored,
}

impl<'a> SourceRows<'a> {
    pub(crate) fn new(source: &'a mut dyn DemSource, quantum_m: f64) -> Self {
        SourceRows {
            source,
            quantum_m,
            band: Vec::new(),
            stored: Stored::NOTHING,
        }
    }

    fn read_some(
        &mut self,
        first: u32,
        n: u32,
        stride: usize,
        out: &mut [i32],
    ) -> Result<(), BuildError> {
        let (width, height) = (self.source.info().width as usize, self.source.info().height);
        // Row 0 of a source is the northern one.
        let first_row = height - first - n;
        self.band.resize(n as usize * width, 0.0);
        self.source.read_rows(first_row, n, &mut self.band)?;
        let quantum_m = self.quantum_m;
        let stored = out
            .par_chunks_mut(stride)
            .zip(self.band.par_chunks(width).rev())
            .map(|(out, row)| quantise_row(row, quantum_m, &mut out[..width]))
            .try_reduce(|| Stored::NOTHING, |a, b| Some(a.merge(b)));
        let stored = stored.ok_or_else(|| self.misfit(first_row, width))?;
        self.stored = self.stored.merge(stored);
        Ok(())
    }

    /// The first sample that does not fit, for an error.
    fn misfit(&self, first: u32, width: usize) -> BuildError {
        let limit = f64::from(MAX_HEIGHT) * self.quantum_m;
        let at = self.band.iter().position(|v| v.abs() > limit).unwrap_or(0);
        BuildError::Unfit {
            path: self.source.info().path.clone(),
            why: format!(
                "row {}, column {}: height {} m, allowed are {limit} m either way with a quantum of {} m",
                first as usize + at / width,
                at % width,
                self.band[at],
                self.quantum_m
            ),
        }
    }
}

impl Rows for SourceRows<'_> {
    fn may_have_data(&self, first: u32, n: u32) -> bool {
        let first_row = self.source.info().height - first - n;
        !self.source.data_columns(first_row, n).is_empty()
    }

    fn stored(&self) -> Option<Stored> {
        Some(self.stored)
    }

    fn resume(&mut self, stored: Stored) {
        self.stored = stored;
    }

    fn read(
        &mut self,
        first: u32,
        n: u32,
        stride: usize,
        out: &mut [i32],
    ) -> Result<(), BuildError> {
        let width = self.source.info().width as usize;
        let most = (READ_SAMPLES / width).max(1) as u32;
        let mut left = n;
        while left > 0 {
            let n = left.min(most);
            left -= n;
            let out = &mut out[left as usize * stride..];
            self.read_some(first + left, n, stride, out)?;
        }
        Ok(())
    }
}

/// `None` if a height does not fit.
fn quantise_row(row: &[f64], quantum_m: f64, out: &mut [i32]) -> Option<Stored> {
    let (mut lo, mut hi, mut valid, mut farthest) = (i32::MAX, i32::MIN, 0_u64, 0);
    let mut largest: f64 = 0.0;
    // No branches, so that several are done at once.
    for (out, &metres) in out.iter_mut().zip(row) {
        let hole = metres.is_nan();
        let units = nearest(metres / quantum_m);
        *out = if hole { HOLE } else { units };
        lo = lo.min(if hole { i32::MAX } else { units });
        hi = hi.max(if hole { i32::MIN } else { units });
        farthest = farthest.max(units.unsigned_abs());
        valid += u64::from(!hole);
        let off = (f64::from(units) * quantum_m - metres).abs();
        largest = if off > largest { off } else { largest };
    }
    if farthest > MAX_HEIGHT as u32 {
        return None;
    }
    // The difference itself was rounded; what it can hide is far below a unit in the last place
    // of the largest height.
    let hidden = f64::from(hi.max(0).max(lo.saturating_neg())) * quantum_m * f64::EPSILON;
    Some(Stored {
        valid_samples: valid,
        range: (valid > 0).then_some([lo, hi]),
        largest_error_m: if largest > 0.0 { largest + hidden } else { 0.0 },
    })
}

/// The nearest whole number, halves away from zero, as `f64::round` has it; 0 for NaN, and the
/// nearest that there is for numbers beyond.
fn nearest(v: f64) -> i32 {
    let whole = v as i32;
    let rest = v - f64::from(whole);
    let more = i32::from(rest >= 0.5) - i32::from(rest <= -0.5);
    whole.saturating_add(more)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_nearest_whole_number_is_that_of_the_library(v in -2e9..2e9f64, halves in -1000i32..1000) {
            for v in [v, f64::from(halves) / 2.0, f64::from(halves) / 2.0 * (1.0 - f64::EPSILON)] {
                prop_assert_eq!(f64::from(nearest(v)), v.round());
            }
        }
    }

    #[test]
    fn heights_beyond_the_limit_do_not_fit_and_holes_do() {
        let mut out = [0; 3];
        let limit = f64::from(MAX_HEIGHT);
        for beyond in [
            limit + 0.5,
            -limit - 0.5,
            1e300,
            f64::INFINITY,
            f64::NEG_INFINITY,
        ] {
            assert_eq!(quantise_row(&[0.0, beyond, 1.0], 1.0, &mut out), None);
        }
        let stored = quantise_row(&[limit + 0.4, f64::NAN, -2.25], 1.0, &mut out).unwrap();
        assert_eq!(out, [MAX_HEIGHT, HOLE, -2]);
        assert_eq!(
            (stored.valid_samples, stored.range),
            (2, Some([-2, MAX_HEIGHT]))
        );
        assert!((0.4..0.41).contains(&stored.largest_error_m));
    }

    #[test]
    fn a_row_of_holes_has_no_range() {
        let stored = quantise_row(&[f64::NAN; 9], 0.5, &mut [0; 9]);
        assert_eq!(stored, Some(Stored::NOTHING));
    }
}
