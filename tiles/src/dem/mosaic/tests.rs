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
            largest_m: 0.0,
            largest_at: None
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
            largest_m: 3.0,
            // Samples are half a cell from the corner that the file names; row 1, column 3.
            largest_at: Some([500_035.0, 4_999_970.0])
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
        let error = Mosaic::open(
            &[base.clone(), other],
            &OpenOptions::default(),
            JoinOptions::default(),
        )
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
    let mosaic = Mosaic::open(&paths, &OpenOptions::default(), JoinOptions::default());
    assert!(matches!(mosaic.err(), Some(DemError::Limits { .. })));
}

#[test]
fn forty_real_tiles_hold_few_open() {
    let Some(data) = real_data() else { return };
    let folder = std::fs::read_dir(data.join("ca_nv_srtm3_hgt")).unwrap();
    let mut paths: Vec<PathBuf> = folder.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    let mut dem = Mosaic::open(&paths, &OpenOptions::default(), JoinOptions::default()).unwrap();
    assert_eq!((dem.info.width, dem.info.height), (13201, 4801));
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for first in (0..4801).step_by(64) {
        let rows = 64.min(4801 - first);
        let mut out = vec![0.0; rows as usize * 13201];
        dem.read_rows(first, rows, &mut out).unwrap();
        assert!(dem.inputs.open_now() <= 22);
        low = out.iter().copied().fold(low, f64::min);
        high = out.iter().copied().fold(high, f64::max);
    }
    assert_eq!((low, high), (-85.0, 4404.0));
    assert_eq!(dem.overlaps().largest_m, 1.0);
    assert_eq!(dem.overlaps().differing, 6229);
    assert!(dem.overlaps().largest_at.is_some());
}

/// Column and row of the first sample; columns and rows.
type Extent = ((i32, i32), (i32, i32));

/// A tile of any size at a place of the common lattice.
struct Tile {
    place: (i32, i32),
    size: (i32, i32),
    path: PathBuf,
}

/// Heights that differ from tile to tile, with holes.
fn told(number: usize, column: i32, row: i32) -> f64 {
    let mixed = (column * 7919 + row * 104_729 + number as i32 * 31) % 11;
    if mixed == 4 {
        -9999.0
    } else {
        f64::from(row * 10 + column + mixed * (number as i32 % 3))
    }
}

fn tiles(folder: &Folder, places: &[Extent]) -> Vec<Tile> {
    let made = places
        .iter()
        .enumerate()
        .map(|(number, &((x, y), (w, h)))| {
            let (east, north) = (5e5 + f64::from(x) * 10.0, 5e6 - f64::from(y) * 20.0);
            let bytes = Tiff::plain(w as u32, h as u32, SampleType::I16)
                .with(33922, Tag::Double(vec![0.0, 0.0, 0.0, east, north, 0.0]))
                .with(42113, Tag::Text("-9999"))
                .bytes(|r, c| told(number, x + c as i32, y + r as i32));
            let path = folder.write(&format!("{number}.tif"), &bytes);
            Tile {
                place: (x, y),
                size: (w, h),
                path,
            }
        });
    made.collect()
}

/// Heights and report of a mosaic, by asking every tile for every sample.
fn naive(tiles: &[Tile], order: &[usize]) -> (Vec<f64>, OverlapReport) {
    let west = tiles.iter().map(|tile| tile.place.0).min().unwrap();
    let north = tiles.iter().map(|tile| tile.place.1).min().unwrap();
    let east = tiles
        .iter()
        .map(|tile| tile.place.0 + tile.size.0)
        .max()
        .unwrap();
    let south = tiles
        .iter()
        .map(|tile| tile.place.1 + tile.size.1)
        .max()
        .unwrap();
    let (mut heights, mut report) = (Vec::new(), OverlapReport::default());
    let mut differences = Vec::new();
    for y in north..south {
        for x in west..east {
            let mut given = order.iter().filter_map(|&number| {
                let tile = &tiles[number];
                let (dx, dy) = (x - tile.place.0, y - tile.place.1);
                let inside = (0..tile.size.0).contains(&dx) && (0..tile.size.1).contains(&dy);
                let height = told(number, x, y);
                (inside && height != -9999.0).then_some(height)
            });
            let height = given.next();
            heights.push(height.unwrap_or(f64::NAN));
            for other in given {
                let difference = (other - height.unwrap()).abs();
                report.overlapping += 1;
                report.differing += u64::from(difference != 0.0);
                let at = [
                    5e5 + 5.0 + f64::from(x) * 10.0,
                    5e6 - 10.0 - f64::from(y) * 20.0,
                ];
                differences.push((difference, at));
            }
        }
    }
    report.largest_m = differences.iter().map(|(d, _)| *d).fold(0.0, f64::max);
    let largest = differences
        .iter()
        .filter(|(d, _)| *d > 0.0 && *d == report.largest_m);
    let places: Vec<_> = largest.map(|(_, at)| *at).collect();
    report.largest_at = places.first().copied();
    (heights, report)
}

fn join(tiles: &[Tile], join: JoinOptions) -> Mosaic {
    let paths: Vec<PathBuf> = tiles.iter().map(|tile| tile.path.clone()).collect();
    Mosaic::open(&paths, &OpenOptions::default(), join).unwrap()
}

fn assert_same(found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len());
    for (i, (a, b)) in found.iter().zip(expected).enumerate() {
        assert!(
            a == b || a.is_nan() && b.is_nan(),
            "sample {i}: {a}, not {b}"
        );
    }
}

#[test]
fn heights_and_report_are_those_of_a_naive_look_at_every_tile_in_either_priority() {
    let folder = Folder::new();
    let places = [
        ((0, 0), (9, 7)),
        ((6, 2), (8, 11)),
        ((3, 5), (5, 5)),
        ((30, 9), (4, 6)),
    ];
    let tiles = tiles(&folder, &places);
    for (priority, order) in [
        (Priority::First, [0, 1, 2, 3]),
        (Priority::Last, [3, 2, 1, 0]),
    ] {
        let (heights, report) = naive(&tiles, &order);
        for band in [1, 4, 15] {
            let seam = Seam::Exact;
            let mut dem = join(&tiles, JoinOptions { priority, seam });
            assert_same(&read_all(&mut dem, band), &heights);
            assert_eq!((report.overlapping > 0, report.differing > 0), (true, true));
            assert_eq!(dem.overlaps(), report);
        }
    }
}

#[test]
fn three_hundred_small_tiles_with_some_missing_are_one_grid_and_few_are_open() {
    let folder = Folder::new();
    // 20 x 15 places; every seventh tile is missing. Neighbours share a row and a column.
    let places: Vec<_> = (0..350)
        .filter(|i| i % 7 != 3)
        .map(|i| ((i % 20 * 3, i / 20 * 3), (4, 4)))
        .collect();
    assert_eq!(places.len(), 300);
    let tiles = tiles(&folder, &places);
    let order: Vec<usize> = (0..300).collect();
    let (heights, report) = naive(&tiles, &order);
    let mut dem = join(&tiles, JoinOptions::default());
    assert_same(&read_all(&mut dem, 5), &heights);
    assert_eq!(dem.overlaps().overlapping, report.overlapping);
    assert!(dem.inputs.open_now() <= 60, "{}", dem.inputs.open_now());
}

#[test]
fn more_tiles_in_a_band_than_may_be_open_are_read_all_the_same() {
    let folder = Folder::new();
    let places: Vec<_> = (0..300).map(|i| ((i * 2, 0), (3, 4))).collect();
    let tiles = tiles(&folder, &places);
    let order: Vec<usize> = (0..300).collect();
    let (heights, _) = naive(&tiles, &order);
    for seam in [Seam::Exact, Seam::Blend(2)] {
        let mut dem = join(
            &tiles,
            JoinOptions {
                seam,
                ..JoinOptions::default()
            },
        );
        let read = read_all(&mut dem, 2);
        if seam == Seam::Exact {
            assert_same(&read, &heights);
        }
        assert!(dem.inputs.open_now() <= 128, "{}", dem.inputs.open_now());
    }
}

#[test]
fn a_blended_seam_goes_from_one_input_to_the_other_whatever_the_bands() {
    let folder = Folder::new();
    let places = [((0, 0), (20, 9)), ((12, 0), (20, 9))];
    let paths: Vec<PathBuf> = places
        .iter()
        .enumerate()
        .map(|(number, &((x, y), (w, h)))| {
            let (east, north) = (5e5 + f64::from(x) * 10.0, 5e6 - f64::from(y) * 20.0);
            let bytes = Tiff::plain(w, h, SampleType::I16)
                .with(33922, Tag::Double(vec![0.0, 0.0, 0.0, east, north, 0.0]))
                .bytes(|_, _| 100.0 * number as f64);
            folder.write(&format!("{number}.tif"), &bytes)
        })
        .collect();
    let seam = Seam::Blend(4);
    let blend = JoinOptions {
        seam,
        ..JoinOptions::default()
    };
    for band in [1, 2, 9] {
        let mut dem = Mosaic::open(&paths, &OpenOptions::default(), blend).unwrap();
        let heights = read_all(&mut dem, band);
        for row in heights.chunks_exact(32) {
            // The first counts up to column 19; the last four of it lean towards the second.
            assert!(row[..16].iter().all(|h| *h == 0.0), "{row:?}");
            assert_eq!(row[16..20], [20.0, 40.0, 60.0, 80.0]);
            assert!(row[20..].iter().all(|h| *h == 100.0), "{row:?}");
        }
        assert_eq!(dem.overlaps().overlapping, 8 * 9);
        assert_eq!(dem.overlaps().largest_m, 100.0);
    }
}

#[test]
fn blended_heights_do_not_depend_on_bands_and_lie_between_the_inputs() {
    let folder = Folder::new();
    let places = [
        ((0, 0), (19, 17)),
        ((6, 2), (18, 21)),
        ((3, 9), (15, 9)),
        ((40, 9), (4, 6)),
    ];
    let tiles = tiles(&folder, &places);
    let seam = Seam::Blend(5);
    let whole = {
        let mut dem = join(
            &tiles,
            JoinOptions {
                seam,
                ..JoinOptions::default()
            },
        );
        read_all(&mut dem, 23)
    };
    for band in [1, 3, 10] {
        let mut dem = join(
            &tiles,
            JoinOptions {
                seam,
                ..JoinOptions::default()
            },
        );
        assert_same(&read_all(&mut dem, band), &whole);
        // And from south to north.
        let mut last = vec![0.0; 44];
        dem.read_rows(22, 1, &mut last).unwrap();
        assert_same(&last, &whole[22 * 44..]);
        dem.read_rows(3, 1, &mut last).unwrap();
        assert_same(&last, &whole[3 * 44..4 * 44]);
    }
    let mut blended = 0;
    for (at, height) in whole.iter().enumerate() {
        let (x, y) = (at as i32 % 44, at as i32 / 44);
        let given: Vec<f64> = tiles
            .iter()
            .enumerate()
            .filter(|(_, tile)| {
                let (dx, dy) = (x - tile.place.0, y - tile.place.1);
                (0..tile.size.0).contains(&dx) && (0..tile.size.1).contains(&dy)
            })
            .map(|(number, _)| told(number, x, y))
            .filter(|height| *height != -9999.0)
            .collect();
        assert_eq!(given.is_empty(), height.is_nan());
        let low = given.iter().copied().fold(f64::INFINITY, f64::min);
        let high = given.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        assert!(given.is_empty() || (low..=high).contains(height));
        blended += u32::from(!given.is_empty() && !given.contains(height));
    }
    assert!(blended > 0);
}

#[test]
fn inputs_of_several_kinds_keep_the_finest_step_or_become_floating_point() {
    let folder = Folder::new();
    let base = tile(&folder, 0, 0, ramp);
    let other = |name: &str, sample| {
        let place = vec![0.0, 0.0, 0.0, 5e5 + 30.0, 5e6, 0.0];
        let bytes = Tiff::plain(4, 4, sample)
            .with(33922, Tag::Double(place))
            .bytes(|_, _| 2.0);
        folder.write(name, &bytes)
    };
    let kind = |paths: &[PathBuf]| {
        let dem = Mosaic::open(paths, &OpenOptions::default(), JoinOptions::default()).unwrap();
        (dem.info.sample_type, dem.info.height_step_m)
    };
    let whole = other("whole.tif", SampleType::I32);
    let float = other("float.tif", SampleType::F32);
    assert_eq!(kind(&[base.clone(), whole]), (SampleType::I64, 1.0));
    assert_eq!(kind(&[base, float]).0, SampleType::F64);
}

#[test]
fn rows_that_no_input_has_are_known_to_be_empty() {
    let folder = Folder::new();
    let paths = [(0, 0), (50, 4000)].map(|(column, row)| tile(&folder, column, row, ramp));
    let dem = Mosaic::open(&paths, &OpenOptions::default(), JoinOptions::default()).unwrap();
    let columns = |first, rows| dem.data_columns(first, rows);
    let first = columns(0, 1);
    assert_eq!((first.len(), &first[0]), (1, &(0..4)));
    assert_eq!(columns(4, 3996), []);
    assert_eq!(columns(3, 3998), [0..4, 50..54]);
}

#[test]
fn tiles_on_both_sides_of_the_date_line_are_neighbours() {
    let folder = Folder::new();
    let tile = |name: &str, from: i16| {
        let bytes = hgt_bytes(1201, move |_, column| from + column as i16);
        folder.write(name, &bytes)
    };
    let (west, east) = (tile("S17E179.hgt", 0), tile("S17W180.hgt", 1200));
    for paths in [[west.clone(), east.clone()], [east, west]] {
        let mut dem = open_all(&paths, &OpenOptions::default()).unwrap();
        assert_eq!((dem.info().width, dem.info().height), (2401, 1201));
        assert_eq!(dem.info().placement.x0.rem_euclid(360.0), 179.0);
        let mut row = vec![0.0; 2401];
        dem.read_rows(600, 1, &mut row).unwrap();
        assert!(row.iter().enumerate().all(|(c, h)| *h == c as f64));
    }
}
