//! How far a height may be from the source's, by what the manifest states.

use super::HeightError;
use escarp_proto::manifest::Manifest;
use serde::Serialize;

/// What every height of a dataset may be off by, whatever the level.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Accuracy {
    /// Largest difference of a stored sample from its source, by quantum and tolerance, metres.
    pub storage_m: f64,
    /// Largest difference of a source sample from the surface of the grid, metres; absent if the
    /// source's samples are the grid's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub resampling_m: Option<f64>,
    /// How far from its place a height may have been taken by the resampling, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub horizontal_m: Option<f64>,
    /// Largest error of distances in the world's plane, in per cent of those on the ground; absent
    /// where the CRS cannot be transformed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale_percent: Option<f64>,
}

impl Accuracy {
    /// As a manifest states it.
    pub fn of(manifest: &Manifest) -> Accuracy {
        let resampling = manifest.resampling.as_ref();
        Accuracy {
            storage_m: manifest.storage_error_m,
            resampling_m: resampling.map(|done| done.largest_difference_m),
            horizontal_m: resampling.map(|done| done.horizontal_error_m),
            scale_percent: manifest.scale_error_percent,
        }
    }

    /// Bound of the vertical error of the finest surface, metres, rounded up.
    pub fn finest_m(&self) -> f64 {
        sum_up(self.storage_m, self.resampling_m.unwrap_or(0.0))
    }
}

/// `a + b`, rounded up.
pub(super) fn sum_up(a: f64, b: f64) -> f64 {
    if a == 0.0 || b == 0.0 {
        return a + b;
    }
    (a + b).next_up()
}

/// Quanta in metres, rounded up.
pub(super) fn metres_up(quanta: f64, quantum_m: f64) -> f64 {
    let metres = quanta * quantum_m;
    if metres > 0.0 { metres.next_up() } else { 0.0 }
}

/// How fine a height has to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Detail {
    /// That of the finest surface.
    Finest,
    /// Its bound may be this many metres, of which storage and resampling take their part.
    ErrorM(f64),
    /// Samples may be so many metres apart.
    ResolutionM(f64),
}

impl Detail {
    /// At most one of the two may be given.
    ///
    /// # Errors
    /// [`HeightError::Usage`] if both are, or one is no length.
    pub fn from(error_m: Option<f64>, resolution_m: Option<f64>) -> Result<Detail, HeightError> {
        let length = |name: &str, metres: f64| match metres.is_finite() && metres >= 0.0 {
            true => Ok(metres),
            false => Err(HeightError::usage(
                format!("{name}={metres}"),
                "0 or more metres",
            )),
        };
        Ok(match (error_m, resolution_m) {
            (None, None) => Detail::Finest,
            (Some(metres), None) => Detail::ErrorM(length("error", metres)?),
            (None, Some(metres)) => Detail::ResolutionM(length("resolution", metres)?),
            (Some(_), Some(_)) => {
                let found = "both error= and resolution=";
                return Err(HeightError::usage(found, "one of the two"));
            }
        })
    }

    /// Whether a cell of so many grid cells a side, within `bound` quanta of the surface, will do.
    pub(super) fn allows(self, bound: u32, stride: u32, manifest: &Manifest) -> bool {
        let georef = &manifest.georef;
        match self {
            Detail::Finest => false,
            Detail::ErrorM(most) => {
                let level_m = metres_up(f64::from(bound), georef.quantum_m);
                sum_up(level_m, Accuracy::of(manifest).finest_m()) <= most
            }
            Detail::ResolutionM(most) => {
                let [dx, dy] = georef.sample_spacing_m;
                f64::from(stride) * dx.max(dy) <= most
            }
        }
    }
}
