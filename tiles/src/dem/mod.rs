//! Elevation input: any DEM file becomes rows of heights in metres.
//!
//! Suggested reading order: [`DemSource`] here, then `error`, `heights` (raw sample to metres),
//! `detect` and `open` (formats are told by content), and one file a format: `geotiff` over
//! `chunks` (decoding), `geokeys` and `affine` (where samples lie); `hgt`, `dted`, `usgs`; `raw`
//! with its headers `esri_header` and `envi`; `ascii_grid` and `matrix` over `number_rows`;
//! `bitmap`, `rgb` and `pyramid`. Around them: `side` and `prj` (files beside a file), `unpack`
//! (gzip, zip), `handover` (to GDAL), `folder`, and `mosaic`, which makes many sources look like
//! one.
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
mod ascii_grid;
mod bitmap;
mod chunks;
mod detect;
mod dted;
mod envi;
mod error;
mod esri_header;
mod fill;
mod folder;
mod geokeys;
mod geotiff;
mod handover;
mod heights;
mod hgt;
mod matrix;
mod mosaic;
mod number_rows;
mod open;
mod prj;
mod pyramid;
mod raw;
mod rgb;
mod side;
#[cfg(test)]
mod testing;
mod unpack;
mod usgs;
mod write;

use escarp_proto::manifest::Resampling;
use escarp_proto::manifest::Tolerance;
use std::ops::Range;
use std::path::PathBuf;

pub use error::DemError;
pub use fill::{DEFAULT_FILL_SAMPLES, Filled, FilledRun, Fills, MAX_FILL_SAMPLES};
pub use folder::expand;
pub use mosaic::{Grain, JoinOptions, MAX_SEAM_SAMPLES, Mosaic, OverlapReport, Priority, Seam};
pub use open::{join_all, open, open_all};
pub use raw::RawShape;
pub use rgb::RgbCoding;
pub use write::{Encoding, write_geotiff, write_geotiff_as};

/// The most samples on one side of an input or a mosaic (the whole Earth at 0.3 arc seconds).
pub const MAX_SIDE_SAMPLES: u32 = 1 << 22;

/// The most bytes that one TIFF tile or strip may decode to (a TIFF in one strip is one chunk).
pub const MAX_CHUNK_BYTES: u64 = 256 << 20;

/// The most bytes that a bitmap may decode to: PNG has no chunks, so it is held whole.
pub const MAX_BITMAP_BYTES: u64 = 512 << 20;

/// The most bytes that a gzip or zip may unpack to, in a temporary file.
pub const MAX_UNPACKED_BYTES: u64 = 64 << 30;

/// Heights beyond this, in metres, are no heights: an undeclared nodata value or damage.
pub const MAX_HEIGHT_M: f64 = 1e9;

/// Samples of whole rows that are read at once for a window of them.
const WINDOW_SAMPLES: u32 = 4 << 20;

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

impl Crs {
    /// What the CRS is called: its code, its definition, or its file's citation.
    pub fn name(&self) -> &str {
        match self {
            Crs::Projected { name, .. } | Crs::Geographic { name, .. } => name,
            Crs::Local => "none",
        }
    }
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
    /// What heights are above, such as `EGM96 height (EPSG:5773)`; recorded, never transformed.
    pub vertical: Option<String>,
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

    /// Reads some columns of some rows into `out`, as [`read_rows`](Self::read_rows) does. Costs
    /// whole rows, unless a source can do better.
    ///
    /// # Errors
    /// As [`read_rows`](Self::read_rows).
    fn read_window(
        &mut self,
        rows: Range<u32>,
        columns: Range<u32>,
        out: &mut [f64],
    ) -> Result<(), DemError> {
        let across = self.info().check_window(&rows, &columns, out)?;
        let width = self.info().width;
        if columns == (0..width) {
            return self.read_rows(rows.start, rows.end - rows.start, out);
        }
        let at_once = (WINDOW_SAMPLES / width).max(1);
        let mut band = Vec::new();
        for (out, row) in out
            .chunks_mut(across * at_once as usize)
            .zip(rows.clone().step_by(at_once as usize))
        {
            let count = at_once.min(rows.end - row);
            band.resize(count as usize * width as usize, 0.0);
            self.read_rows(row, count, &mut band)?;
            let lines = band.chunks_exact(width as usize);
            for (out, line) in out.chunks_exact_mut(across).zip(lines) {
                out.copy_from_slice(&line[columns.start as usize..columns.end as usize]);
            }
        }
        Ok(())
    }

    /// Columns and rows that are stored together: windows of whole blocks, counted from the
    /// north-west, cost no more than themselves.
    fn block_shape(&self) -> [u32; 2] {
        [self.info().width, 1]
    }

    /// What overlapping inputs said of the same samples, over the rows read so far; `None` where
    /// there is only one input.
    fn overlaps(&self) -> Option<OverlapReport> {
        None
    }

    /// Whether some samples are of inputs that are coarser than the grid.
    fn is_nested(&self) -> bool {
        false
    }

    /// Which samples of some rows are of coarser inputs: cheap for the rows read last.
    ///
    /// # Errors
    /// As [`read_rows`](Self::read_rows).
    fn grains(&mut self, first_row: u32, rows: u32, out: &mut [Grain]) -> Result<(), DemError> {
        let _ = (first_row, rows);
        out.fill(Grain::Finest);
        Ok(())
    }

    /// Reads what was never asked for, where [`resampling`](Self::resampling) or
    /// [`tolerances`](Self::tolerances) need it: after a build that was resumed.
    ///
    /// # Errors
    /// As [`read_rows`](Self::read_rows).
    fn finish(&mut self) -> Result<(), DemError> {
        Ok(())
    }

    /// What bringing the input to this grid cost, over the rows read so far; `None` where each
    /// sample is the input's.
    fn resampling(&self) -> Option<Resampling> {
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
    /// Metres that the largest value of an 8 or 16 bit unsigned sample stands for, 0 being 0 m;
    /// instead of a step.
    pub max_height_m: Option<f64>,
    /// What coordinates mean, for files that are placed but do not say in which system.
    pub crs: Option<Crs>,
    /// Shape of the samples of files that say nothing of themselves. Inputs are then read so,
    /// whatever they look like (unpacked first, if they are gzip or zip).
    pub raw: Option<RawShape>,
    /// How heights are coded in the colours of PNG tiles.
    pub rgb: Option<RgbCoding>,
    /// Zoom to read of a folder of tiles.
    pub zoom: Option<u8>,
    /// Zoom, column and row of a tile that does not lie in a folder `{z}/{x}/{y}.png`.
    pub tile: Option<[u32; 3]>,
    /// Text files of the longitudes and latitudes of an ASCII matrix' columns and rows.
    pub lons_lats: Option<[PathBuf; 2]>,
}

/// Says something that the user should know of a file, and that is no error.
fn note(path: &std::path::Path, text: &str) {
    eprintln!("note: {}: {text}", path.display());
}

impl DemInfo {
    /// Checks a window asked of [`DemSource::read_window`], and gives its columns.
    pub(crate) fn check_window(
        &self,
        rows: &Range<u32>,
        columns: &Range<u32>,
        out: &[f64],
    ) -> Result<usize, DemError> {
        let inside = |range: &Range<u32>, side| range.start < range.end && range.end <= side;
        let samples = rows.len() * columns.len();
        if inside(rows, self.height) && inside(columns, self.width) && samples == out.len() {
            return Ok(columns.len());
        }
        let what = format!(
            "rows {rows:?}, columns {columns:?} for {} of {} x {} samples",
            out.len(),
            self.width,
            self.height
        );
        Err(DemError::usage(
            &self.path,
            what,
            "ask for a window that exists",
        ))
    }

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
