//! Where the eye is, what it sees, and the numbers that keep positions exact on the GPU.

use super::scene::EXAGGERATIONS;
use crate::mesh::basis;
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
/// Boxes are held larger by this share of their distance, for the GPU's single precision.
const CULL_MARGIN: f64 = 1e-6;

/// An eye in a dataset's grid, with its frustum.
///
/// The eye's place is split into whole grid cells and quanta, which are subtracted as integers,
/// and a remainder in metres, which is the same for all vertices. The cell is the nearest one:
/// then what is subtracted from a vertex is at most as long as the vertex is far, and no vertex
/// loses more than a few units in the last place of its own distance. What single precision takes
/// from the remainder is given back by the projection.
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
    /// What the remainder is short of the eye for being in single precision, metres.
    pub lost_m: DVec3,
    /// Metres a column, a row, and a quantum with exaggeration.
    pub spacing_m: Vec3,
    /// Factor on all heights.
    pub exaggeration: f64,
    near_m: f64,
}

impl EyeFrame {
    /// The frame of a [checked](View::check) view, with heights drawn `exaggeration` times as high.
    pub fn of(view: &View, georef: &Georef, exaggeration: f32) -> EyeFrame {
        let [right, up, forward] = basis(view.direction).map(DVec3::from);
        let tangent = (f64::from(view.fov_y) / 2.0).tan();
        let aspect = f64::from(view.viewport_px[0]) / f64::from(view.viewport_px[1]);
        let exaggeration = allowed_exaggeration(exaggeration);
        let quantum = georef.quantum_m * exaggeration;
        let [dx, dy] = georef.sample_spacing_m;
        let (column, rest_x) = split(view.eye_m[0] - georef.origin_m[0], dx, FARTHEST_CELL);
        let (row, rest_y) = split(view.eye_m[1] - georef.origin_m[1], dy, FARTHEST_CELL);
        let (height, rest_z) = split(view.eye_m[2], quantum, FARTHEST_QUANTA);
        let rest = DVec3::new(rest_x, rest_y, rest_z);
        let remainder_m = rest.as_vec3();
        EyeFrame {
            eye_m: DVec3::from(view.eye_m),
            right,
            up,
            forward,
            half_tangents: [tangent * aspect, tangent],
            cell: [column, row],
            // At most `FARTHEST_QUANTA`.
            height: height as i32,
            remainder_m,
            lost_m: rest - remainder_m.as_dvec3(),
            spacing_m: DVec3::new(dx, dy, quantum).as_vec3(),
            exaggeration,
            near_m: NEAR_M.min(dx.min(dy) * 0.05),
        }
    }

    /// Grid coordinates counted from the eye's cell. Exact for all grids there can be.
    pub fn relative(&self, origin: [u32; 2]) -> [i32; 2] {
        [0, 1].map(|axis| (i64::from(origin[axis]) - self.cell[axis]) as i32)
    }

    /// From metres relative to the eye, as the shaders have them, to clip space. Depth is `near /
    /// distance`: 1 at the near plane and 0 at infinity, which spreads a float's precision evenly
    /// over all distances.
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
        let back = |axis: DVec3| -axis.dot(self.lost_m) as f32;
        let depth = self.near_m as f32;
        let last = Vec4::new(back(right), back(up), depth, back(self.forward));
        Mat4::from_cols(column(0), column(1), column(2), last)
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

/// The factor that heights are drawn with: no number is none, and nothing is drawn upside down.
fn allowed_exaggeration(factor: f32) -> f64 {
    let [least, most] = EXAGGERATIONS;
    match factor.is_nan() {
        true => 1.0,
        false => f64::from(factor.clamp(least, most)),
    }
}

/// The whole number of steps that is nearest to a length, at most `farthest` from zero, and the
/// rest in metres, rounded once. Flat ground (a step of 0) is all rest.
fn split(length_m: f64, step_m: f64, farthest: f64) -> (i64, f64) {
    let steps = length_m / step_m;
    if !steps.is_finite() {
        return (0, length_m);
    }
    let whole = steps.round().clamp(-farthest, farthest);
    (whole as i64, whole.mul_add(-step_m, length_m))
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
    fn a_vertex_under_the_eye_is_right_however_far_apart_samples_are() {
        let georef = Georef {
            origin_m: [-2e7, -1e7],
            sample_spacing_m: [37_065.3, 37_065.3],
            ..georef()
        };
        for aside in [[0.13, 0.4], [-0.3, 0.02], [9000.4, -18_000.7]] {
            let at = georef.world(401, 217, 0);
            let eye = [at[0] + aside[0], at[1] + aside[1], 1.0];
            let frame = EyeFrame::of(&view(eye, [0.1, 0.2, -1.0]), &georef, 1.0);
            let right = DVec3::from(at) - DVec3::from(eye);
            let clip = frame.clip_from_eye() * place(&frame, 401, 217, 0).extend(1.0);
            let ahead = frame.forward.dot(right);
            let [x, y] = frame.half_tangents;
            let off = |clip: f32, axis: DVec3, tangent: f64| {
                (f64::from(clip) - axis.dot(right) / tangent).abs() / ahead
            };
            assert!(off(clip.x, frame.right, x) < 1e-6, "{aside:?}");
            assert!(off(clip.y, frame.up, y) < 1e-6, "{aside:?}");
            assert!(off(clip.w, frame.forward, 1.0) < 1e-6, "{aside:?}");
        }
    }

    #[test]
    fn no_exaggeration_takes_a_number_from_a_frame() {
        for factor in [f32::NAN, f32::INFINITY, f32::MAX, -1.0, 0.0, 1e-45] {
            let frame = EyeFrame::of(&view([1.0, 2.0, 500.0], [0.0, 1.0, 0.0]), &georef(), factor);
            let at = place(&frame, 7, 9, 1 << 30);
            assert!(
                at.is_finite() && frame.exaggeration >= 0.0,
                "{factor}: {at}"
            );
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
