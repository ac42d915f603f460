//! Rows of integer heights, in the order in which a band needs them: from north to south.

use super::BuildError;
use super::level::Slots;
use super::quantise::HOLE;
use crate::dem::DemSource;
use escarp_proto::page::MAX_HEIGHT;
use rayon::prelude::*;

/// Heights of grid rows, northern row first.
pub(super) trait Rows {
    /// Fills rows `first..first + n` (grid rows, from the south) with heights or [`HOLE`],
    /// southern row first; all of them lie within the data.
    fn read(&mut self, first: u32, n: u32, out: &mut [i32]) -> Result<(), BuildError>;

    /// Whether rows `first..first + n` may hold a height: if not, they need not be read.
    fn may_have_data(&self, first: u32, n: u32) -> bool {
        let _ = (first, n);
        true
    }

    /// What hangs below each cell; nothing does below the finest.
    fn slots(&self) -> Option<&Slots> {
        None
    }
}

/// What was stored of a source.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stored {
    pub(super) valid_samples: u64,
    pub(super) range: Option<[i32; 2]>,
    /// Rounded up.
    pub(super) largest_error_m: f64,
}

impl Stored {
    const NOTHING: Stored = Stored {
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
pub(super) struct SourceRows<'a> {
    source: &'a mut dyn DemSource,
    quantum_m: f64,
    band: Vec<f64>,
    stored: Stored,
}

impl<'a> SourceRows<'a> {
    pub(super) fn new(source: &'a mut dyn DemSource, quantum_m: f64) -> Self {
        SourceRows {
            source,
            quantum_m,
            band: Vec::new(),
            stored: Stored::NOTHING,
        }
    }

    pub(super) fn summary(&self) -> Stored {
        self.stored
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

    fn read(&mut self, first: u32, n: u32, out: &mut [i32]) -> Result<(), BuildError> {
        let (width, height) = (self.source.info().width as usize, self.source.info().height);
        // Row 0 of a source is the northern one.
        let first_row = height - first - n;
        self.band.resize(n as usize * width, 0.0);
        self.source.read_rows(first_row, n, &mut self.band)?;
        let quantum_m = self.quantum_m;
        let stored = out
            .par_chunks_mut(width)
            .zip(self.band.par_chunks(width).rev())
            .map(|(out, row)| quantise_row(row, quantum_m, out))
            .try_reduce(|| Stored::NOTHING, |a, b| Some(a.merge(b)));
        let stored = stored.ok_or_else(|| self.misfit(first_row, width))?;
        self.stored = self.stored.merge(stored);
        Ok(())
    }
}

/// `None` if a height does not fit.
fn quantise_row(row: &[f64], quantum_m: f64, out: &mut [i32]) -> Option<Stored> {
    let (mut lo, mut hi, mut valid) = (i32::MAX, i32::MIN, 0);
    let mut largest: f64 = 0.0;
    for (out, &metres) in out.iter_mut().zip(row) {
        if metres.is_nan() {
            *out = HOLE;
            continue;
        }
        let units = (metres / quantum_m).round();
        if units.abs() > f64::from(MAX_HEIGHT) {
            return None;
        }
        *out = units as i32;
        lo = lo.min(*out);
        hi = hi.max(*out);
        valid += 1;
        largest = largest.max((units * quantum_m - metres).abs());
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
