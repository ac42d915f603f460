//! Where a dataset lies: its world's plane as a CRS, its corners in degrees, and which CRS would
//! suit it better.

use super::longitude::wrapped;
use super::{Projection, epsg_definition};
use crate::dem::{Crs, Placement};
use escarp_proto::georef::Plane;
use escarp_proto::manifest::Manifest;
use serde::Serialize;

/// Longitude and latitude of a dataset's samples, degrees, longitudes in -180..180.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Extent {
    /// South-west corner.
    pub south_west: [f64; 2],
    /// South-east corner.
    pub south_east: [f64; 2],
    /// North-west corner.
    pub north_west: [f64; 2],
    /// North-east corner.
    pub north_east: [f64; 2],
    /// Middle.
    pub centre: [f64; 2],
}

/// The CRS of a dataset's world.
pub fn crs_of(plane: &Plane) -> Crs {
    match plane {
        Plane::Projected {
            crs,
            metres_per_unit,
        } => Crs::Projected {
            name: crs.clone(),
            metres_per_unit: *metres_per_unit,
        },
        Plane::Geographic { crs, radius_m, .. } => Crs::Geographic {
            name: crs.clone(),
            radius_m: *radius_m,
        },
        Plane::Local => Crs::Local,
    }
}

/// Where a dataset's samples lie in the CRS of its sources.
pub fn placement_of(manifest: &Manifest) -> Placement {
    let georef = &manifest.georef;
    let last_row = manifest.samples[1] - 1;
    let (unit, origin) = match &georef.plane {
        Plane::Projected {
            metres_per_unit, ..
        } => ([1.0 / metres_per_unit; 2], [0.0; 2]),
        Plane::Geographic {
            radius_m,
            middle_longitude_deg,
            middle_latitude_deg,
            ..
        } => {
            let north = radius_m.to_radians();
            let east = north * middle_latitude_deg.to_radians().cos();
            (
                [1.0 / east, 1.0 / north],
                [*middle_longitude_deg, *middle_latitude_deg],
            )
        }
        Plane::Local => ([1.0; 2], [0.0; 2]),
    };
    Placement {
        x0: origin[0] + georef.origin_m[0] * unit[0],
        y0: origin[1] + georef.world_y(last_row) * unit[1],
        dx: georef.sample_spacing_m[0] * unit[0],
        dy: georef.sample_spacing_m[1] * unit[1],
    }
}

/// A dataset's corners and middle in degrees; `None` where its CRS cannot be transformed.
pub fn of(manifest: &Manifest) -> Option<Extent> {
    let crs = crs_of(&manifest.georef.plane);
    let projection = Projection::of(&crs).ok()?;
    let place = placement_of(manifest);
    let [east, south] = manifest.samples.map(|n| f64::from(n - 1));
    let at = |c: f64, r: f64| {
        let (x, y) = (place.x0 + c * place.dx, place.y0 - r * place.dy);
        let [longitude, latitude] = match crs {
            // As it is, without a way to radians and back.
            Crs::Geographic { .. } => [x, y],
            _ => projection.to_degrees(x, y)?,
        };
        Some([wrapped(longitude), latitude])
    };
    Some(Extent {
        south_west: at(0.0, south)?,
        south_east: at(east, south)?,
        north_west: at(0.0, 0.0)?,
        north_east: at(east, 0.0)?,
        centre: at(east / 2.0, south / 2.0)?,
    })
}

/// Wider than this, metres, and a UTM zone is no better than what there is.
const UTM_WIDTH_M: f64 = 1e6;

/// A CRS in which a dataset would be nearly true to scale, as `--crs` takes it; `None` for one that
/// covers so much of its body that no plane is.
pub fn suggestion(manifest: &Manifest) -> Option<String> {
    let plane = &manifest.georef.plane;
    let crs = crs_of(plane);
    let [longitude, latitude] = of(manifest)?.centre;
    let [a, b] = Projection::of(&crs).ok()?.axes_m();
    let [x, y, _] = manifest.extent_m().map(|[from, to]| to - from);
    // Seen from the middle of a stereographic plane, 0.6 radii away are 10 %.
    if x.hypot(y) > 1.2 * a {
        return None;
    }
    let zone = ((longitude + 180.0) / 6.0).floor() as u16 + 1;
    let code = match latitude {
        lat if lat.abs() > 80.0 || x > UTM_WIDTH_M => None,
        lat if lat >= 0.0 => Some(32600 + zone.min(60)),
        _ => Some(32700 + zone.min(60)),
    };
    let earth = (a - 6_378_137.0).abs() < 2000.0 && a != b;
    let name = match code.filter(|code| earth && epsg_definition(*code).is_some()) {
        Some(code) => format!("EPSG:{code}"),
        None => {
            let (longitude, latitude) = (longitude.round(), latitude.round());
            format!("+proj=stere +lat_0={latitude} +lon_0={longitude} +a={a} +b={b}")
        }
    };
    (name != crs.name()).then_some(name)
}
