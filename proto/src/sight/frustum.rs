//! What a view can see.

use crate::georef::WorldBox;
use crate::view::View;

/// Directions whose level share is less look straight down or up.
const LEAST_LEVEL: f64 = 1e-6;

/// The four sides of a view's pyramid; what is behind the eye lies outside of one of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frustum {
    eye_m: [f64; 3],
    /// Normals that point inwards.
    sides: [[f64; 3]; 4],
}

impl Frustum {
    /// The pyramid of a view whose picture's upper side is up in the world.
    pub fn of(view: &View) -> Frustum {
        let [right, up, forward] = basis(view.direction);
        let tan_y = (f64::from(view.fov_y) / 2.0).tan();
        let tan_x = tan_y * f64::from(view.viewport_px[0]) / f64::from(view.viewport_px[1]);
        let side = |axis: [f64; 3], tan: f64| std::array::from_fn(|i| forward[i] * tan - axis[i]);
        let negative = |v: [f64; 3]| v.map(|c| -c);
        Frustum {
            eye_m: view.eye_m,
            sides: [
                side(right, tan_x),
                side(negative(right), tan_x),
                side(up, tan_y),
                side(negative(up), tan_y),
            ],
        }
    }

    /// Whether all of a box is within the sides, so that any box in it may be seen. Of a box that
    /// holds nothing none is.
    pub fn sees_all(&self, region: &WorldBox) -> bool {
        let is_empty = (0..3).any(|axis| region.min[axis] > region.max[axis]);
        !is_empty
            && self.sides.iter().all(|normal| {
                let nearest = |i: usize| {
                    let corner = if normal[i] > 0.0 {
                        region.min[i]
                    } else {
                        region.max[i]
                    };
                    (corner - self.eye_m[i]) * normal[i]
                };
                (0..3).map(nearest).sum::<f64>() >= 0.0
            })
    }

    /// Whether any of a box may be seen. Never says no to a box that can be.
    #[inline]
    pub fn may_see(&self, region: &WorldBox) -> bool {
        self.sides.iter().all(|normal| {
            let farthest = |i: usize| {
                let corner = if normal[i] > 0.0 {
                    region.max[i]
                } else {
                    region.min[i]
                };
                (corner - self.eye_m[i]) * normal[i]
            };
            let reach: f64 = (0..3).map(farthest).sum();
            let scale: f64 = (0..3).map(|i| farthest(i).abs()).sum();
            reach >= -1e-9 * scale
        })
    }
}

/// Right, up and forward of a picture that is level, unit vectors at right angles. Looking
/// straight up or down, north is up, or down, in the picture. Meshes and pictures have them from
/// here, so that what is drawn is never what the mesh takes for unseen.
pub fn basis(direction: [f32; 3]) -> [[f64; 3]; 3] {
    let forward = unit(direction.map(f64::from));
    let forward = match forward.iter().all(|c| c.is_finite()) {
        true => forward,
        // No view that was checked.
        false => [0.0, 1.0, 0.0],
    };
    let level = forward[0].hypot(forward[1]);
    let right = match level > LEAST_LEVEL {
        true => [forward[1] / level, -forward[0] / level, 0.0],
        // At right angles to what is forward, however little it leans east.
        false => unit([forward[2].abs(), 0.0, -forward[0] * forward[2].signum()]),
    };
    [right, cross(right, forward), forward]
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = v.iter().map(|c| c * c).sum::<f64>().sqrt();
    v.map(|c| c / length)
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}
