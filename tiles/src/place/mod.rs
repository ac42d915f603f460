//! Sources brought to another grid: cut to bounds, to another spacing, or into another CRS.
//!
//! Suggested reading order: [`Wish`] and [`place`] here, `target` (which grid), `mapping` (from
//! grid to grid), `crop`, `resampled` over `blocks` (what is read of the source) and `sampler`
//! (heights between samples), `measure` (what resampling cost).
//!
//! A target sample is a height of the source's surface at that place, never an average: what a
//! coarser grid loses is measured and reported instead.

mod blocks;
mod crop;
mod facets;
mod mapping;
mod measure;
mod resampled;
mod sampler;
mod target;
#[cfg(test)]
mod tests;

pub use facets::Facets;
pub use resampled::Resampled;

use crate::dem::{Crs, DemError, DemInfo, DemSource, Grain};
use crop::Cropped;
use mapping::Mapping;
use target::Target;

/// How heights between samples are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Interpolation {
    /// From the four samples around: never beyond them.
    #[default]
    Linear,
    /// From sixteen samples (Keys, "Cubic convolution interpolation for digital image
    /// processing", 1981), linear beside holes and at borders: nearer to rounded ground, and may
    /// go a little beyond the samples.
    Cubic,
}

impl Interpolation {
    /// Its name on the command line and in a manifest.
    pub fn name(self) -> &'static str {
        match self {
            Interpolation::Linear => "linear",
            Interpolation::Cubic => "cubic",
        }
    }
}

/// The grid that is wished for; each `None` leaves it to the source.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Wish {
    /// CRS of the grid.
    pub crs: Option<Crs>,
    /// Distance of its samples, in the units of its CRS (degrees where that is geographic).
    pub spacing: Option<f64>,
    /// West, south, east, north, in the units of its CRS; without georeference, metres from the
    /// south-west sample.
    pub bounds: Option<[f64; 4]>,
    /// How heights between samples are found.
    pub interpolation: Interpolation,
}

/// Brings a source to a grid. Where CRS and spacing stay, samples are exact.
///
/// # Errors
/// [`DemError::Usage`] for a CRS that cannot be transformed, or a grid that holds no sample of the
/// source; [`DemError::Limits`] for a grid that is too large.
pub fn place(source: Box<dyn DemSource>, wish: &Wish) -> Result<Box<dyn DemSource>, DemError> {
    let info = source.info();
    let crs = wish.crs.as_ref().filter(|crs| !same_crs(crs, &info.crs));
    let spacing = wish.spacing.filter(|spacing| {
        let place = &info.placement;
        let same = |step: f64| (step - spacing).abs() <= 1e-9 * step;
        !(same(place.dx) && same(place.dy))
    });
    if crs.is_none() && spacing.is_none() && wish.bounds.is_none() {
        return Ok(source);
    }
    let mapping = match crs {
        None => Mapping::same(info),
        Some(crs) => Mapping::between(info, crs)?,
    };
    let target = Target::choose(info, &mapping, crs, spacing, wish.bounds)?;
    if let (None, None, Some(window)) = (crs, spacing, target.window_of(info)) {
        let info = target.info(info);
        return Ok(Box::new(Cropped::new(source, info, window)));
    }
    let resampled = Resampled::new(source, target, mapping, wish.interpolation)?;
    Ok(Box::new(resampled))
}

/// Brings a source to a given grid in its own CRS, linearly between its samples; exactly where the
/// grid's samples are some of its own.
///
/// # Errors
/// Those of reading.
pub fn onto(source: Box<dyn DemSource>, grid: DemInfo) -> Result<Box<dyn DemSource>, DemError> {
    let mapping = Mapping::same(source.info());
    let target = Target {
        placement: grid.placement,
        width: grid.width,
        height: grid.height,
        crs: grid.crs,
    };
    let resampled = Resampled::new(source, target, mapping, Interpolation::Linear)?;
    Ok(Box::new(resampled))
}

/// Unnamed or differently named, what transforms alike is one.
fn same_crs(a: &Crs, b: &Crs) -> bool {
    a == b
        || matches!((crate::crs::definition(a), crate::crs::definition(b)), (Ok(a), Ok(b)) if a == b)
}

/// A source whose heights are above what the user says.
pub struct Stated {
    source: Box<dyn DemSource>,
    info: DemInfo,
}

impl Stated {
    /// `source` with another vertical reference.
    pub fn new(source: Box<dyn DemSource>, vertical: String) -> Stated {
        let info = DemInfo {
            vertical: Some(vertical),
            ..source.info().clone()
        };
        Stated { source, info }
    }
}

impl DemSource for Stated {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.source.read_rows(first_row, rows, out)
    }

    fn read_window(
        &mut self,
        rows: std::ops::Range<u32>,
        columns: std::ops::Range<u32>,
        out: &mut [f64],
    ) -> Result<(), DemError> {
        self.source.read_window(rows, columns, out)
    }

    fn block_shape(&self) -> [u32; 2] {
        self.source.block_shape()
    }

    fn data_columns(&self, first_row: u32, rows: u32) -> Vec<std::ops::Range<u32>> {
        self.source.data_columns(first_row, rows)
    }

    fn overlaps(&self) -> Option<crate::dem::OverlapReport> {
        self.source.overlaps()
    }

    fn finish(&mut self) -> Result<(), DemError> {
        self.source.finish()
    }

    fn grains(&mut self, first_row: u32, rows: u32, out: &mut [Grain]) -> Result<(), DemError> {
        self.source.grains(first_row, rows, out)
    }

    fn is_nested(&self) -> bool {
        self.source.is_nested()
    }

    fn resampling(&self) -> Option<escarp_proto::manifest::Resampling> {
        self.source.resampling()
    }
}
