//! Regions of interest: fine storage where it matters, coarser elsewhere.
//!
//! Where a tolerance allows it, the heights inside a page are replaced by what the page's corners
//! imply, so that the page is cut and needs no record. That is done to the heights before any
//! page is made of them:
//!
//! 1. A block of 256 cells is cut if all its samples, those on its border included, are then
//!    within their tolerance of the source. Its corners stay.
//! 2. In what that leaves, a block of 16 cells is cut by the same rule.
//!
//! Heights on a block's side follow from the side's ends alone, whichever block beside it is cut;
//! so every sample has one height, and a neighbour that is not cut takes it over. Each decision
//! rests on the source and on decisions of step 1 alone: the result does not depend on bands or
//! threads. It needs the bands on either side, so one band is read ahead. Blocks beyond 256 cells
//! are not tried: they would save a few bytes in 65,536 samples.

mod blocks;
mod mask;
mod polygon;
mod tolerance;

pub use tolerance::{Tolerances, Wish};

use super::quantise::HOLE;
use crate::dem::{DemError, DemInfo, DemSource, Fills, Grain, OverlapReport};
use blocks::{BAND, Cut, Field, Given};
use escarp_proto::geometry::GridLevels;
use escarp_proto::manifest::{Resampling, Tolerance};
use escarp_proto::page::MAX_HEIGHT;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

/// Rows that are read from the source at a time.
const READ_ROWS: u32 = 64;

/// A source whose heights are whole quanta, and coarser where tolerances allow it.
pub struct Coarsened {
    source: Box<dyn DemSource>,
    grid: GridLevels,
    quantum_m: f64,
    tolerances: Tolerances,
    /// Bands as given, and which of their large blocks are cut: those last asked for.
    given: BTreeMap<u32, (Given, Vec<Cut>)>,
    /// The band last made.
    made: Option<(u32, Field)>,
    /// By region, the most that rounding to whole quanta took, and the farthest that a height was
    /// moved, in quanta.
    largest: Vec<(f64, u32)>,
    /// Bands that `largest` knows of.
    noted: BTreeSet<u32>,
}

impl Coarsened {
    /// `quantum_m` is the one that the dataset will have.
    ///
    /// # Errors
    /// [`DemError::Usage`] if the source is larger than any grid.
    pub fn new(
        source: Box<dyn DemSource>,
        quantum_m: f64,
        tolerances: Tolerances,
    ) -> Result<Coarsened, DemError> {
        let info = source.info();
        let Some(grid) = GridLevels::covering(info.width, info.height) else {
            let what = format!("{} x {} samples", info.width, info.height);
            return Err(DemError::usage(&info.path, what, "build it in parts"));
        };
        let largest = vec![(0.0, 0); tolerances.len()];
        Ok(Coarsened {
            source,
            grid,
            quantum_m,
            tolerances,
            given: BTreeMap::new(),
            made: None,
            largest,
            noted: BTreeSet::new(),
        })
    }

    fn last_row(&self) -> u32 {
        self.source.info().height - 1
    }

    /// Reads a band, if it is there, and decides which of its large blocks are cut.
    fn prepare(&mut self, band: Option<u32>) -> Result<(), DemError> {
        let Some(band) = band.filter(|band| band * BAND <= self.last_row()) else {
            return Ok(());
        };
        if !self.given.contains_key(&band) {
            let given = self.read(band)?;
            let cuts = blocks::large_cuts(&given, self.grid, band);
            self.given.insert(band, (given, cuts));
        }
        Ok(())
    }

    /// The rows of a band, as whole quanta, and how far each may be moved.
    fn read(&mut self, band: u32) -> Result<Given, DemError> {
        let (width, last) = (self.source.info().width, self.last_row());
        let first = band * BAND;
        let rows = (last - first).min(BAND) + 1;
        let mut given = Given::new(first, rows, width);
        // Grid rows are counted from the south, a source's from the north.
        let (mut heights, mut grains, mut allowed) = (Vec::new(), Vec::new(), Vec::new());
        for start in (0..rows).step_by(READ_ROWS as usize) {
            let n = READ_ROWS.min(rows - start);
            let source_row = last - (first + rows - 1) + start;
            heights.resize((n * width) as usize, 0.0);
            self.source.read_rows(source_row, n, &mut heights)?;
            grains.resize(heights.len(), Grain::Finest);
            self.source.grains(source_row, n, &mut grains)?;
            self.tolerances.rows(source_row, n, &grains, &mut allowed)?;
            for i in 0..n as usize {
                let at = i * width as usize..(i + 1) * width as usize;
                let y = first + rows - 1 - start - i as u32;
                self.take_row(&mut given, y, &heights[at.clone()], &allowed[at])?;
            }
        }
        Ok(given)
    }

    fn take_row(
        &mut self,
        given: &mut Given,
        y: u32,
        heights: &[f64],
        allowed: &[(f64, u8)],
    ) -> Result<(), DemError> {
        let quantum_m = self.quantum_m;
        for (x, (&metres, &(tolerance_m, region))) in heights.iter().zip(allowed).enumerate() {
            if metres.is_nan() {
                continue;
            }
            let units = (metres / quantum_m).round();
            if units.abs() > f64::from(MAX_HEIGHT) {
                let info = self.source.info();
                let row = info.height - 1 - y;
                let what = format!("row {row}, column {x}: height {metres} m");
                let hint = format!("a quantum of {quantum_m} m is too small for it");
                return Err(DemError::usage(&info.path, what, hint));
            }
            // What rounding takes of the tolerance; the difference itself was rounded, too.
            let rounding_m = (units * quantum_m - metres).abs();
            let rounding_m = match rounding_m {
                0.0 => 0.0,
                some => some + metres.abs() * 4.0 * f64::EPSILON,
            };
            let (largest_m, _) = &mut self.largest[usize::from(region)];
            *largest_m = largest_m.max(rounding_m);
            let allowed = ((tolerance_m - rounding_m) / quantum_m).floor();
            let fits = allowed * quantum_m + rounding_m <= tolerance_m;
            let allowed = if fits { allowed } else { allowed - 1.0 };
            given.set(x as u32, y, units as i32, allowed, region);
        }
        Ok(())
    }

    /// Makes a band's rows: south to north, the row shared with the band above included.
    fn make(&mut self, band: u32) -> Result<(), DemError> {
        if self
            .made
            .as_ref()
            .is_some_and(|(number, _)| *number == band)
        {
            return Ok(());
        }
        let around = [band.checked_add(1), Some(band), band.checked_sub(1)];
        for band in around {
            self.prepare(band)?;
        }
        self.given
            .retain(|&number, _| number + 1 >= band && number <= band + 1);
        let Some((given, _)) = self.given.get(&band) else {
            return Ok(());
        };
        let mut field = given.field(0);
        for (_, cuts) in self.given.values() {
            field.apply(cuts, self.grid);
        }
        let small = blocks::small_cuts(given, &field, self.grid);
        let below = band.checked_sub(1).and_then(|band| self.given.get(&band));
        let from_below = below.map(|(below, _)| {
            // Of the band below, only the blocks that share a row with this one.
            let mut strip = below.field(BAND - blocks::SMALL);
            for (_, cuts) in self.given.values() {
                strip.apply(cuts, self.grid);
            }
            blocks::small_cuts(below, &strip, self.grid)
        });
        field.apply(&small, self.grid);
        field.apply(&from_below.unwrap_or_default(), self.grid);
        field.note_moves(given, &mut self.largest);
        self.noted.insert(band);
        self.made = Some((band, field));
        Ok(())
    }
}

impl DemSource for Coarsened {
    fn info(&self) -> &DemInfo {
        self.source.info()
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info().check_band(first_row, rows, out)?;
        let width = self.info().width as usize;
        for (row, out) in (first_row..).zip(out.chunks_exact_mut(width)) {
            let y = self.last_row() - row;
            self.make(y / BAND)?;
            let Some((_, field)) = &self.made else {
                continue;
            };
            for (out, &units) in out.iter_mut().zip(field.row(y)) {
                *out = match units {
                    HOLE => f64::NAN,
                    units => f64::from(units) * self.quantum_m,
                };
            }
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), DemError> {
        for band in (0..=self.last_row() / BAND).rev() {
            if !self.noted.contains(&band) {
                self.make(band)?;
            }
        }
        self.source.finish()
    }

    fn resampling(&self) -> Option<Resampling> {
        self.source.resampling()
    }

    fn overlaps(&self) -> Option<OverlapReport> {
        self.source.overlaps()
    }

    fn data_columns(&self, first_row: u32, rows: u32) -> Vec<Range<u32>> {
        self.source.data_columns(first_row, rows)
    }

    fn fills(&self) -> Option<&Fills> {
        self.source.fills()
    }

    fn tolerances(&self) -> Vec<Tolerance> {
        self.tolerances.stated(&self.largest, self.quantum_m)
    }
}

#[cfg(test)]
mod tests;
