//! The one place where grid coordinates become world positions.
//!
//! World axes: `x` east, `y` north, `z` up, in metres, double precision. For projected data the
//! world *is* the projected plane, in metres. Geographic data is laid out as a plane at its middle
//! latitude, on its body's radius: `x = R cos(middle latitude) (longitude - middle longitude)`,
//! `y = R (latitude - middle latitude)`, angles in radians.

use crate::page::Range;
use serde::{Deserialize, Serialize};

/// Allowed distances of samples, and units of height, metres.
pub const SCALES_M: std::ops::RangeInclusive<f64> = 1e-9..=1e9;

/// From grid coordinates and quanta to metres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Georef {
    /// World position of the grid's south-west sample, metres.
    pub origin_m: [f64; 2],
    /// Distance of neighbouring samples to the east and to the north, metres.
    pub sample_spacing_m: [f64; 2],
    /// Metres a unit of height.
    pub quantum_m: f64,
    /// The plane that the world is.
    pub plane: Plane,
}

/// Which plane the world's `x` and `y` are coordinates of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Plane {
    /// The plane of a projected CRS, in metres.
    Projected {
        /// The CRS as its file names it, such as `EPSG:32612`.
        crs: String,
        /// Metres a unit of the CRS.
        metres_per_unit: f64,
    },
    /// Longitude and latitude laid out at the middle latitude.
    Geographic {
        /// The CRS as its file names it, such as `EPSG:4326`.
        crs: String,
        /// Radius of the body, metres.
        radius_m: f64,
        /// Longitude at `x = 0`, degrees.
        middle_longitude_deg: f64,
        /// Latitude at `y = 0`, degrees.
        middle_latitude_deg: f64,
    },
    /// No georeference: metres from the south-west sample.
    Local,
}

impl Georef {
    /// World position of a grid sample with a height in quanta, metres.
    pub fn world(&self, x: u32, y: u32, height: i32) -> [f64; 3] {
        [self.world_x(x), self.world_y(y), self.world_z(height)]
    }

    /// World `x` of a grid column, metres. Grows with `x`.
    pub fn world_x(&self, x: u32) -> f64 {
        self.origin_m[0] + f64::from(x) * self.sample_spacing_m[0]
    }

    /// World `y` of a grid row, metres. Grows with `y`.
    pub fn world_y(&self, y: u32) -> f64 {
        self.origin_m[1] + f64::from(y) * self.sample_spacing_m[1]
    }

    /// World `z` of a height in quanta, metres.
    pub fn world_z(&self, height: i32) -> f64 {
        f64::from(height) * self.quantum_m
    }

    /// Grid column and row, with fractions, of a world position.
    pub fn grid(&self, x_m: f64, y_m: f64) -> [f64; 2] {
        [
            (x_m - self.origin_m[0]) / self.sample_spacing_m[0],
            (y_m - self.origin_m[1]) / self.sample_spacing_m[1],
        ]
    }

    /// Half the diagonal of a square with this many cells a side, metres, rounded up.
    pub fn half_diagonal_m(&self, cells: u32) -> f64 {
        let [dx, dy] = self.sample_spacing_m;
        let half = f64::from(cells) / 2.0;
        half * (dx * dx + dy * dy).sqrt() * (1.0 + 4.0 * f64::EPSILON)
    }

    /// The box of a rectangle of the grid and a range of heights.
    pub fn world_box(&self, x: [u32; 2], y: [u32; 2], range: Range) -> WorldBox {
        WorldBox {
            min: self.world(x[0], y[0], range.lo),
            max: self.world(x[1], y[1], range.hi),
        }
    }

    /// # Errors
    /// What is wrong, for a field that is not finite, or a spacing or quantum that is not positive.
    pub fn check(&self) -> Result<(), String> {
        let [dx, dy] = self.sample_spacing_m;
        for (name, found) in [
            ("spacing", dx),
            ("spacing", dy),
            ("quantum", self.quantum_m),
        ] {
            if !SCALES_M.contains(&found) {
                let (least, most) = (SCALES_M.start(), SCALES_M.end());
                return Err(format!(
                    "{name} of {found:e} m, allowed are {least:e} to {most:e} m"
                ));
            }
        }
        if !self.origin_m.iter().all(|v| v.is_finite()) {
            return Err(format!(
                "origin {:?}, allowed are finite numbers",
                self.origin_m
            ));
        }
        Ok(())
    }
}

/// An axis-parallel box in the world, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WorldBox {
    /// South-west bottom.
    pub min: [f64; 3],
    /// North-east top.
    pub max: [f64; 3],
}

impl WorldBox {
    /// Distance from a point: the largest of the distances along the axes, metres, 0 inside.
    /// Never more than the straight distance. Grows as the box shrinks, exactly.
    pub fn distance_m(&self, point: [f64; 3]) -> f64 {
        let along = |axis: usize| (self.min[axis] - point[axis]).max(point[axis] - self.max[axis]);
        along(0).max(along(1)).max(along(2)).max(0.0)
    }
}
