//! From a user's coordinates to the grid and back.

use super::HeightError;
use crate::native::{native, world};
use escarp_proto::georef::{Georef, Plane};
use escarp_proto::manifest::Manifest;
use escarp_tiles::crs::extent::crs_of;
use escarp_tiles::crs::{Projection, longitude};

/// A place this near to a sample, in distances of samples, is the sample: coordinates are written
/// with so many digits, and a column of samples must not be missed for the last of them.
const SNAP: f64 = 1e-7;

/// Which coordinates a request and its answer have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CoordinateKind {
    /// Those of the dataset's CRS, in its units.
    Native,
    /// Longitude and latitude in degrees, on the datum of the dataset's CRS.
    LonLat,
}

/// Where the samples of a dataset lie.
pub struct Frame {
    georef: Georef,
    samples: [u32; 2],
    /// For longitude and latitude of a projected CRS.
    projection: Option<Projection>,
    kind: CoordinateKind,
}

/// A place within the data, as columns and rows of the grid with fractions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridPlace(pub(super) [f64; 2]);

impl Frame {
    /// The frame of a dataset.
    ///
    /// # Errors
    /// [`HeightError::Usage`] for longitude and latitude where the dataset has none.
    pub fn of(manifest: &Manifest, kind: CoordinateKind) -> Result<Frame, HeightError> {
        let plane = &manifest.georef.plane;
        let projection = match (kind, plane) {
            (CoordinateKind::LonLat, Plane::Projected { .. } | Plane::Local) => {
                let projection = Projection::of(&crs_of(plane)).map_err(|why| {
                    let found = format!("longitude and latitude of this dataset: {why}");
                    HeightError::usage(found, "its own coordinates")
                })?;
                Some(projection)
            }
            _ => None,
        };
        Ok(Frame {
            georef: manifest.georef.clone(),
            samples: manifest.samples,
            projection,
            kind,
        })
    }

    /// Which coordinates it takes and gives.
    pub fn kind(&self) -> CoordinateKind {
        self.kind
    }

    /// Columns and rows of the grid, with fractions, of a point; anywhere. `None` where the
    /// projection has no plane.
    pub fn grid(&self, point: [f64; 2]) -> Option<[f64; 2]> {
        let [mut x, y] = match &self.projection {
            Some(projection) => projection.from_degrees(point[0], point[1])?,
            None => point,
        };
        if let Plane::Geographic {
            middle_longitude_deg: middle,
            ..
        } = self.georef.plane
        {
            // Any turn of the circle; the middle is a number like the others.
            x = middle + longitude::wrapped(x - middle);
        }
        let [x, y] = world(&self.georef, [x, y]);
        let grid = self.georef.grid(x, y);
        grid.iter().all(|v| v.is_finite()).then_some(grid)
    }

    /// The coordinates of a place of the grid. `None` where it has none.
    pub fn coordinates(&self, grid: [f64; 2]) -> Option<[f64; 2]> {
        let georef = &self.georef;
        let at = |axis: usize| georef.origin_m[axis] + grid[axis] * georef.sample_spacing_m[axis];
        let point = native(georef, [at(0), at(1)]);
        let point = match &self.projection {
            Some(projection) => projection.to_degrees(point[0], point[1])?,
            None => point,
        };
        point.iter().all(|v| v.is_finite()).then_some(point)
    }

    /// The place within the data at which a point of the grid is; `None` outside.
    pub fn within(&self, grid: [f64; 2]) -> Option<GridPlace> {
        let mut place = [0.0; 2];
        for axis in 0..2 {
            let last = f64::from(self.samples[axis] - 1);
            let near = grid[axis].round();
            let snapped = if (grid[axis] - near).abs() <= SNAP {
                near
            } else {
                grid[axis]
            };
            if !(0.0..=last).contains(&snapped) {
                return None;
            }
            // Not -0.
            place[axis] = snapped + 0.0;
        }
        Some(GridPlace(place))
    }

    /// Distance of two places of the grid in the world's plane, metres.
    pub fn distance_m(&self, a: [f64; 2], b: [f64; 2]) -> f64 {
        let [dx, dy] = self.georef.sample_spacing_m;
        ((b[0] - a[0]) * dx).hypot((b[1] - a[1]) * dy)
    }

    /// The grid's steps, metres.
    pub(super) fn spacing_m(&self) -> [f64; 2] {
        self.georef.sample_spacing_m
    }

    /// Columns and rows of samples.
    pub(super) fn samples(&self) -> [u32; 2] {
        self.samples
    }
}

impl GridPlace {
    /// A sample.
    pub fn sample(x: u32, y: u32) -> GridPlace {
        GridPlace([f64::from(x), f64::from(y)])
    }

    /// Column and row, with fractions.
    pub fn grid(self) -> [f64; 2] {
        self.0
    }
}
