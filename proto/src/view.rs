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
        let error = |field, found: String, allowed: String| {
            Err(ViewError {
                field,
                found,
                allowed,
            })
        };
        if !self.eye_m.iter().all(|v| v.abs() <= FARTHEST_EYE_M) {
            let allowed = format!("within {FARTHEST_EYE_M:e} m");
            return error("eye", format!("{:?}", self.eye_m), allowed);
        }
        let length: f32 = self.direction.iter().map(|v| v * v).sum();
        if !length.is_normal() {
            return error(
                "direction",
                format!("{:?}", self.direction),
                "a vector with a length".into(),
            );
        }
        if !self.velocity_m_s.iter().all(|v| v.is_finite()) {
            return error(
                "velocity",
                format!("{:?}", self.velocity_m_s),
                "finite".into(),
            );
        }
        let [least, most] = FIELDS_OF_VIEW;
        if !(least..=most).contains(&self.fov_y) {
            let allowed = format!("{least}..={most} radians");
            return error("field of view", self.fov_y.to_string(), allowed);
        }
        let [least, most] = VIEWPORT_PX;
        if !self
            .viewport_px
            .iter()
            .all(|px| (least..=most).contains(px))
        {
            let allowed = format!("{least}..={most} px a side");
            return error("viewport", format!("{:?}", self.viewport_px), allowed);
        }
        let [least, most] = SCREEN_ERRORS_PX;
        if !(least..=most).contains(&self.max_screen_error_px) {
            let allowed = format!("{least}..={most} px");
            return error(
                "max_screen_error_px",
                self.max_screen_error_px.to_string(),
                allowed,
            );
        }
        Ok(())
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

    #[test]
    fn the_threshold_turns_metres_at_a_distance_into_pixels() {
        let view = view();
        let metres_a_px_at_1_km = 1000.0 / view.px_per_slope();
        let promised = 1000.0 / view.threshold();
        assert!((promised / metres_a_px_at_1_km - 2.0).abs() < 1e-6);
    }
}
