//! From a source's CRS to the world's plane, and from its rows to the grid's.

use crate::crs::{Projection, longitude};
use crate::dem::{Crs, DemInfo, Placement};
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
    let middle = place.x0 + span(place.dx, info.width) / 2.0;
    let middle_latitude_deg = south + span(place.dy, info.height) / 2.0;
    let metres_a_degree = radius_m.to_radians();
    let east = metres_a_degree * middle_latitude_deg.to_radians().cos();
    let origin = [
        (place.x0 - middle) * east,
        (south - middle_latitude_deg) * metres_a_degree,
    ];
    let plane = Plane::Geographic {
        crs: crs.to_owned(),
        radius_m,
        middle_longitude_deg: longitude::wrapped(middle),
        middle_latitude_deg,
    };
    (origin, [place.dx * east, place.dy * metres_a_degree], plane)
}

/// Places along each side at which the scale is looked at.
const SCALE_PLACES: u32 = 17;

/// Largest error of horizontal distances in the world's plane over a source's extent, east or
/// north, in per cent of the distance on the body's ellipsoid. `None` where the CRS cannot be
/// transformed. A pole has no east: it counts from a thousandth of a degree.
pub fn scale_error_percent(info: &DemInfo) -> Option<f64> {
    let projection = Projection::of(&info.crs).ok()?;
    let mut largest: f64 = 0.0;
    for row in 0..SCALE_PLACES {
        for column in 0..SCALE_PLACES {
            let part = |n: u32, side: u32| {
                f64::from(n) / f64::from(SCALE_PLACES - 1) * f64::from(side - 1)
            };
            let Placement { x0, y0, dx, dy } = info.placement;
            let place = [
                x0 + part(column, info.width) * dx,
                y0 - part(row, info.height) * dy,
            ];
            for scale in scales(info, &projection, place).into_iter().flatten() {
                largest = largest.max((scale - 1.0).abs());
            }
        }
    }
    Some(largest * 100.0)
}

/// Metres in the plane for each metre on the ground, eastwards and northwards in the plane.
fn scales(info: &DemInfo, projection: &Projection, [x, y]: [f64; 2]) -> Option<[f64; 2]> {
    if let Crs::Geographic { radius_m, .. } = &info.crs {
        let placement = &info.placement;
        let middle = placement.y0 - f64::from(info.height - 1) / 2.0 * placement.dy;
        let metres = projection.metres_a_degree(y.clamp(-89.999, 89.999));
        let plane = radius_m.to_radians();
        return Some([
            plane * middle.to_radians().cos() / metres[0],
            plane / metres[1],
        ]);
    }
    let Crs::Projected {
        metres_per_unit, ..
    } = &info.crs
    else {
        return None;
    };
    // Central differences over some hundred metres: exact to a millionth.
    let step = 100.0 / metres_per_unit;
    let scale = |dx: f64, dy: f64| {
        let a = projection.to_degrees(x - dx, y - dy)?;
        let b = projection.to_degrees(x + dx, y + dy)?;
        let metres = projection.metres_a_degree(f64::midpoint(a[1], b[1]));
        let east = longitude::wrapped(b[0] - a[0]) * metres[0];
        let ground = east.hypot((b[1] - a[1]) * metres[1]);
        Some(200.0 / ground)
    };
    Some([scale(step, 0.0)?, scale(0.0, step)?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crs;
    use crate::dem::{Registration, SampleType};

    fn info(crs: Crs, [x0, y0]: [f64; 2], step: f64, side: u32) -> DemInfo {
        DemInfo {
            path: "grid".into(),
            format: "grid",
            width: side,
            height: side,
            placement: Placement {
                x0,
                y0,
                dx: step,
                dy: step,
            },
            crs,
            registration: Registration::Grid,
            sample_type: SampleType::I16,
            height_step_m: 1.0,
            nodata: None,
            vertical: None,
        }
    }

    #[test]
    fn a_spheres_plane_is_wrong_by_the_cosines_of_its_border_and_its_middle() {
        let moon = crs::from_proj("+proj=longlat +R=1737400").unwrap();
        let percent = scale_error_percent(&info(moon, [0.0, 60.0], 0.2, 101)).unwrap();
        let expected = 50f64.to_radians().cos() / 60f64.to_radians().cos() - 1.0;
        assert!((percent - 100.0 * expected).abs() < 1e-9, "{percent}");
    }

    #[test]
    fn a_projections_scale_is_found_by_differences() {
        // In the middle of a UTM zone it is 0.9996.
        let utm = crs::from_epsg(32645).unwrap();
        let percent = scale_error_percent(&info(utm, [499_000.0, 3e6], 20.0, 101)).unwrap();
        assert!((percent - 0.04).abs() < 1e-4, "{percent}");
        // Mercator's is 1 / cos, here at 60 degrees and on an ellipsoid.
        let web = crs::from_epsg(3857).unwrap();
        let percent = scale_error_percent(&info(web, [0.0, 8_399_738.0], 1.0, 3)).unwrap();
        assert!((99.0..101.0).contains(&percent), "{percent}");
    }

    #[test]
    fn longitudes_of_another_turn_make_the_same_world() {
        let wgs84 = || crs::from_epsg(4326).unwrap();
        let [a, b] = [200.0, -160.0].map(|west| info(wgs84(), [west, 10.0], 0.1, 11));
        assert_eq!(georef_of(&a, 1.0), georef_of(&b, 1.0));
    }
}
