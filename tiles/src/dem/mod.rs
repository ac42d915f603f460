//! Elevation input: any DEM file becomes rows of heights in metres.
//!
//! Suggested reading order: [`DemSource`] here, then `error`, `heights` (raw sample to metres),
//! `geokeys` and `affine` (where GeoTIFF samples lie), `geotiff` over `chunks` (decoding), `hgt`,
//! `png`, and `mosaic`, which makes many sources look like one.
//!
//! ```text
//!  column 0      column 1            (x0, y0) is the CENTRE of sample (column 0, row 0),
//!     o─────dx─────o  ── row 0       the north-west one, in grid- and cell-registered
//!     │            │                 files alike: a cell-registered reader has already
//!     dy           │                 moved by half a cell.
//!     │            │
//!     o────────────o  ── row 1       x(c) = x0 + c*dx        y(r) = y0 - r*dy
//! ```
//!
//! Every reader is safe on untrusted files: sizes are checked against the file's length and the
//! limits below before memory is taken, and damage is an error that names the place.

mod affine;
mod chunks;
mod error;
mod fill;
mod geokeys;
mod geotiff;
mod heights;
mod hgt;
mod mosaic;
mod open;
mod png;
#[cfg(test)]
mod testing;
mod write;

use escarp_proto::manifest::Tolerance;
use std::ops::Range;
use std::path::PathBuf;

pub use error::DemError;
pub use fill::{DEFAULT_FILL_SAMPLES, Filled, FilledRun, Fills, MAX_FILL_SAMPLES};
pub use mosaic::{JoinOptions, MAX_SEAM_SAMPLES, Mosaic, OverlapReport, Priority, Seam};
pub use open::{join_all, open, open_all};
pub use write::write_geotiff;

/// The most samples on one side of an input or a mosaic (the whole Earth at 0.3 arc seconds).
pub const MAX_SIDE_SAMPLES: u32 = 1 << 22;

/// The most bytes that one TIFF tile or strip may decode to (a TIFF in one strip is one chunk).
pub const MAX_CHUNK_BYTES: u64 = 256 << 20;

/// The most bytes that a PNG may decode to: PNG has no chunks, so it is held whole.
pub const MAX_PNG_BYTES: u64 = 512 << 20;

/// Heights beyond this, in metres, are no heights: an undeclared nodata value or damage.
pub const MAX_HEIGHT_M: f64 = 1e9;

/// Where samples lie: CRS coordinates of the centre of sample (column 0, row 0), the north-west
/// one, and steps. Column `c` is at `x0 + c*dx`, row `r` at `y0 - r*dy`; `dx` and `dy` are above
/// zero. A file stored south-up is flipped by its reader, so that this always holds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// East coordinate of column 0, in CRS units.
    pub x0: f64,
    /// North coordinate of row 0, in CRS units.
    pub y0: f64,
    /// Step to the next column, east, in CRS units.
    pub dx: f64,
    /// Step to the next row, south, in CRS units.
    pub dy: f64,
}

/// What the coordinates of a [`Placement`] mean.
#[derive(Debug, Clone, PartialEq)]
pub enum Crs {
    /// Plane coordinates.
    Projected {
        /// Such as `EPSG:32612`, or the file's citation where it gives no code.
        name: String,
        /// Turns the coordinates into metres.
        metres_per_unit: f64,
    },
    /// Longitude and latitude in degrees.
    Geographic {
        /// Such as `EPSG:4326`, or the file's citation where it gives no code.
        name: String,
        /// Semi-major axis of the body, in metres.
        radius_m: f64,
    },
    /// No georeference: the user gave the spacing in metres; sample (0, 0) is at the origin.
    Local,
}

impl std::fmt::Display for Crs {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Crs::Projected {
                name,
                metres_per_unit,
            } => write!(f, "{name} with units of {metres_per_unit} m"),
            Crs::Geographic { name, radius_m } => write!(f, "{name} on a radius of {radius_m} m"),
            Crs::Local => f.write_str("none"),
        }
    }
}

/// Whether samples were recorded as grid points or as cells. For information: [`Placement`]
/// already has the half-cell shift applied.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Registration {
    /// Grid-registered (`PixelIsPoint`): a coordinate names a sample.
    Grid,
    /// Cell-registered (`PixelIsArea`): a coordinate names a cell's corner.
    Cell,
}

/// How a sample is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names are the types")]
pub enum SampleType {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F16,
    F32,
    F64,
}

impl SampleType {
    /// Bytes of one sample in the file.
    pub fn bytes(self) -> u32 {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 | Self::F16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    /// True where heights are a whole number of [`DemInfo::height_step_m`] (plus an offset).
    pub fn is_integer(self) -> bool {
        !matches!(self, Self::F16 | Self::F32 | Self::F64)
    }
}

/// What is known of a source before its samples are read.
#[derive(Debug, Clone, PartialEq)]
pub struct DemInfo {
    /// The file; for a mosaic the first input.
    pub path: PathBuf,
    /// Such as `GeoTIFF`, `SRTM hgt`, `PNG`, `mosaic`.
    pub format: &'static str,
    /// Samples in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Where the samples lie.
    pub placement: Placement,
    /// What the placement's coordinates mean.
    pub crs: Crs,
    /// As recorded in the file.
    pub registration: Registration,
    /// As stored in the file; for a mosaic of several kinds, [`SampleType::F64`].
    pub sample_type: SampleType,
    /// Metres that one unit of the stored value stands for.
    pub height_step_m: f64,
    /// The stored value (before step and offset) that means "no height here".
    pub nodata: Option<f64>,
}

/// A grid of heights that can be read by rows.
pub trait DemSource: Send {
    /// Size, place, and kind.
    fn info(&self) -> &DemInfo;

    /// Reads rows `first_row..first_row + rows`, row 0 being the north one, into `out`: heights in
    /// metres, row by row, NaN where there is a hole. Bands from north to south are fast (each
    /// TIFF chunk is decoded once); any order is right.
    ///
    /// # Errors
    /// [`DemError::Usage`] if the rows lie outside or `out` is not `rows * width` long;
    /// [`DemError::Damaged`] and [`DemError::Io`] naming the place. `out` is then unspecified.
    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError>;

    /// What overlapping inputs said of the same samples, over the rows read so far; `None` where
    /// there is only one input.
    fn overlaps(&self) -> Option<OverlapReport> {
        None
    }

    /// Columns outside of which rows `first_row..first_row + rows` are known to be holes, without
    /// reading them: ascending, apart from each other. None at all if there is no data in them.
    fn data_columns(&self, first_row: u32, rows: u32) -> Vec<Range<u32>> {
        let _ = (first_row, rows);
        std::iter::once(0..self.info().width).collect()
    }

    /// By how much heights are coarser than those of the files, over the rows read so far; empty
    /// where nothing was allowed to be.
    fn tolerances(&self) -> Vec<Tolerance> {
        Vec::new()
    }

    /// Which samples are no data but fill; `None` where nothing was asked to be filled.
    fn fills(&self) -> Option<&Fills> {
        None
    }
}

/// What the user says about an input; each `None` leaves it to the file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct OpenOptions {
    /// Metres between samples, for files without georeference (needed there, ignored elsewhere).
    pub spacing_m: Option<f64>,
    /// Metres a stored unit stands for; replaces the file's scale and vertical unit.
    pub height_step_m: Option<f64>,
    /// Metres added to each height; replaces the file's offset.
    pub height_offset_m: Option<f64>,
    /// Stored value that is a hole; replaces the file's nodata value.
    pub nodata: Option<f64>,
}

impl DemInfo {
    /// Checks a band asked of [`DemSource::read_rows`].
    pub(crate) fn check_band(
        &self,
        first_row: u32,
        rows: u32,
        out: &[f64],
    ) -> Result<(), DemError> {
        let end = u64::from(first_row) + u64::from(rows);
        if end > u64::from(self.height) {
            let what = format!("rows {first_row}..{end} were asked of {} rows", self.height);
            return Err(DemError::usage(
                &self.path,
                what,
                "ask only for rows that exist",
            ));
        }
        let samples = u64::from(rows) * u64::from(self.width);
        if out.len() as u64 != samples {
            let what = format!("a buffer of {} samples for a band of {samples}", out.len());
            return Err(DemError::usage(
                &self.path,
                what,
                "give rows * width samples",
            ));
        }
        Ok(())
    }

    /// Checks the size against [`MAX_SIDE_SAMPLES`] before anything is computed from it.
    fn check_size(&self) -> Result<(), DemError> {
        for (side, found) in [("width", self.width), ("height", self.height)] {
            if found == 0 {
                return Err(DemError::damaged(
                    &self.path,
                    side,
                    "0 samples",
                    "at least 1",
                ));
            }
            if found > MAX_SIDE_SAMPLES {
                let (found, allowed) = (u64::from(found), u64::from(MAX_SIDE_SAMPLES));
                return Err(DemError::limits(
                    &self.path, side, found, allowed, "samples",
                ));
            }
        }
        Ok(())
    }
}
