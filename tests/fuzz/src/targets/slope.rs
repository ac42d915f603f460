//! A small source that is no file.

use escarp_tiles::dem::{Crs, DemError, DemInfo, DemSource, Placement, Registration, SampleType};
use std::path::PathBuf;

/// A slope with holes, that can be read so many times, and then has a bad block.
pub struct Slope {
    info: DemInfo,
    reads_left: u32,
}

impl Slope {
    pub fn new(width: u32, height: u32, reads_left: u32) -> Slope {
        let info = DemInfo {
            path: PathBuf::from("slope"),
            format: "slope",
            width,
            height,
            placement: Placement {
                x0: 0.0,
                y0: 0.0,
                dx: 1.0,
                dy: 1.0,
            },
            crs: Crs::Local,
            registration: Registration::Grid,
            sample_type: SampleType::I32,
            height_step_m: 1.0,
            nodata: None,
            vertical: None,
        };
        Slope { info, reads_left }
    }
}

impl DemSource for Slope {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, _: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.reads_left = self.reads_left.checked_sub(1).ok_or_else(|| DemError::Io {
            path: self.info.path.clone(),
            doing: "read",
            source: std::io::Error::other("a bad block"),
        })?;
        for (i, out) in (0..).zip(out) {
            let (column, row) = (i % self.info.width, first_row + i / self.info.width);
            let is_hole = (5..9).contains(&column) && row % 100 < 3;
            *out = match is_hole {
                true => f64::NAN,
                false => f64::from(column * column + 3 * row),
            };
        }
        Ok(())
    }
}
