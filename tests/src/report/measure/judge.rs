//! What a deviation is worth on the screen.

use super::scan::Corners;
use escarp_client::mesh::Frustum;
use escarp_proto::georef::{Georef, WorldBox};
use escarp_proto::view::View;

/// Distances below this count as this much, metres: at no distance every deviation is infinite.
const NEAREST_M: f64 = 1e-6;

/// Turns deviations into pixels, for one view.
#[derive(Debug, Clone)]
pub struct Judge {
    georef: Georef,
    frustum: Frustum,
    eye_m: [f64; 3],
    px_per_slope: f64,
    /// Where the picture's right, its upper side and its depth are.
    axes: [[f64; 3]; 3],
}

/// A deviation in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// As promised: height times pixels a slope over distance, the largest of the three axes'.
    pub px: f64,
    /// How far apart mesh and surface are in the picture, if both are in front of the eye.
    pub projected_px: Option<f64>,
}

impl Judge {
    /// For a view that is in order.
    pub fn new(georef: &Georef, view: &View) -> Judge {
        let forward = unit(view.direction.map(f64::from));
        let level = forward[0].hypot(forward[1]);
        let right = match level > 1e-6 {
            true => [forward[1] / level, -forward[0] / level, 0.0],
            false => [1.0, 0.0, 0.0],
        };
        Judge {
            georef: georef.clone(),
            frustum: Frustum::of(view),
            eye_m: view.eye_m,
            px_per_slope: view.px_per_slope(),
            axes: [right, cross(right, forward), forward],
        }
    }

    /// Whether any of a box may be seen.
    pub fn may_see(&self, region: &WorldBox) -> bool {
        self.frustum.may_see(region)
    }

    /// From grid coordinates to the world.
    pub fn georef(&self) -> &Georef {
        &self.georef
    }

    /// The smallest box that holds a triangle, metres.
    pub fn box_of(&self, corners: &Corners) -> WorldBox {
        let [a, b, c] = corners.map(|(x, y, height)| {
            let z = height * self.georef.quantum_m;
            [self.georef.world_x(x), self.georef.world_y(y), z]
        });
        let ends =
            |pick: fn(f64, f64) -> f64| std::array::from_fn(|i| pick(pick(a[i], b[i]), c[i]));
        WorldBox {
            min: ends(f64::min),
            max: ends(f64::max),
        }
    }

    /// Position of a sample if it may be seen.
    pub fn sees(&self, x: u32, y: u32, height: i32) -> Option<[f64; 3]> {
        let at_m = self.georef.world(x, y, height);
        let point = WorldBox {
            min: at_m,
            max: at_m,
        };
        self.frustum.may_see(&point).then_some(at_m)
    }

    /// Distance of a point in the measure of the promise, metres.
    pub fn distance_m(&self, at_m: [f64; 3]) -> f64 {
        let point = WorldBox {
            min: at_m,
            max: at_m,
        };
        point.distance_m(self.eye_m)
    }

    /// Pixels of a height difference at a point, as promised.
    pub fn px(&self, at_m: [f64; 3], deviation_m: f64) -> f64 {
        if deviation_m == 0.0 {
            return 0.0;
        }
        deviation_m.abs() * self.px_per_slope / self.distance_m(at_m).max(NEAREST_M)
    }

    /// A deviation of the mesh, up or down, from a point of the surface.
    pub fn deviation(&self, at_m: [f64; 3], up_m: f64) -> Seen {
        let [surface, mesh] = [0.0, up_m].map(|up_m| {
            let from: [f64; 3] = [
                at_m[0] - self.eye_m[0],
                at_m[1] - self.eye_m[1],
                at_m[2] + up_m - self.eye_m[2],
            ];
            let [x, y, depth] = self.axes.map(|axis| dot(axis, from));
            (depth > NEAREST_M).then(|| [x / depth, y / depth])
        });
        let projected = surface.zip(mesh).map(|(a, b)| {
            let apart = (a[0] - b[0]).hypot(a[1] - b[1]);
            apart * self.px_per_slope
        });
        Seen {
            px: self.px(at_m, up_m),
            projected_px: projected,
        }
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = dot(v, v).sqrt();
    v.map(|c| c / length)
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}
