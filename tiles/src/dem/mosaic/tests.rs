//! Mosaics of hand-made tiles.

use super::super::testing::{Folder, Tag, Tiff, hgt_bytes, real_data};
use super::super::{DemError, DemSource, OpenOptions, SampleType, open_all};
use super::*;

fn read_all(dem: &mut dyn DemSource, band: u32) -> Vec<f64> {
    let (width, height) = (dem.info().width, dem.info().height);
    let mut heights = Vec::new();
    for first in (0..height).step_by(band as usize) {
        let rows = band.min(height - first);
        let mut out = vec![0.0; (rows * width) as usize];
        dem.read_rows(first, rows, &mut out).unwrap();
        heights.extend(out);
    }
    heights
}

/// A 4 x 4 tile whose first sample is sample (`column`, `row`) of the common lattice.
fn tile(folder: &Folder, column: i32, row: i32, height: impl Fn(i32, i32) -> f64) -> PathBuf {
    let (x, y) = (5e5 + f64::from(column) * 10.0, 5e6 - f64::from(row) * 20.0);
    let bytes = Tiff::plain(4, 4, SampleType::I16)
        .with(33922, Tag::Double(vec![0.0, 0.0, 0.0, x, y, 0.0]))
        .with(42113, Tag::Text("-9999"))
        .bytes(|r, c| height(row + r as i32, column + c as i32));
    folder.write(&format!("{column}_{row}.tif"), &bytes)
}

fn ramp(row: i32, column: i32) -> f64 {
    f64::from(row * 100 + column)
}

#[test]
fn tiles_with_shared_edges_and_a_missing_one_become_one_ramp_with_a_hole() {
    let folder = Folder::new();
    // Three of four, sharing one row and one column; the south-east one is missing.
    let paths = [(3, 0), (0, 0), (0, 3)].map(|(c, r)| tile(&folder, c, r, ramp));
    let mut dem = open_all(&paths, &OpenOptions::default()).unwrap();
    assert_eq!((dem.info().width, dem.info().height), (7, 7));
    assert_eq!(dem.info().placement.x0, 500_005.0);
    for band in [7, 1, 3] {
        for (at, height) in read_all(dem.as_mut(), band).into_iter().enumerate() {
            let (row, column) = (at as i32 / 7, at as i32 % 7);
            let hole = row > 3 && column > 3;
            assert_eq!(height.is_nan(), hole, "row {row} column {column}");
            assert!(hole || height == ramp(row, column));
        }
    }
    let report = dem.overlaps().unwrap();
    // Two edges of 4 samples, counted once however often they are read.
    assert_eq!(
        report,
        OverlapReport {
            overlapping: 8,
            differing: 0,
            largest_m: 0.0
        }
    );
}

#[test]
fn the_earlier_input_wins_but_a_hole_never_does() {
    let folder = Folder::new();
    let first = tile(
        &folder,
        0,
        0,
        |r, c| if (r, c) == (0, 3) { -9999.0 } else { 1.0 },
    );
    let second = tile(&folder, 3, 0, |_, _| 4.0);
    let mut dem = open_all(&[first, second], &OpenOptions::default()).unwrap();
    let heights = read_all(dem.as_mut(), 2);
    assert_eq!(heights[..7], [1.0, 1.0, 1.0, 4.0, 4.0, 4.0, 4.0]);
    assert_eq!(heights[7..14], [1.0, 1.0, 1.0, 1.0, 4.0, 4.0, 4.0]);
    let report = dem.overlaps().unwrap();
    assert_eq!(
        report,
        OverlapReport {
            overlapping: 3,
            differing: 3,
            largest_m: 3.0
        }
    );
}

#[test]
fn srtm_tiles_meet_at_their_shared_edge() {
    let folder = Folder::new();
    let (west, east) = (
        hgt_bytes(1201, |_, c| c as i16),
        hgt_bytes(1201, |_, c| c as i16 + 1200),
    );
    let paths = [
        folder.write("N10E020.hgt", &west),
        folder.write("N10E021.hgt", &east),
    ];
    let mut dem = open_all(&paths, &OpenOptions::default()).unwrap();
    assert_eq!((dem.info().width, dem.info().height), (2401, 1201));
    let mut row = vec![0.0; 2401];
    dem.read_rows(1200, 1, &mut row).unwrap();
    assert!(row.iter().enumerate().all(|(c, h)| *h == c as f64));
}

#[test]
fn inputs_that_do_not_fit_name_both_files_and_the_command() {
    let folder = Folder::new();
    let base = tile(&folder, 0, 0, ramp);
    let plain = || Tiff::plain(4, 4, SampleType::I16);
    let place = |x| Tag::Double(vec![0.0, 0.0, 0.0, x, 5e6, 0.0]);
    let off_lattice = plain().with(33922, place(5e5 + 43.0));
    let coarser = plain().with(33550, Tag::Double(vec![10.1, 20.0, 0.0]));
    let keys = vec![1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 32633];
    let other_crs = plain().with(34735, Tag::Short(keys));
    for (name, tiff) in [
        ("off.tif", off_lattice),
        ("coarse.tif", coarser),
        ("zone.tif", other_crs),
    ] {
        let other = folder.write(name, &tiff.bytes(|_, _| 0.0));
        let error = Mosaic::open(&[base.clone(), other], &OpenOptions::default())
            .err()
            .unwrap();
        let text = error.to_string();
        assert!(matches!(error, DemError::Usage { .. }));
        assert!(
            text.contains(name) && text.contains("0_0.tif") && text.contains("gdalwarp"),
            "{text}"
        );
    }
}

#[test]
fn inputs_far_apart_are_refused_by_the_limit() {
    let folder = Folder::new();
    let far = |x, name| {
        let tag = Tag::Double(vec![0.0, 0.0, 0.0, x, 5e6, 0.0]);
        let bytes = Tiff::plain(4, 4, SampleType::I16)
            .with(33922, tag)
            .bytes(|_, _| 0.0);
        folder.write(name, &bytes)
    };
    let paths = [far(0.0, "a.tif"), far(1e9, "b.tif")];
    let mosaic = Mosaic::open(&paths, &OpenOptions::default());
    assert!(matches!(mosaic.err(), Some(DemError::Limits { .. })));
}

#[test]
fn forty_real_tiles_hold_few_open() {
    let Some(data) = real_data() else { return };
    let folder = std::fs::read_dir(data.join("ca_nv_srtm3_hgt")).unwrap();
    let mut paths: Vec<PathBuf> = folder.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    let mut dem = Mosaic::open(&paths, &OpenOptions::default()).unwrap();
    assert_eq!((dem.info.width, dem.info.height), (13201, 4801));
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for first in (0..4801).step_by(64) {
        let rows = 64.min(4801 - first);
        let mut out = vec![0.0; rows as usize * 13201];
        dem.read_rows(first, rows, &mut out).unwrap();
        assert!(
            dem.parts
                .iter()
                .filter(|part| part.source.is_some())
                .count()
                <= 22
        );
        low = out.iter().copied().fold(low, f64::min);
        high = out.iter().copied().fold(high, f64::max);
    }
    assert_eq!((low, high), (-85.0, 4404.0));
    assert_eq!(dem.overlaps().largest_m, 1.0);
    println!("{:?}", dem.overlaps());
}
