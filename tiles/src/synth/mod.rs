//! A deterministic synthetic DEM: continents, ridges, gullies, lakes, an escarpment, fine detail.
//!
//! Each height is a function of seed and place alone, in integers alone, so that any machine makes
//! the same terrain, and any band of rows can be had without the others. What is wide ([`land`])
//! is worked out at every eighth sample of every eighth row and interpolated; four octaves of
//! detail, and the lip of the escarpment, are worked out at every sample.
//!
//! Hills are as many samples wide whatever the spacing: at 1 m it is a land a tenth in size.

mod detail;
mod land;
mod spec;

use crate::dem::{
    Crs, DemError, DemInfo, DemSource, MAX_SIDE_SAMPLES, Placement, Registration, SampleType,
    write_geotiff as write_dem,
};
use detail::{Noise, Weights, along_row, between_rows, weights};
use land::{ONE, land, smooth_step};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Centimetres between samples, unless another spacing is asked for.
pub const SPACING_CM: u32 = 1000;

/// The widest spacing, in centimetres.
pub const MAX_SPACING_CM: u32 = 100_000;

/// Level of the lakes at [`SPACING_CM`], in centimetres: all that would lie lower is water.
pub const LAKE_CM: i32 = 70_000;

/// No height is above this at [`SPACING_CM`], in centimetres.
pub const MAX_CM: i32 = 300_000;

/// Samples between two points at which the land is worked out.
const PITCH: usize = 8;
/// Rows that share lattices of detail.
const BLOCK: u32 = 16;
/// Heights have this many fractional bits before they are rounded to centimetres.
const FRACTION: u32 = 4;

const WEIGHTS: Weights<PITCH> = weights();

/// Detail where the land is roughest: largest height of each octave, in centimetres.
const CRESTS_CM: i64 = 3200;
const SPURS_CM: i64 = 1800;
const ROCKS_CM: i64 = 500;
const GRAIN_CM: i64 = 160;

/// The land at every eighth sample of a row, from the one before the first.
#[derive(Debug, Clone, Default)]
struct LandRow {
    height: Vec<i32>,
    rough: Vec<i32>,
    fault: Vec<i32>,
    step: Vec<i32>,
}

impl LandRow {
    fn new(seed: u64, number: i64, columns: usize) -> LandRow {
        let mut row = LandRow::default();
        let fraction = |cm: i64| (cm.clamp(0, i64::from(MAX_CM)) << FRACTION) as i32;
        for column in 0..columns as i64 {
            let at = land(
                seed,
                (column - 1) * PITCH as i64,
                (number - 1) * PITCH as i64,
            );
            row.height.push(fraction(at.cm));
            row.rough.push((at.rough >> 6) as i32);
            row.fault.push(at.fault.clamp(-ONE, ONE) as i32);
            row.step.push(fraction(at.step_cm));
        }
        row
    }
}

/// The synthetic DEM as a source: a square in UTM zone 32N, grid-registered, without holes.
#[derive(Debug, Clone)]
pub struct SynthSource {
    info: DemInfo,
    seed: u64,
    spacing_cm: u32,
    /// Rows of the land that the last band needed.
    land: BTreeMap<i64, LandRow>,
}

impl SynthSource {
    /// A square of `size` samples a side (1 to [`MAX_SIDE_SAMPLES`], clamped), [`SPACING_CM`] apart.
    pub fn new(size: u32, seed: u64) -> Self {
        Self::with_spacing_cm(size, seed, SPACING_CM)
    }

    /// The same with samples `spacing_cm` apart (1 to [`MAX_SPACING_CM`], clamped).
    pub fn with_spacing_cm(size: u32, seed: u64, spacing_cm: u32) -> Self {
        let size = size.clamp(1, MAX_SIDE_SAMPLES);
        let spacing_cm = spacing_cm.clamp(1, MAX_SPACING_CM);
        let spacing_m = f64::from(spacing_cm) / 100.0;
        let placement = Placement {
            x0: 500_000.0,
            y0: 5_200_000.0,
            dx: spacing_m,
            dy: spacing_m,
        };
        let info = DemInfo {
            path: PathBuf::from(spec::words(size, seed, spacing_cm)),
            format: "synthetic",
            width: size,
            height: size,
            placement,
            crs: Crs::Projected {
                name: "EPSG:32632".into(),
                metres_per_unit: 1.0,
            },
            registration: Registration::Grid,
            sample_type: SampleType::I32,
            height_step_m: 0.01,
            nodata: None,
            vertical: None,
        };
        Self {
            info,
            seed,
            spacing_cm,
            land: BTreeMap::new(),
        }
    }

    /// Works out the rows of the land around a band, but for those that are there.
    fn prepare(&mut self, first_row: u32, rows: u32) {
        let last = i64::from((first_row + rows - 1) / PITCH as u32) + 3;
        let wanted = i64::from(first_row / PITCH as u32)..=last;
        self.land.retain(|number, _| wanted.contains(number));
        let missing: Vec<i64> = wanted.filter(|row| !self.land.contains_key(row)).collect();
        let columns = self.info.width.div_ceil(PITCH as u32) as usize + 3;
        let seed = self.seed;
        let made = missing.into_par_iter();
        let made = made.map(|number| (number, LandRow::new(seed, number, columns)));
        let made: Vec<(i64, LandRow)> = made.collect();
        self.land.extend(made);
    }

    /// Rows `first..first + n` in metres, all in one block of detail.
    fn block(&self, first: u32, out: &mut [f64]) {
        let width = self.info.width as usize;
        let from = i64::from(first);
        let rows = from..from + (out.len() / width) as i64;
        let mut detail = Detail::new(self.seed, rows.clone(), width);
        let mut line = Line::new(width);
        // Heights grow with the spacing; rounded to nearest.
        let scale = i64::from(self.spacing_cm);
        let unit = i64::from(SPACING_CM) << FRACTION;
        for (row, out) in rows.zip(out.chunks_exact_mut(width)) {
            self.line(row, &mut detail, &mut line);
            for (out, &height) in out.iter_mut().zip(&line.height) {
                let height = height.clamp(LAKE_CM << FRACTION, MAX_CM << FRACTION);
                let cm = if self.spacing_cm == SPACING_CM {
                    (height + (1 << (FRACTION - 1))) >> FRACTION
                } else {
                    ((i64::from(height) * scale + unit / 2) / unit) as i32
                };
                *out = f64::from(cm) / 100.0;
            }
        }
    }

    /// A row, before it is cut at the lakes.
    fn line(&self, row: i64, detail: &mut Detail, line: &mut Line) {
        let number = row / PITCH as i64;
        let mut rows = self.land.range(number..number + 4).map(|(_, row)| row);
        let (Some(a), Some(b), Some(c), Some(d)) =
            (rows.next(), rows.next(), rows.next(), rows.next())
        else {
            return; // prepared before
        };
        let weights = &WEIGHTS[(row % PITCH as i64) as usize];
        let mut field = |of: fn(&LandRow) -> &[i32], out: &mut [i32]| {
            between_rows(weights, [of(a), of(b), of(c), of(d)], &mut line.points);
            along_row(&WEIGHTS, &line.points, out);
        };
        field(|row| &row.height, &mut line.height);
        field(|row| &row.rough, &mut line.rough);
        field(|row| &row.step, &mut line.step);
        field(|row| &row.fault, &mut line.fault);
        detail.add(row, &line.rough, &mut line.height);
        for ((height, &step), &fault) in line.height.iter_mut().zip(&line.step).zip(&line.fault) {
            if step > 0 {
                let share = smooth_step(i64::from(fault), -ONE / 400, ONE / 400);
                *height += ((i64::from(step) * share) >> 16) as i32;
            }
        }
    }
}

/// What a row is made of.
struct Line {
    points: Vec<i32>,
    height: Vec<i32>,
    rough: Vec<i32>,
    step: Vec<i32>,
    fault: Vec<i32>,
}

impl Line {
    fn new(width: usize) -> Line {
        Line {
            points: Vec::new(),
            height: vec![0; width],
            rough: vec![0; width],
            step: vec![0; width],
            fault: vec![0; width],
        }
    }
}

/// Octaves that need every sample: two folded into crests, two as they are.
struct Detail {
    crests: Noise<16>,
    spurs: Noise<8>,
    rocks: Noise<4>,
    grain: Noise<2>,
    octaves: [Vec<i32>; 4],
}

impl Detail {
    fn new(seed: u64, rows: std::ops::Range<i64>, width: usize) -> Detail {
        Detail {
            crests: Noise::new(seed, rows.clone(), width, CRESTS_CM << FRACTION),
            spurs: Noise::new(seed, rows.clone(), width, SPURS_CM << FRACTION),
            rocks: Noise::new(seed, rows.clone(), width, ROCKS_CM << FRACTION),
            grain: Noise::new(seed, rows, width, GRAIN_CM << FRACTION),
            octaves: std::array::from_fn(|_| vec![0; width]),
        }
    }

    fn add(&mut self, row: i64, rough: &[i32], height: &mut [i32]) {
        let [crests, spurs, rocks, grain] = &mut self.octaves;
        self.crests.row(row, crests);
        self.spurs.row(row, spurs);
        self.rocks.row(row, rocks);
        self.grain.row(row, grain);
        let folded = crests.iter().zip(&*spurs).map(|(a, b)| -(a + b).abs());
        let plain = rocks.iter().zip(&*grain).map(|(a, b)| a + b);
        for (((height, folded), plain), rough) in
            height.iter_mut().zip(folded).zip(plain).zip(rough)
        {
            *height += ((folded + plain) * rough) >> 10;
        }
    }
}

impl DemSource for SynthSource {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        if rows == 0 {
            return Ok(());
        }
        self.prepare(first_row, rows);
        out.par_chunks_mut(BLOCK as usize * self.info.width as usize)
            .zip(0..rows.div_ceil(BLOCK))
            .for_each(|(out, block)| self.block(first_row + block * BLOCK, out));
        Ok(())
    }
}

/// Writes the synthetic DEM as a GeoTIFF of 32-bit floats in metres, holding 256 rows at a time.
///
/// # Errors
/// [`DemError::Usage`] for a size of 0 or above [`MAX_SIDE_SAMPLES`]; [`DemError::Io`].
pub fn write_geotiff(path: &Path, size: u32, seed: u64) -> Result<(), DemError> {
    let mut source = SynthSource::new(size, seed);
    if source.info.width != size {
        let what = format!("a size of {size} samples");
        return Err(DemError::usage(
            path,
            what,
            format!("give 1 to {MAX_SIDE_SAMPLES}"),
        ));
    }
    write_dem(path, &mut source)
}

#[cfg(test)]
mod tests;
