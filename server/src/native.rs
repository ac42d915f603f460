//! From world positions back to the coordinates of a dataset's own reference system, for people
//! and other programs. Inverse of what `escarp_proto::georef` describes.

use escarp_proto::georef::{Georef, Plane};
use escarp_proto::manifest::Manifest;
use serde::Serialize;

/// The outline of a dataset in its own coordinates.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NativeCorners {
    /// The reference system as the source names it; absent if there is none.
    pub crs: Option<String>,
    /// Unit of the coordinates: `degree`, `metre`, or metres a unit.
    pub unit: String,
    /// The outermost samples' `[x, y]`, or `[longitude, latitude]`: south-west, south-east,
    /// north-east, north-west.
    pub corners: [[f64; 2]; 4],
}

/// The four outermost samples of a dataset in its own coordinates.
pub fn native_corners(manifest: &Manifest) -> NativeCorners {
    let georef = &manifest.georef;
    let [[west, east], [south, north], _] = manifest.extent_m();
    let world = [[west, south], [east, south], [east, north], [west, north]];
    let (crs, unit) = match &georef.plane {
        Plane::Projected {
            crs,
            metres_per_unit,
        } if *metres_per_unit == 1.0 => (Some(crs.clone()), "metre".into()),
        Plane::Projected {
            crs,
            metres_per_unit,
        } => (Some(crs.clone()), format!("{metres_per_unit} metres")),
        Plane::Geographic { crs, .. } => (Some(crs.clone()), "degree".into()),
        Plane::Local => (None, "metre".into()),
    };
    NativeCorners {
        crs,
        unit,
        corners: world.map(|position| native(georef, position)),
    }
}

/// Native coordinates of a world position.
pub fn native(georef: &Georef, [x, y]: [f64; 2]) -> [f64; 2] {
    match &georef.plane {
        Plane::Projected {
            metres_per_unit, ..
        } => [x / metres_per_unit, y / metres_per_unit],
        Plane::Geographic {
            radius_m,
            middle_longitude_deg,
            middle_latitude_deg,
            ..
        } => {
            let parallel_m = radius_m * middle_latitude_deg.to_radians().cos();
            [
                middle_longitude_deg + (x / parallel_m).to_degrees(),
                middle_latitude_deg + (y / radius_m).to_degrees(),
            ]
        }
        Plane::Local => [x, y],
    }
}

/// World position of native coordinates, metres: the inverse of [`native`].
pub fn world(georef: &Georef, [x, y]: [f64; 2]) -> [f64; 2] {
    match &georef.plane {
        Plane::Projected {
            metres_per_unit, ..
        } => [x * metres_per_unit, y * metres_per_unit],
        Plane::Geographic {
            radius_m,
            middle_longitude_deg,
            middle_latitude_deg,
            ..
        } => {
            let parallel_m = radius_m * middle_latitude_deg.to_radians().cos();
            [
                parallel_m * (x - middle_longitude_deg).to_radians(),
                radius_m * (y - middle_latitude_deg).to_radians(),
            ]
        }
        Plane::Local => [x, y],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn georef(plane: Plane) -> Georef {
        Georef {
            origin_m: [0.0; 2],
            sample_spacing_m: [1.0; 2],
            quantum_m: 1.0,
            plane,
        }
    }

    #[test]
    fn a_degree_north_and_east_of_the_middle_comes_back() {
        let radius_m = 1_737_400.0;
        let plane = Plane::Geographic {
            crs: "IAU_2015:30100".into(),
            radius_m,
            middle_longitude_deg: 10.0,
            middle_latitude_deg: 60.0,
        };
        let degree_m = radius_m * 1f64.to_radians();
        let [longitude, latitude] = native(&georef(plane), [degree_m / 2.0, degree_m]);
        assert!((longitude - 11.0).abs() < 1e-12);
        assert!((latitude - 61.0).abs() < 1e-12);
    }

    #[test]
    fn the_world_of_native_coordinates_is_where_they_came_from() {
        let geographic = Plane::Geographic {
            crs: "EPSG:4326".into(),
            radius_m: 6_378_137.0,
            middle_longitude_deg: 86.5,
            middle_latitude_deg: 27.5,
        };
        let feet = Plane::Projected {
            crs: "EPSG:2230".into(),
            metres_per_unit: 0.3048,
        };
        for plane in [geographic, feet, Plane::Local] {
            let georef = georef(plane);
            let [x, y] = world(&georef, native(&georef, [-1234.5, 67_890.1]));
            assert!((x + 1234.5).abs() < 1e-6 && (y - 67_890.1).abs() < 1e-6);
        }
    }

    #[test]
    fn feet_are_feet() {
        let plane = Plane::Projected {
            crs: "EPSG:2230".into(),
            metres_per_unit: 0.3048,
        };
        let [x, y] = native(&georef(plane), [304.8, 0.3048]);
        assert!((x - 1000.0).abs() < 1e-9 && (y - 1.0).abs() < 1e-12);
    }
}
