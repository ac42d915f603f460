//! Every kind of input: a linear ramp comes out exact, and where it belongs in the world.

use escarp_proto::georef::Plane;
use escarp_tests::inputs::{
    HGT_SIDE, Registered, STEP_M, Stored, TIE_M, hgt_bytes, write_png, write_tiff, write_zip,
};
use escarp_tests::terrain::{build_with, hash, read_samples};
use escarp_tiles::build::Quantum;
use escarp_tiles::dataset::Dataset;
use escarp_tiles::dem::{DemSource, OpenOptions, open, open_all};
use escarp_tiles::synth::SynthSource;
use escarp_tiles::verify::compare;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

const WGS84_RADIUS_M: f64 = 6_378_137.0;
const SIZE: [u32; 2] = [53, 38];

/// Builds a dataset from a source, and holds it against the source.
fn build(folder: &Path, source: &mut dyn DemSource, quantum: Quantum) -> Dataset {
    let path = folder.join("out.escarp");
    build_with(&path, source, quantum, true).expect("it builds");
    let dataset = Dataset::open(&path).expect("it opens");
    let found = compare(&dataset, source, &|_, _| {}).expect("it compares");
    let promised_m = dataset.manifest().storage_error_m;
    assert!(
        found.largest_difference_m <= promised_m,
        "{found:?}, promised {promised_m}"
    );
    assert_eq!((found.missing, found.invented), (0, 0));
    dataset
}

fn build_files(folder: &Path, paths: &[PathBuf], options: &OpenOptions) -> Dataset {
    let mut source = open_all(paths, options).expect("it is read");
    build(folder, source.as_mut(), Quantum::Natural)
}

/// Calls with the world position of every sample; `None` for a hole.
fn visit(dataset: &Dataset, mut visit: impl FnMut(u32, u32, Option<[f64; 3]>)) {
    let [width, height] = dataset.manifest().samples;
    let samples = read_samples(dataset);
    for y in 0..height {
        for x in 0..width {
            let sample = samples[(y * width + x) as usize];
            visit(
                x,
                y,
                sample.map(|sample| dataset.manifest().georef.world(x, y, sample)),
            );
        }
    }
}

/// A ramp over the world: one metre more each half column east, and each quarter row north, so
/// that a shift by half a sample shows.
fn ramp([east_m, north_m]: [f64; 2]) -> f64 {
    (east_m - TIE_M[0]) / 5.0 + (north_m - TIE_M[1]) / 5.0 + 400.0
}

#[test]
fn a_ramp_in_a_geotiff_comes_out_exact_grid_and_cell_registered() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("ramp.tif");
    for (registered, shift) in [(Registered::Grid, 0.0), (Registered::Cell, 0.5)] {
        for stored in [Stored::I16, Stored::U16, Stored::I32, Stored::F32] {
            let first = [TIE_M[0] + shift * STEP_M[0], TIE_M[1] - shift * STEP_M[1]];
            let at = |column: u32, row: u32| {
                [
                    first[0] + f64::from(column) * STEP_M[0],
                    first[1] - f64::from(row) * STEP_M[1],
                ]
            };
            write_tiff(&path, SIZE, registered, stored, |column, row| {
                ramp(at(column, row))
            });
            let options = OpenOptions::default();
            let dataset = build_files(folder.path(), std::slice::from_ref(&path), &options);
            let what = format!("{registered:?} {stored:?}");
            assert_eq!(dataset.manifest().samples, SIZE, "{what}");
            assert_eq!(dataset.manifest().storage_error_m, 0.0, "{what}");
            visit(&dataset, |x, y, place| {
                let [east, north, up] = place.expect("no holes");
                assert_eq!([east, north], at(x, SIZE[1] - 1 - y), "{what}");
                assert!(
                    (up - ramp([east, north])).abs() < 1e-9,
                    "{what} {x} {y}: {up}"
                );
            });
        }
    }
}

/// A ramp over longitude and latitude, whole metres at the samples of a tile.
fn degrees_ramp(longitude: f64, latitude: f64) -> f64 {
    (longitude - 20.0) * 1200.0 * 3.0 + (latitude - 10.0) * 1200.0 * 2.0
}

/// A tile of the ramp, by its south-west corner.
fn tile(longitude: i32, latitude: i32) -> Vec<u8> {
    let step = f64::from(HGT_SIDE - 1);
    hgt_bytes(|column, row| {
        let east = f64::from(longitude) + f64::from(column) / step;
        let north = f64::from(latitude + 1) - f64::from(row) / step;
        degrees_ramp(east, north).round()
    })
}

/// Holds every sample against the ramp, at the longitude and latitude of its world position.
fn check_degrees(dataset: &Dataset, is_hole: impl Fn(f64, f64) -> bool) {
    let georef = &dataset.manifest().georef;
    let Plane::Geographic {
        radius_m,
        middle_longitude_deg: longitude,
        middle_latitude_deg: latitude,
        ..
    } = &georef.plane
    else {
        panic!("{:?}", georef.plane);
    };
    assert_eq!(*radius_m, WGS84_RADIUS_M);
    let metres_a_degree = WGS84_RADIUS_M * std::f64::consts::PI / 180.0;
    let metres_east = metres_a_degree * (latitude * std::f64::consts::PI / 180.0).cos();
    let mut holes = 0;
    visit(dataset, |x, y, place| {
        let east = longitude + georef.world_x(x) / metres_east;
        let north = latitude + georef.world_y(y) / metres_a_degree;
        let Some([_, _, up]) = place else {
            assert!(is_hole(east, north), "a hole at {east}, {north}");
            holes += 1;
            return;
        };
        assert!(!is_hole(east, north), "no hole at {east}, {north}");
        assert!(
            (up - degrees_ramp(east, north)).abs() < 1e-5,
            "{east} {north}: {up}"
        );
    });
    let samples = dataset.manifest().samples;
    assert_eq!(
        dataset.manifest().valid_samples,
        u64::from(samples[0]) * u64::from(samples[1]) - holes
    );
}

#[test]
fn a_ramp_in_an_srtm_tile_comes_out_exact_plain_and_zipped() {
    let folder = TempDir::new().unwrap();
    let (plain, zipped) = (
        folder.path().join("N10E020.hgt"),
        folder.path().join("a.hgt.zip"),
    );
    std::fs::write(&plain, tile(20, 10)).unwrap();
    write_zip(&zipped, "N10E020.hgt", &tile(20, 10));
    let mut datasets = [plain, zipped].map(|path| {
        let dataset = build_files(folder.path(), &[path], &OpenOptions::default());
        check_degrees(&dataset, |_, _| false);
        (dataset.manifest().georef.clone(), read_samples(&dataset))
    });
    let (one, two) = datasets.split_at_mut(1);
    assert!(one == two, "zipped, it is another one");
}

#[test]
fn srtm_tiles_with_a_missing_one_become_one_ramp_with_a_hole() {
    let folder = TempDir::new().unwrap();
    let tiles = [(20, 10), (21, 10), (20, 11)].map(|(longitude, latitude)| {
        let path = folder
            .path()
            .join(format!("N{latitude}E{longitude:03}.hgt"));
        std::fs::write(&path, tile(longitude, latitude)).unwrap();
        path
    });
    let dataset = build_files(folder.path(), &tiles, &OpenOptions::default());
    assert_eq!(dataset.manifest().samples, [2 * HGT_SIDE - 1; 2]);
    // The edges that the missing tile shares belong to its neighbours, too.
    check_degrees(&dataset, |east, north| {
        east > 21.0 + 1e-9 && north > 11.0 + 1e-9
    });
}

#[test]
fn a_ramp_in_a_png_comes_out_exact_with_spacing_step_and_offset() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("ramp.png");
    let grey = |column: u32, row: u32| 700.0 + 3.0 * f64::from(column) - 2.0 * f64::from(row);
    write_png(&path, SIZE, grey);
    let options = OpenOptions {
        spacing_m: Some(30.0),
        height_step_m: Some(0.25),
        height_offset_m: Some(-50.0),
        ..OpenOptions::default()
    };
    let dataset = build_files(folder.path(), &[path], &options);
    assert_eq!(dataset.manifest().georef.plane, Plane::Local);
    visit(&dataset, |x, y, place| {
        let [east, north, up] = place.expect("no holes");
        assert_eq!([east, north], [30.0 * f64::from(x), 30.0 * f64::from(y)]);
        assert_eq!(up, grey(x, SIZE[1] - 1 - y) * 0.25 - 50.0);
    });
}

#[test]
fn floating_point_heights_are_stored_without_loss_if_so_wished() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("float.tif");
    let height = |column, row| {
        f64::from(hash(column, row) % 65536) / 4096.0 - f64::from(column) * 17.0 + 0.5
    };
    write_tiff(&path, SIZE, Registered::Grid, Stored::F32, height);
    let mut source = open(&path, &OpenOptions::default()).expect("it is read");
    let dataset = build(folder.path(), source.as_mut(), Quantum::Lossless);
    assert_eq!(dataset.manifest().storage_error_m, 0.0);
    visit(&dataset, |x, y, place| {
        assert_eq!(
            place.map(|place| place[2]),
            Some(height(x, SIZE[1] - 1 - y))
        );
    });
    // By default they are stored in centimetres, and the difference is stated.
    let dataset = build(folder.path(), source.as_mut(), Quantum::Natural);
    let stated_m = dataset.manifest().storage_error_m;
    assert!(stated_m > 0.0 && stated_m <= 0.005 + 1e-9, "{stated_m}");
}

#[test]
fn the_synthetic_terrain_is_the_same_through_a_file() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("sample.tif");
    escarp_tiles::synth::write_geotiff(&path, 130, 5).unwrap();
    let direct = build(
        folder.path(),
        &mut SynthSource::new(130, 5),
        Quantum::Metres(0.01),
    );
    let (georef, samples) = (direct.manifest().georef.clone(), read_samples(&direct));
    let options = OpenOptions::default();
    let dataset = build_files(folder.path(), std::slice::from_ref(&path), &options);
    assert_eq!(dataset.manifest().georef, georef);
    assert_eq!(read_samples(&dataset), samples);
}
