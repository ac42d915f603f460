//! Regions against a look at every place.

use super::polygon::Polygons;
use super::tolerance::Marks;
use crate::dem::{Crs, DemInfo, Placement, Registration, SampleType};
use proptest::prelude::*;
use std::path::{Path, PathBuf};

const SIDE: u32 = 24;

/// A source of 24 x 24 samples; column 0 is at 100 east, row 0 at 523 north.
fn info() -> DemInfo {
    DemInfo {
        path: PathBuf::from("a.tif"),
        format: "test",
        width: SIDE,
        height: SIDE,
        placement: Placement {
            x0: 100.0,
            y0: 523.0,
            dx: 1.0,
            dy: 1.0,
        },
        crs: Crs::Projected {
            name: "EPSG:32632".into(),
            metres_per_unit: 1.0,
        },
        registration: Registration::Grid,
        sample_type: SampleType::I16,
        height_step_m: 1.0,
        nodata: None,
        vertical: None,
    }
}

fn parse(json: &str) -> Result<Polygons, String> {
    Polygons::parse(json.as_bytes(), Path::new("r.geojson"), &info()).map_err(|e| e.to_string())
}

/// Touched and core samples of all rows.
fn marks(polygons: &Polygons) -> (Vec<bool>, Vec<bool>) {
    let samples = (SIDE * SIDE) as usize;
    let (mut touched, mut core) = (vec![false; samples], vec![false; samples]);
    let marks = Marks {
        touched: &mut touched,
        core: &mut core,
    };
    polygons.mark(0, SIDE, marks);
    (touched, core)
}

/// Whether a place, in columns and rows, lies in a triangle.
fn inside(triangle: &[[f64; 2]; 3], p: [f64; 2]) -> bool {
    let side = |i: usize| {
        let (a, b) = (triangle[i], triangle[(i + 1) % 3]);
        (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
    };
    let sides = [side(0), side(1), side(2)];
    sides.iter().all(|s| *s > 0.0) || sides.iter().all(|s| *s < 0.0)
}

fn geojson(triangles: &[[[f64; 2]; 3]]) -> String {
    let ring = |t: &[[f64; 2]; 3]| {
        let at = |i: usize| format!("[{},{}]", 100.0 + t[i][0], 523.0 - t[i][1]);
        format!("[[{},{},{},{}]]", at(0), at(1), at(2), at(0))
    };
    let rings: Vec<String> = triangles.iter().map(ring).collect();
    let coordinates = rings.join(",");
    format!(
        r#"{{"type":"Feature","properties":{{"a":1}},"geometry":{{"type":"MultiPolygon","coordinates":[{coordinates}]}}}}"#
    )
}

proptest! {
    #[test]
    fn every_cell_that_a_polygon_touches_has_its_four_corners_in_the_region(
        triangles in prop::collection::vec(prop::array::uniform3(prop::array::uniform2(-4.0..28.0f64)), 1..4),
    ) {
        let Ok(polygons) = parse(&geojson(&triangles)) else { return Ok(()) };
        let (touched, core) = marks(&polygons);
        // Places inside each cell, looked at one by one.
        for row in 0..SIDE - 1 {
            for column in 0..SIDE - 1 {
                let places = (0..64).map(|i| {
                    [f64::from(column) + f64::from(i % 8) / 7.0, f64::from(row) + f64::from(i / 8) / 7.0]
                });
                let held: Vec<bool> = places.map(|p| triangles.iter().any(|t| inside(t, p))).collect();
                for corner in [0, 1, SIDE, SIDE + 1] {
                    let at = (row * SIDE + column + corner) as usize;
                    if held.contains(&true) {
                        prop_assert!(touched[at], "column {column}, row {row}");
                    }
                    if core[at] {
                        // Its cells are wholly inside; a place on a side may be judged either way.
                        let within = held.iter().filter(|h| !**h).count();
                        prop_assert!(within == 0, "column {column}, row {row}: {within} outside");
                    }
                }
            }
        }
    }
}

#[test]
fn a_road_narrower_than_a_cell_marks_the_cells_that_it_runs_through() {
    let road = r#"{"type":"FeatureCollection","features":[{"type":"Feature","properties":null,
        "geometry":{"type":"Polygon","coordinates":
        [[[99,510.4],[130,510.4],[130,510.5],[99,510.5],[99,510.4]]]}}]}"#;
    let (touched, core) = marks(&parse(road).unwrap());
    for (at, touched) in touched.iter().enumerate() {
        let row = at as u32 / SIDE;
        assert_eq!(*touched, row == 12 || row == 13, "row {row}");
    }
    assert!(!core.contains(&true));
}

#[test]
fn a_hole_in_a_polygon_is_outside() {
    let ring = |low: f64, high: f64| {
        let (w, e, s, n) = (100.0 + low, 100.0 + high, 523.0 - high, 523.0 - low);
        format!("[[{w},{s}],[{e},{s}],[{e},{n}],[{w},{n}],[{w},{s}]]")
    };
    let (outer, hole) = (ring(2.5, 20.5), ring(7.5, 14.5));
    let json = format!(r#"{{"type":"Polygon","coordinates":[{outer},{hole}]}}"#);
    let (touched, core) = marks(&parse(&json).unwrap());
    let at = |column: usize, row: usize| row * SIDE as usize + column;
    assert!(core[at(5, 11)] && core[at(11, 5)]);
    assert!(!touched[at(11, 11)] && !touched[at(1, 1)]);
    assert!(touched[at(7, 11)] && !core[at(7, 11)]);
}

#[test]
fn what_is_no_region_says_what_to_do() {
    for (json, word) in [
        ("{", "not GeoJSON"),
        (
            r#"{"type":"LineString","coordinates":[[1,2],[3,4]]}"#,
            "ST_Buffer",
        ),
        (
            r#"{"type":"FeatureCollection","features":[]}"#,
            "no polygon",
        ),
        (
            r#"{"type":"Polygon","coordinates":[[[100,500],[110,500],[110,510],[100,511]]]}"#,
            "closed",
        ),
        (
            r#"{"type":"Polygon","coordinates":[[[100],[110,500],[110,510],[100]]]}"#,
            "position",
        ),
        (
            r#"{"type":"Polygon","coordinates":[[[9.5,47],[9.6,47],[9.6,47.1],[9.5,47]]]}"#,
            "-t_srs",
        ),
    ] {
        let refused = parse(json).err().unwrap();
        assert!(
            refused.contains(word) && refused.contains("r.geojson"),
            "{refused}"
        );
    }
    let deep = format!(
        "{}{}",
        r#"{"type":"GeometryCollection","geometries":["#.repeat(60),
        "]}".repeat(60)
    );
    assert!(parse(&deep).is_err());
}
