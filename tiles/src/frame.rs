//! From a source's CRS to the world's plane, and from its rows to the grid's.

use crate::dem::{Crs, DemInfo};
use escarp_proto::georef::{Georef, Plane};

/// Lays a source out in the world. Grid row 0 is the source's southern row.
///
/// Geographic data goes on a plane in metres at its middle latitude, on its body's radius.
pub fn georef_of(info: &DemInfo, quantum_m: f64) -> Georef {
    let place = &info.placement;
    let south = place.y0 - f64::from(info.height - 1) * place.dy;
    let (origin_m, sample_spacing_m, plane) = match &info.crs {
        Crs::Projected {
            name,
            metres_per_unit,
        } => (
            [place.x0 * metres_per_unit, south * metres_per_unit],
            [place.dx * metres_per_unit, place.dy * metres_per_unit],
            Plane::Projected {
                crs: name.clone(),
                metres_per_unit: *metres_per_unit,
            },
        ),
        Crs::Geographic { name, radius_m } => geographic(info, name, *radius_m, south),
        Crs::Local => ([0.0, 0.0], [place.dx, place.dy], Plane::Local),
    };
    Georef {
        origin_m,
        sample_spacing_m,
        quantum_m,
        plane,
    }
}

fn geographic(info: &DemInfo, crs: &str, radius_m: f64, south: f64) -> ([f64; 2], [f64; 2], Plane) {
    let place = &info.placement;
    let span = |step: f64, samples: u32| step * f64::from(samples - 1);
    let middle_longitude_deg = place.x0 + span(place.dx, info.width) / 2.0;
    let middle_latitude_deg = south + span(place.dy, info.height) / 2.0;
    let metres_a_degree = radius_m.to_radians();
    let east = metres_a_degree * middle_latitude_deg.to_radians().cos();
    let origin = [
        (place.x0 - middle_longitude_deg) * east,
        (south - middle_latitude_deg) * metres_a_degree,
    ];
    let plane = Plane::Geographic {
        crs: crs.to_owned(),
        radius_m,
        middle_longitude_deg,
        middle_latitude_deg,
    };
    (origin, [place.dx * east, place.dy * metres_a_degree], plane)
}
