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

/// A CRS in which a place on Earth, or on a sphere, is nearly true to scale, as `--crs` takes it.
pub fn suggestion(plane: &Plane, [longitude, latitude]: [f64; 2]) -> Option<String> {
    let crs = crs_of(plane);
    let [a, b] = Projection::of(&crs).ok()?.axes_m();
    let earth = (a - 6_378_137.0).abs() < 2000.0 && a != b;
    let zone = ((longitude + 180.0) / 6.0).floor() as u16 + 1;
    let code = match latitude {
        lat if lat >= 75.0 => 3995,
        lat if lat <= -65.0 => 3031,
        lat if lat >= 0.0 => 32600 + zone.min(60),
        _ => 32700 + zone.min(60),
    };
    if earth && epsg_definition(code).is_some() {
        return Some(format!("EPSG:{code}"));
    }
    let size = if a == b {
        format!("+R={a}")
    } else {
        format!("+a={a} +b={b}")
    };
    let (longitude, latitude) = (longitude.round(), latitude.round());
    Some(format!(
        "+proj=stere +lat_0={latitude} +lon_0={longitude} {size}"
    ))
}
