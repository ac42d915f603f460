//! Paths that a camera flies along: the file that `fly` reads, and one for any dataset.
//!
//! Places are interpolated by Catmull-Rom splines. Heights never overshoot those of the keys
//! (F. N. Fritsch, J. Butland, "A Method for Constructing Local Monotone Piecewise Cubic
//! Interpolants", 1984), and where all are positive their logarithms are interpolated, so that a
//! descent from 500 km to 500 m is as even to the eye at its end as at its beginning.

use crate::camera;
use escarp_proto::manifest::Manifest;
use escarp_proto::view::{FARTHEST_EYE_M, SCREEN_ERRORS_PX, View};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Most keys of a path.
pub const MAX_KEYS: usize = 10_000;
/// Longest path, seconds.
pub const MAX_DURATION_S: f64 = 86_400.0;
/// Least time from one key to the next, seconds.
pub const LEAST_TIME_S: f64 = 1e-3;
/// Most pictures of a flight.
pub const MAX_FRAMES: f64 = 1e6;
/// Longest side of a picture, pixels.
pub const MAX_SIDE_PX: u32 = 16_384;
/// Allowed vertical fields of view, degrees.
pub const FIELDS_OF_VIEW_DEG: [f64; 2] = [1.0, 170.0];

/// Why a path cannot be flown.
#[derive(Debug, Error)]
pub enum PathError {
    /// It is not JSON of the right form.
    #[error("not a path")]
    Json(#[from] serde_json::Error),
    /// A value is not allowed.
    #[error("path: {field} is {found}, allowed is {allowed}")]
    Value {
        /// Where it stands.
        field: String,
        /// What stands there.
        found: String,
        /// What may stand there.
        allowed: String,
    },
}

/// A flight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Path {
    /// Vertical field of view, degrees.
    #[serde(default = "default_fov_deg")]
    pub fov_deg: f64,
    /// Tolerance, pixels.
    #[serde(default = "default_error_px")]
    pub error_px: f32,
    /// Width and height of the pictures, pixels.
    #[serde(default = "default_size")]
    pub size: [u32; 2],
    /// Pictures a second.
    #[serde(default = "default_fps")]
    pub fps: f64,
    /// Where to be when; at least one.
    pub keys: Vec<Key>,
}

/// A place on a path.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Key {
    /// When, seconds.
    pub t: f64,
    /// The eye, metres.
    pub eye: [f64; 3],
    /// What it looks at, metres.
    pub look: [f64; 3],
}

fn default_fov_deg() -> f64 {
    60.0
}

fn default_error_px() -> f32 {
    2.0
}

fn default_size() -> [u32; 2] {
    [1280, 720]
}

fn default_fps() -> f64 {
    30.0
}

impl Path {
    /// Reads and checks a path.
    ///
    /// # Errors
    /// Where it is not JSON of the right form, or the first value that is not allowed.
    pub fn from_json(json: &[u8]) -> Result<Path, PathError> {
        let path: Path = serde_json::from_slice(json)?;
        path.check()?;
        Ok(path)
    }

    /// # Errors
    /// The first value that is not allowed.
    pub fn check(&self) -> Result<(), PathError> {
        within("fov_deg", self.fov_deg, FIELDS_OF_VIEW_DEG)?;
        within(
            "error_px",
            f64::from(self.error_px),
            SCREEN_ERRORS_PX.map(f64::from),
        )?;
        within("fps", self.fps, [0.01, 1000.0])?;
        for side in self.size {
            within("size", f64::from(side), [1.0, f64::from(MAX_SIDE_PX)])?;
        }
        within(
            "number of keys",
            self.keys.len() as f64,
            [1.0, MAX_KEYS as f64],
        )?;
        let mut least = 0.0;
        for (i, key) in self.keys.iter().enumerate() {
            within(&format!("keys[{i}].t"), key.t, [least, MAX_DURATION_S])?;
            key.check(i)?;
            // Speeds are differences of places over those of times, and must be numbers.
            least = key.t + LEAST_TIME_S;
        }
        within(
            "number of frames",
            self.duration_s() * self.fps,
            [0.0, MAX_FRAMES],
        )
    }

    /// Seconds from the first key to the last.
    pub fn duration_s(&self) -> f64 {
        match (self.keys.first(), self.keys.last()) {
            (Some(first), Some(last)) => last.t - first.t,
            _ => 0.0,
        }
    }

    /// Pictures of the flight, its first and last moment among them.
    pub fn frames(&self) -> u64 {
        (self.duration_s() * self.fps + 1e-9).floor() as u64 + 1
    }

    /// When a picture is taken, seconds.
    pub fn frame_time_s(&self, frame: u64) -> f64 {
        self.keys.first().map_or(0.0, |key| key.t) + frame as f64 / self.fps
    }

    /// `(eye, look)` at a time in seconds, metres. Before the first key it is the first, after the
    /// last the last.
    ///
    /// # Panics
    /// If the path has no keys, which [`check`](Self::check) refuses.
    pub fn sample(&self, t: f64) -> ([f64; 3], [f64; 3]) {
        (self.place(t, |key| key.eye), self.place(t, |key| key.look))
    }

    /// The view at a time in seconds, velocity and all.
    ///
    /// # Panics
    /// As [`sample`](Self::sample).
    pub fn view(&self, t: f64) -> View {
        const STEP_S: f64 = 1e-3;
        let (eye, look) = self.sample(t);
        let fov = self.fov_deg.to_radians();
        let mut view = camera::look_at(eye, look, fov, self.size, self.error_px);
        let ahead = DVec3::from(self.sample(t + STEP_S).0);
        let behind = DVec3::from(self.sample(t - STEP_S).0);
        view.velocity_m_s = ((ahead - behind) / (2.0 * STEP_S)).as_vec3().into();
        view
    }

    fn place(&self, t: f64, place: impl Fn(&Key) -> [f64; 3]) -> [f64; 3] {
        let along = |axis: usize| {
            let value = |i: usize| place(&self.keys[i])[axis];
            self.along(t, value, central)
        };
        let heights_are_positive = self.keys.iter().all(|key| place(key)[2] > 0.0);
        let height = |i: usize| place(&self.keys[i])[2];
        let z = if heights_are_positive {
            self.along(t, |i| height(i).ln(), monotone).exp()
        } else {
            self.along(t, height, monotone)
        };
        [along(0), along(1), z]
    }

    /// A value between keys by a cubic Hermite spline, whose slopes `slope` chooses.
    fn along(
        &self,
        t: f64,
        value: impl Fn(usize) -> f64,
        slope: fn([f64; 2], [f64; 2]) -> f64,
    ) -> f64 {
        let last = self.keys.len() - 1;
        let next = self.keys.partition_point(|key| key.t <= t);
        if next == 0 || next > last {
            return value(next.min(last));
        }
        let width = |i: usize| self.keys[i + 1].t - self.keys[i].t;
        let rise = |i: usize| (value(i + 1) - value(i)) / width(i);
        let slope_at = |i: usize| match i {
            // At its ends the path rests.
            0 => 0.0,
            _ if i == last => 0.0,
            _ => slope([width(i - 1), width(i)], [rise(i - 1), rise(i)]),
        };
        let i = next - 1;
        let h = width(i);
        let s = (t - self.keys[i].t) / h;
        let ease = s * s * (3.0 - 2.0 * s);
        let (start, end) = (s * (1.0 - s) * (1.0 - s), s * s * (s - 1.0));
        value(i) * (1.0 - ease)
            + value(i + 1) * ease
            + h * (start * slope_at(i) + end * slope_at(next))
    }
}

/// Slope of the parabola through three keys: Catmull-Rom for keys that are not evenly spaced.
fn central(widths: [f64; 2], rises: [f64; 2]) -> f64 {
    (rises[0] * widths[1] + rises[1] * widths[0]) / (widths[0] + widths[1])
}

/// Fritsch and Butland's slope: level where the values turn, and never too steep.
fn monotone(widths: [f64; 2], rises: [f64; 2]) -> f64 {
    if rises[0] * rises[1] <= 0.0 {
        return 0.0;
    }
    let weights = [widths[0] + 2.0 * widths[1], 2.0 * widths[0] + widths[1]];
    (weights[0] + weights[1]) / (weights[1] / rises[0] + weights[0] / rises[1])
}

impl Key {
    fn check(&self, i: usize) -> Result<(), PathError> {
        for (name, place) in [("eye", self.eye), ("look", self.look)] {
            for value in place {
                within(
                    &format!("keys[{i}].{name}"),
                    value,
                    [-FARTHEST_EYE_M, FARTHEST_EYE_M],
                )?;
            }
        }
        if self.eye == self.look {
            return Err(PathError::Value {
                field: format!("keys[{i}].look"),
                found: format!("{:?}", self.look),
                allowed: "another place than eye".into(),
            });
        }
        Ok(())
    }
}

fn within(field: &str, found: f64, [least, most]: [f64; 2]) -> Result<(), PathError> {
    if (least..=most).contains(&found) {
        return Ok(());
    }
    Err(PathError::Value {
        field: field.into(),
        found: found.to_string(),
        allowed: format!("{least}..={most}"),
    })
}

/// A flight that shows any dataset: from the overview down to its middle, and low across it to
/// the north-east. It stays above the highest height there is, since it knows no other.
pub fn default_path(manifest: &Manifest) -> Path {
    let size = default_size();
    let aspect = f64::from(size[0]) / f64::from(size[1]);
    let (eye, look) = camera::overview(manifest, camera::DEFAULT_FOV_Y, aspect);
    let ([eye, look], route) = ([eye, look].map(DVec3::from), Route::over(manifest));
    let mut keys = vec![key(0.0, eye, look), key(1.5, eye, look)];
    // The way down shrinks by the same factor in each step.
    const STEPS: u32 = 6;
    for step in 1..=STEPS {
        let share = f64::from(step) / f64::from(STEPS);
        let (goal, ahead) = route.at(0.0);
        let left = ((goal - ahead).length() / (eye - look).length()).powf(share);
        let turned = (eye - look)
            .normalize()
            .lerp((goal - ahead).normalize(), share)
            .normalize();
        let target = ahead + (look - ahead) * (left * (1.0 - share));
        let back = (eye - look).length() * left;
        let place = target + turned * back;
        keys.push(key(
            1.5 + 7.5 * share,
            place.with_z(place.z.max(goal.z)),
            target,
        ));
    }
    for leg in 1..=3 {
        let (eye, look) = route.at(f64::from(leg) / 3.0);
        keys.push(key(9.0 + 3.0 * f64::from(leg), eye, look));
    }
    Path {
        fov_deg: default_fov_deg(),
        error_px: default_error_px(),
        size,
        fps: default_fps(),
        keys,
    }
}

fn key(t: f64, eye: DVec3, look: DVec3) -> Key {
    let farthest = DVec3::splat(FARTHEST_EYE_M);
    let [eye, look] = [eye, look].map(|place| place.clamp(-farthest, farthest).into());
    Key { t, eye, look }
}

/// A low, level flight.
struct Route {
    start: DVec3,
    way: DVec3,
    /// From the eye to what it looks at.
    sight: DVec3,
}

impl Route {
    fn over(manifest: &Manifest) -> Route {
        let [x, y, z] = manifest.extent_m();
        let side = (x[1] - x[0]).min(y[1] - y[0]).max(1.0);
        let relief = z[1] - z[0];
        let above = (0.004 * side).clamp(0.05 * relief, 2.0 * relief.max(0.01 * side));
        let middle = DVec3::new((x[0] + x[1]) / 2.0, (y[0] + y[1]) / 2.0, z[1] + above);
        let way = DVec3::new(0.35, 1.0, 0.0).normalize();
        // Towards what is farther below, the steeper: 14 degrees down over flat land.
        let ahead = 4.0 * (above + 0.5 * relief);
        Route {
            start: middle - way * (0.22 * side),
            way: way * (0.25 * side).min(60.0 * (above + relief)),
            sight: way * ahead - DVec3::Z * (above + 0.5 * relief),
        }
    }

    fn at(&self, share: f64) -> (DVec3, DVec3) {
        let eye = self.start + self.way * share;
        (eye, eye + self.sight)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::app::fake;
    use escarp_proto::geometry::GridLevels;
    use escarp_proto::georef::{Georef, Plane};
    use proptest::prelude::*;

    /// A dataset of `side` metres a side, heights in metres.
    pub(crate) fn manifest(side: f64, height_range: [i32; 2]) -> Manifest {
        let georef = Georef {
            origin_m: [5e5, -3e6],
            sample_spacing_m: [side / 256.0; 2],
            quantum_m: 1.0,
            plane: Plane::Local,
        };
        fake::manifest(GridLevels::new(8).unwrap(), 257, height_range, georef)
    }

    fn path(keys: &[(f64, f64)]) -> Path {
        let keys = keys.iter().map(|&(t, z)| Key {
            t,
            eye: [t * 10.0, 0.0, z],
            look: [t * 10.0, 1e6, 1.0],
        });
        Path {
            fov_deg: 60.0,
            error_px: 2.0,
            size: [64, 48],
            fps: 10.0,
            keys: keys.collect(),
        }
    }

    #[test]
    fn a_descent_halves_the_height_in_equal_times() {
        let path = path(&[
            (0.0, 512_000.0),
            (10.0, 32_000.0),
            (20.0, 2_000.0),
            (30.0, 125.0),
        ]);
        let z = |t: f64| path.sample(t).0[2];
        assert!((z(15.0) - 8000.0).abs() < 1.0, "{}", z(15.0));
        assert_eq!((z(-5.0), z(99.0)), (z(0.0), z(30.0)));
        assert!((z(30.0) - 125.0).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn heights_stay_between_their_keys_and_keys_are_met(
            keys in prop::collection::vec((0.01f64..10.0, -1e4f64..1e6), 1..8),
            shift in prop::sample::select(vec![0.0, 2e4]),
        ) {
            let mut t = 0.0;
            let keys: Vec<(f64, f64)> = keys.iter().map(|(dt, z)| { t += dt; (t, z + shift) }).collect();
            let path = path(&keys);
            prop_assert!(path.check().is_ok());
            for pair in keys.windows(2) {
                let ((t0, z0), (t1, z1)) = (pair[0], pair[1]);
                for step in 0..=20 {
                    let z = path.sample(t0 + (t1 - t0) * f64::from(step) / 20.0).0[2];
                    let slack = 1e-9 * (z0.abs() + z1.abs());
                    prop_assert!(z >= z0.min(z1) - slack && z <= z0.max(z1) + slack);
                }
                prop_assert!((path.sample(t0).0[2] - z0).abs() <= 1e-9 * z0.abs());
            }
        }
    }

    #[test]
    fn a_file_is_read_with_defaults_and_errors_name_the_place() {
        let read = |json: &str| Path::from_json(json.as_bytes());
        let key = |t: &str| format!(r#"{{"t":{t},"eye":[0,0,9],"look":[0,1,0]}}"#);
        let path = read(&format!(r#"{{"keys":[{},{}]}}"#, key("0"), key("2.5"))).unwrap();
        assert_eq!(
            (path.size, path.fps, path.frames()),
            ([1280, 720], 30.0, 76)
        );
        // As a program prints it: the error and its cause.
        let error = |json: &str| format!("{:#}", anyhow::Error::new(read(json).unwrap_err()));
        assert!(error(r#"{"keys":[]}"#).contains("number of keys is 0"));
        let falling = format!(r#"{{"keys":[{},{}]}}"#, key("3"), key("3"));
        assert!(
            error(&falling).contains("keys[1].t is 3"),
            "{}",
            error(&falling)
        );
        let far = r#"{"keys":[{"t":0,"eye":[1e300,0,0],"look":[0,1,0]}]}"#;
        assert!(error(far).contains("keys[0].eye is 1"), "{}", error(far));
        let blind = r#"{"keys":[{"t":0,"eye":[1,0,0],"look":[1,0,0]}]}"#;
        assert!(error(blind).contains("another place than eye"));
        assert!(error(r#"{"keys":[],"speed":3}"#).contains("unknown field `speed`"));
        let long = format!(r#"{{"fps":1000,"keys":[{},{}]}}"#, key("0"), key("80000"));
        assert!(error(&long).contains("number of frames"));
        let endless = Path {
            fps: f64::NAN,
            ..path
        };
        assert!(
            endless
                .check()
                .unwrap_err()
                .to_string()
                .contains("fps is NaN")
        );
    }

    #[test]
    fn the_default_path_is_allowed_and_stays_above_the_highest_ground() {
        for side in [1e3, 3e4, 2e6] {
            for heights in [[0, 0], [0, 300], [-11_000, 9_000]] {
                let path = default_path(&manifest(side, heights));
                path.check().unwrap();
                let read = Path::from_json(&serde_json::to_vec(&path).unwrap()).unwrap();
                assert_eq!(read.frames(), path.frames());
                for frame in 0..path.frames() {
                    let view = path.view(path.frame_time_s(frame));
                    assert_eq!(view.check(), Ok(()));
                    assert!(
                        view.eye_m[2] > f64::from(heights[1]),
                        "{side} {heights:?} {frame}"
                    );
                }
            }
        }
    }
}
