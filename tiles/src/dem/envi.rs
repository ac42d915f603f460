//! ENVI headers: `key = value` lines, values in braces over several of them.
//!
//! After NV5, "ENVI Header Files". `map info` places the corner of a pixel, counted from 1.0 at
//! the corner of the first.

use std::collections::BTreeMap;
use std::path::Path;

use crate::crs;

use super::affine::{self, Layout};
use super::error::in_and_out;
use super::heights::HeightRule;
use super::raw::{RawGrid, RawShape, Rows, Stated};
use super::{Crs, DemError, OpenOptions, Registration, SampleType, prj, side};

/// Keys in lower case, and values without braces.
struct Header<'a> {
    values: BTreeMap<String, String>,
    path: &'a Path,
}

impl<'a> Header<'a> {
    fn parse(text: &str, path: &'a Path) -> Self {
        let mut values = BTreeMap::new();
        let mut rest = text;
        while let Some((before, after)) = rest.split_once('=') {
            let key = before.lines().last().unwrap_or_default().trim();
            let after = after.trim_start_matches([' ', '\t']);
            let (value, next) = match after.strip_prefix('{') {
                Some(braced) => braced.split_once('}').unwrap_or((braced, "")),
                None => after.split_once('\n').unwrap_or((after, "")),
            };
            values.insert(key.to_ascii_lowercase(), value.trim().to_string());
            rest = next;
        }
        Self { values, path }
    }

    fn whole(&self, key: &str, default: Option<u64>) -> Result<u64, DemError> {
        let text = self.values.get(key);
        let found = match text {
            None => default,
            Some(text) => text.parse().ok(),
        };
        found.ok_or_else(|| self.damaged(key, "a whole number"))
    }

    fn side(&self, key: &str) -> Result<u32, DemError> {
        let side = self.whole(key, None)?;
        u32::try_from(side).map_err(|_| self.damaged(key, "a count of samples"))
    }

    fn damaged(&self, key: &str, expected: &str) -> DemError {
        let found = self
            .values
            .get(key)
            .map_or("nothing".into(), |v| format!("{v:?}"));
        DemError::damaged(self.path, format!("header key {key:?}"), found, expected)
    }

    fn sample_type(&self) -> Result<SampleType, DemError> {
        use SampleType as T;
        Ok(match self.whole("data type", None)? {
            1 => T::U8,
            2 => T::I16,
            3 => T::I32,
            4 => T::F32,
            5 => T::F64,
            12 => T::U16,
            13 => T::U32,
            14 => T::I64,
            15 => T::U64,
            _ => return Err(self.damaged("data type", "1 to 5 or 12 to 15 (real numbers)")),
        })
    }

    /// `map info = {projection, column, row, x, y, dx, dy, ...}`.
    fn layout(&self, height: u32) -> Result<Option<Layout>, DemError> {
        let Some(info) = self.values.get("map info") else {
            return Ok(None);
        };
        let damaged = || self.damaged("map info", "a projection and 6 numbers");
        let parts: Vec<&str> = info.split(',').map(str::trim).collect();
        let number = |at: usize| parts.get(at).and_then(|t| t.parse::<f64>().ok());
        let numbers: Option<Vec<f64>> = (1..7).map(number).collect();
        let Some(&[column, row, x, y, dx, dy]) = numbers.as_deref() else {
            return Err(damaged());
        };
        let turned = parts.iter().filter_map(|p| p.strip_prefix("rotation="));
        if turned
            .filter_map(|angle| angle.parse::<f64>().ok())
            .any(|angle| angle != 0.0)
        {
            let hint = format!(
                "straighten it: gdalwarp -r bilinear {}",
                in_and_out(self.path)
            );
            return Err(DemError::unsupported(self.path, "a rotated raster", hint));
        }
        let first = [x + (1.5 - column) * dx, y - (1.5 - row) * dy];
        let place = [dx, 0.0, first[0], 0.0, -dy, first[1]];
        affine::of_first_sample(place, height, self.path).map(Some)
    }

    /// `coordinate system string` (WKT), or the words of `map info`.
    fn crs(&self) -> Result<Option<Crs>, DemError> {
        let unsupported = |why: String| {
            let hint = "name the coordinate system: --input-crs EPSG:CODE";
            DemError::unsupported(self.path, why, hint)
        };
        if let Some(wkt) = self.values.get("coordinate system string") {
            return crs::wkt::from_wkt(wkt).map(Some).map_err(unsupported);
        }
        let Some(info) = self.values.get("map info") else {
            return Ok(None);
        };
        let parts: Vec<String> = info
            .split(',')
            .map(|p| p.trim().to_ascii_lowercase())
            .collect();
        let wgs84 = parts.iter().any(|p| p == "wgs-84" || p == "wgs84");
        let south = parts.iter().any(|p| p == "south");
        let code = match parts[0].as_str() {
            "geographic lat/lon" if wgs84 => Some(4326),
            "utm" if wgs84 => parts
                .get(7)
                .and_then(|zone| prj::utm_code("WGS84", zone.parse().ok()?, south)),
            _ => None,
        };
        let code = code.map(crs::from_epsg).transpose().map_err(unsupported)?;
        Ok(code)
    }
}

/// Opens the samples that an ENVI header describes.
///
/// # Errors
/// [`DemError::Damaged`] naming the key; [`DemError::Unsupported`] for several bands.
pub(super) fn open(header: &Path, data: &Path, options: &OpenOptions) -> Result<RawGrid, DemError> {
    let text = side::read_text(header)?;
    let header = Header::parse(&text, header);
    let bands = header.whole("bands", Some(1))?;
    if bands != 1 {
        let hint = format!("take one: gdal_translate -b 1 {}", in_and_out(data));
        let what = format!("an image with {bands} bands");
        return Err(DemError::unsupported(data, what, hint));
    }
    if header.whole("file compression", Some(0))? != 0 {
        let hint = format!("convert it: gdal_translate {}", in_and_out(data));
        return Err(DemError::unsupported(data, "a compressed ENVI file", hint));
    }
    let shape = RawShape {
        width: header.side("samples")?,
        height: header.side("lines")?,
        sample_type: header.sample_type()?,
        big_endian: match header.whole("byte order", Some(0))? {
            0 => false,
            1 => true,
            _ => return Err(header.damaged("byte order", "0 (least byte first) or 1")),
        },
        skip_bytes: header.whole("header offset", Some(0))?,
    };
    let layout = header.layout(shape.height)?;
    let crs = match (layout, header.crs()?) {
        (Some(_), None) => side::projection(data, options)?.map(|p| p.crs),
        (_, found) => found,
    };
    let (layout, crs) = side::settle(layout, crs, data, options)?;
    let nodata = match header.values.get("data ignore value") {
        None => None,
        Some(text) => {
            let number = text.parse().ok();
            Some(number.ok_or_else(|| header.damaged("data ignore value", "a number"))?)
        }
    };
    let rule = HeightRule {
        nodata,
        ..HeightRule::METRES
    };
    let stated = Stated {
        format: "ENVI",
        layout,
        crs,
        registration: Registration::Cell,
        rule,
        vertical: None,
    };
    RawGrid::new(data, Rows::packed(shape), stated, options)
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Folder, read_all};
    use super::*;

    const HEADER: &str = "ENVI\ndescription = {\n a = b}\nsamples = 3\nlines   = 2\nbands = 1\n\
        header offset = 2\nfile type = ENVI Standard\ndata type = 12\ninterleave = bsq\n\
        byte order = 1\nmap info = {UTM, 1.0, 1.0, 500000, 5000000, 10, 20, 32, North, WGS-84,\n\
        units=Meters}\ndata ignore value = 7\n";

    fn open_with(header: &str, name: &str) -> Result<(super::super::DemInfo, Vec<f64>), DemError> {
        let folder = Folder::new();
        folder.write("a.hdr", header.as_bytes());
        let samples = [1u16, 2, 7, 4, 5, 60000].map(u16::to_be_bytes).concat();
        let path = folder.write(name, &[&[0, 0][..], &samples].concat());
        let read = read_all(&path, &OpenOptions::default())?;
        let other = read_all(&folder.path().join("a.hdr"), &OpenOptions::default())?;
        assert_eq!(other.0, read.0);
        Ok(read)
    }

    #[test]
    fn heights_lie_at_the_middle_of_the_cells_that_map_info_places() {
        for name in ["a.bsq", "a.dat", "a"] {
            let (info, read) = open_with(HEADER, name).unwrap();
            let place = info.placement;
            let expected = (500_005.0, 4_999_990.0, 10.0, 20.0);
            assert_eq!((place.x0, place.y0, place.dx, place.dy), expected);
            assert!(matches!(info.crs, Crs::Projected { ref name, .. } if name == "EPSG:32632"));
            assert_eq!((read[0], read[2].is_nan(), read[5]), (1.0, true, 60000.0));
        }
    }

    #[test]
    fn a_reference_pixel_elsewhere_counts_back_to_the_first() {
        let moved = HEADER.replace("1.0, 1.0, 500000, 5000000", "2.5, 2.5, 500015, 4999970");
        let (info, _) = open_with(&moved, "a.bsq").unwrap();
        assert_eq!(
            (info.placement.x0, info.placement.y0),
            (500_005.0, 4_999_990.0)
        );
    }

    #[test]
    fn every_short_prefix_of_the_header_is_read_or_refused_without_panic() {
        for length in 0..HEADER.len() {
            let _ = open_with(&HEADER[..length], "a.bsq");
        }
        let longer = HEADER.replace("lines   = 2", "lines = 3");
        let error = open_with(&longer, "a.bsq").unwrap_err().to_string();
        assert!(error.contains("at least 20"), "{error}");
    }

    #[test]
    fn odd_headers_are_refused_with_their_key() {
        let cases = [
            ("data type = 12", "data type = 6", "data type"),
            ("samples = 3", "samples = 99999999999", "samples"),
            ("bands = 1", "bands = 2", "2 bands"),
            ("byte order = 1", "byte order = 2", "byte order"),
            ("units=Meters", "rotation=12.5", "rotated"),
            ("1.0, 1.0,", "one,", "map info"),
            ("10, 20, 32", "0, 20, 32", "steps"),
        ];
        for (from, to, expected) in cases {
            let error = open_with(&HEADER.replace(from, to), "a.bsq")
                .unwrap_err()
                .to_string();
            assert!(error.contains(expected), "{to}: {error}");
        }
    }
}
