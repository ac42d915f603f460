use super::super::testing::{Folder, read_all, real_data};
use super::*;

/// Column, rows from the lattice's south, values from the south.
type Given<'a> = (u32, u32, &'a [i32]);

fn record_a(system: u32, unit: u32, z_step: &str, profiles: usize) -> String {
    let zone = if system == 1 { 10 } else { 0 };
    let (ground, step) = if system == 1 {
        (2, "0.300000E+02")
    } else {
        (3, "3.000000E+00")
    };
    let mut text = format!("{:144}{:6}{:6}{system:6}{zone:6}", "A TEST", 1, 1);
    text += &"   0.000000000000000D+00".repeat(15);
    text += &format!("{ground:6}{unit:6}{:6}", 4);
    text += &"   0.500000000000000D+06".repeat(8);
    text += &"   0.100000000000000D+03".repeat(2);
    text += &format!("   0.000000000000000D+00{:6}{step}{step}{z_step}", 0);
    text += &format!("{:6}{profiles:6}", 1);
    assert_eq!(text.len(), 864);
    text += &format!("{:24}{:2}{:2}", "", 2, 1);
    format!("{text:1024}")
}

fn profile(number: usize, (column, row, values): Given<'_>, datum: f64, step: f64) -> String {
    let real = |v: f64| format!("{:>24}", format!("{v:.15E}").replace('E', "D"));
    let (x, y) = (step * f64::from(column + 10), step * f64::from(row + 20));
    let mut text = format!("{:6}{number:6}{:6}{:6}", 1, values.len(), 1);
    text += &[x, y, datum, 0.0, 0.0].map(real).concat();
    for value in values {
        let used = text.len() % 1024;
        if used + 6 > 1020 {
            text += &" ".repeat(1024 - used);
        }
        text += &format!("{value:6}");
    }
    let length = text.len().div_ceil(1024) * 1024;
    format!("{text:length$}")
}

fn file(system: u32, unit: u32, z: &str, profiles: &[Given<'_>]) -> Vec<u8> {
    let step = if system == 1 { 30.0 } else { 3.0 };
    let mut text = record_a(system, unit, z, profiles.len());
    for (i, given) in profiles.iter().enumerate() {
        text += &profile(i + 1, *given, 0.0, step);
    }
    text.into_bytes()
}

const METRE: &str = "0.100000E+01";
const RAGGED: [Given<'_>; 3] = [
    (0, 1, &[10, 11]),
    (1, 0, &[20, -32767, -32767, 23]),
    (2, 1, &[-31]),
];

fn read_bytes(bytes: &[u8]) -> Result<(DemInfo, Vec<f64>), DemError> {
    let folder = Folder::new();
    read_all(&folder.write("a.dem", bytes), &OpenOptions::default())
}

#[test]
fn profiles_of_any_length_and_start_stand_at_their_place() {
    let (info, heights) = read_bytes(&file(1, 2, METRE, &RAGGED)).unwrap();
    let place = info.placement;
    assert_eq!(
        (place.x0, place.y0, place.dx, place.dy),
        (300.0, 690.0, 30.0, 30.0)
    );
    assert!(matches!(info.crs, Crs::Projected { ref name, .. } if name == "EPSG:26710"));
    assert_eq!(info.vertical.as_deref(), Some("NGVD29 height"));
    let hole = f64::NAN;
    let expected = [
        hole, 23.0, hole, 11.0, hole, hole, 10.0, hole, -31.0, hole, 20.0, hole,
    ];
    let text = |heights: &[f64]| format!("{heights:?}");
    assert_eq!(text(&heights), text(&expected));
}

#[test]
fn feet_tenths_and_seconds_become_metres_and_degrees() {
    let (info, heights) = read_bytes(&file(0, 1, "0.100000E+00", &[(0, 0, &[1000])])).unwrap();
    assert!(matches!(info.crs, Crs::Geographic { ref name, .. } if name == "EPSG:4267"));
    assert_eq!(
        (info.placement.x0, info.placement.dx),
        (30.0 / 3600.0, 3.0 / 3600.0)
    );
    assert!((heights[0] - 30.48).abs() < 1e-9, "{heights:?}");
    assert!((info.height_step_m - 0.03048).abs() < 1e-12);
}

#[test]
fn a_profile_may_have_a_datum_of_its_own() {
    let mut text = record_a(1, 2, METRE, 2);
    text += &profile(1, (0, 0, &[5]), 100.0, 30.0);
    text += &profile(2, (1, 0, &[5]), 200.5, 30.0);
    let (info, heights) = read_bytes(text.as_bytes()).unwrap();
    assert_eq!(heights, [105.0, 205.5]);
    assert!(!info.sample_type.is_integer());
}

#[test]
fn line_ends_between_records_and_long_profiles_do_no_harm() {
    let values: Vec<i32> = (0..700).map(|i| i - 350).collect();
    let bytes = file(
        1,
        2,
        METRE,
        &[(0, 0, &values), (1, 0, &[-32767, -32767, 7])],
    );
    let (_, plain) = read_bytes(&bytes).unwrap();
    assert_eq!(
        (plain[0], plain[2 * 699], plain[2 * 697 + 1]),
        (349.0, -350.0, 7.0)
    );
    let lines: Vec<u8> = bytes
        .chunks(1024)
        .flat_map(|r| [r, b"\n"].concat())
        .collect();
    let (_, broken) = read_bytes(&lines).unwrap();
    assert_eq!(format!("{plain:?}"), format!("{broken:?}"));
}

#[test]
fn every_cut_before_the_last_number_is_an_error() {
    let bytes = file(1, 2, METRE, &RAGGED);
    let last = bytes.iter().rposition(|b| *b != b' ').unwrap();
    for length in (0..1100)
        .chain((1100..last).step_by(7))
        .chain(last - 3..last)
    {
        // The number itself may be cut: only then another one is read.
        let inside = length + 2 > last;
        assert!(read_bytes(&bytes[..length]).is_err() || inside, "{length}");
    }
}

#[test]
fn hostile_files_are_refused_with_their_place() {
    let good = String::from_utf8(file(1, 2, METRE, &RAGGED)).unwrap();
    let far = file(1, 2, METRE, &[(0, 0, &[1]), (4_000_000, 4_000_000, &[1])]);
    assert!(
        read_bytes(&far)
            .unwrap_err()
            .to_string()
            .contains("a box of")
    );
    let cases = [
        (1024 + 12, " 99999", "byte"),
        (1024 + 18, "     2", "2 columns"),
        (1024 + 24, "                     NaN", "start"),
        (1024 + 24, "   0.301000000000000D+04", "whole steps"),
        (816, "0.000000E+00", "step above 0"),
        (858, "   999", "cut short"),
        (858, "     0", "count of profiles"),
        (162, "    77", "zone 77"),
        (890, " 9", "datum 9"),
        (528, "     1", "unit 1"),
    ];
    for (at, text, expected) in cases {
        let mut bytes = good.clone();
        bytes.replace_range(at..at + text.len(), text);
        let error = read_bytes(bytes.as_bytes()).unwrap_err().to_string();
        assert!(error.contains(expected), "{text}: {error}");
    }
}

#[test]
fn corners_of_the_sheet_widen_the_box_unless_they_are_far_off() {
    let good = String::from_utf8(file(1, 2, METRE, &RAGGED)).unwrap();
    // The profiles span 600 to 690; rows are 30 apart.
    for (corner, height, y0) in [
        ("   0.569000000000000D+03", 6, 690.0),
        ("   0.721000000000000D+03", 6, 750.0),
        ("   0.900000000000000D+09", 4, 690.0),
    ] {
        let mut text = good.clone();
        text.replace_range(570..594, corner);
        let (info, heights) = read_bytes(text.as_bytes()).unwrap();
        assert_eq!((info.height, info.placement.y0), (height, y0), "{corner}");
        assert_eq!(heights.iter().filter(|h| !h.is_nan()).count(), 5);
    }
}

#[test]
fn mount_st_helens_has_its_published_heights() {
    let Some(data) = real_data() else { return };
    let (info, heights) =
        read_all(&data.join("SainteHelens.dem"), &OpenOptions::default()).unwrap();
    assert_eq!((info.width, info.height), (327, 468));
    assert_eq!(
        (info.placement.x0, info.placement.y0),
        (557_820.0, 5_121_990.0)
    );
    let valid = || heights.iter().filter(|h| !h.is_nan());
    assert_eq!(valid().fold(f64::INFINITY, |a, b| a.min(*b)), 682.0);
    assert_eq!(valid().fold(f64::NEG_INFINITY, |a, b| a.max(*b)), 2543.0);
}
