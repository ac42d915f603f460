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

/// Heights that are quantised together.
const LANES: usize = 8;

/// Running results of [`quantise_row`], one a lane, so that lanes need not wait for each other.
#[derive(Clone, Copy)]
struct Lane {
    lo: i32,
    hi: i32,
    holes: i32,
    off: f64,
    farthest: f64,
}

/// `None` if a height does not fit.
fn quantise_row(row: &[f64], quantum_m: f64, out: &mut [i32]) -> Option<Stored> {
    let mut lanes = [Lane::NOTHING; LANES];
    let (chunks, rest) = row.as_chunks::<LANES>();
    let (out_chunks, out_rest) = out.as_chunks_mut::<LANES>();
    for (out, row) in out_chunks.iter_mut().zip(chunks) {
        for i in 0..LANES {
            out[i] = lanes[i].take(row[i], quantum_m);
        }
    }
    for (out, &metres) in out_rest.iter_mut().zip(rest) {
        *out = lanes[0].take(metres, quantum_m);
    }
    let all = lanes.into_iter().fold(Lane::NOTHING, Lane::merge);
    if all.farthest > f64::from(MAX_HEIGHT) {
        return None;
    }
    let valid = row.len() as u64 - u64::from(all.holes.unsigned_abs());
    // The difference itself was rounded; what it can hide is far below a unit in the last place
    // of the largest height.
    let most = all.hi.max(0).max(all.lo.saturating_neg());
    let hidden = f64::from(most) * quantum_m * f64::EPSILON;
    Some(Stored {
        valid_samples: valid,
        range: (valid > 0).then_some([all.lo, all.hi]),
        largest_error_m: if all.off > 0.0 { all.off + hidden } else { 0.0 },
    })
}

impl Lane {
    const NOTHING: Lane = Lane {
        lo: i32::MAX,
        hi: i32::MIN,
        holes: 0,
        off: 0.0,
        farthest: 0.0,
    };

    /// A height in quanta; what it is beyond the limit does not matter. No branches.
    #[inline(always)]
    fn take(&mut self, metres: f64, quantum_m: f64) -> i32 {
        let hole = metres.is_nan();
        let nearest = nearest(metres / quantum_m);
        let units = whole(nearest);
        self.lo = self.lo.min(if hole { i32::MAX } else { units });
        self.hi = self.hi.max(if hole { i32::MIN } else { units });
        self.holes += i32::from(hole);
        let (off, far) = ((nearest * quantum_m - metres).abs(), nearest.abs());
        // Comparisons with what is no number are false.
        self.off = if off > self.off { off } else { self.off };
        self.farthest = if far > self.farthest {
            far
        } else {
            self.farthest
        };
        if hole { HOLE } else { units }
    }

    fn merge(self, other: Lane) -> Lane {
        Lane {
            lo: self.lo.min(other.lo),
            hi: self.hi.max(other.hi),
            holes: self.holes + other.holes,
            off: self.off.max(other.off),
            farthest: self.farthest.max(other.farthest),
        }
    }
}

/// Added to a number up to `2^51`, this leaves no room for a fraction.
const NO_FRACTION: f64 = 6_755_399_441_055_744.0;

/// The nearest whole number, halves away from zero, as `f64::round` has it for all that can be
/// heights; in parts that the processor has for several numbers at once.
fn nearest(v: f64) -> f64 {
    // Halves go to the even side here.
    let whole = (v + NO_FRACTION) - NO_FRACTION;
    let rest = v - whole;
    let up = if rest == 0.5 && v > 0.0 { 1.0 } else { 0.0 };
    let down = if rest == -0.5 && v < 0.0 { 1.0 } else { 0.0 };
    let small = v.abs() < 2_147_483_648.0;
    if small { whole + up - down } else { v }
}

/// A whole number below `2^31` as an integer: the lower bits of the sum are its own.
fn whole(nearest: f64) -> i32 {
    (nearest + NO_FRACTION).to_bits() as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_nearest_whole_number_is_that_of_the_library(v in -2e9..2e9f64, halves in -1000i32..1000) {
            for v in [v, f64::from(halves) / 2.0, f64::from(halves) / 2.0 * (1.0 - f64::EPSILON)] {
                prop_assert_eq!(nearest(v), v.round());
                prop_assert_eq!(f64::from(whole(nearest(v))), v.round());
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
