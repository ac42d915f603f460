//! Greyscale PNG with 16 or 8 bits: a height map without georeference, so the user gives the
//! spacing, and the metres of one grey level if it is not 1.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use image::codecs::png::PngDecoder;
use image::{ColorType, ImageDecoder, ImageError, Limits};

use super::error::in_and_out;
use super::heights::{self, HeightRule};
use super::open::local_placement;
use super::{
    Crs, DemError, DemInfo, DemSource, MAX_PNG_BYTES, OpenOptions, Registration, SampleType,
};

/// One open PNG, decoded whole (up to [`MAX_PNG_BYTES`]) when rows are first asked for.
pub(super) struct Png {
    info: DemInfo,
    rule: HeightRule,
    samples: Option<Vec<u8>>,
}

/// What the IHDR chunk says.
struct Header {
    width: u32,
    height: u32,
    bits: u8,
    colour: u8,
}

impl Png {
    /// Reads the header.
    ///
    /// # Errors
    /// [`DemError::Usage`] without a spacing, [`DemError::Unsupported`] for colour,
    /// [`DemError::Limits`] for size.
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Self, DemError> {
        let header = header(path)?;
        let sample_type = sample_type(&header, path)?;
        let rule = HeightRule::resolve(HeightRule::METRES, options, sample_type, path)?;
        let info = DemInfo {
            path: path.into(),
            format: "PNG",
            width: header.width,
            height: header.height,
            placement: local_placement(options, path)?,
            crs: Crs::Local,
            registration: Registration::Grid,
            sample_type,
            height_step_m: rule.step_m,
            nodata: rule.nodata,
            vertical: None,
        };
        info.check_size()?;
        let bytes = decoded_bytes(&info);
        if bytes > MAX_PNG_BYTES {
            let what = "the decoded PNG (gdal_translate makes a GeoTIFF of it)";
            return Err(DemError::limits(path, what, bytes, MAX_PNG_BYTES, "bytes"));
        }
        Ok(Self {
            info,
            rule,
            samples: None,
        })
    }

    fn decode(&self) -> Result<Vec<u8>, DemError> {
        let path = &self.info.path;
        let file = File::open(path).map_err(|e| DemError::io(path, "open", e))?;
        let mut limits = Limits::default();
        limits.max_alloc = Some(MAX_PNG_BYTES);
        let failed = |error| explain(error, path);
        let decoder = PngDecoder::with_limits(BufReader::new(file), limits).map_err(failed)?;
        if !matches!(decoder.color_type(), ColorType::L8 | ColorType::L16) {
            // A greyscale file may still declare one grey transparent.
            let hint = format!("convert it: gdal_translate -of GTiff {}", in_and_out(path));
            return Err(DemError::unsupported(path, "a PNG with transparency", hint));
        }
        let bytes = decoded_bytes(&self.info);
        if decoder.total_bytes() != bytes {
            let found = format!("{} bytes of samples", decoder.total_bytes());
            return Err(DemError::damaged(
                path,
                "the PNG header",
                found,
                format!("{bytes}"),
            ));
        }
        let mut samples = vec![0; bytes as usize];
        decoder.read_image(&mut samples).map_err(failed)?;
        Ok(samples)
    }
}

impl DemSource for Png {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        if self.samples.is_none() {
            self.samples = Some(self.decode()?);
        }
        let samples = self.samples.as_deref().unwrap_or_default();
        let from = first_row as usize * self.info.width as usize;
        for (at, height) in (from..).zip(out.iter_mut()) {
            let stored = match self.info.sample_type {
                SampleType::U8 => f64::from(samples[at]),
                _ => f64::from(u16::from_ne_bytes([samples[2 * at], samples[2 * at + 1]])),
            };
            *height = self.rule.height_m(stored);
        }
        heights::check(&self.info, first_row, out)
    }
}

fn decoded_bytes(info: &DemInfo) -> u64 {
    u64::from(info.width) * u64::from(info.height) * u64::from(info.sample_type.bytes())
}

/// Reads signature and IHDR: `[8 signature][4 length][4 "IHDR"][4 width][4 height][1 bits][1 colour]`.
fn header(path: &Path) -> Result<Header, DemError> {
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(|e| DemError::io(path, "open", e))?;
    file.take(26)
        .read_to_end(&mut bytes)
        .map_err(|e| DemError::io(path, "read", e))?;
    match bytes[..] {
        [
            _,
            _,
            _,
            _,
            _,
            _,
            _,
            _,
            _,
            _,
            _,
            _,
            b'I',
            b'H',
            b'D',
            b'R',
            a,
            b,
            c,
            d,
            e,
            f,
            g,
            h,
            bits,
            colour,
        ] => {
            let (width, height) = (
                u32::from_be_bytes([a, b, c, d]),
                u32::from_be_bytes([e, f, g, h]),
            );
            Ok(Header {
                width,
                height,
                bits,
                colour,
            })
        }
        _ => {
            let found = format!("{} bytes that are no header", bytes.len());
            Err(DemError::damaged(
                path,
                "the PNG header",
                found,
                "an IHDR chunk",
            ))
        }
    }
}

fn sample_type(header: &Header, path: &Path) -> Result<SampleType, DemError> {
    let what = match (header.colour, header.bits) {
        (0, 16) => return Ok(SampleType::U16),
        (0, 8) => return Ok(SampleType::U8),
        (0, bits) => format!("a greyscale PNG with {bits} bits"),
        (2, _) => "an RGB PNG".into(),
        (3, _) => "a PNG with a palette".into(),
        (4, _) => "a greyscale PNG with transparency".into(),
        (6, _) => "an RGBA PNG".into(),
        (other, _) => format!("a PNG of colour type {other}"),
    };
    let hint = "heights must be greyscale with 16 or 8 bits; if the colours code heights, as in \
                Mapbox terrain-RGB, decode them first: gdal_calc.py -R IN.png --R_band=1 -G IN.png \
                --G_band=2 -B IN.png --B_band=3 --type=Float32 --outfile=OUT.tif \
                --calc=\"-10000+(R*65536.0+G*256.0+B)*0.1\"";
    Err(DemError::unsupported(path, what, hint))
}

fn explain(error: ImageError, path: &Path) -> DemError {
    let expected = "a sound PNG (is the file cut short?)";
    match error {
        ImageError::IoError(e) if e.kind() != std::io::ErrorKind::UnexpectedEof => {
            DemError::io(path, "read", e)
        }
        ImageError::Limits(e) => DemError::damaged(
            path,
            "the PNG data",
            e.to_string(),
            "at most 512 MiB decoded",
        ),
        other => DemError::damaged(path, "the PNG data", other.to_string(), expected),
    }
}

#[cfg(test)]
mod tests {
    use super::super::open;
    use super::super::testing::{Folder, png_bytes};
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
            let mut dem = open(&path, &options).unwrap();
            assert_eq!(
                (dem.info().placement.dx, dem.info().crs.clone()),
                (160.0, Crs::Local)
            );
            let mut rows = vec![0.0; 6];
            dem.read_rows(0, 2, &mut rows).unwrap();
            assert_eq!(rows[0], 5.0);
            assert!((rows[5] - (south * 0.1 + 5.0)).abs() < 1e-12);
        }
    }

    #[test]
    fn without_spacing_the_error_says_how_to_give_it() {
        let folder = Folder::new();
        let path = folder.write("a.png", &png_bytes(3, 2, true, |_, _| 0));
        let error = open(&path, &OpenOptions::default()).err().unwrap();
        assert!(error.to_string().contains("--spacing"), "{error}");
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
        let path = folder.write("a.png", &bytes);
        assert!(matches!(
            open(&path, &spaced()),
            Err(DemError::Limits { .. })
        ));
    }

    #[test]
    fn colour_is_refused() {
        let folder = Folder::new();
        let mut bytes = png_bytes(5, 4, false, |_, _| 0);
        bytes[25] = 2;
        let path = folder.write("a.png", &bytes);
        assert!(matches!(
            open(&path, &spaced()),
            Err(DemError::Unsupported { .. })
        ));
    }
}
