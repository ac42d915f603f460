//! A source on another grid, made band by band.
//!
//! Bands are of fixed rows, whatever rows are asked for, so that what is measured does not depend
//! on the reader. A band is cut into rectangles whose places in the source are computed, whose
//! blocks are read, and whose heights are interpolated on all cores. Memory: two bands of the
//! target, the places of one rectangle, and [`KEPT_SAMPLES`](super::blocks::KEPT_SAMPLES) of the
//! source.

use super::Interpolation;
use super::blocks::{Blocks, KEPT_SAMPLES};
use super::mapping::{Mapping, fill_lattice};
use super::measure::{Measured, Strip, measure};
use super::sampler::Sampler;
use super::target::Target;
use crate::dem::{DemError, DemInfo, DemSource, OverlapReport, SampleType};
use escarp_proto::manifest::Resampling;
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::ops::Range;

/// Rows of a band.
const BAND_ROWS: u32 = 64;
/// Columns of the first rectangles of a band.
const RECTANGLE_COLUMNS: u32 = 2048;
/// Places in the source are right to this part of a cell halfway between places that are exact,
/// where straight lines are farthest from a curve.
pub(super) const LATTICE_TOLERANCE: f64 = 0.002;
/// What is promised of every place, in cells of the source.
const PLACE_ERROR: f64 = 0.01;
/// An integer source's heights keep steps of this part of its own.
const STEP_PART: f64 = 0.25;
/// Rows whose places are found together.
const PLACE_ROWS: usize = 33;
/// Places a side at which the transform is tried there and back.
const ROUND_TRIPS: u32 = 33;

/// A source on another grid.
pub struct Resampled {
    info: DemInfo,
    from: DemInfo,
    blocks: Blocks,
    mapping: Mapping,
    sampler: Sampler,
    /// Heights are rounded to this, metres; 0 leaves them.
    step_m: f64,
    band: Option<Band>,
    /// Differences from the source, of each band that has been made.
    measured: Vec<Option<Measured>>,
    horizontal_error_m: f64,
    /// Source cells that one step of the target crosses at most.
    stride: f64,
    /// The target's samples are some of the source's, side by side.
    is_window: bool,
}

/// Heights of some rows of the target.
struct Band {
    number: u32,
    first_row: u32,
    heights: Vec<f64>,
}

impl Resampled {
    pub(super) fn new(
        source: Box<dyn DemSource>,
        target: Target,
        mapping: Mapping,
        interpolation: Interpolation,
    ) -> Result<Resampled, DemError> {
        let from = source.info().clone();
        let mut info = target.info(&from);
        info.format = "resampled";
        let exact = takes_samples(&from, &info, &mapping);
        let steps = |info: &DemInfo| [info.placement.dx, info.placement.dy];
        let is_window = exact && steps(&from) == steps(&info);
        let mut step_m = 0.0;
        if !exact && from.sample_type.is_integer() {
            step_m = from.height_step_m.abs() * STEP_PART;
            info.sample_type = SampleType::I64;
            info.height_step_m = step_m;
        } else if !exact {
            info.sample_type = SampleType::F64;
        }
        info.nodata = info.nodata.filter(|_| exact);
        let sampler = Sampler {
            width: from.width,
            height: from.height,
            turn: mapping.turn,
            interpolation,
        };
        let horizontal_error_m = horizontal_error_m(&from, &mapping);
        let stride = stride(&info, &mapping);
        Ok(Resampled {
            measured: vec![None; info.height.div_ceil(BAND_ROWS) as usize],
            blocks: Blocks::new(source),
            info,
            from,
            mapping,
            sampler,
            step_m,
            band: None,
            horizontal_error_m,
            stride,
            is_window,
        })
    }

    /// The band with a number, made if it is not the last one made. It starts one row early, so
    /// that bands share a row and no cell is between them.
    fn band(&mut self, number: u32) -> Result<&Band, DemError> {
        if self.band.as_ref().is_none_or(|band| band.number != number) {
            self.band = None; // before there is memory for two
            let first_row = (number * BAND_ROWS).saturating_sub(1);
            let end = ((number + 1) * BAND_ROWS).min(self.info.height);
            let width = self.info.width;
            let mut heights = vec![f64::NAN; (end - first_row) as usize * width as usize];
            let mut used = BTreeSet::new();
            for left in (0..width).step_by(RECTANGLE_COLUMNS as usize) {
                let right = (left + RECTANGLE_COLUMNS).min(width);
                let columns = left..right;
                self.rectangle(first_row..end, columns, first_row, &mut heights, &mut used)?;
            }
            let at = number as usize;
            // Nothing is lost in a window, so that nothing is measured.
            if self.measured[at].is_none() && !self.is_window {
                self.measured[at] = Some(self.measure(first_row, end, &heights, &used)?);
            }
            self.band = Some(Band {
                number,
                first_row,
                heights,
            });
        }
        self.band.as_ref().ok_or_else(|| {
            DemError::usage(&self.info.path, "a band that was not made", "report this")
        })
    }

    /// Heights of a rectangle, in halves if its blocks would not all be kept.
    fn rectangle(
        &mut self,
        rows: Range<u32>,
        columns: Range<u32>,
        band_row: u32,
        out: &mut [f64],
        used: &mut BTreeSet<(u32, u32)>,
    ) -> Result<(), DemError> {
        let size = [columns.len(), rows.len()];
        let places = self.places(&rows, &columns);
        let mut keys = BTreeSet::new();
        for place in &places {
            self.sampler.needs(*place, self.blocks.shape(), &mut keys);
        }
        if keys.len() * self.blocks.block_samples() > KEPT_SAMPLES && size != [1, 1] {
            let half = |range: &Range<u32>| u32::midpoint(range.start, range.end);
            let (first, second) = if size[0] >= size[1] {
                let middle = half(&columns);
                (
                    (rows.clone(), columns.start..middle),
                    (rows, middle..columns.end),
                )
            } else {
                let middle = half(&rows);
                (
                    (rows.start..middle, columns.clone()),
                    (middle..rows.end, columns),
                )
            };
            self.rectangle(first.0, first.1, band_row, out, used)?;
            return self.rectangle(second.0, second.1, band_row, out, used);
        }
        let loaded = self.blocks.load(&keys)?;
        self.cover(&places, size, used);
        let width = self.info.width as usize;
        let (sampler, step_m) = (self.sampler, self.step_m);
        let start = (rows.start - band_row) as usize * width;
        out[start..]
            .par_chunks_mut(width)
            .zip(places.par_chunks(size[0]))
            .for_each(|(out, places)| {
                let mut reader = loaded.reader();
                let out = &mut out[columns.start as usize..columns.end as usize];
                for (height, place) in out.iter_mut().zip(places) {
                    *height = rounded(sampler.height(*place, &mut reader), step_m);
                }
            });
        Ok(())
    }

    /// Column and row in the source of each target sample of a rectangle, in parts on all cores.
    fn places(&self, rows: &Range<u32>, columns: &Range<u32>) -> Vec<[f64; 2]> {
        let place = &self.info.placement;
        let mapping = &self.mapping;
        let map =
            |c: f64, r: f64| mapping.to_source([place.x0 + c * place.dx, place.y0 - r * place.dy]);
        let across = columns.len();
        let mut places = vec![[f64::NAN; 2]; across * rows.len()];
        places
            .par_chunks_mut(across * PLACE_ROWS)
            .enumerate()
            .for_each(|(part, out)| {
                let first = [columns.start, rows.start + (part * PLACE_ROWS) as u32];
                let size = [across, out.len() / across];
                fill_lattice(&map, first, size, LATTICE_TOLERANCE, out);
            });
        places
    }

    /// Blocks with source samples among the places of a rectangle: those of the boxes around its
    /// parts, and a target's cell more.
    fn cover(&self, places: &[[f64; 2]], size: [usize; 2], keys: &mut BTreeSet<(u32, u32)>) {
        const PART: usize = 32;
        let [wide, high] = self.blocks.shape().map(f64::from);
        for left in (0..size[0]).step_by(PART) {
            let right = (left + PART + 1).min(size[0]);
            let mut range = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
            for row in places.chunks_exact(size[0]) {
                for place in row[left..right].iter().filter(|place| !place[0].is_nan()) {
                    for (range, v) in range.iter_mut().zip(place) {
                        *range = [range[0].min(*v), range[1].max(*v)];
                    }
                }
            }
            let margin = self.stride + 2.0;
            let ends = |[from, to]: [f64; 2], side: u32, step: f64| {
                let last = f64::from(side - 1);
                let from = ((from - margin).clamp(0.0, last) / step) as u32;
                let to = ((to + margin).clamp(0.0, last) / step) as u32;
                from..=to
            };
            if range[0][0] <= range[0][1] {
                for row in ends(range[1], self.from.height, high) {
                    let columns = ends(range[0], self.from.width, wide);
                    keys.extend(columns.map(|column| (column, row)));
                }
            }
        }
    }

    fn measure(
        &mut self,
        first_row: u32,
        end: u32,
        heights: &[f64],
        used: &BTreeSet<(u32, u32)>,
    ) -> Result<Measured, DemError> {
        let strip = Strip {
            target: &self.info,
            first_row,
            end,
            heights,
        };
        let mut all = Measured::default();
        // One block after the other, so that memory is bounded whatever the band needed.
        for key in used {
            let loaded = self.blocks.load(&BTreeSet::from([*key]))?;
            let (columns, rows) = self.blocks.extent(*key);
            all.add(measure(&strip, &self.mapping, &loaded, columns, rows));
        }
        Ok(all)
    }
}

impl DemSource for Resampled {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        let width = self.info.width as usize;
        for (row, out) in (first_row..).zip(out.chunks_exact_mut(width)) {
            let band = self.band(row / BAND_ROWS)?;
            let start = (row - band.first_row) as usize * width;
            out.copy_from_slice(&band.heights[start..start + width]);
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), DemError> {
        for number in 0..self.measured.len() {
            if self.measured[number].is_none() && !self.is_window {
                self.band(number as u32)?;
            }
        }
        Ok(())
    }

    fn overlaps(&self) -> Option<OverlapReport> {
        self.blocks.source().overlaps()
    }

    fn resampling(&self) -> Option<Resampling> {
        if self.is_window {
            return None;
        }
        let mut all = Measured::default();
        self.measured
            .iter()
            .flatten()
            .for_each(|band| all.add(*band));
        Some(Resampling {
            from_crs: self.from.crs.name().to_owned(),
            from_spacing: [self.from.placement.dx, self.from.placement.dy],
            interpolation: self.sampler.interpolation.name().to_owned(),
            compared: all.compared,
            uncovered: all.uncovered,
            largest_difference_m: all.largest_m(),
            rms_difference_m: all.rms_m(),
            horizontal_error_m: self.horizontal_error_m,
        })
    }
}

/// To the nearest multiple of a step.
fn rounded(height: f64, step_m: f64) -> f64 {
    if step_m == 0.0 {
        height
    } else {
        (height / step_m).round() * step_m
    }
}

/// Whether each target sample is one of the source's.
fn takes_samples(from: &DemInfo, to: &DemInfo, mapping: &Mapping) -> bool {
    let whole = |cells: f64| (cells - cells.round()).abs() < 1e-9 * cells.abs().max(1.0);
    let (a, b) = (&from.placement, &to.placement);
    mapping.is_same()
        && whole(b.dx / a.dx)
        && whole(b.dy / a.dy)
        && whole((b.x0 - a.x0) / a.dx)
        && whole((b.y0 - a.y0) / a.dy)
}

/// The most source cells, east or north, between neighbouring samples of the target, by a lattice
/// of places. A jump of half a turn is none.
fn stride(to: &DemInfo, mapping: &Mapping) -> f64 {
    let place = &to.placement;
    let at = |c: f64, r: f64| mapping.to_source([place.x0 + c * place.dx, place.y0 - r * place.dy]);
    let mut largest: f64 = 1.0;
    for r in 0..ROUND_TRIPS {
        for c in 0..ROUND_TRIPS {
            let part = |n: u32, side: u32| {
                (f64::from(n) / f64::from(ROUND_TRIPS - 1) * f64::from(side - 1)).floor()
            };
            let (c, r) = (part(c, to.width), part(r, to.height));
            let Some(here) = at(c, r) else { continue };
            for there in [at(c + 1.0, r), at(c, r + 1.0)].into_iter().flatten() {
                let half_turn = mapping
                    .turn
                    .map_or(f64::INFINITY, |turn| f64::from(turn) / 2.0);
                let east = (there[0] - here[0]).abs();
                let east = if east > half_turn { 0.0 } else { east };
                largest = largest.max(east).max((there[1] - here[1]).abs());
            }
        }
    }
    largest
}

/// How far from its true place a height may be read, metres, rounded up: what straight lines
/// between exact places leave, and what the transform misses when it goes there and back.
fn horizontal_error_m(from: &DemInfo, mapping: &Mapping) -> f64 {
    if mapping.is_same() {
        return 0.0;
    }
    let mut largest: f64 = 0.0;
    for r in 0..ROUND_TRIPS {
        for c in 0..ROUND_TRIPS {
            let at =
                |n: u32, side: u32| f64::from(n) / f64::from(ROUND_TRIPS - 1) * f64::from(side - 1);
            let place = [at(c, from.width), at(r, from.height)];
            // Where there is no way to the target, no height is read either.
            let cells = mapping.round_trip_cells(place).unwrap_or(0.0) + PLACE_ERROR;
            let [east, north] = mapping.source_units_m(&from.crs, place[1]);
            let metres = (from.placement.dx * east).hypot(from.placement.dy * north);
            largest = largest.max(cells * metres);
        }
    }
    largest * (1.0 + 1e-9)
}
