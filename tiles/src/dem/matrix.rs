//! Numbers in lines and nothing else: an ASCII matrix, such as a program prints an array. The
//! longitudes of its columns and the latitudes of its rows come from two more texts; without
//! them it lies nowhere, and the user gives the spacing.

use std::path::Path;

use crate::crs;

use super::affine::{self, Layout};
use super::heights::{self, HeightRule};
use super::number_rows::{NumberRows, Shape, as_stored};
use super::{DemError, DemInfo, DemSource, OpenOptions, Registration, SampleType, side, unpack};

/// How far a coordinate may be off even spacing, in cells.
const MAX_UNEVEN: f64 = 0.01;

/// EPSG code of the longitudes and latitudes, if the user says nothing else.
const WGS84: u16 = 4326;

/// One open matrix.
pub(super) struct Matrix {
    info: DemInfo,
    rule: HeightRule,
    rows: NumberRows,
    south_up: bool,
}

impl Matrix {
    /// Goes through the numbers once, and places them.
    ///
    /// # Errors
    /// [`DemError::Damaged`] naming the byte; [`DemError::Usage`] for coordinates that are not
    /// evenly spaced, or as many as columns and rows.
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Self, DemError> {
        let rows = NumberRows::index(path, 0, Shape::Lines)?;
        let size = [rows.width(), rows.height()];
        let (layout, crs) = match &options.lons_lats {
            Some([lons, lats]) => {
                let (x, dx) = spaced(lons, size[0], "columns", path)?;
                let (y, dy) = spaced(lats, size[1], "rows", path)?;
                let layout = affine::of_first_sample([dx, 0.0, x, 0.0, dy, y], size[1], path)?;
                let wgs84 = || crs::from_epsg(WGS84);
                let crs = options.crs.clone().map_or_else(wgs84, Ok);
                let crs = crs.map_err(|why| DemError::unsupported(path, why, "name another"))?;
                (layout, crs)
            }
            None => unplaced(path, size[1], options)?,
        };
        let sample_type = match rows.is_whole() {
            true => SampleType::I32,
            false => SampleType::F64,
        };
        let mut rule = HeightRule::resolve(HeightRule::METRES, options, sample_type, path)?;
        rule.nodata = rule.nodata.map(as_stored);
        let info = DemInfo {
            path: path.into(),
            format: "ASCII matrix",
            width: size[0],
            height: size[1],
            placement: layout.placement,
            crs,
            registration: Registration::Grid,
            sample_type,
            height_step_m: rule.step_m,
            nodata: rule.nodata,
            vertical: None,
        };
        info.check_size()?;
        let south_up = layout.south_up;
        Ok(Self {
            info,
            rule,
            rows,
            south_up,
        })
    }
}

fn unplaced(
    path: &Path,
    height: u32,
    options: &OpenOptions,
) -> Result<(Layout, super::Crs), DemError> {
    let layout = side::world_file(path, height)?;
    let projection = match layout {
        Some(_) => side::projection(path, options)?,
        None => None,
    };
    side::settle(layout, projection.map(|p| p.crs), path, options).map_err(|error| match error {
        DemError::Usage { path, what, hint } => {
            let more = "or, for a matrix of numbers: --lons FILE --lats FILE";
            DemError::usage(&path, what, format!("{hint}; {more}"))
        }
        other => other,
    })
}

/// First coordinate and step of a text of evenly spaced ones.
fn spaced(file: &Path, count: u32, what: &str, matrix: &Path) -> Result<(f64, f64), DemError> {
    let numbers = unpack::with_plain(file, &mut |plain| {
        let mut rows = NumberRows::index(plain, 0, Shape::Given(1, count))?;
        let mut numbers = vec![0.0; count as usize];
        rows.read(0, &mut numbers)?;
        Ok(numbers)
    })?;
    let (Some(first), Some(last)) = (numbers.first(), numbers.last()) else {
        return Err(DemError::usage(
            file,
            "it is empty",
            "give one number a line",
        ));
    };
    let step = (last - first) / f64::from(count.max(2) - 1);
    let even = |(i, x): (usize, &f64)| {
        let off = x - (first + i as f64 * step);
        off.abs() <= MAX_UNEVEN * step.abs()
    };
    if step == 0.0 || !step.is_finite() || !numbers.iter().enumerate().all(even) {
        let what = format!(
            "its numbers are not evenly spaced, as the {what} of {} must be",
            matrix.display()
        );
        let hint = "resample the matrix to even steps first";
        return Err(DemError::usage(file, what, hint));
    }
    Ok((*first, step))
}

impl DemSource for Matrix {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        let width = self.info.width as usize;
        if self.south_up {
            self.rows.read(self.info.height - first_row - rows, out)?;
            flip(out, width);
        } else {
            self.rows.read(first_row, out)?;
        }
        for height in out.iter_mut() {
            *height = self.rule.height_m(*height);
        }
        heights::check(&self.info, first_row, out)
    }
}

/// Turns the order of rows round.
fn flip(rows: &mut [f64], width: usize) {
    let count = rows.len() / width;
    for row in 0..count / 2 {
        let (north, south) = rows.split_at_mut((count - 1 - row) * width);
        north[row * width..(row + 1) * width].swap_with_slice(&mut south[..width]);
    }
}

#[cfg(test)]
mod tests {
    use super::super::Crs;
    use super::super::testing::{Folder, gzip_bytes, read_all};
    use super::*;

    fn placed(folder: &Folder, lons: &str, lats: &str) -> OpenOptions {
        let lons = folder.write("lons.gz", &gzip_bytes(lons.as_bytes()));
        let lats = folder.write("lats.txt", lats.as_bytes());
        OpenOptions {
            lons_lats: Some([lons, lats]),
            ..OpenOptions::default()
        }
    }

    #[test]
    fn longitudes_and_latitudes_place_it_south_row_first_or_last() {
        let folder = Folder::new();
        let path = folder.write("a.gz", &gzip_bytes(b"1.5 2 3\n4 5 6\n"));
        let lons = "20\n20.5\n21";
        let (info, heights) = read_all(&path, &placed(&folder, lons, "-10\n-9\n")).unwrap();
        let place = info.placement;
        assert_eq!(
            (place.x0, place.y0, place.dx, place.dy),
            (20.0, -9.0, 0.5, 1.0)
        );
        assert!(matches!(info.crs, Crs::Geographic { ref name, .. } if name == "EPSG:4326"));
        assert_eq!(heights, [4.0, 5.0, 6.0, 1.5, 2.0, 3.0]);
        let (info, heights) = read_all(&path, &placed(&folder, lons, "-9\n-10\n")).unwrap();
        assert_eq!(info.placement, place);
        assert_eq!(heights, [1.5, 2.0, 3.0, 4.0, 5.0, 6.0]);
    }

    #[test]
    fn uneven_or_miscounted_coordinates_are_refused_with_their_file() {
        let folder = Folder::new();
        let path = folder.write("a.txt", b"1 2 3\n4 5 6\n");
        for (lons, lats) in [
            ("1 2 4", "1 2"),
            ("1 2", "1 2"),
            ("1 1 1", "1 2"),
            ("1 nan 3", "1 2"),
        ] {
            let error = read_all(&path, &placed(&folder, lons, lats)).unwrap_err();
            assert!(error.to_string().contains("lons.gz"), "{lons}: {error}");
        }
        let error = read_all(&path, &placed(&folder, "1 2 3", "1 2 3")).unwrap_err();
        assert!(error.to_string().contains("lats.txt"), "{error}");
    }

    #[test]
    fn without_coordinates_it_needs_a_spacing() {
        let folder = Folder::new();
        let path = folder.write("a.txt", b"1 2\n4 5\n");
        let error = read_all(&path, &OpenOptions::default())
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("--spacing") && error.contains("--lons"),
            "{error}"
        );
        let options = OpenOptions {
            spacing_m: Some(30.0),
            ..OpenOptions::default()
        };
        assert_eq!(read_all(&path, &options).unwrap().1, [1.0, 2.0, 4.0, 5.0]);
    }
}
