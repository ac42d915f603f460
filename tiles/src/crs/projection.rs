//! From plane coordinates to longitude and latitude and back, by `proj4rs`.
//!
//! Heights take no part: they are never transformed. Where the two datums differ, the horizontal
//! shift is that of seven parameters at most; shift grids are not read, and a datum that only a
//! grid ties to WGS 84 is taken to coincide with it. That differs from PROJ with its grids by
//! millimetres to metres (North America 1927: up to some hundred).

use super::{Crs, definition, has_flag, parameter, without};
use proj4rs::Proj;

const WGS84_AXES_M: [f64; 2] = [6_378_137.0, 6_356_752.314_245_179];

/// A CRS that can be transformed.
#[derive(Clone)]
pub struct Projection {
    proj: Proj,
    /// Longitude and latitude on the same datum.
    geographic: Proj,
    /// Metres a unit of the coordinates; `None` for degrees.
    metres_per_unit: Option<f64>,
    /// Semi-major and semi-minor axis, metres.
    axes_m: [f64; 2],
}

/// A PROJ string as `proj4rs` reads it.
///
/// # Errors
/// A sentence, for a projection that is not known, has no inverse, or points elsewhere than east
/// and north.
pub(super) fn checked(definition: &str) -> Result<Proj, String> {
    if parameter(definition, "axis").is_some_and(|axis| axis != "enu") {
        return Err(format!("{definition:?} has axes other than east and north"));
    }
    // Grids are files of another installation: a grid that is not there shifts nothing.
    let plain = without(definition, &["nadgrids", "geoidgrids", "title", "type"]);
    let mut proj = Proj::from_proj_string(&plain);
    if proj.is_err() && parameter(&plain, "datum") == Some("NAD27") {
        proj = Proj::from_proj_string(&format!("{} +ellps=clrk66", without(&plain, &["datum"])));
    }
    let proj = proj.map_err(|why| format!("{plain:?} is not understood: {why}"))?;
    if proj.is_geocent() {
        return Err(format!("{plain:?} is geocentric: it has no plane"));
    }
    if !proj.has_inverse() || !proj.has_forward() {
        return Err(format!("{plain:?} has no way back from the plane"));
    }
    Ok(proj)
}

impl Projection {
    /// What transforms a CRS.
    ///
    /// # Errors
    /// A sentence, for a CRS without a definition, or one that `proj4rs` does not know.
    pub fn of(crs: &Crs) -> Result<Projection, String> {
        let definition = definition(crs)?;
        let metres_per_unit = match crs {
            Crs::Projected {
                metres_per_unit, ..
            } => Some(*metres_per_unit),
            _ => None,
        };
        // The unit is the file's word, so that a file which differs from its code is right.
        let proj = checked(&without(&definition, &["units", "to_meter"]))?;
        if proj.is_latlong() != metres_per_unit.is_none() {
            return Err(format!("{definition:?} does not fit coordinates of {crs}"));
        }
        // The web's Mercator has a sphere's formulas, but coordinates of the ellipsoid.
        let axes_m = match parameter(&definition, "nadgrids") {
            Some("@null") => WGS84_AXES_M,
            _ => proj.ellipse_parameters().into(),
        };
        let datum = ["datum", "ellps", "R", "a", "b", "rf", "towgs84"];
        let same: Vec<String> = datum
            .iter()
            .filter_map(|name| Some(format!("+{name}={}", parameter(&definition, name)?)))
            .collect();
        let geographic = checked(&format!("+proj=longlat {} +no_defs", same.join(" ")))?;
        Ok(Projection {
            proj,
            geographic,
            metres_per_unit,
            axes_m,
        })
    }

    /// Longitude and latitude in degrees, on the CRS's own datum and from Greenwich. `None` where
    /// the plane has none.
    pub fn to_degrees(&self, x: f64, y: f64) -> Option<[f64; 2]> {
        self.to(&self.geographic, None, [x, y])
    }

    /// Plane coordinates of longitude and latitude in degrees, as [`to_degrees`](Self::to_degrees)
    /// gives them.
    pub fn from_degrees(&self, longitude: f64, latitude: f64) -> Option<[f64; 2]> {
        let mut point = (longitude.to_radians(), latitude.to_radians(), 0.0);
        proj4rs::transform::transform(&self.geographic, &self.proj, &mut point).ok()?;
        finished(point, self.metres_per_unit)
    }

    /// Coordinates in another CRS, across datums. `None` where there are none.
    pub fn transform(&self, other: &Projection, point: [f64; 2]) -> Option<[f64; 2]> {
        self.to(&other.proj, other.metres_per_unit, point)
    }

    fn to(&self, proj: &Proj, metres_per_unit: Option<f64>, [x, y]: [f64; 2]) -> Option<[f64; 2]> {
        let mut point = match self.metres_per_unit {
            Some(metres) => (x * metres, y * metres, 0.0),
            None => (x.to_radians(), y.to_radians(), 0.0),
        };
        proj4rs::transform::transform(&self.proj, proj, &mut point).ok()?;
        finished(point, metres_per_unit)
    }

    /// Semi-major and semi-minor axis of the body, metres.
    pub fn axes_m(&self) -> [f64; 2] {
        self.axes_m
    }

    /// Whether coordinates are degrees.
    pub fn is_geographic(&self) -> bool {
        self.metres_per_unit.is_none()
    }

    /// Whether both lie on bodies of about the same size.
    pub fn is_on_the_body_of(&self, other: &Projection) -> bool {
        let (a, b) = (self.axes_m[0], other.axes_m[0]);
        (a - b).abs() < 0.005 * a.max(b)
    }

    /// Metres on the ground for a step in degrees of longitude and one of latitude, at a latitude.
    pub fn metres_a_degree(&self, latitude: f64) -> [f64; 2] {
        let [a, b] = self.axes_m;
        let e2 = 1.0 - (b / a) * (b / a);
        let (sin, cos) = latitude.to_radians().sin_cos();
        let w2 = 1.0 - e2 * sin * sin;
        let prime_vertical = a / w2.sqrt();
        let meridian = a * (1.0 - e2) / (w2 * w2.sqrt());
        [(prime_vertical * cos).to_radians(), meridian.to_radians()]
    }
}

fn finished((x, y, _): (f64, f64, f64), metres_per_unit: Option<f64>) -> Option<[f64; 2]> {
    let point = match metres_per_unit {
        Some(metres) => [x / metres, y / metres],
        None => [x.to_degrees(), y.to_degrees()],
    };
    point.iter().all(|v| v.is_finite()).then_some(point)
}

/// Whether a definition ties its datum to WGS 84 by a grid that is not read here.
pub fn needs_grid(definition: &str) -> bool {
    parameter(definition, "nadgrids").is_some_and(|grids| grids != "@null")
        || parameter(definition, "datum") == Some("NAD27")
        || has_flag(definition, "nadgrids")
}
