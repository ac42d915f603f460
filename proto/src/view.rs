//! A view and the two tests of Ulrich's Update(): a vertex is enabled, and a box entered, when
//! `error * threshold > distance`.

use crate::georef::WorldBox;
use crate::page::Kind;
use bincode::{Decode, Encode};
use thiserror::Error;

/// Allowed tolerances, pixels.
pub const SCREEN_ERRORS_PX: [f32; 2] = [0.05, 1024.0];
/// Allowed vertical fields of view, radians.
pub const FIELDS_OF_VIEW: [f32; 2] = [0.001, 3.0];
/// Allowed viewport sides, pixels.
pub const VIEWPORT_PX: [u32; 2] = [1, 32768];
/// Allowed coordinates of an eye, metres from the world's origin.
pub const FARTHEST_EYE_M: f64 = 1e12;

/// What stands for a field of view that is no number, radians: 60 degrees.
const USUAL_FIELD_OF_VIEW: f32 = std::f32::consts::FRAC_PI_3;
/// What stands for a tolerance that is no number, pixels.
const USUAL_SCREEN_ERROR_PX: f32 = 2.0;

/// From where, and how exactly, the terrain is looked at.
#[derive(Debug, Clone, Copy, PartialEq, Encode, Decode)]
pub struct View {
    /// Position of the eye in the world, metres.
    pub eye_m: [f64; 3],
    /// Where it looks; any length but zero.
    pub direction: [f32; 3],
    /// Velocity of the eye, metres a second.
    pub velocity_m_s: [f32; 3],
    /// Vertical field of view, radians.
    pub fov_y: f32,
    /// Width and height of the picture, pixels.
    pub viewport_px: [u32; 2],
    /// The tolerance: how far, on the screen, the mesh may be from the data, pixels.
    pub max_screen_error_px: f32,
}

/// A view that no picture can be made of.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("{field} is {found}, allowed is {allowed}")]
pub struct ViewError {
    /// The field.
    pub field: &'static str,
    /// Its value.
    pub found: String,
    /// What may stand there.
    pub allowed: String,
}

impl View {
    /// # Errors
    /// The first field that is not finite or out of its range.
    pub fn check(&self) -> Result<(), ViewError> {
        match self.errors().next() {
            Some(error) => Err(error),
            None => Ok(()),
        }
    }

    /// A view that [`check`](Self::check) allows, and what had to be changed for it. A number that
    /// is none becomes 0, or what is usual; one that is out of its range the nearest that is in it;
    /// a direction of any length but 0 one of length 1 that is the same, which needs no mention.
    pub fn clamped(&self) -> (View, Vec<ViewError>) {
        let mut view = *self;
        if let Some(direction) = unit(self.direction) {
            let usable = self.error_of_direction().is_none();
            view.direction = if usable { self.direction } else { direction };
        }
        let notes: Vec<ViewError> = view.errors().collect();
        let [least_fov, most_fov] = FIELDS_OF_VIEW;
        let [least_side, most_side] = VIEWPORT_PX;
        let [least_error, most_error] = SCREEN_ERRORS_PX;
        let direction = match view.error_of_direction() {
            Some(_) => [0.0, 1.0, 0.0],
            None => view.direction,
        };
        let view = View {
            eye_m: view.eye_m.map(|v| within(v, 0.0, FARTHEST_EYE_M)),
            direction,
            velocity_m_s: view.velocity_m_s.map(|v| match v.is_nan() {
                true => 0.0,
                false => v.clamp(f32::MIN, f32::MAX),
            }),
            fov_y: or(view.fov_y, USUAL_FIELD_OF_VIEW).clamp(least_fov, most_fov),
            viewport_px: view.viewport_px.map(|px| px.clamp(least_side, most_side)),
            max_screen_error_px: or(view.max_screen_error_px, USUAL_SCREEN_ERROR_PX)
                .clamp(least_error, most_error),
        };
        (view, notes)
    }

    /// All fields that are not finite or out of their ranges.
    fn errors(&self) -> impl Iterator<Item = ViewError> {
        let error = |field, found: String, allowed: String| ViewError {
            field,
            found,
            allowed,
        };
        let eye = self.eye_m.iter().all(|v| v.abs() <= FARTHEST_EYE_M);
        let eye = (!eye).then(|| {
            let allowed = format!("within {FARTHEST_EYE_M:e} m");
            error("eye", format!("{:?}", self.eye_m), allowed)
        });
        let velocity = self.velocity_m_s.iter().all(|v| v.is_finite());
        let velocity = (!velocity).then(|| {
            let found = format!("{:?}", self.velocity_m_s);
            error("velocity", found, "finite".into())
        });
        let [least, most] = FIELDS_OF_VIEW;
        let fov = (!(least..=most).contains(&self.fov_y)).then(|| {
            let allowed = format!("{least}..={most} radians");
            error("field of view", self.fov_y.to_string(), allowed)
        });
        let [least, most] = VIEWPORT_PX;
        let sides = self.viewport_px.iter();
        let viewport = (!sides.into_iter().all(|px| (least..=most).contains(px))).then(|| {
            let allowed = format!("{least}..={most} px a side");
            error("viewport", format!("{:?}", self.viewport_px), allowed)
        });
        let [least, most] = SCREEN_ERRORS_PX;
        let found = self.max_screen_error_px;
        let tolerance = (!(least..=most).contains(&found)).then(|| {
            let allowed = format!("{least}..={most} px");
            error("max_screen_error_px", found.to_string(), allowed)
        });
        let direction = self.error_of_direction();
        [eye, direction, velocity, fov, viewport, tolerance]
            .into_iter()
            .flatten()
    }

    fn error_of_direction(&self) -> Option<ViewError> {
        let length: f32 = self.direction.iter().map(|v| v * v).sum();
        (!length.is_normal()).then(|| ViewError {
            field: "direction",
            found: format!("{:?}", self.direction),
            allowed: "a vector with a length".into(),
        })
    }

    /// Where the eye will be, as fast as it is, metres from the world's origin.
    pub fn eye_after(&self, seconds: f64) -> [f64; 3] {
        std::array::from_fn(|axis| {
            let way_m = f64::from(self.velocity_m_s[axis]) * seconds;
            (self.eye_m[axis] + way_m).clamp(-FARTHEST_EYE_M, FARTHEST_EYE_M)
        })
    }

    /// Pixels that one metre covers at one metre's distance.
    pub fn px_per_slope(&self) -> f64 {
        f64::from(self.viewport_px[1]) / (2.0 * (f64::from(self.fov_y) / 2.0).tan())
    }

    /// Ulrich's threshold: a converged mesh is within `distance / threshold` of every sample.
    pub fn threshold(&self) -> f64 {
        self.px_per_slope() / f64::from(self.max_screen_error_px)
    }
}

/// The number, or another one in place of what is none.
const fn or(value: f32, other: f32) -> f32 {
    if value.is_nan() { other } else { value }
}

/// The nearest number that is at most this far from zero.
const fn within(value: f64, other: f64, most: f64) -> f64 {
    if value.is_nan() {
        return other;
    }
    value.clamp(-most, most)
}

/// A vector's direction, with length 1; `None` if it has none.
fn unit(v: [f32; 3]) -> Option<[f32; 3]> {
    let v = v.map(f64::from);
    let length = v.iter().map(|c| c * c).sum::<f64>().sqrt();
    let has_direction = length > 0.0 && length.is_finite();
    has_direction.then(|| v.map(|c| (c / length) as f32))
}

/// The vertex test and the box test from one eye.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tests {
    /// The eye, metres.
    pub eye_m: [f64; 3],
    /// See [`View::threshold`].
    pub threshold: f64,
}

impl Tests {
    /// The tests of a view.
    pub fn of(view: &View) -> Tests {
        Tests {
            eye_m: view.eye_m,
            threshold: view.threshold(),
        }
    }

    /// The two sides of the test of a region, metres: how far its error reaches, and how far away
    /// it is. It must be refined where it reaches farther.
    pub fn sides(&self, error_m: f64, region: &WorldBox) -> (f64, f64) {
        (error_m * self.threshold, region.distance_m(self.eye_m))
    }
}

/// A region's error in metres: its bound in quanta, and where an outline crosses it at least half
/// its square's diagonal, so that outlines, too, are within the tolerance.
pub fn error_m(error: u32, kind: Kind, quantum_m: f64, half_diagonal_m: f64) -> f64 {
    let vertical = f64::from(error) * quantum_m;
    match kind {
        Kind::Full => vertical,
        Kind::Empty => 0.0,
        Kind::Mixed => vertical.max(half_diagonal_m),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view() -> View {
        View {
            eye_m: [0.0; 3],
            direction: [0.0, 1.0, 0.0],
            velocity_m_s: [0.0; 3],
            fov_y: 1.0,
            viewport_px: [1280, 720],
            max_screen_error_px: 2.0,
        }
    }

    #[test]
    fn a_usual_view_is_allowed_and_every_broken_one_is_named() {
        assert_eq!(view().check(), Ok(()));
        let broken = |change: fn(&mut View)| {
            let mut view = view();
            change(&mut view);
            view.check().unwrap_err().field
        };
        assert_eq!(broken(|v| v.eye_m[1] = f64::NAN), "eye");
        assert_eq!(broken(|v| v.eye_m[1] = 1e300), "eye");
        assert_eq!(broken(|v| v.direction = [0.0; 3]), "direction");
        assert_eq!(broken(|v| v.direction[0] = f32::INFINITY), "direction");
        assert_eq!(broken(|v| v.velocity_m_s[2] = f32::NAN), "velocity");
        assert_eq!(broken(|v| v.fov_y = 0.0), "field of view");
        assert_eq!(broken(|v| v.viewport_px[0] = 0), "viewport");
        assert_eq!(
            broken(|v| v.max_screen_error_px = 0.0),
            "max_screen_error_px"
        );
        assert_eq!(
            broken(|v| v.max_screen_error_px = f32::NAN),
            "max_screen_error_px"
        );
    }

    const ODD: [f64; 12] = [
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        0.0,
        -0.0,
        f64::MIN_POSITIVE / 4.0,
        -1e-310,
        f64::MAX,
        f64::MIN,
        1.0,
        -1e12,
        1e30,
    ];
    const ODD_F32: [f32; 12] = [
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        0.0,
        -0.0,
        f32::MIN_POSITIVE / 4.0,
        -1e-40,
        f32::MAX,
        f32::MIN,
        1.0,
        -1e20,
        1e-30,
    ];

    /// A clamped view is allowed, its notes are the fields that were not, and it is the same if
    /// there were none.
    fn hold_clamped(view: View) {
        let (clamped, notes) = view.clamped();
        assert_eq!(clamped.check(), Ok(()), "{view:?}");
        let finite = clamped.threshold().is_finite() && clamped.threshold() > 0.0;
        assert!(finite, "{view:?}");
        match (view.check(), notes.first()) {
            (Ok(()), None) => assert_eq!(clamped, view),
            // Too long or too short for single precision, but a direction.
            (Err(error), _) if error.field == "direction" && unit(view.direction).is_some() => {
                let length: f32 = clamped.direction.iter().map(|v| v * v).sum();
                assert!((length - 1.0).abs() < 1e-5, "{view:?}");
            }
            (Err(error), Some(note)) => assert_eq!(error.field, note.field),
            (check, note) => panic!("{view:?}: {check:?}, {note:?}"),
        }
    }

    #[test]
    fn any_view_is_clamped_to_an_allowed_one_that_says_what_was_changed() {
        hold_clamped(view());
        for (odd, odd_f32) in ODD.into_iter().zip(ODD_F32) {
            for axis in 0..3 {
                let mut changed = view();
                changed.eye_m[axis] = odd;
                hold_clamped(changed);
                let mut changed = view();
                changed.direction[axis] = odd_f32;
                hold_clamped(changed);
                hold_clamped(View {
                    direction: [odd_f32; 3],
                    ..view()
                });
                let mut changed = view();
                changed.velocity_m_s[axis] = odd_f32;
                hold_clamped(changed);
            }
            hold_clamped(View {
                fov_y: odd_f32,
                ..view()
            });
            hold_clamped(View {
                max_screen_error_px: odd_f32,
                ..view()
            });
        }
        for px in [0, 1, 32_768, 32_769, u32::MAX] {
            for viewport_px in [[px, 720], [1280, px], [px, px]] {
                hold_clamped(View {
                    viewport_px,
                    ..view()
                });
            }
        }
    }

    #[test]
    fn all_that_is_wrong_with_a_view_is_named_at_once() {
        let broken = View {
            eye_m: [f64::NAN, 1e13, 5.0],
            direction: [0.0; 3],
            velocity_m_s: [f32::NAN, 1.0, f32::INFINITY],
            fov_y: f32::NAN,
            viewport_px: [0, u32::MAX],
            max_screen_error_px: f32::NEG_INFINITY,
        };
        let (clamped, notes) = broken.clamped();
        let fields: Vec<_> = notes.iter().map(|note| note.field).collect();
        assert_eq!(
            fields,
            [
                "eye",
                "direction",
                "velocity",
                "field of view",
                "viewport",
                "max_screen_error_px"
            ]
        );
        assert_eq!(clamped.eye_m, [0.0, FARTHEST_EYE_M, 5.0]);
        assert_eq!(clamped.velocity_m_s, [0.0, 1.0, f32::MAX]);
        assert_eq!(clamped.viewport_px, VIEWPORT_PX);
        assert_eq!(clamped.max_screen_error_px, SCREEN_ERRORS_PX[0]);
    }

    #[test]
    fn the_threshold_turns_metres_at_a_distance_into_pixels() {
        let view = view();
        let metres_a_px_at_1_km = 1000.0 / view.px_per_slope();
        let promised = 1000.0 / view.threshold();
        assert!((promised / metres_a_px_at_1_km - 2.0).abs() < 1e-6);
    }
}
