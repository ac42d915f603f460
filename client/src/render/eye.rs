//! Where the eye is, what it sees, and the numbers that keep positions exact on the GPU.

use escarp_proto::georef::{Georef, WorldBox};
use escarp_proto::view::View;
use glam::{DVec3, Mat4, Vec3, Vec4};

/// No grid cell that the eye is counted from is farther out. Grid coordinates end at `2^28`, so
/// that differences fit an `i32`. An eye farther out than this only has a longer remainder.
const FARTHEST_CELL: f64 = (1 << 29) as f64;
/// No height that the eye is counted from is larger: `2^30` less this fits an `i32`.
const FARTHEST_QUANTA: f64 = ((1 << 30) - 1) as f64;
/// Nothing nearer is drawn, metres; in finely sampled data it is less.
const NEAR_M: f64 = 0.1;
/// Directions whose horizontal share is less look straight down or up; north is then on top.
const LEAST_HORIZONTAL: f64 = 1e-6;
/// Boxes are held larger by this share of their distance, for the GPU's single precision.
const CULL_MARGIN: f64 = 1e-6;

/// An eye in a dataset's grid, with its frustum.
///
/// The eye's place is split into whole grid cells and quanta, which are subtracted as integers,
/// and a remainder in metres, which is the same for all vertices.
#[derive(Debug, Clone, PartialEq)]
pub struct EyeFrame {
    /// The eye, metres.
    pub eye_m: DVec3,
    /// Unit vector to the right of the picture.
    pub right: DVec3,
    /// Unit vector to the top of the picture.
    pub up: DVec3,
    /// Unit vector into the picture.
    pub forward: DVec3,
    /// Tangents of half the angles of view, horizontal and vertical.
    pub half_tangents: [f64; 2],
    /// Grid column and row that places are counted from.
    pub cell: [i64; 2],
    /// Height that heights are counted from, quanta.
    pub height: i32,
    /// The eye from that column, row and height, metres.
    pub remainder_m: Vec3,
    /// Metres a column, a row, and a quantum with exaggeration.
    pub spacing_m: Vec3,
    /// Factor on all heights.
    pub exaggeration: f64,
    near_m: f64,
}

impl EyeFrame {
    /// The frame of a [checked](View::check) view, with heights drawn `exaggeration` times as high.
    pub fn of(view: &View, georef: &Georef, exaggeration: f32) -> EyeFrame {
        let [right, up, forward] = basis(DVec3::from(view.direction.map(f64::from)));
        let tangent = (f64::from(view.fov_y) / 2.0).tan();
        let aspect = f64::from(view.viewport_px[0]) / f64::from(view.viewport_px[1]);
        let quantum = georef.quantum_m * f64::from(exaggeration);
        let [dx, dy] = georef.sample_spacing_m;
        let [x, y] = georef.grid(view.eye_m[0], view.eye_m[1]);
        let (column, rest_x) = split(x, FARTHEST_CELL);
        let (row, rest_y) = split(y, FARTHEST_CELL);
        let (height, rest_z) = split_height(view.eye_m[2], quantum);
        EyeFrame {
            eye_m: DVec3::from(view.eye_m),
            right,
            up,
            forward,
            half_tangents: [tangent * aspect, tangent],
            cell: [column, row],
            height,
            remainder_m: DVec3::new(rest_x * dx, rest_y * dy, rest_z).as_vec3(),
            spacing_m: DVec3::new(dx, dy, quantum).as_vec3(),
            exaggeration: f64::from(exaggeration),
            near_m: NEAR_M.min(dx.min(dy) * 0.05),
        }
    }

    /// Grid coordinates counted from the eye's cell. Exact for all grids there can be.
    pub fn relative(&self, origin: [u32; 2]) -> [i32; 2] {
        [0, 1].map(|axis| (i64::from(origin[axis]) - self.cell[axis]) as i32)
    }

    /// From metres relative to the eye to clip space. Depth is `near / distance`: 1 at the near
    /// plane and 0 at infinity, which spreads a float's precision evenly over all distances.
    pub fn clip_from_eye(&self) -> Mat4 {
        let [x, y] = self.half_tangents;
        let (right, up) = (self.right / x, self.up / y);
        let column = |axis: usize| {
            Vec4::new(
                right[axis] as f32,
                up[axis] as f32,
                0.0,
                self.forward[axis] as f32,
            )
        };
        let depth = Vec4::new(0.0, 0.0, self.near_m as f32, 0.0);
        Mat4::from_cols(column(0), column(1), column(2), depth)
    }

    /// Whether any of a box can be in the picture. May say yes too often, never no.
    pub fn sees(&self, bounds: &WorldBox) -> bool {
        let tall = DVec3::new(1.0, 1.0, self.exaggeration);
        let min = DVec3::from(bounds.min) * tall - self.eye_m;
        let max = DVec3::from(bounds.max) * tall - self.eye_m;
        let reach = min.abs().max(max.abs()).max_element();
        let [x, y] = self.half_tangents;
        [
            self.forward,
            self.forward * x + self.right,
            self.forward * x - self.right,
            self.forward * y + self.up,
            self.forward * y - self.up,
        ]
        .iter()
        .all(|&inward| {
            let farthest = (inward * min).max(inward * max).element_sum();
            farthest >= -CULL_MARGIN * reach * inward.length()
        })
    }
}

/// Right, up and forward of a picture that is level.
fn basis(direction: DVec3) -> [DVec3; 3] {
    let forward = direction.try_normalize().unwrap_or(DVec3::Y);
    let horizontal = forward.truncate().length();
    let hint = if horizontal > LEAST_HORIZONTAL {
        DVec3::Z
    } else {
        DVec3::Y * -forward.z.signum()
    };
    let right = forward.cross(hint).normalize();
    [right, right.cross(forward), forward]
}

/// A whole number near `value`, at most `farthest` from zero, and the rest.
fn split(value: f64, farthest: f64) -> (i64, f64) {
    let whole = value.floor().clamp(-farthest, farthest);
    (whole as i64, value - whole)
}

/// Whole quanta of a height, and the rest in metres. Flat ground (a quantum of 0) is all rest.
fn split_height(z_m: f64, quantum_m: f64) -> (i32, f64) {
    let quanta = z_m / quantum_m;
    if !quanta.is_finite() {
        return (0, z_m);
    }
    let (whole, _) = split(quanta, FARTHEST_QUANTA);
    (whole as i32, z_m - whole as f64 * quantum_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use escarp_proto::georef::Plane;
    use proptest::prelude::*;

    fn georef() -> Georef {
        Georef {
            origin_m: [400_000.0, 5_000_000.0],
            sample_spacing_m: [30.0, 25.0],
            quantum_m: 0.1,
            plane: Plane::Local,
        }
    }

    fn view(eye_m: [f64; 3], direction: [f32; 3]) -> View {
        View {
            eye_m,
            direction,
            velocity_m_s: [0.0; 3],
            fov_y: 1.0,
            viewport_px: [1280, 720],
            max_screen_error_px: 2.0,
        }
    }

    /// The shader's arithmetic.
    fn place(frame: &EyeFrame, x: u32, y: u32, height: i32) -> Vec3 {
        let [dx, dy] = frame.relative([x, y]);
        let steps = Vec3::new(dx as f32, dy as f32, (height - frame.height) as f32);
        steps * frame.spacing_m - frame.remainder_m
    }

    proptest! {
        #[test]
        fn places_are_right_to_single_precision_from_any_eye(
            eye in [-1e12f64..1e12, -1e12..1e12, -1e12..1e12],
            scale in 0i32..12,
            x in 0u32..=1 << 28, y in 0u32..=1 << 28, height in -(1i32 << 30)..=1 << 30,
        ) {
            let georef = georef();
            let eye = eye.map(|v| v / 10f64.powi(scale));
            let frame = EyeFrame::of(&view(eye, [0.0, 1.0, -1.0]), &georef, 1.0);
            let right = DVec3::from(georef.world(x, y, height)) - DVec3::from(eye);
            let found = place(&frame, x, y, height).as_dvec3();
            prop_assert!((found - right).abs().max_element() <= right.length().max(1.0) * 1e-6);
        }

        #[test]
        fn what_projects_into_the_picture_is_never_culled(
            eye in [-5e4f64..5e4, -5e4..5e4, -1e3..2e4], direction in [-1f32..1.0, -1.0..1.0, -1.0..1.0],
            corner in [-5e4f64..5e4, -5e4..5e4, 0.0..3e3], size in [0f64..1e4, 0.0..1e4, 0.0..1e3],
            share in [0f64..1.0, 0.0..1.0, 0.0..1.0],
        ) {
            prop_assume!(direction.iter().map(|v| v * v).sum::<f32>() > 1e-6);
            let frame = EyeFrame::of(&view(eye, direction), &georef(), 1.0);
            let (min, size) = (DVec3::from(corner), DVec3::from(size));
            let bounds = WorldBox { min: min.into(), max: (min + size).into() };
            let point = min + size * DVec3::from(share) - frame.eye_m;
            let clip = frame.clip_from_eye() * point.as_vec3().extend(1.0);
            if clip.w > 0.0 && clip.x.abs() <= clip.w && clip.y.abs() <= clip.w {
                prop_assert!(frame.sees(&bounds));
            }
        }
    }

    #[test]
    fn a_box_beside_behind_or_above_the_picture_is_culled() {
        let frame = EyeFrame::of(&view([0.0; 3], [0.0, 1.0, 0.0]), &georef(), 1.0);
        let at = |x: f64, y: f64, z: f64| WorldBox {
            min: [x - 1.0, y - 1.0, z - 1.0],
            max: [x + 1.0, y + 1.0, z + 1.0],
        };
        assert!(frame.sees(&at(0.0, 100.0, 0.0)));
        assert!(!frame.sees(&at(0.0, -100.0, 0.0)));
        assert!(!frame.sees(&at(200.0, 100.0, 0.0)));
        assert!(!frame.sees(&at(-200.0, 100.0, 0.0)));
        assert!(!frame.sees(&at(0.0, 100.0, 90.0)));
        assert!(!frame.sees(&at(0.0, 100.0, -90.0)));
    }

    #[test]
    fn straight_down_north_is_on_top() {
        let frame = EyeFrame::of(&view([0.0; 3], [0.0, 0.0, -1.0]), &georef(), 1.0);
        assert!((frame.up - DVec3::Y).length() < 1e-9);
        assert!((frame.right - DVec3::X).length() < 1e-9);
    }

    #[test]
    fn heights_without_exaggeration_are_flat_and_finite() {
        let frame = EyeFrame::of(&view([0.0, 0.0, 500.0], [0.0, 1.0, 0.0]), &georef(), 0.0);
        assert_eq!(place(&frame, 0, 0, 1 << 30).z, -500.0);
    }
}
