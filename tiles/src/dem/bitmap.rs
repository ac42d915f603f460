//! Greyscale pictures of 8 or 16 bits: PNG, PGM, BMP, JPEG. A height map that knows no place, so
//! the user gives the spacing (or a world file lies beside it), and the metres of one grey level
//! or of white.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use image::{ColorType, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits};

use super::error::in_and_out;
use super::heights::{self, HeightRule};
use super::{
    DemError, DemInfo, DemSource, MAX_BITMAP_BYTES, OpenOptions, Registration, SampleType, side,
};

/// Decoders hold parts of the picture beside the result.
const DECODER_BYTES: u64 = 2 * MAX_BITMAP_BYTES;

/// One open picture, decoded whole (up to [`MAX_BITMAP_BYTES`]) when rows are first asked for.
pub(super) struct Bitmap {
    info: DemInfo,
    rule: HeightRule,
    south_up: bool,
    samples: Option<Vec<u8>>,
}

impl Bitmap {
    /// Reads the header.
    ///
    /// # Errors
    /// [`DemError::Usage`] without a spacing, [`DemError::Unsupported`] for colour,
    /// [`DemError::Limits`] for size.
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Self, DemError> {
        let (decoder, format) = decoder(path)?;
        let (width, height) = decoder.dimensions();
        let sample_type = sample_type(decoder.color_type(), format, path)?;
        let layout = side::world_file(path, height)?;
        let projection = match layout {
            Some(_) => side::projection(path, options)?,
            None => None,
        };
        let rule = HeightRule::resolve(HeightRule::METRES, options, sample_type, path)?;
        let registration = match layout {
            Some(_) => Registration::Cell,
            None => Registration::Grid,
        };
        let (layout, crs) = side::settle(layout, projection.map(|p| p.crs), path, options)?;
        let info = DemInfo {
            path: path.into(),
            format: name_of(format),
            width,
            height,
            placement: layout.placement,
            crs,
            registration,
            sample_type,
            height_step_m: rule.step_m,
            nodata: rule.nodata,
            vertical: None,
        };
        info.check_size()?;
        check_bytes(decoder.total_bytes(), path)?;
        Ok(Self {
            info,
            rule,
            south_up: layout.south_up,
            samples: None,
        })
    }

    fn decode(&self) -> Result<Vec<u8>, DemError> {
        let path = &self.info.path;
        let (pixels, colour) = pixels(path)?;
        let samples = match colour {
            ColorType::L8 | ColorType::L16 => pixels,
            _ => grey_of_colour(&pixels, self.info.width, path)?,
        };
        let expected = u64::from(self.info.width)
            * u64::from(self.info.height)
            * u64::from(self.info.sample_type.bytes());
        if samples.len() as u64 == expected {
            return Ok(samples);
        }
        let found = format!("{} bytes of samples", samples.len());
        let place = "the picture's header";
        Err(DemError::damaged(path, place, found, expected.to_string()))
    }
}

impl DemSource for Bitmap {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        if self.samples.is_none() {
            self.samples = Some(self.decode()?);
        }
        let samples = self.samples.as_deref().unwrap_or_default();
        let width = self.info.width as usize;
        for (row, heights) in (first_row..).zip(out.chunks_exact_mut(width)) {
            let stored = match self.south_up {
                true => self.info.height - 1 - row,
                false => row,
            };
            let from = stored as usize * width;
            for (at, height) in (from..).zip(heights) {
                let stored = match self.info.sample_type {
                    SampleType::U8 => f64::from(samples[at]),
                    _ => f64::from(u16::from_ne_bytes([samples[2 * at], samples[2 * at + 1]])),
                };
                *height = self.rule.height_m(stored);
            }
        }
        heights::check(&self.info, first_row, out)
    }
}

/// A decoder that has read the header.
///
/// # Errors
/// [`DemError::Damaged`], [`DemError::Io`].
pub(super) fn decoder(path: &Path) -> Result<(impl ImageDecoder + use<>, ImageFormat), DemError> {
    let failed = |e| DemError::io(path, "read", e);
    let file = File::open(path).map_err(|e| DemError::io(path, "open", e))?;
    let mut reader = ImageReader::new(BufReader::new(file))
        .with_guessed_format()
        .map_err(failed)?;
    let mut limits = Limits::default();
    limits.max_alloc = Some(DECODER_BYTES);
    reader.limits(limits);
    let format = reader.format().unwrap_or(ImageFormat::Png);
    let decoder = reader.into_decoder().map_err(|e| explain(e, path))?;
    Ok((decoder, format))
}

/// All pixels, in the machine's byte order, and what they are.
///
/// # Errors
/// [`DemError::Limits`] beyond [`MAX_BITMAP_BYTES`]; [`DemError::Damaged`], [`DemError::Io`].
pub(super) fn pixels(path: &Path) -> Result<(Vec<u8>, ColorType), DemError> {
    let (decoder, _) = decoder(path)?;
    let bytes = decoder.total_bytes();
    check_bytes(bytes, path)?;
    let colour = decoder.color_type();
    let mut pixels = vec![0; bytes as usize];
    decoder
        .read_image(&mut pixels)
        .map_err(|e| explain(e, path))?;
    Ok((pixels, colour))
}

fn check_bytes(bytes: u64, path: &Path) -> Result<(), DemError> {
    if bytes <= MAX_BITMAP_BYTES {
        return Ok(());
    }
    let what = "the decoded picture (gdal_translate makes a GeoTIFF of it)";
    Err(DemError::limits(
        path,
        what,
        bytes,
        MAX_BITMAP_BYTES,
        "bytes",
    ))
}

fn name_of(format: ImageFormat) -> &'static str {
    match format {
        ImageFormat::Bmp => "BMP",
        ImageFormat::Pnm => "PGM",
        ImageFormat::Jpeg => "JPEG",
        _ => "PNG",
    }
}

/// A BMP has no greys but in its colours, which are compared when they are decoded.
fn sample_type(
    colour: ColorType,
    format: ImageFormat,
    path: &Path,
) -> Result<SampleType, DemError> {
    match (colour, format) {
        (ColorType::L8, _) => Ok(SampleType::U8),
        (ColorType::L16, _) => Ok(SampleType::U16),
        (ColorType::Rgb8 | ColorType::Rgba8, ImageFormat::Bmp) => Ok(SampleType::U8),
        (ColorType::La8 | ColorType::La16, _) => {
            let hint = format!("take the grey: gdal_translate -b 1 {}", in_and_out(path));
            Err(DemError::unsupported(
                path,
                "a picture with transparency",
                hint,
            ))
        }
        (ColorType::Rgb8 | ColorType::Rgba8, ImageFormat::Png) => {
            let hint = format!(
                "if its colours code heights, say how: --rgb mapbox or --rgb terrarium; if they \
                 are greys, take one: gdal_translate -b 1 {}",
                in_and_out(path)
            );
            Err(DemError::unsupported(path, "a PNG in colour", hint))
        }
        _ => {
            let hint = format!("take one colour: gdal_translate -b 1 {}", in_and_out(path));
            Err(DemError::unsupported(path, "a picture in colour", hint))
        }
    }
}

/// Greys of pixels whose red, green and blue are the same.
fn grey_of_colour(pixels: &[u8], width: u32, path: &Path) -> Result<Vec<u8>, DemError> {
    let (across, _) = decoder(path).map(|(d, _)| (d.color_type().bytes_per_pixel(), ()))?;
    let across = usize::from(across);
    let mut greys = Vec::with_capacity(pixels.len() / across);
    for (at, pixel) in pixels.chunks_exact(across).enumerate() {
        if pixel[0] != pixel[1] || pixel[1] != pixel[2] {
            let (row, column) = (at / width as usize, at % width as usize);
            let what = format!("colour, at row {row}, column {column},");
            let hint = format!("take one colour: gdal_translate -b 1 {}", in_and_out(path));
            return Err(DemError::unsupported(path, what, hint));
        }
        greys.push(pixel[0]);
    }
    Ok(greys)
}

fn explain(error: ImageError, path: &Path) -> DemError {
    let expected = "a sound picture (is the file cut short?)";
    match error {
        ImageError::IoError(e) if e.kind() != std::io::ErrorKind::UnexpectedEof => {
            DemError::io(path, "read", e)
        }
        ImageError::Limits(e) => {
            let expected = "at most 512 MiB decoded";
            DemError::damaged(path, "the picture's data", e.to_string(), expected)
        }
        other => DemError::damaged(path, "the picture's data", other.to_string(), expected),
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Folder, png_bytes, read_all};
    use super::super::{Crs, open};
    use super::*;

    fn spaced() -> OpenOptions {
        OpenOptions {
            spacing_m: Some(160.0),
            height_step_m: Some(0.1),
            ..OpenOptions::default()
        }
    }

    #[test]
    fn grey_levels_become_metres_by_step_and_offset() {
        let folder = Folder::new();
        let sixteen = folder.write(
            "a.png",
            &png_bytes(3, 2, true, |r, c| (r * 1000 + c) as u16),
        );
        let eight = folder.write(
            "b.png",
            &png_bytes(3, 2, false, |r, c| (r * 100 + c) as u16),
        );
        let options = OpenOptions {
            height_offset_m: Some(5.0),
            ..spaced()
        };
        for (path, south) in [(sixteen, 1002.0), (eight, 102.0)] {
            let (info, rows) = read_all(&path, &options).unwrap();
            assert_eq!((info.placement.dx, info.crs), (160.0, Crs::Local));
            assert_eq!(rows[0], 5.0);
            assert!((rows[5] - (south * 0.1 + 5.0)).abs() < 1e-12);
        }
    }

    #[test]
    fn white_stands_for_the_largest_height_that_is_given() {
        let folder = Folder::new();
        let options = OpenOptions {
            max_height_m: Some(510.0),
            height_step_m: None,
            ..spaced()
        };
        for (sixteen, white) in [(true, 65535), (false, 255)] {
            let path = folder.write(
                "a.png",
                &png_bytes(3, 1, sixteen, |_, c| [0, white / 5, white][c as usize]),
            );
            let (_, rows) = read_all(&path, &options).unwrap();
            assert_eq!((rows[0], rows[2]), (0.0, 510.0));
            assert!((rows[1] - 102.0).abs() < 1e-9, "{rows:?}");
        }
    }

    #[test]
    fn pgm_and_bmp_are_read_like_png() {
        let folder = Folder::new();
        let mut wide = b"P5 3 2 65535\n".to_vec();
        wide.extend(
            [0u16, 1, 2, 1000, 1001, 1002]
                .map(u16::to_be_bytes)
                .concat(),
        );
        let mut bmp = Vec::new();
        let greys: Vec<u8> = [0, 1, 2, 100, 101, 102]
            .iter()
            .flat_map(|g| [*g; 3])
            .collect();
        let mut encoder = image::codecs::bmp::BmpEncoder::new(&mut bmp);
        encoder
            .encode(&greys, 3, 2, image::ExtendedColorType::Rgb8)
            .unwrap();
        let options = OpenOptions {
            height_step_m: None,
            ..spaced()
        };
        let cases: [(&[u8], f64); 4] = [
            (&wide, 1000.0),
            (b"P5 3 2 255\n\x00\x01\x02\x64\x65\x66", 100.0),
            (b"P2 3 2 255\n0 1 2 100 101 102\n", 100.0),
            (&bmp, 100.0),
        ];
        for (bytes, south) in cases {
            let path = folder.write("a.any", bytes);
            let (_, rows) = read_all(&path, &options).unwrap();
            assert_eq!(rows, [0.0, 1.0, 2.0, south, south + 1.0, south + 2.0]);
        }
        // One pixel that is no grey.
        let last = bmp.len() - 4;
        bmp[last] ^= 1;
        let error = read_all(&folder.write("a.bmp", &bmp), &options).unwrap_err();
        assert!(error.to_string().contains("colour, at row"), "{error}");
    }

    #[test]
    fn without_spacing_the_error_says_how_to_give_it() {
        let folder = Folder::new();
        let path = folder.write("a.png", &png_bytes(3, 2, true, |_, _| 0));
        let error = open(&path, &OpenOptions::default()).err().unwrap();
        assert!(error.to_string().contains("--spacing"), "{error}");
    }

    #[test]
    fn a_world_file_and_a_prj_place_a_picture() {
        let folder = Folder::new();
        let path = folder.write("a.png", &png_bytes(3, 2, true, |r, c| (10 * r + c) as u16));
        folder.write("a.pgw", b"10\n0\n0\n-10\n500005\n4999995\n");
        folder.write("a.prj", b"Projection UTM\nZone 32\nDatum WGS84\n");
        let (info, rows) = read_all(&path, &OpenOptions::default()).unwrap();
        assert_eq!(
            (info.placement.x0, info.placement.y0),
            (500_005.0, 4_999_995.0)
        );
        assert_eq!((info.registration, rows[5]), (Registration::Cell, 12.0));
    }

    #[test]
    fn every_short_prefix_is_an_error_and_no_panic() {
        let folder = Folder::new();
        let bytes = png_bytes(5, 4, true, |r, c| (r * 7 + c * 3) as u16);
        // The last 12 bytes are IEND, which a decoder need not have seen.
        for length in 0..bytes.len() - 12 {
            let path = folder.write("a.png", &bytes[..length]);
            let read = open(&path, &spaced()).and_then(|mut d| d.read_rows(0, 4, &mut [0.0; 20]));
            assert!(read.is_err(), "{length} of {} bytes", bytes.len());
        }
    }

    #[test]
    fn a_size_that_lies_takes_no_memory() {
        let folder = Folder::new();
        let mut bytes = png_bytes(5, 4, true, |_, _| 0);
        bytes[16..24].copy_from_slice(&[0, 0x3f, 0xff, 0xff, 0, 0x3f, 0xff, 0xff]);
        let crc = crc32(&bytes[12..29]);
        bytes[29..33].copy_from_slice(&crc.to_be_bytes());
        for bytes in [&bytes[..], b"P5 4000000 4000000 255\n"] {
            let path = folder.write("a.png", bytes);
            let error = open(&path, &spaced()).err().unwrap();
            assert!(matches!(error, DemError::Limits { .. }), "{error}");
        }
    }

    /// Of a PNG chunk, bit by bit.
    fn crc32(bytes: &[u8]) -> u32 {
        let step = |crc: u32, _| (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg());
        let byte = |crc: u32, byte: &u8| (0..8).fold(crc ^ u32::from(*byte), step);
        !bytes.iter().fold(u32::MAX, byte)
    }

    #[test]
    fn colour_is_refused_with_the_words_that_read_it() {
        let folder = Folder::new();
        let mut bytes = png_bytes(5, 4, false, |_, _| 0);
        bytes[25] = 2;
        let crc = crc32(&bytes[12..29]);
        bytes[29..33].copy_from_slice(&crc.to_be_bytes());
        let path = folder.write("a.png", &bytes);
        let error = open(&path, &spaced()).err().unwrap();
        assert!(matches!(error, DemError::Unsupported { .. }));
        assert!(error.to_string().contains("--rgb mapbox"), "{error}");
    }
}
