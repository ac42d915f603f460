//! Small DEM files, made without the readers that are under test.

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use std::fs::File;
use std::io::Write;
use std::path::Path;
use tiff::encoder::{TiffEncoder, colortype};
use tiff::tags::Tag;

/// Samples a side of an SRTM tile of 3 arc seconds.
pub const HGT_SIDE: u32 = 1201;

/// How a GeoTIFF says where its samples lie. Its first sample, or the north-west corner of its
/// first cell, is at (500000, 5000000) in UTM zone 32; samples are 10 m apart east, 20 m south.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Registered {
    /// `PixelIsPoint`.
    Grid,
    /// `PixelIsArea`.
    Cell,
}

/// How a GeoTIFF stores a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names are the types")]
pub enum Stored {
    I16,
    U16,
    I32,
    F32,
}

/// Easting and northing of the tie point of [`write_tiff`], metres.
pub const TIE_M: [f64; 2] = [500_000.0, 5_000_000.0];
/// Steps east and south of [`write_tiff`], metres.
pub const STEP_M: [f64; 2] = [10.0, 20.0];

/// Writes a GeoTIFF of heights by column and row, row 0 the northern one.
///
/// # Panics
/// If it cannot be written.
pub fn write_tiff(
    path: &Path,
    [width, height]: [u32; 2],
    registered: Registered,
    stored: Stored,
    heights: impl Fn(u32, u32) -> f64,
) {
    let samples = by_rows([width, height], &heights);
    let raster_type = match registered {
        Registered::Grid => 2,
        Registered::Cell => 1,
    };
    let keys: [u16; 20] = [
        1,
        1,
        0,
        4,
        1024,
        0,
        1,
        1,
        1025,
        0,
        1,
        raster_type,
        3072,
        0,
        1,
        32632,
        3076,
        0,
        1,
        9001,
    ];
    let scale = [STEP_M[0], STEP_M[1], 0.0];
    let tie = [0.0, 0.0, 0.0, TIE_M[0], TIE_M[1], 0.0];
    let mut encoder = TiffEncoder::new(File::create(path).unwrap()).unwrap();
    macro_rules! write {
        ($colour:ty, $sample:ty) => {{
            let mut image = encoder.new_image::<$colour>(width, height).unwrap();
            let tags = image.encoder();
            tags.write_tag(Tag::ModelPixelScaleTag, &scale[..]).unwrap();
            tags.write_tag(Tag::ModelTiepointTag, &tie[..]).unwrap();
            tags.write_tag(Tag::GeoKeyDirectoryTag, &keys[..]).unwrap();
            let samples: Vec<$sample> = samples.iter().map(|v| *v as $sample).collect();
            image.write_data(&samples).unwrap();
        }};
    }
    match stored {
        Stored::I16 => write!(colortype::GrayI16, i16),
        Stored::U16 => write!(colortype::Gray16, u16),
        Stored::I32 => write!(colortype::GrayI32, i32),
        Stored::F32 => write!(colortype::Gray32Float, f32),
    }
}

/// The bytes of an SRTM tile.
pub fn hgt_bytes(heights: impl Fn(u32, u32) -> f64) -> Vec<u8> {
    let samples = by_rows([HGT_SIDE; 2], &heights);
    samples
        .iter()
        .flat_map(|v| (*v as i16).to_be_bytes())
        .collect()
}

/// A zip with one file in it.
///
/// # Panics
/// If it cannot be written.
pub fn write_zip(path: &Path, name: &str, content: &[u8]) {
    let mut zip = zip::ZipWriter::new(File::create(path).unwrap());
    zip.start_file(name, zip::write::SimpleFileOptions::default())
        .unwrap();
    zip.write_all(content).unwrap();
    zip.finish().unwrap();
}

/// Writes a PNG of 16 bits.
///
/// # Panics
/// If it cannot be written.
pub fn write_png(path: &Path, [width, height]: [u32; 2], greys: impl Fn(u32, u32) -> f64) {
    let samples = by_rows([width, height], &greys);
    let bytes: Vec<u8> = samples
        .iter()
        .flat_map(|v| (*v as u16).to_ne_bytes())
        .collect();
    let encoder = PngEncoder::new(File::create(path).unwrap());
    encoder
        .write_image(&bytes, width, height, ExtendedColorType::L16)
        .unwrap();
}

fn by_rows([width, height]: [u32; 2], heights: &impl Fn(u32, u32) -> f64) -> Vec<f64> {
    let row = |row| (0..width).map(move |column| heights(column, row));
    (0..height).flat_map(row).collect()
}
