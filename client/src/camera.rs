//! A camera that flies, and the views it gives. Knows no window and no clock.

use escarp_proto::manifest::Manifest;
use escarp_proto::view::{FARTHEST_EYE_M, View};
use glam::{DVec2, DVec3};

/// Vertical field of view if nothing else is said, radians.
pub const DEFAULT_FOV_Y: f64 = 60.0 * std::f64::consts::PI / 180.0;
/// The steepest look up or down, radians: short of the pole, where there is no level picture.
const STEEPEST: f64 = 89.5 * std::f64::consts::PI / 180.0;
/// Heights above ground flown a second at pace 1.
const HEIGHTS_A_SECOND: f64 = 0.8;
/// Seconds in which the speed comes near to what the keys ask for.
const EASE_S: f64 = 0.15;
/// Factor on the pace of one notch of the wheel, and how far the pace goes either way.
const NOTCH: f64 = 1.25;
const PACES: [f64; 2] = [1.0 / 64.0, 64.0];
/// Factor on the speed while the key for it is held.
const HURRY: f64 = 4.0;
/// Nearer to the ground the speed falls no further, metres.
const LOWEST_M: f64 = 0.1;
/// Long frames count as this many seconds, so that a stall is not a leap.
const LONGEST_STEP_S: f64 = 0.1;
/// An overview looks down by this angle, radians.
const OVERVIEW_PITCH: f64 = -36.0 * std::f64::consts::PI / 180.0;
/// Share of the picture, from its middle to its edge, that an overview fills.
const OVERVIEW_FILL: f64 = 0.94;

/// What the pilot asks for; each direction in `-1..=1`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Controls {
    /// Along the line of sight.
    pub forward: f64,
    /// Level, to the right.
    pub right: f64,
    /// Straight up.
    pub up: f64,
    /// Four times as fast.
    pub hurry: bool,
}

/// A camera that is always level.
#[derive(Debug, Clone, PartialEq)]
pub struct FlyCamera {
    /// The eye, metres.
    pub eye_m: DVec3,
    /// Compass course, radians: 0 north, a quarter turn east.
    pub yaw: f64,
    /// Above the horizon, radians.
    pub pitch: f64,
    /// Vertical field of view, radians.
    pub fov_y: f64,
    /// Velocity, metres a second.
    pub velocity_m_s: DVec3,
    pace: f64,
    home: ([f64; 3], [f64; 3]),
}

impl FlyCamera {
    /// A camera at `eye` that looks at `look`, both in metres; this is its home, too.
    pub fn new(eye: [f64; 3], look: [f64; 3], fov_y: f64) -> FlyCamera {
        let mut camera = FlyCamera {
            eye_m: DVec3::ZERO,
            yaw: 0.0,
            pitch: 0.0,
            fov_y,
            velocity_m_s: DVec3::ZERO,
            pace: 1.0,
            home: (eye, look),
        };
        camera.go_home();
        camera
    }

    /// Goes, at once, to where it began.
    pub fn go_home(&mut self) {
        let (eye, look) = self.home;
        self.pace = 1.0;
        self.jump(eye, look);
    }

    /// Goes, at once, to `eye` and looks at `look`, metres.
    /// What is no place, it stays away from.
    pub fn jump(&mut self, eye: [f64; 3], look: [f64; 3]) {
        let way = DVec3::from(look) - DVec3::from(eye);
        if !way.is_finite() {
            return;
        }
        self.eye_m = allowed(eye.into());
        self.velocity_m_s = DVec3::ZERO;
        if way.truncate() != DVec2::ZERO {
            self.yaw = way.x.atan2(way.y);
        }
        self.pitch = way
            .z
            .atan2(way.truncate().length())
            .clamp(-STEEPEST, STEEPEST);
    }

    /// Unit vector along the line of sight.
    pub fn direction(&self) -> DVec3 {
        let (level, up) = (self.pitch.cos(), self.pitch.sin());
        DVec3::new(self.yaw.sin() * level, self.yaw.cos() * level, up)
    }

    /// Turns right and up by these angles, radians.
    pub fn turn(&mut self, right: f64, up: f64) {
        if !(right.is_finite() && up.is_finite()) {
            return;
        }
        self.yaw = (self.yaw + right).rem_euclid(std::f64::consts::TAU);
        self.pitch = (self.pitch + up).clamp(-STEEPEST, STEEPEST);
    }

    /// Turns as a drag of this many pixels in a picture of that height does: what is in the middle
    /// of the picture stays under the pointer.
    pub fn drag(&mut self, right_px: f64, down_px: f64, picture_height_px: f64) {
        let angle = self.fov_y / picture_height_px.max(1.0);
        self.turn(-right_px * angle, down_px * angle);
    }

    /// Makes the pace faster, or slower, by notches of a wheel.
    pub fn change_pace(&mut self, notches: f64) {
        let factor = NOTCH.powf(notches);
        if !factor.is_nan() {
            self.pace = (self.pace * factor).clamp(PACES[0], PACES[1]);
        }
    }

    /// Speed of full controls at this height above the ground, metres a second.
    pub fn speed_m_s(&self, above_ground_m: f64) -> f64 {
        above_ground_m.clamp(LOWEST_M, FARTHEST_EYE_M).max(LOWEST_M) * HEIGHTS_A_SECOND * self.pace
    }

    /// Flies for `dt_s` seconds.
    pub fn step(&mut self, controls: &Controls, above_ground_m: f64, dt_s: f64) {
        let dt = if dt_s > 0.0 {
            dt_s.min(LONGEST_STEP_S)
        } else {
            0.0
        };
        let speed = self.speed_m_s(above_ground_m) * if controls.hurry { HURRY } else { 1.0 };
        let right = DVec3::new(self.yaw.cos(), -self.yaw.sin(), 0.0);
        let way =
            self.direction() * controls.forward + right * controls.right + DVec3::Z * controls.up;
        let wanted = way.clamp_length_max(1.0) * speed;
        self.velocity_m_s += (wanted - self.velocity_m_s) * (1.0 - (-dt / EASE_S).exp());
        if way == DVec3::ZERO && self.velocity_m_s.length() < speed * 1e-3 {
            self.velocity_m_s = DVec3::ZERO;
        }
        self.eye_m = allowed(self.eye_m + self.velocity_m_s * dt);
    }

    /// Rises to at least this height, metres, if it is below.
    pub fn stay_above(&mut self, least_z_m: f64) {
        self.eye_m.z = self.eye_m.z.max(least_z_m).min(FARTHEST_EYE_M);
    }

    /// Whether it moves by itself.
    pub fn is_moving(&self) -> bool {
        self.velocity_m_s != DVec3::ZERO
    }

    /// What it sees in a picture of this size, with this tolerance in pixels.
    pub fn view(&self, viewport_px: [u32; 2], max_screen_error_px: f32) -> View {
        View {
            eye_m: self.eye_m.into(),
            direction: self.direction().as_vec3().into(),
            velocity_m_s: self.velocity_m_s.as_vec3().into(),
            fov_y: self.fov_y as f32,
            viewport_px,
            max_screen_error_px,
        }
    }
}

/// The nearest place where an eye may be.
fn allowed(eye_m: DVec3) -> DVec3 {
    let farthest = DVec3::splat(FARTHEST_EYE_M);
    eye_m.clamp(-farthest, farthest)
}

/// The view from `eye` to `look`, metres; north, if they are the same place.
pub fn look_at(
    eye: [f64; 3],
    look: [f64; 3],
    fov_y: f64,
    viewport_px: [u32; 2],
    max_screen_error_px: f32,
) -> View {
    let way = (DVec3::from(look) - DVec3::from(eye)).normalize_or(DVec3::Y);
    View {
        eye_m: eye,
        direction: way.as_vec3().into(),
        velocity_m_s: [0.0; 3],
        fov_y: fov_y as f32,
        viewport_px,
        max_screen_error_px,
    }
}

/// `(eye, look)` from the south that fills a picture with the whole of the data. `fov_y` is the
/// vertical field of view in radians, `aspect` width over height.
pub fn overview(manifest: &Manifest, fov_y: f64, aspect: f64) -> ([f64; 3], [f64; 3]) {
    let corners = corners(manifest.extent_m());
    let forward = DVec3::new(0.0, OVERVIEW_PITCH.cos(), OVERVIEW_PITCH.sin());
    let up = DVec3::new(0.0, -forward.z, forward.y);
    let half = (fov_y / 2.0).tan() * OVERVIEW_FILL;
    let mut look = corners.iter().sum::<DVec3>() / corners.len() as f64;
    let mut back = 0.0;
    // The near edge looms larger than the far one, so the middle of the data is not the middle of
    // the picture: a few steps find the height to look at.
    for _ in 0..32 {
        let seen = corners.map(|c| {
            let from = c - look;
            [from.x, up.dot(from), forward.dot(from)]
        });
        back = seen
            .iter()
            .flat_map(|[x, y, z]| [x.abs() / (half * aspect) - z, y.abs() / half - z])
            .fold(1.0, f64::max);
        let slopes = seen.map(|[_, y, z]| y / (z + back));
        let low = slopes.iter().copied().fold(f64::INFINITY, f64::min);
        let high = slopes.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        look += up * (back * (low + high) / 2.0);
    }
    // Data that reaches as far out as it may is not seen as a whole.
    (allowed(look - forward * back).into(), look.into())
}

fn corners(extent: [[f64; 2]; 3]) -> [DVec3; 8] {
    let side = |axis: usize, i: usize| extent[axis][i >> axis & 1];
    std::array::from_fn(|i| DVec3::new(side(0, i), side(1, i), side(2, i)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::tests::manifest;

    fn camera() -> FlyCamera {
        FlyCamera::new([0.0, 0.0, 100.0], [0.0, 100.0, 100.0], DEFAULT_FOV_Y)
    }

    #[test]
    fn it_flies_where_it_looks_and_stops_when_let_go() {
        let mut camera = camera();
        camera.turn(std::f64::consts::FRAC_PI_2, 0.0);
        let ahead = Controls {
            forward: 1.0,
            ..Default::default()
        };
        for _ in 0..100 {
            camera.step(&ahead, 100.0, 0.02);
        }
        assert!(camera.eye_m.x > 100.0, "{}", camera.eye_m);
        assert!(camera.eye_m.y.abs() < 1e-9 && camera.is_moving());
        assert!((camera.velocity_m_s.length() - camera.speed_m_s(100.0)).abs() < 0.1);
        for _ in 0..100 {
            camera.step(&Controls::default(), 100.0, 0.02);
        }
        assert!(!camera.is_moving());
        camera.go_home();
        assert_eq!(camera.eye_m, DVec3::new(0.0, 0.0, 100.0));
        assert_eq!(camera.yaw, 0.0);
    }

    #[test]
    fn speed_grows_with_height_and_pace_and_two_keys_are_not_faster_than_one() {
        let mut camera = camera();
        let slow = camera.speed_m_s(100.0);
        assert_eq!(camera.speed_m_s(1000.0), slow * 10.0);
        camera.change_pace(1.0);
        assert_eq!(camera.speed_m_s(100.0), slow * NOTCH);
        let both = Controls {
            forward: 1.0,
            right: 1.0,
            ..Default::default()
        };
        (0..100).for_each(|_| camera.step(&both, 100.0, 0.05));
        assert!(camera.velocity_m_s.length() <= slow * NOTCH * 1.0001);
    }

    #[test]
    fn it_never_looks_past_straight_down_nor_leaps_after_a_stall() {
        let mut camera = camera();
        camera.turn(0.0, -10.0);
        assert!(camera.direction().z > -1.0 && camera.direction().truncate().length() > 1e-3);
        let before = camera.eye_m;
        let down = Controls {
            up: -1.0,
            ..Default::default()
        };
        camera.step(&down, 100.0, 3600.0);
        assert!((camera.eye_m - before).length() < 100.0);
    }

    #[test]
    fn its_view_is_allowed() {
        let view = camera().view([1280, 720], 2.0);
        assert_eq!(view.check(), Ok(()));
        assert_eq!(
            look_at([1.0; 3], [1.0; 3], 1.0, [4, 3], 2.0).check(),
            Ok(())
        );
    }

    #[test]
    fn an_overview_holds_all_corners_and_fills_the_picture() {
        for (side, heights) in [
            (1e3, [0, 100]),
            (2e6, [-400, 9000]),
            (3e4, [100, 100]),
            (1e3, [0, 9000]),
        ] {
            for aspect in [0.5, 1.0, 16.0 / 9.0] {
                let manifest = manifest(side, heights);
                let (eye, look) = overview(&manifest, DEFAULT_FOV_Y, aspect);
                let (eye, forward) = (DVec3::from(eye), DVec3::from(look) - DVec3::from(eye));
                let forward = forward.normalize();
                let up = DVec3::X.cross(forward);
                let half = (DEFAULT_FOV_Y / 2.0).tan();
                let reach = corners(manifest.extent_m()).map(|corner| {
                    let from = corner - eye;
                    let depth = forward.dot(from) * half;
                    assert!(depth > 0.0);
                    (from.x / depth / aspect)
                        .abs()
                        .max((up.dot(from) / depth).abs())
                });
                let widest = reach.into_iter().fold(0.0, f64::max);
                assert!(
                    (0.9..=0.96).contains(&widest),
                    "{side} {heights:?} {aspect}: {widest}"
                );
                assert!(eye.z > f64::from(heights[1]));
            }
        }
    }
}
