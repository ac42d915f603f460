//! Codes, PROJ strings and WKT against control points that others published.

use super::*;
use proptest::prelude::*;

fn projection(text: &str) -> Projection {
    Projection::of(&from_user(text).unwrap()).unwrap()
}

fn near(found: Option<[f64; 2]>, expected: [f64; 2], within: f64) {
    let found = found.expect("a point");
    for (f, e) in found.iter().zip(expected) {
        assert!((f - e).abs() <= within, "{found:?}, expected {expected:?}");
    }
}

fn dms(d: f64, m: f64, s: f64) -> f64 {
    d.signum() * (d.abs() + m / 60.0 + s / 3600.0)
}

/// IOGP Guidance Note 7-2: examples of each method.
#[test]
fn the_worked_examples_of_guidance_note_7_2_are_met() {
    // Lambert conic conformal (2SP): Texas South Central, US survey feet.
    let texas = projection("EPSG:32040");
    let (longitude, latitude) = (-96.0, dms(28.0, 30.0, 0.0));
    near(
        texas.from_degrees(longitude, latitude),
        [2_963_503.91, 254_759.80],
        0.02,
    );
    // Transverse Mercator: OSGB 1936 / British National Grid.
    let britain = projection("EPSG:27700");
    let (longitude, latitude) = (dms(0.0, 30.0, 0.0), dms(50.0, 30.0, 0.0));
    near(
        britain.from_degrees(longitude, latitude),
        [577_274.99, 69_740.50],
        0.02,
    );
    // Polar stereographic (A): UPS North.
    let north = projection("EPSG:5041");
    near(
        north.from_degrees(44.0, 73.0),
        [3_320_416.75, 632_668.43],
        0.02,
    );
    // Lambert azimuthal equal area: ETRS89-LAEA Europe.
    let europe = projection("EPSG:3035");
    near(
        europe.from_degrees(5.0, 50.0),
        [3_962_799.45, 2_999_718.85],
        0.02,
    );
    // Oblique stereographic: Amersfoort / RD New.
    let dutch = projection("EPSG:28992");
    near(
        dutch.from_degrees(6.0, 53.0),
        [196_105.283, 557_057.739],
        0.02,
    );
    // Popular visualisation pseudo-Mercator.
    let web = projection("EPSG:3857");
    let (longitude, latitude) = (dms(-100.0, 20.0, 0.0), dms(24.0, 22.0, 54.433));
    near(
        web.from_degrees(longitude, latitude),
        [-11_169_055.58, 2_800_000.0],
        0.02,
    );
}

/// Snyder, "Map Projections, A Working Manual" (1987), equations 8-9, 8-10: the series in powers
/// of the distance from the meridian, good to a millimetre within a UTM zone.
fn utm_by_series(longitude: f64, latitude: f64, middle: f64) -> [f64; 2] {
    let (a, f) = (6_378_137.0, 1.0 / 298.257_223_563);
    let e2: f64 = f * (2.0 - f);
    let ep2 = e2 / (1.0 - e2);
    let (phi, lambda) = (latitude.to_radians(), (longitude - middle).to_radians());
    let (sin, cos, tan) = (phi.sin(), phi.cos(), phi.tan());
    let n = a / (1.0 - e2 * sin * sin).sqrt();
    let (t, c, big_a) = (tan * tan, ep2 * cos * cos, lambda * cos);
    let (e4, e6) = (e2 * e2, e2 * e2 * e2);
    let m = a
        * ((1.0 - e2 / 4.0 - 3.0 * e4 / 64.0 - 5.0 * e6 / 256.0) * phi
            - (3.0 * e2 / 8.0 + 3.0 * e4 / 32.0 + 45.0 * e6 / 1024.0) * (2.0 * phi).sin()
            + (15.0 * e4 / 256.0 + 45.0 * e6 / 1024.0) * (4.0 * phi).sin()
            - 35.0 * e6 / 3072.0 * (6.0 * phi).sin());
    let x = n
        * (big_a
            + (1.0 - t + c) * big_a.powi(3) / 6.0
            + (5.0 - 18.0 * t + t * t + 72.0 * c - 58.0 * ep2) * big_a.powi(5) / 120.0);
    let y = m + n
        * tan
        * (big_a.powi(2) / 2.0
            + (5.0 - t + 9.0 * c + 4.0 * c * c) * big_a.powi(4) / 24.0
            + (61.0 - 58.0 * t + t * t + 600.0 * c - 330.0 * ep2) * big_a.powi(6) / 720.0);
    [500_000.0 + 0.9996 * x, 0.9996 * y]
}

proptest! {
    #[test]
    fn utm_agrees_with_snyders_series_to_a_centimetre(
        zone in 1u16..=60, east in -3.0f64..3.0, latitude in 0.0f64..80.0,
    ) {
        let middle = f64::from(zone) * 6.0 - 183.0;
        let utm = projection(&format!("EPSG:{}", 32600 + zone));
        let found = utm.from_degrees(middle + east, latitude).unwrap();
        let expected = utm_by_series(middle + east, latitude, middle);
        for (f, e) in found.iter().zip(expected) {
            prop_assert!((f - e).abs() < 0.01, "{:?} {:?}", found, expected);
        }
        let [longitude, back] = utm.to_degrees(found[0], found[1]).unwrap();
        prop_assert!((longitude - middle - east).abs() < 1e-9 && (back - latitude).abs() < 1e-9);
    }

    #[test]
    fn no_text_makes_the_parser_panic(text in "[A-Z\\[\\](),\"0-9.eE+ -]{0,200}") {
        let _ = from_user(&text);
        let _ = vertical::from_wkt(&text);
    }
}

const UTM_WKT1: &str = r#"PROJCS["WGS 84 / UTM zone 45N",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4326"]],PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",87],PARAMETER["scale_factor",0.9996],PARAMETER["false_easting",500000],PARAMETER["false_northing",0],UNIT["metre",1],AXIS["Easting",EAST],AXIS["Northing",NORTH],AUTHORITY["EPSG","32645"]]"#;

const UTM_ESRI: &str = r#"PROJCS["WGS_1984_UTM_Zone_45N",GEOGCS["GCS_WGS_1984",DATUM["D_WGS_1984",SPHEROID["WGS_1984",6378137.0,298.257223563]],PRIMEM["Greenwich",0.0],UNIT["Degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],PARAMETER["False_Easting",500000.0],PARAMETER["False_Northing",0.0],PARAMETER["Central_Meridian",87.0],PARAMETER["Scale_Factor",0.9996],PARAMETER["Latitude_Of_Origin",0.0],UNIT["Meter",1.0]]"#;

const UTM_WKT2: &str = r#"PROJCRS["WGS 84 / UTM zone 45N",BASEGEOGCRS["WGS 84",ENSEMBLE["World Geodetic System 1984 ensemble",MEMBER["World Geodetic System 1984 (Transit)"],ELLIPSOID["WGS 84",6378137,298.257223563,LENGTHUNIT["metre",1]],ENSEMBLEACCURACY[2.0]],PRIMEM["Greenwich",0,ANGLEUNIT["degree",0.0174532925199433]]],CONVERSION["UTM zone 45N",METHOD["Transverse Mercator",ID["EPSG",9807]],PARAMETER["Latitude of natural origin",0,ANGLEUNIT["degree",0.0174532925199433],ID["EPSG",8801]],PARAMETER["Longitude of natural origin",87,ANGLEUNIT["degree",0.0174532925199433],ID["EPSG",8802]],PARAMETER["Scale factor at natural origin",0.9996,SCALEUNIT["unity",1],ID["EPSG",8805]],PARAMETER["False easting",500000,LENGTHUNIT["metre",1],ID["EPSG",8806]],PARAMETER["False northing",0,LENGTHUNIT["metre",1],ID["EPSG",8807]]],CS[Cartesian,2],AXIS["(E)",east,ORDER[1],LENGTHUNIT["metre",1]],AXIS["(N)",north,ORDER[2],LENGTHUNIT["metre",1]]]"#;

#[test]
fn one_projection_in_three_dialects_is_one_code() {
    for wkt in [UTM_WKT1, UTM_ESRI, UTM_WKT2] {
        let expected = Crs::Projected {
            name: "EPSG:32645".into(),
            metres_per_unit: 1.0,
        };
        assert_eq!(from_user(wkt), Ok(expected));
    }
}

#[test]
fn a_wkt_without_its_code_transforms_as_the_code_does() {
    // Esri's California zone III in feet, and the same by its code.
    let esri = r#"PROJCS["NAD_1983_StatePlane_California_III_FIPS_0403_Feet",GEOGCS["GCS_North_American_1983",DATUM["D_North_American_1983",SPHEROID["GRS_1980",6378137.0,298.257222101]],PRIMEM["Greenwich",0.0],UNIT["Degree",0.0174532925199433]],PROJECTION["Lambert_Conformal_Conic"],PARAMETER["False_Easting",6561666.666666666],PARAMETER["False_Northing",1640416.666666667],PARAMETER["Central_Meridian",-120.5],PARAMETER["Standard_Parallel_1",37.06666666666667],PARAMETER["Standard_Parallel_2",38.43333333333333],PARAMETER["Latitude_Of_Origin",36.5],UNIT["Foot_US",0.3048006096012192]]"#;
    let crs = from_user(esri).unwrap();
    let Crs::Projected {
        name,
        metres_per_unit,
    } = &crs
    else {
        panic!("{crs}");
    };
    assert_eq!(*metres_per_unit, 0.304_800_609_601_219_2);
    assert_eq!(
        title(name),
        "NAD_1983_StatePlane_California_III_FIPS_0403_Feet"
    );
    let (by_text, by_code) = (Projection::of(&crs).unwrap(), projection("EPSG:2227"));
    let expected = by_code.from_degrees(-122.4, 37.8).unwrap();
    near(by_text.from_degrees(-122.4, 37.8), expected, 1e-3);
    // Its name is a definition again.
    assert_eq!(from_user(name).unwrap(), crs);
}

#[test]
fn spheres_of_other_bodies_keep_their_name_and_radius() {
    let moon = r#"GEOGCS["GCS_Moon_2000",DATUM["D_Moon_2000",SPHEROID["Moon_2000_IAU_IAG",1737400.0,0.0]],PRIMEM["Reference_Meridian",0.0],UNIT["Degree",0.0174532925199433]]"#;
    let expected = Crs::Geographic {
        name: "GCS_Moon_2000".into(),
        radius_m: 1_737_400.0,
    };
    assert_eq!(from_user(moon), Ok(expected));
    let polar = format!(
        r#"PROJCS["Moon_North",{moon},PROJECTION["Polar_Stereographic"],PARAMETER["latitude_of_origin",90],PARAMETER["central_meridian",0],PARAMETER["scale_factor",1],PARAMETER["false_easting",0],PARAMETER["false_northing",0],UNIT["metre",1]]"#
    );
    let north = Projection::of(&from_user(&polar).unwrap()).unwrap();
    // On a sphere r = 2 R tan(45 degrees - latitude / 2).
    let r = 2.0 * 1_737_400.0 * 5f64.to_radians().tan();
    near(north.from_degrees(90.0, 80.0), [r, 0.0], 1e-3);
    assert!(!north.is_on_the_body_of(&projection("EPSG:4326")));
    // Mars is flattened, so its definition is kept.
    let mars = r#"GEOGCS["Mars 2000",DATUM["D_Mars_2000",SPHEROID["Mars_2000_IAU_IAG",3396190.0,169.8944472236118]],PRIMEM["Reference_Meridian",0],UNIT["degree",0.0174532925199433]]"#;
    let mars = from_user(mars).unwrap();
    let Crs::Geographic { name, radius_m } = &mars else {
        panic!("{mars}");
    };
    assert_eq!((title(name), *radius_m), ("Mars_2000", 3_396_190.0));
    assert!((Projection::of(&mars).unwrap().axes_m()[1] - 3_376_200.0).abs() < 0.1);
}

#[test]
fn a_compound_crs_gives_its_two_halves() {
    let vertical = r#"VERT_CS["EGM96 height",VERT_DATUM["EGM96 geoid",2005],UNIT["metre",1],AXIS["Up",UP],AUTHORITY["EPSG","5773"]]"#;
    let compound = format!(r#"COMPD_CS["both",{UTM_WKT1},{vertical}]"#);
    assert_eq!(from_user(&compound), from_user(UTM_WKT1));
    assert_eq!(
        vertical::from_wkt(&compound).as_deref(),
        Some("EGM96 height (EPSG:5773)")
    );
    assert_eq!(vertical::from_wkt(UTM_WKT1), None);
    let feet = r#"VERTCRS["NAVD88 height (ftUS)",VDATUM["NAVD88"],CS[vertical,1],AXIS["h",up,LENGTHUNIT["US survey foot",0.304800609601219]]]"#;
    assert_eq!(vertical::metres_of_wkt(feet), Some(0.304_800_609_601_219));
}

#[test]
fn the_code_of_the_worlds_web_maps_is_known_by_its_name() {
    let esri = UTM_ESRI.replace("Transverse_Mercator", "Mercator_Auxiliary_Sphere");
    assert_eq!(from_user(&esri), from_user("EPSG:3857"));
}

#[test]
fn what_is_not_understood_says_so() {
    for (text, says) in [
        ("EPSG:99", "not known"),
        ("EPSG:x", "allowed is one number"),
        ("EPSG:4978", "geocentric"),
        ("Moon", "allowed are EPSG:code"),
        ("+proj=nothing", "not understood"),
        ("+proj=tmerc +axis=wsu", "axes"),
        ("LOCAL_CS[\"site\",UNIT[\"metre\",1]]", "LOCAL_CS"),
        ("GEOGCS[\"x\"]", "no datum"),
        ("GEOGCS[\"x\",DATUM[\"y\"]]", "how large"),
    ] {
        let error = from_user(text).unwrap_err();
        assert!(error.contains(says), "{text}: {error}");
    }
    let grads = UTM_WKT1.replace("Transverse_Mercator", "Tilted_Perspective");
    let grads = grads.replace("AUTHORITY[\"EPSG\",\"32645\"]", "AXIS[\"x\",EAST]");
    assert!(
        from_user(&grads)
            .unwrap_err()
            .contains("Tilted_Perspective")
    );
}

#[test]
fn every_prefix_of_a_wkt_is_an_error_and_no_panic() {
    for wkt in [UTM_WKT1, UTM_ESRI, UTM_WKT2] {
        for end in 0..wkt.len() {
            assert!(from_user(&wkt[..end]).is_err(), "{}", &wkt[..end]);
        }
    }
}

#[test]
fn nearly_all_planes_and_degrees_of_the_epsg_registry_are_understood() {
    let known: Vec<u16> = (1024..32_767)
        .filter(|code| epsg_definition(*code).is_some())
        .collect();
    let understood = known.iter().filter(|code| from_epsg(**code).is_ok());
    let (understood, known) = (understood.count(), known.len());
    assert!(understood * 100 >= known * 95, "{understood} of {known}");
}
