//! ESRI's headers: the `.hdr` of `.bil`, `.bip`, `.bsq` and `.flt` files, and the first lines of
//! an ASCII grid. One key and its value a line, in any order and case.
//!
//! After ESRI, "BIL, BIP, and BSQ raster files" and "Esri ASCII raster format" (ArcGIS help).

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::affine::{self, Layout};
use super::detect::{Head, Kind, kind_of};
use super::error::in_and_out;
use super::heights::HeightRule;
use super::raw::{RawGrid, RawShape, Rows, Stated};
use super::{DemError, OpenOptions, Registration, SampleType, side};

/// Extensions of sample files, the likelier first.
const DATA_EXTENSIONS: [&str; 9] = [
    "bil", "flt", "bsq", "bip", "dem", "img", "dat", "raw", "bin",
];

/// Keys in lower case and their values.
pub(super) struct Keys {
    values: BTreeMap<String, String>,
    path: PathBuf,
}

impl Keys {
    pub fn new(path: &Path) -> Self {
        Self {
            values: BTreeMap::new(),
            path: path.into(),
        }
    }

    pub fn insert(&mut self, key: &str, value: &str) {
        self.values
            .insert(key.to_ascii_lowercase(), value.trim().into());
    }

    /// `KEY value` lines.
    pub fn of_lines(text: &str, path: &Path) -> Self {
        let mut keys = Self::new(path);
        for line in text.lines() {
            if let Some((key, value)) = line.trim().split_once(char::is_whitespace) {
                keys.insert(key, value);
            }
        }
        keys
    }

    pub fn text(&self, key: &str) -> Option<&str> {
        self.values.get(key).map(String::as_str)
    }

    /// # Errors
    /// [`DemError::Damaged`] for a value that is no number.
    pub fn number(&self, key: &str) -> Result<Option<f64>, DemError> {
        self.parsed(key, "a number")
    }

    /// # Errors
    /// [`DemError::Damaged`] for a value that is no whole number.
    pub fn whole(&self, key: &str) -> Result<Option<u64>, DemError> {
        self.parsed(key, "a whole number")
    }

    /// A side of the raster.
    ///
    /// # Errors
    /// [`DemError::Damaged`] where the key is missing or its value no count.
    pub fn side(&self, key: &str) -> Result<u32, DemError> {
        let expected = "a count of samples";
        self.parsed(key, expected)?
            .ok_or_else(|| self.damaged(key, "nothing", expected))
    }

    fn parsed<T: std::str::FromStr>(&self, key: &str, what: &str) -> Result<Option<T>, DemError> {
        let Some(text) = self.text(key) else {
            return Ok(None);
        };
        let first = text.split_whitespace().next().unwrap_or_default();
        match first.parse() {
            Ok(value) => Ok(Some(value)),
            Err(_) => Err(self.damaged(key, &format!("{text:?}"), what)),
        }
    }

    fn damaged(&self, key: &str, found: &str, expected: &str) -> DemError {
        let place = format!("header key {}", key.to_ascii_uppercase());
        DemError::damaged(&self.path, place, found, expected)
    }

    /// Where the raster lies: by its upper left sample (`ULXMAP`), or by the lower left sample
    /// or corner (`XLLCENTER`, `XLLCORNER`). `None` without either.
    ///
    /// # Errors
    /// [`DemError::Damaged`] where one of a pair is missing.
    pub fn layout(&self, height: u32) -> Result<Option<(Layout, Registration)>, DemError> {
        let cell = self.number("cellsize")?;
        let step = |own: Option<f64>| own.or(cell);
        let dx = step(self.number("dx")?.or(self.number("xdim")?));
        let dy = step(self.number("dy")?.or(self.number("ydim")?));
        if let (Some(x), Some(y)) = (self.number("ulxmap")?, self.number("ulymap")?) {
            let steps = [self.needed(dx, "xdim")?, self.needed(dy, "ydim")?];
            return self.upright(steps, [x, y], height, Registration::Cell);
        }
        let (x, x_shift) = self.lower_left("xll")?;
        let (y, y_shift) = self.lower_left("yll")?;
        let (x, y) = match (x, y) {
            (Some(x), Some(y)) => (x, y),
            (None, None) => return Ok(None),
            _ => return Err(self.damaged("xllcorner, yllcorner", "one of them", "both")),
        };
        let [dx, dy] = [self.needed(dx, "cellsize")?, self.needed(dy, "cellsize")?];
        let registration = match x_shift {
            0.0 => Registration::Grid,
            _ => Registration::Cell,
        };
        let north = y + (f64::from(height) - 1.0 + y_shift) * dy;
        self.upright([dx, dy], [x + x_shift * dx, north], height, registration)
    }

    fn needed(&self, value: Option<f64>, key: &str) -> Result<f64, DemError> {
        let sound = value.filter(|step| step.is_finite() && *step > 0.0);
        let found = value.map_or("nothing".into(), |v| v.to_string());
        sound.ok_or_else(|| self.damaged(key, &found, "a step above 0"))
    }

    /// A coordinate and the cells from it to the first sample's centre.
    fn lower_left(&self, axis: &str) -> Result<(Option<f64>, f64), DemError> {
        if let Some(centre) = self.number(&format!("{axis}center"))? {
            return Ok((Some(centre), 0.0));
        }
        if let Some(centre) = self.number(&format!("{axis}centre"))? {
            return Ok((Some(centre), 0.0));
        }
        Ok((self.number(&format!("{axis}corner"))?, 0.5))
    }

    fn upright(
        &self,
        [dx, dy]: [f64; 2],
        [x, y]: [f64; 2],
        height: u32,
        registration: Registration,
    ) -> Result<Option<(Layout, Registration)>, DemError> {
        let layout = affine::of_first_sample([dx, 0.0, x, 0.0, -dy, y], height, &self.path)?;
        Ok(Some((layout, registration)))
    }
}

/// Whether a text is a header and nothing else: keys of columns and rows.
pub(super) fn looks_like(text: &str) -> bool {
    let has = |wanted: &str| {
        let mut words = text.lines().filter_map(|l| l.split_whitespace().next());
        words.any(|word| word.eq_ignore_ascii_case(wanted))
    };
    has("ncols") && has("nrows")
}

/// The header that a file without any sign lies beside: `a.hdr` or `a.bil.hdr` of `a.bil`.
pub(super) fn header_of(path: &Path) -> Option<(PathBuf, Kind)> {
    if side::is_side_file(path) {
        return None;
    }
    let mut appended = path.as_os_str().to_owned();
    appended.push(".hdr");
    let candidates = [Some(PathBuf::from(appended)), side::beside(path, &["hdr"])];
    candidates.into_iter().flatten().find_map(|header| {
        let head = Head::read(&header).ok()?;
        let kind = kind_of(&header, &head).filter(|kind| kind.is_header())?;
        Some((header, kind))
    })
}

/// The file of samples that a header lies beside.
///
/// # Errors
/// [`DemError::Usage`] where there is none.
pub(super) fn data_of(header: &Path, kind: Kind) -> Result<PathBuf, DemError> {
    let plain = header.with_extension("");
    if plain.is_file() {
        return Ok(plain); // a.bil.hdr beside a.bil
    }
    side::beside(header, &DATA_EXTENSIONS).ok_or_else(|| {
        let names = match kind {
            Kind::EnviHeader => "its name without extension, or with .dat, .img, .bsq, .bil, .bip",
            _ => "its name with .bil, .bip, .bsq or .flt",
        };
        let hint = format!("put them beside it under {names}");
        DemError::usage(header, "it is a header, and its samples are missing", hint)
    })
}

/// Opens the samples that an ESRI header describes.
///
/// # Errors
/// [`DemError::Damaged`] naming the key; [`DemError::Unsupported`] for several bands or odd types.
pub(super) fn open(header: &Path, data: &Path, options: &OpenOptions) -> Result<RawGrid, DemError> {
    let keys = Keys::of_lines(&side::read_text(header)?, header);
    let (width, height) = (keys.side("ncols")?, keys.side("nrows")?);
    let bands = keys.whole("nbands")?.unwrap_or(1);
    if bands != 1 {
        let hint = format!("take one: gdal_translate -b 1 {}", in_and_out(data));
        let what = format!("an image with {bands} bands");
        return Err(DemError::unsupported(data, what, hint));
    }
    let shape = RawShape {
        width,
        height,
        sample_type: sample_type(&keys, data)?,
        big_endian: big_endian(&keys)?,
        skip_bytes: keys.whole("skipbytes")?.unwrap_or(0),
    };
    let mut rows = Rows::packed(shape);
    let packed = rows.row_bytes;
    for key in ["bandrowbytes", "totalrowbytes"] {
        rows.row_bytes = keys.whole(key)?.unwrap_or(rows.row_bytes);
    }
    if rows.row_bytes < packed {
        let found = rows.row_bytes.to_string();
        return Err(keys.damaged("totalrowbytes", &found, &format!("at least {packed}")));
    }
    let stated = stated(&keys, height, data, options)?;
    RawGrid::new(data, rows, stated, options)
}

fn stated(
    keys: &Keys,
    height: u32,
    data: &Path,
    options: &OpenOptions,
) -> Result<Stated, DemError> {
    let own = keys.layout(height)?;
    let registration = own.map_or(Registration::Cell, |(_, registration)| registration);
    let layout = match own {
        Some((layout, _)) => Some(layout),
        None => side::world_file(data, height)?,
    };
    let projection = match layout {
        Some(_) => side::projection(data, options)?,
        None => None,
    };
    let unit_m = projection.as_ref().and_then(|p| p.height_unit_m);
    let vertical = projection.as_ref().and_then(|p| p.vertical.clone());
    let (layout, crs) = side::settle(layout, projection.map(|p| p.crs), data, options)?;
    let nodata = match keys.number("nodata")? {
        None => keys.number("nodata_value")?,
        found => found,
    };
    let rule = HeightRule {
        step_m: unit_m.unwrap_or(1.0),
        offset_m: 0.0,
        nodata,
    };
    Ok(Stated {
        format: "ESRI header and samples",
        layout,
        crs,
        registration,
        rule,
        vertical,
    })
}

fn big_endian(keys: &Keys) -> Result<bool, DemError> {
    let order = keys.text("byteorder").unwrap_or("I").to_ascii_uppercase();
    match order.as_str() {
        "I" | "LSBFIRST" | "INTEL" | "LSB" => Ok(false),
        "M" | "MSBFIRST" | "MOTOROLA" | "MSB" => Ok(true),
        _ => Err(keys.damaged(
            "byteorder",
            &format!("{order:?}"),
            "I, M, LSBFIRST or MSBFIRST",
        )),
    }
}

/// By `NBITS` and `PIXELTYPE`. A `.flt` has neither: it holds floats of 32 bits.
fn sample_type(keys: &Keys, data: &Path) -> Result<SampleType, DemError> {
    use SampleType as T;
    let kind = keys
        .text("pixeltype")
        .unwrap_or_default()
        .to_ascii_uppercase();
    // GTOPO30 says no type, but that -9999 is a hole.
    let negative = keys.number("nodata")?.is_some_and(|nodata| nodata < 0.0);
    let signed = kind.starts_with("SIGNED") || (kind.is_empty() && negative);
    let is_flt = keys.text("nbits").is_none() && keys.text("cellsize").is_some();
    let bits = keys.whole("nbits")?.unwrap_or(if is_flt { 32 } else { 8 });
    match (bits, kind == "FLOAT" || is_flt, signed) {
        (32, true, _) => Ok(T::F32),
        (64, true, _) => Ok(T::F64),
        (8, false, false) => Ok(T::U8),
        (8, false, true) => Ok(T::I8),
        (16, false, false) => Ok(T::U16),
        (16, false, true) => Ok(T::I16),
        (32, false, false) => Ok(T::U32),
        (32, false, true) => Ok(T::I32),
        _ => {
            let hint = format!(
                "convert it: gdal_translate -ot Float32 {}",
                in_and_out(data)
            );
            let what = format!("a sample of {bits} bits and pixel type {kind:?}");
            Err(DemError::unsupported(data, what, hint))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Crs;
    use super::super::testing::{Folder, read_all};
    use super::*;

    const BIL: &str = "BYTEORDER M\nLAYOUT BIL\nNROWS 2\nNCOLS 3\nNBANDS 1\nNBITS 16\n\
                       PIXELTYPE SIGNEDINT\nULXMAP 500000\nULYMAP 5000000\nXDIM 10\nYDIM 20\n\
                       NODATA -9999\nSKIPBYTES 4\nTOTALROWBYTES 8\n";
    const UTM: &[u8] = b"Projection UTM\nZone 32\nDatum WGS84\n";

    /// Rows of 3 samples and 2 bytes that are none, after 4 bytes that are none.
    fn bil_bytes() -> Vec<u8> {
        let row = |row: [i16; 4]| row.map(i16::to_be_bytes).concat();
        [vec![7; 4], row([1, -2, 3, 99]), row([4, -9999, 6, 99])].concat()
    }

    fn written(header: &str, data: &[u8], extension: &str) -> (Folder, PathBuf) {
        let folder = Folder::new();
        folder.write("a.hdr", header.as_bytes());
        folder.write("a.prj", UTM);
        let path = folder.write(&format!("a.{extension}"), data);
        (folder, path)
    }

    #[test]
    fn a_bil_is_read_from_either_file_with_skips_and_order_as_said() {
        let (folder, data) = written(BIL, &bil_bytes(), "bil");
        for path in [data, folder.path().join("a.hdr")] {
            let (info, read) = read_all(&path, &OpenOptions::default()).unwrap();
            let place = info.placement;
            assert_eq!(
                (place.x0, place.y0, place.dx, place.dy),
                (5e5, 5e6, 10.0, 20.0)
            );
            assert!(matches!(info.crs, Crs::Projected { ref name, .. } if name == "EPSG:32632"));
            assert_eq!(read[..4], [1.0, -2.0, 3.0, 4.0]);
            assert!(read[4].is_nan());
            assert_eq!(read[5], 6.0);
        }
    }

    #[test]
    fn a_flt_has_floats_placed_by_its_lower_left_corner_or_centre() {
        let bytes = [1.5f32, -2.25, 3.0, 4.0, -9999.0, 6.0]
            .map(f32::to_le_bytes)
            .concat();
        for (key, first) in [("corner", [105.0, 230.0]), ("center", [100.0, 220.0])] {
            let header = format!(
                "ncols 3\nnrows 3\nXLL{key} 100\nyll{key} 200\ncellsize 10\n\
                 nodata_VALUE -9999\nbyteorder LSBFIRST\n"
            );
            let rows = header.replace("nrows 3", "nrows 2");
            let (_folder, path) = written(&rows, &bytes, "flt");
            let (info, read) = read_all(&path, &OpenOptions::default()).unwrap();
            let expected = [
                first[0],
                first[1] - if key == "corner" { 15.0 } else { 10.0 },
            ];
            assert_eq!([info.placement.x0, info.placement.y0], expected, "{key}");
            assert_eq!((read[1], read[4].is_nan()), (-2.25, true));
            // One row fewer than the header says.
            let (_folder, path) = written(&header, &bytes, "flt");
            let error = read_all(&path, &OpenOptions::default()).unwrap_err();
            assert!(error.to_string().contains("at least 36"), "{error}");
        }
    }

    #[test]
    fn every_short_prefix_of_the_samples_is_an_error() {
        let bytes = bil_bytes();
        // The last two bytes only fill the row.
        for length in 0..bytes.len() - 2 {
            let (_folder, path) = written(BIL, &bytes[..length], "bil");
            assert!(
                read_all(&path, &OpenOptions::default()).is_err(),
                "{length}"
            );
        }
    }

    #[test]
    fn hostile_and_odd_headers_are_refused_with_their_key() {
        let cases = [
            ("NROWS 2", "NROWS two", "NROWS"),
            ("NROWS 2", "NROWS -2", "NROWS"),
            ("NROWS 2", "NROWS 4294967295", "height"),
            ("NCOLS 3", "NCOLS 0", "width"),
            ("NBITS 16", "NBITS 12", "12 bits"),
            ("NBITS 16", "NBITS 99999999999999999999", "NBITS"),
            ("NBANDS 1", "NBANDS 3", "gdal_translate -b 1"),
            ("BYTEORDER M", "BYTEORDER X", "BYTEORDER"),
            (
                "SKIPBYTES 4",
                "SKIPBYTES 18446744073709551615",
                "end of the samples",
            ),
            ("TOTALROWBYTES 8", "TOTALROWBYTES 5", "at least 6"),
            (
                "TOTALROWBYTES 8",
                "TOTALROWBYTES 18446744073709551615",
                "end of the samples",
            ),
            ("XDIM 10", "XDIM 0", "XDIM"),
            ("XDIM 10", "XDIM nan", "XDIM"),
            ("ULXMAP 500000", "ULXMAP inf", "origin"),
        ];
        for (from, to, expected) in cases {
            let (_folder, path) = written(&BIL.replace(from, to), &bil_bytes(), "bil");
            let error = read_all(&path, &OpenOptions::default())
                .unwrap_err()
                .to_string();
            assert!(error.contains(expected), "{to}: {error}");
        }
    }

    #[test]
    fn a_header_without_samples_and_a_place_without_system_say_what_to_do() {
        let folder = Folder::new();
        let header = folder.write("a.hdr", BIL.as_bytes());
        let error = read_all(&header, &OpenOptions::default())
            .unwrap_err()
            .to_string();
        assert!(error.contains(".bil"), "{error}");
        let path = folder.write("a.bil", &bil_bytes());
        let error = read_all(&path, &OpenOptions::default())
            .unwrap_err()
            .to_string();
        assert!(error.contains("--input-crs"), "{error}");
    }
}
