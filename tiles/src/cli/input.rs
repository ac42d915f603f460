//! What the user says of how to read input files.

use crate::crs;
use crate::dem::{Crs, OpenOptions, RawShape, RgbCoding};
use clap::{Args, ValueEnum};
use std::path::{Path, PathBuf};

/// What the user says about inputs.
#[derive(Debug, Clone, Args)]
pub(super) struct InputArgs {
    /// Distance of samples: of files without georeference it states theirs, in metres; others are
    /// brought to it, in the units of the dataset's CRS (metres, feet, degrees)
    #[arg(long, value_name = "DISTANCE", allow_negative_numbers = true)]
    spacing: Option<f64>,
    /// Metres a stored unit stands for, for integer files (pictures: default 1)
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    height_step: Option<f64>,
    /// Metres that white stands for, black being 0 m, for greys of 8 or 16 bits
    #[arg(
        long,
        value_name = "M",
        conflicts_with = "height_step",
        allow_negative_numbers = true
    )]
    max_height: Option<f64>,
    /// Metres added to every height
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    height_offset: Option<f64>,
    /// Stored value that means "no data"
    #[arg(long, value_name = "VALUE", allow_negative_numbers = true)]
    nodata: Option<f64>,
    /// What coordinates mean, for files that do not say: EPSG:CODE, a PROJ string, WKT, or a
    /// .prj file
    #[arg(long, value_name = "CRS", value_parser = parse_crs)]
    input_crs: Option<Crs>,
    /// Shape of files without any header: WIDTHxHEIGHT:TYPE[:le|be][:SKIP], TYPE one of u8 i8 u16
    /// i16 u32 i32 u64 i64 f32 f64, north row first
    #[arg(long, value_name = "SHAPE")]
    raw: Option<RawShape>,
    /// How heights are coded in the colours of PNG tiles
    #[arg(long, value_name = "CODING", value_enum)]
    rgb: Option<Coding>,
    /// Zoom to read of a folder {z}/{x}/{y}.png; default: the deepest without a missing tile
    #[arg(long, value_name = "Z")]
    zoom: Option<u8>,
    /// Which tile a single PNG is
    #[arg(long, value_name = "Z/X/Y", value_parser = parse_tile)]
    tile: Option<[u32; 3]>,
    /// Text of the longitudes of an ASCII matrix' columns
    #[arg(long, value_name = "FILE", requires = "lats")]
    lons: Option<PathBuf>,
    /// Text of the latitudes of its rows
    #[arg(long, value_name = "FILE", requires = "lons")]
    lats: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Coding {
    /// -10000 m + 0.1 m * (65536 R + 256 G + B)
    Mapbox,
    /// 256 R + G + B / 256 - 32768 m
    Terrarium,
}

impl InputArgs {
    /// Files that the options name.
    pub(super) fn files(&self) -> Vec<PathBuf> {
        [&self.lons, &self.lats]
            .into_iter()
            .flatten()
            .cloned()
            .collect()
    }

    pub(super) fn options(&self) -> OpenOptions {
        OpenOptions {
            spacing_m: self.spacing,
            height_step_m: self.height_step,
            height_offset_m: self.height_offset,
            nodata: self.nodata,
            max_height_m: self.max_height,
            crs: self.input_crs.clone(),
            raw: self.raw,
            rgb: self.rgb.map(|coding| match coding {
                Coding::Mapbox => RgbCoding::Mapbox,
                Coding::Terrarium => RgbCoding::Terrarium,
            }),
            zoom: self.zoom,
            tile: self.tile,
            lons_lats: self.lons.clone().zip(self.lats.clone()).map(Into::into),
        }
    }
}

/// A code, a text, or a file that has the text.
fn parse_crs(text: &str) -> Result<Crs, String> {
    if Path::new(text).is_file() {
        let read = std::fs::read_to_string(text);
        return crs::from_user(&read.map_err(|e| format!("it cannot be read: {e}"))?);
    }
    crs::from_user(text)
}

fn parse_tile(text: &str) -> Result<[u32; 3], String> {
    let numbers: Option<Vec<u32>> = text.split('/').map(|n| n.parse().ok()).collect();
    let numbers = numbers.unwrap_or_default();
    <[u32; 3]>::try_from(numbers)
        .map_err(|_| "a tile is ZOOM/COLUMN/ROW, such as 12/3626/1617".into())
}
