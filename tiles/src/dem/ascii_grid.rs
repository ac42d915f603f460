//! ESRI ASCII grids: keys and values, then numbers from the north-west, row by row.

use std::path::Path;

use super::detect::Head;
use super::esri_header::Keys;
use super::heights::{self, HeightRule};
use super::number_rows::{NumberRows, Shape, as_stored};
use super::{DemError, DemInfo, DemSource, OpenOptions, Registration, SampleType, side};

/// The keys of a grid.
const KEYS: [&str; 13] = [
    "ncols",
    "nrows",
    "xllcorner",
    "yllcorner",
    "xllcenter",
    "yllcenter",
    "xllcentre",
    "yllcentre",
    "cellsize",
    "dx",
    "dy",
    "nodata_value",
    "nodata",
];

/// One open grid; its rows are parsed as they are asked for.
pub(super) struct AsciiGrid {
    info: DemInfo,
    rule: HeightRule,
    rows: NumberRows,
}

/// Keys and values at the start of a text, and the byte where they end.
fn header(text: &str, path: &Path) -> (Keys, usize) {
    let mut keys = Keys::new(path);
    let mut at = 0;
    loop {
        let (key, after_key) = word(text, at);
        let known = KEYS.iter().any(|known| known.eq_ignore_ascii_case(key));
        if !known {
            return (keys, at);
        }
        let (value, after_value) = word(text, after_key);
        keys.insert(key, value);
        at = after_value;
    }
}

/// The next word from a byte on, and the byte after it.
fn word(text: &str, from: usize) -> (&str, usize) {
    let rest = &text[from..];
    let start = rest.len() - rest.trim_start().len();
    let length = rest[start..]
        .find(char::is_whitespace)
        .unwrap_or(rest.len() - start);
    (&rest[start..start + length], from + start + length)
}

/// Whether a text starts with the keys of a grid, and numbers follow them.
pub(super) fn looks_like(text: &str) -> bool {
    let (keys, at) = header(text, Path::new(""));
    let (next, _) = word(text, at);
    let sized = keys.text("ncols").is_some() && keys.text("nrows").is_some();
    let stepped = keys.text("cellsize").is_some() || keys.text("dx").is_some();
    sized && stepped && next.parse::<f64>().is_ok()
}

impl AsciiGrid {
    /// Reads the header and goes through the numbers once.
    ///
    /// # Errors
    /// [`DemError::Damaged`] naming key or byte; those of the place.
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Self, DemError> {
        let head = Head::read(path)?;
        let text = head.text().unwrap_or_default();
        let marked = head.bytes.len() - text.len(); // a byte order mark
        let (keys, at) = header(text, path);
        let (width, height) = (keys.side("ncols")?, keys.side("nrows")?);
        let (own, registration) = keys.layout(height)?.unzip();
        let projection = match own {
            Some(_) => side::projection(path, options)?,
            None => None,
        };
        let unit_m = projection.as_ref().and_then(|p| p.height_unit_m);
        let vertical = projection.as_ref().and_then(|p| p.vertical.clone());
        let (layout, crs) = side::settle(own, projection.map(|p| p.crs), path, options)?;
        let nodata = match keys.number("nodata_value")? {
            None => keys.number("nodata")?,
            found => found,
        };
        let mut info = DemInfo {
            path: path.into(),
            format: "ESRI ASCII grid",
            width,
            height,
            placement: layout.placement,
            crs,
            registration: registration.unwrap_or(Registration::Cell),
            sample_type: SampleType::F64,
            height_step_m: 1.0,
            nodata: None,
            vertical,
        };
        info.check_size()?;
        let rows = NumberRows::index(path, (marked + at) as u64, Shape::Given(width, height))?;
        if rows.is_whole() {
            info.sample_type = SampleType::I32;
        }
        let rule = HeightRule {
            step_m: unit_m.unwrap_or(1.0),
            offset_m: 0.0,
            nodata,
        };
        let mut rule = HeightRule::resolve(rule, options, info.sample_type, path)?;
        rule.nodata = rule.nodata.map(as_stored);
        (info.height_step_m, info.nodata) = (rule.step_m, rule.nodata);
        Ok(Self { info, rule, rows })
    }
}

impl DemSource for AsciiGrid {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        self.rows.read(first_row, out)?;
        for height in out.iter_mut() {
            *height = self.rule.height_m(*height);
        }
        heights::check(&self.info, first_row, out)
    }
}

#[cfg(test)]
mod tests {
    use super::super::Crs;
    use super::super::testing::{Folder, read_all};
    use super::*;

    const GRID: &str = "NCOLS 3\nnrows 2\nXllCorner 500000\nyllcorner 5000000\n\
                        cellsize 10\nNODATA_value -9999\n1 2 3\n4 -9999 6\n";

    fn read(text: &str) -> Result<(DemInfo, Vec<f64>), DemError> {
        let folder = Folder::new();
        folder.write("a.prj", b"Projection UTM\nZone 32\nDatum WGS84\n");
        read_all(
            &folder.write("a.asc", text.as_bytes()),
            &OpenOptions::default(),
        )
    }

    #[test]
    fn a_grid_is_placed_by_corner_or_centre_in_any_case_and_order() {
        let (info, heights) = read(GRID).unwrap();
        let place = info.placement;
        assert_eq!(
            (place.x0, place.y0, place.dx, place.dy),
            (500_005.0, 5_000_015.0, 10.0, 10.0)
        );
        assert!(matches!(info.crs, Crs::Projected { ref name, .. } if name == "EPSG:32632"));
        assert_eq!(
            (info.registration, info.sample_type),
            (Registration::Cell, SampleType::I32)
        );
        assert_eq!(
            (heights[0], heights[4].is_nan(), heights[5]),
            (1.0, true, 6.0)
        );
        let centred = "dy 20 DX 10 nodata_value 6\nyllcenter 5000000 xllcenter 500000\r\n\
                       nrows 2 ncols 3 1 2 3 4 5.5 6";
        let (info, heights) = read(centred).unwrap();
        let place = info.placement;
        assert_eq!(
            (place.x0, place.y0, place.dx, place.dy),
            (5e5, 5_000_020.0, 10.0, 20.0)
        );
        assert_eq!(
            (info.registration, info.sample_type),
            (Registration::Grid, SampleType::F64)
        );
        assert_eq!((heights[4], heights[5].is_nan()), (5.5, true));
    }

    #[test]
    fn a_nodata_value_beyond_heights_matches_however_it_is_printed() {
        let text = GRID.replace("value -9999", "value -3.4028234663852886e+38");
        let text = text.replace("4 -9999", "-3.40282e+38 -3.4028235e38");
        // Fewer digits than a float has make another number, which is no height.
        let error = read(&text).unwrap_err().to_string();
        assert!(
            error.contains("row 1, column 0") && error.contains("--nodata"),
            "{error}"
        );
        let (_, heights) = read(&text.replace("-3.40282e+38", "4")).unwrap();
        assert_eq!((heights[3], heights[4].is_nan()), (4.0, true));
    }

    #[test]
    fn feet_come_from_the_prj() {
        let folder = Folder::new();
        folder.write(
            "a.prj",
            b"Projection UTM\nZone 32\nDatum WGS84\nZunits FEET\n",
        );
        let path = folder.write("a.asc", GRID.as_bytes());
        let (info, heights) = read_all(&path, &OpenOptions::default()).unwrap();
        assert_eq!((info.height_step_m, heights[0]), (0.3048, 0.3048));
    }

    #[test]
    fn every_cut_before_the_last_number_is_an_error() {
        let last = GRID.trim_end().len() - 1;
        for length in 0..=last {
            assert!(
                read(&GRID[..length]).is_err(),
                "{length}: {:?}",
                &GRID[..length]
            );
        }
    }

    #[test]
    fn hostile_headers_are_refused() {
        let cases = [
            ("NCOLS 3", "NCOLS 0", "width"),
            ("NCOLS 3", "NCOLS 3000000", "6000000"),
            ("NCOLS 3", "NCOLS 4294967296", "NCOLS"),
            ("cellsize 10", "cellsize 0", "step above 0"),
            ("cellsize 10", "cellsize -10", "step above 0"),
            ("cellsize 10", "cellsize 1e999", "step above 0"),
            ("yllcorner 5000000\n", "", "both"),
            ("nrows 2", "nrows 3", "6 numbers"),
            ("nrows 2", "nrows 1", "another number"),
            ("value -9999", "value none", "NODATA_VALUE"),
        ];
        for (from, to, expected) in cases {
            let error = read(&GRID.replace(from, to)).unwrap_err().to_string();
            assert!(error.contains(expected), "{to}: {error}");
        }
    }
}
