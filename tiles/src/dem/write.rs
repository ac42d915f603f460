//! Writes any source as a GeoTIFF: tiled, deflate with a predictor, streamed by rows of tiles (the
//! encoder's own strip calls do not compress when streamed).

mod keys;

use std::io::{BufWriter, Seek, Write};
use std::path::Path;

use rayon::prelude::*;
use tempfile::NamedTempFile;
use tiff::TiffError;
use tiff::encoder::compression::{CompressionAlgorithm, Deflate, DeflateLevel};
use tiff::encoder::{DirectoryEncoder, TiffEncoder, TiffKind, TiffKindBig, TiffKindStandard};
use tiff::tags::{CompressionMethod, Predictor, SampleFormat, Tag};

use super::{Crs, DemError, DemInfo, DemSource, Registration};
use keys::Keys;

/// Samples on a side of a tile; tiles of very wide grids are lower.
const TILE: u32 = 256;

/// Samples of one row of tiles that are held in memory, unless it is of the lowest tiles.
const ROW_SAMPLES: u32 = 32 << 20;

/// TIFF allows multiples of this as a tile's height.
const LEAST_TILE: u32 = 16;

/// Raw bytes above which the file is a BigTIFF: offsets of a classic one end at 4 GiB.
const CLASSIC_BYTES: u64 = 3 << 30;

/// How heights are stored, in metres.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// Whole metres; the lowest value is a hole.
    I16,
    /// Whole metres; the lowest value is a hole.
    I32,
    /// Floats of 32 bits; NaN is a hole.
    F32,
    /// Floats of 64 bits; NaN is a hole.
    F64,
}

impl Encoding {
    /// Such as `i16`.
    pub fn name(self) -> &'static str {
        match self {
            Encoding::I16 => "i16",
            Encoding::I32 => "i32",
            Encoding::F32 => "f32",
            Encoding::F64 => "f64",
        }
    }

    fn bytes(self) -> u32 {
        match self {
            Encoding::I16 => 2,
            Encoding::I32 | Encoding::F32 => 4,
            Encoding::F64 => 8,
        }
    }

    fn is_integer(self) -> bool {
        matches!(self, Encoding::I16 | Encoding::I32)
    }

    fn nodata(self) -> String {
        match self {
            Encoding::I16 => i16::MIN.to_string(),
            Encoding::I32 => i32::MIN.to_string(),
            Encoding::F32 | Encoding::F64 => "nan".into(),
        }
    }

    /// Appends a row of a tile, with the predictor applied.
    fn encode(self, row: impl Iterator<Item = f64>, out: &mut Vec<u8>) {
        match self {
            Encoding::I16 => {
                let mut last = 0;
                for height in row {
                    let stored = whole(height, i16::MIN.into()) as i16;
                    out.extend(stored.wrapping_sub(last).to_le_bytes());
                    last = stored;
                }
            }
            Encoding::I32 => {
                let mut last = 0;
                for height in row {
                    let stored = whole(height, i32::MIN.into()) as i32;
                    out.extend(stored.wrapping_sub(last).to_le_bytes());
                    last = stored;
                }
            }
            Encoding::F32 => predict(
                &row.map(|h| (h as f32).to_be_bytes()).collect::<Vec<_>>(),
                out,
            ),
            Encoding::F64 => predict(&row.map(f64::to_be_bytes).collect::<Vec<_>>(), out),
        }
    }
}

/// A height as a whole number; a hole as the lowest one.
fn whole(height: f64, hole: f64) -> f64 {
    if height.is_nan() {
        hole
    } else {
        height.round()
    }
}

/// Writes `source` to `path` as 32-bit floats in metres: see [`write_geotiff_as`].
///
/// # Errors
/// As [`write_geotiff_as`].
pub fn write_geotiff(path: &Path, source: &mut dyn DemSource) -> Result<(), DemError> {
    write_geotiff_as(path, source, Encoding::F32)
}

/// Writes `source` to `path`, in metres, with its place and what its heights are above. The file
/// appears when it is whole. Holds one row of tiles in memory.
///
/// # Errors
/// Those of reading the source; [`DemError::Io`] naming `path`.
pub fn write_geotiff_as(
    path: &Path,
    source: &mut dyn DemSource,
    encoding: Encoding,
) -> Result<(), DemError> {
    let info = source.info();
    let raw_bytes = u64::from(info.width) * u64::from(info.height) * u64::from(encoding.bytes());
    let folder = path
        .parent()
        .filter(|p| !p.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    let failed = |doing| move |error| DemError::io(path, doing, error);
    let file = temporary(folder).map_err(failed("create"))?;
    let mut out = BufWriter::new(file);
    if raw_bytes < CLASSIC_BYTES {
        write::<_, TiffKindStandard>(&mut out, source, encoding, path)?;
    } else {
        write::<_, TiffKindBig>(&mut out, source, encoding, path)?;
    }
    let file = out
        .into_inner()
        .map_err(|e| DemError::io(path, "write", e.into_error()))?;
    file.as_file().sync_all().map_err(failed("sync"))?;
    file.persist(path)
        .map_err(|e| DemError::io(path, "rename", e.error))?;
    Ok(())
}

/// A file beside the final one, which everyone may read that may read a usual new file.
fn temporary(folder: &Path) -> std::io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder
        .prefix(".escarp-")
        .suffix(".tif")
        .tempfile_in(folder)
}

fn write<W: Write + Seek, K: TiffKind>(
    out: W,
    source: &mut dyn DemSource,
    encoding: Encoding,
    path: &Path,
) -> Result<(), DemError> {
    let failed = |error| tiff_failed(error, path);
    let mut tiff = TiffEncoder::<W, K>::new_generic(out).map_err(failed)?;
    let mut directory = tiff.image_directory().map_err(failed)?;
    let (width, height) = (source.info().width, source.info().height);
    let tile_height = tile_height(width);
    write_tags(&mut directory, source.info(), encoding, tile_height).map_err(failed)?;
    let (mut offsets, mut counts) = (Vec::new(), Vec::new());
    for top in (0..height).step_by(tile_height as usize) {
        let rows = tile_height.min(height - top);
        for tile in tile_row(source, [top, rows], tile_height, encoding, path)? {
            offsets.push(directory.write_data(&tile[..]).map_err(failed)?);
            counts.push(tile.len() as u64);
        }
    }
    write_offsets::<_, K>(&mut directory, Tag::TileOffsets, &offsets).map_err(failed)?;
    write_offsets::<_, K>(&mut directory, Tag::TileByteCounts, &counts).map_err(failed)?;
    directory.finish().map_err(failed)
}

/// Rows of a tile, so that a row of tiles does not take more memory than it should.
fn tile_height(width: u32) -> u32 {
    let most = ROW_SAMPLES / width.max(1) / LEAST_TILE * LEAST_TILE;
    most.clamp(LEAST_TILE, TILE)
}

/// Compressed tiles of one row of tiles.
fn tile_row(
    source: &mut dyn DemSource,
    [top, rows]: [u32; 2],
    tile_height: u32,
    encoding: Encoding,
    path: &Path,
) -> Result<Vec<Vec<u8>>, DemError> {
    let width = source.info().width;
    let mut heights = vec![0.0; rows as usize * width as usize];
    source.read_rows(top, rows, &mut heights)?;
    let compress = |left: u32| {
        let mut raw = Vec::with_capacity((TILE * tile_height * encoding.bytes()) as usize);
        for row in 0..tile_height {
            // Beyond the border the last sample is repeated, which compresses to nothing.
            let start = row.min(rows - 1) as usize * width as usize;
            let column = |c: u32| heights[start + (left + c).min(width - 1) as usize];
            encoding.encode((0..TILE).map(column), &mut raw);
        }
        let mut packed = Vec::new();
        Deflate::with_level(DeflateLevel::Balanced)
            .write_to(&mut packed, &raw)
            .map(|_| packed)
    };
    let lefts: Vec<u32> = (0..width).step_by(TILE as usize).collect();
    let tiles: Result<_, std::io::Error> = lefts.into_par_iter().map(compress).collect();
    tiles.map_err(|e| DemError::io(path, "compress", e))
}

/// TIFF predictor 3 (Adobe, "TIFF Technical Note 3", 2005) on big-endian samples: the row's most
/// significant bytes first, then the next ones, each byte as the difference to the one before.
pub(super) fn predict<const BYTES: usize>(row: &[[u8; BYTES]], out: &mut Vec<u8>) {
    let mut last = 0u8;
    for byte in 0..BYTES {
        for sample in row {
            let value = sample[byte];
            out.push(value.wrapping_sub(last));
            last = value;
        }
    }
}

type Directory<'a, W, K> = DirectoryEncoder<'a, W, K>;

fn write_tags<W: Write + Seek, K: TiffKind>(
    directory: &mut Directory<'_, W, K>,
    info: &DemInfo,
    encoding: Encoding,
    tile_height: u32,
) -> Result<(), TiffError> {
    let (format, predictor) = match encoding.is_integer() {
        true => (SampleFormat::Int, Predictor::Horizontal),
        false => (SampleFormat::IEEEFP, Predictor::FloatingPoint),
    };
    directory.write_tag(Tag::ImageWidth, info.width)?;
    directory.write_tag(Tag::ImageLength, info.height)?;
    directory.write_tag(Tag::BitsPerSample, encoding.bytes() as u16 * 8)?;
    directory.write_tag(Tag::Compression, CompressionMethod::Deflate.to_u16())?;
    directory.write_tag(Tag::PhotometricInterpretation, 1u16)?;
    directory.write_tag(Tag::SamplesPerPixel, 1u16)?;
    directory.write_tag(Tag::SampleFormat, format.to_u16())?;
    directory.write_tag(Tag::Predictor, predictor.to_u16())?;
    directory.write_tag(Tag::TileWidth, TILE)?;
    directory.write_tag(Tag::TileLength, tile_height)?;
    directory.write_tag(Tag::GdalNodata, &encoding.nodata()[..])?;
    match info.crs {
        Crs::Local => write_spacing(directory, info),
        _ => write_place(directory, info),
    }
}

/// Without georeference: the spacing alone. Readers take such files for cell-registered.
fn write_spacing<W: Write + Seek, K: TiffKind>(
    directory: &mut Directory<'_, W, K>,
    info: &DemInfo,
) -> Result<(), TiffError> {
    let place = &info.placement;
    let (x, y) = (place.x0 - place.dx / 2.0, place.y0 + place.dy / 2.0);
    directory.write_tag(Tag::ModelPixelScaleTag, &[place.dx, place.dy, 0.0][..])?;
    directory.write_tag(Tag::ModelTiepointTag, &[0.0, 0.0, 0.0, x, y, 0.0][..])
}

fn write_place<W: Write + Seek, K: TiffKind>(
    directory: &mut Directory<'_, W, K>,
    info: &DemInfo,
) -> Result<(), TiffError> {
    let place = &info.placement;
    let shift = match info.registration {
        Registration::Grid => 0.0,
        Registration::Cell => 0.5,
    };
    let (x, y) = (place.x0 - shift * place.dx, place.y0 + shift * place.dy);
    directory.write_tag(Tag::ModelPixelScaleTag, &[place.dx, place.dy, 0.0][..])?;
    directory.write_tag(Tag::ModelTiepointTag, &[0.0, 0.0, 0.0, x, y, 0.0][..])?;
    let keys = Keys::of(info);
    directory.write_tag(Tag::GeoKeyDirectoryTag, &keys.directory()[..])?;
    if !keys.doubles.is_empty() {
        directory.write_tag(Tag::GeoDoubleParamsTag, &keys.doubles[..])?;
    }
    if !keys.ascii.is_empty() {
        directory.write_tag(Tag::GeoAsciiParamsTag, &keys.ascii[..])?;
    }
    Ok(())
}

fn write_offsets<W: Write + Seek, K: TiffKind>(
    directory: &mut Directory<'_, W, K>,
    tag: Tag,
    values: &[u64],
) -> Result<(), TiffError> {
    let values = values.iter().map(|value| K::convert_offset(*value));
    directory.write_tag(
        tag,
        K::convert_slice(&values.collect::<Result<Vec<_>, _>>()?),
    )
}

fn tiff_failed(error: TiffError, path: &Path) -> DemError {
    let error = match error {
        TiffError::IoError(error) => error,
        other => std::io::Error::other(other),
    };
    DemError::io(path, "write", error)
}
