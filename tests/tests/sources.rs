//! Every format that is no GeoTIFF, `.hgt` or PNG (`inputs.rs` has those): the same ramp, written
//! by hand in each of them, comes out exact and at its place, in either registration; packed, it
//! is the same. And the real files, where a machine has them.

use escarp_proto::georef::Plane;
use escarp_tests::terrain::{build_with, read_samples};
use escarp_tiles::build::Quantum;
use escarp_tiles::dataset::Dataset;
use escarp_tiles::dem::{DemSource, OpenOptions, RgbCoding, open_all};
use escarp_tiles::verify::compare;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

const SIZE: [u32; 2] = [53, 38];
const SPACING_M: f64 = 10.0;
/// North-west sample of grids in metres.
const FIRST_M: [f64; 2] = [500_000.0, 5_000_000.0];
const UTM: &str = "Projection UTM\nZone 32\nDatum WGS84\n";

/// One metre more a column, three less a row: a shift by half a sample, or a turn, shows.
fn ramp(column: u32, row: u32) -> i32 {
    400 + column as i32 - 3 * row as i32
}

fn rows() -> impl Iterator<Item = Vec<i32>> {
    (0..SIZE[1]).map(|row| (0..SIZE[0]).map(|column| ramp(column, row)).collect())
}

fn build(folder: &Path, source: &mut dyn DemSource) -> Dataset {
    let path = folder.join("out.escarp");
    build_with(&path, source, Quantum::Natural, true).expect("it builds");
    let dataset = Dataset::open(&path).expect("it opens");
    let found = compare(&dataset, source, &|_, _| {}).expect("it compares");
    assert!(
        found.largest_difference_m <= dataset.manifest().storage_error_m,
        "{found:?}"
    );
    assert_eq!((found.missing, found.invented), (0, 0));
    dataset
}

fn build_file(folder: &Path, path: PathBuf, options: &OpenOptions) -> Dataset {
    let mut source = open_all(&[path], options).expect("it is read");
    build(folder, source.as_mut())
}

/// Holds every sample of a dataset in metres against the ramp, whose first sample is at `first`.
fn check(dataset: &Dataset, first: [f64; 2], what: &str) {
    let manifest = dataset.manifest();
    assert_eq!(manifest.samples, SIZE, "{what}");
    let samples = read_samples(dataset);
    for row in 0..SIZE[1] {
        for column in 0..SIZE[0] {
            let y = SIZE[1] - 1 - row;
            let sample = samples[(y * SIZE[0] + column) as usize].expect("no holes");
            let found = manifest.georef.world(column, y, sample);
            let expected = [
                first[0] + SPACING_M * f64::from(column),
                first[1] - SPACING_M * f64::from(row),
                f64::from(ramp(column, row)),
            ];
            assert_eq!(found, expected, "{what} {column} {row}");
        }
    }
}

fn text() -> String {
    let line = |row: Vec<i32>| row.iter().map(i32::to_string).collect::<Vec<_>>().join(" ") + "\n";
    rows().map(line).collect()
}

fn ascii_grid(registered: &str) -> String {
    let south = FIRST_M[1] - SPACING_M * f64::from(SIZE[1] - 1);
    let [w, h] = SIZE;
    let place = format!("XLL{registered} {}\nYLL{registered} {south}", FIRST_M[0]);
    format!(
        "NCOLS {w}\nNROWS {h}\n{place}\nCELLSIZE 10\nNODATA_VALUE -9999\n{}",
        text()
    )
}

/// What lies at the corner lies half a cell from the first sample.
fn of_corner() -> [f64; 2] {
    [FIRST_M[0] + SPACING_M / 2.0, FIRST_M[1] + SPACING_M / 2.0]
}

#[test]
fn a_ramp_in_an_ascii_grid_comes_out_exact_by_corner_and_centre_and_packed() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("a.prj"), UTM).unwrap();
    for (registered, first) in [("CENTER", FIRST_M), ("CORNER", of_corner())] {
        let grid = ascii_grid(registered);
        fs::write(at("a.asc"), &grid).unwrap();
        let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        gzip.write_all(grid.as_bytes()).unwrap();
        fs::write(at("a.asc.gz"), gzip.finish().unwrap()).unwrap();
        escarp_tests::inputs::write_zip(&at("a.zip"), "inner/b.asc", grid.as_bytes());
        for name in ["a.asc", "a.asc.gz", "a.zip"] {
            let dataset = build_file(folder.path(), at(name), &OpenOptions::default());
            check(&dataset, first, &format!("{name} {registered}"));
        }
    }
}

#[test]
fn a_ramp_in_samples_beside_a_header_comes_out_exact() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("a.prj"), UTM).unwrap();
    let [w, h] = SIZE;
    let [x, y] = FIRST_M;
    let big: Vec<u8> = rows()
        .flatten()
        .flat_map(|v| (v as i16).to_be_bytes())
        .collect();
    let float: Vec<u8> = rows()
        .flatten()
        .flat_map(|v| (v as f32).to_le_bytes())
        .collect();
    let esri = format!(
        "BYTEORDER M\nNROWS {h}\nNCOLS {w}\nNBITS 16\nPIXELTYPE SIGNEDINT\n\
         ULXMAP {x}\nULYMAP {y}\nXDIM 10\nYDIM 10\n"
    );
    let south = y - SPACING_M * f64::from(h - 1);
    let flt = format!(
        "ncols {w}\nnrows {h}\nxllcorner {x}\nyllcorner {south}\ncellsize 10\nbyteorder LSBFIRST\n"
    );
    let envi = format!(
        "ENVI\nsamples = {w}\nlines = {h}\nbands = 1\ndata type = 2\nbyte order = 1\n\
         map info = {{UTM, 1, 1, {x}, {y}, 10, 10, 32, North, WGS-84}}\n"
    );
    let north_west = [x + SPACING_M / 2.0, y - SPACING_M / 2.0];
    for (name, header, data, first) in [
        ("a.bil", esri, &big, FIRST_M),
        ("a.flt", flt, &float, of_corner()),
        ("a.img", envi, &big, north_west),
    ] {
        fs::write(at("a.hdr"), header).unwrap();
        fs::write(at(name), data).unwrap();
        let dataset = build_file(folder.path(), at(name), &OpenOptions::default());
        check(&dataset, first, name);
        let dataset = build_file(folder.path(), at("a.hdr"), &OpenOptions::default());
        check(&dataset, first, &format!("header of {name}"));
        fs::remove_file(at(name)).unwrap();
    }
}

#[test]
fn a_ramp_in_raw_samples_and_pictures_comes_out_exact_where_a_world_file_says() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    let [w, h] = SIZE;
    let grey: Vec<u8> = rows()
        .flatten()
        .flat_map(|v| (v as u16).to_be_bytes())
        .collect();
    fs::write(at("a.raw"), &grey).unwrap();
    let pgm = [format!("P5 {w} {h} 65535\n").as_bytes(), &grey].concat();
    fs::write(at("a.pgm"), pgm).unwrap();
    fs::write(at("a.prj"), UTM).unwrap();
    let [x, y] = FIRST_M;
    fs::write(at("a.wld"), format!("10\n0\n0\n-10\n{x}\n{y}\n")).unwrap();
    let shaped = OpenOptions {
        raw: Some(format!("{w}x{h}:u16:be").parse().unwrap()),
        ..OpenOptions::default()
    };
    for (name, options) in [("a.raw", &shaped), ("a.pgm", &OpenOptions::default())] {
        check(&build_file(folder.path(), at(name), options), FIRST_M, name);
    }
}

#[test]
fn a_matrix_is_placed_by_longitudes_and_latitudes_from_either_end() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    let numbers = |count: u32, of: &dyn Fn(u32) -> f64| -> String {
        (0..count).map(|i| format!("{}\n", of(i))).collect()
    };
    fs::write(
        at("lons"),
        numbers(SIZE[0], &|i| 170.0 + f64::from(i) / 2.0),
    )
    .unwrap();
    let south: String = text()
        .lines()
        .rev()
        .map(|line| format!("{line}\n"))
        .collect();
    let mut found = Vec::new();
    for (matrix, sign) in [(text(), -1.0), (south, 1.0)] {
        fs::write(
            at("lats"),
            numbers(SIZE[1], &|i| sign * (f64::from(i) - 18.5) / 2.0),
        )
        .unwrap();
        fs::write(at("matrix"), matrix).unwrap();
        let options = OpenOptions {
            lons_lats: Some([at("lons"), at("lats")]),
            ..OpenOptions::default()
        };
        let dataset = build_file(folder.path(), at("matrix"), &options);
        assert!(matches!(
            dataset.manifest().georef.plane,
            Plane::Geographic { .. }
        ));
        found.push((dataset.manifest().georef.clone(), read_samples(&dataset)));
    }
    assert!(found[0] == found[1], "south row first, it is another one");
    let expected: Vec<i32> = (0..SIZE[1])
        .rev()
        .flat_map(|r| (0..SIZE[0]).map(move |c| ramp(c, r)))
        .collect();
    let heights: Vec<i32> = found[0].1.iter().map(|h| h.expect("no holes")).collect();
    assert_eq!(heights, expected);
}

/// Files of the shared data, if they are here.
fn real(name: &str) -> Option<PathBuf> {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data");
    let folder = std::env::var("ESCARP_DATA").unwrap_or_else(|_| beside.into());
    Some(PathBuf::from(folder).join(name)).filter(|path| path.exists())
}

#[test]
fn real_files_have_their_published_size_heights_and_holes() {
    let rgb = OpenOptions {
        rgb: Some(RgbCoding::Mapbox),
        tile: Some([10, 906, 403]),
        ..OpenOptions::default()
    };
    let puget = OpenOptions {
        spacing_m: Some(160.0),
        height_step_m: Some(0.1),
        ..OpenOptions::default()
    };
    let lons_lats = ["lons", "lats"].map(|what| real(&format!("etopo20/etopo20{what}.gz")));
    let [lons, lats] = lons_lats;
    let etopo = OpenOptions {
        lons_lats: lons.zip(lats).map(Into::into),
        ..OpenOptions::default()
    };
    let plain = OpenOptions::default();
    let cases = [
        (
            "SainteHelens.dem",
            &plain,
            [327, 468],
            [682.0, 2543.0],
            4151,
        ),
        (
            "fuji_mapbox_terrain_rgb.png",
            &rgb,
            [512, 512],
            [13.7, 3751.0],
            0,
        ),
        ("ps_height_1k.png", &puget, [1025, 1025], [0.0, 4379.8], 0),
        (
            "merewether_topography1_asc.zip",
            &plain,
            [321, 416],
            [16.47, 51.97],
            73,
        ),
        (
            "etopo20/etopo20data.gz",
            &etopo,
            [1081, 540],
            [-9026.6, 6228.8],
            0,
        ),
        (
            "mt_everest_90m.tif",
            &plain,
            [1201, 1201],
            [192.0, 8642.0],
            130_953,
        ),
        (
            "greenriver_lidar_1m_f32.tif",
            &plain,
            [2000, 1000],
            [1297.29, 1347.03],
            0,
        ),
        (
            "rio_elev_f32_3857.tif",
            &plain,
            [512, 512],
            [0.44, 114.92],
            0,
        ),
        ("N49W123.tif", &plain, [1201, 1201], [-37.0, 2674.0], 34_926),
        ("N49W124.tif", &plain, [1201, 1201], [-26.0, 2630.0], 25_620),
        // Four tiles of the mosaic are sea and missing: 1200 x 1200 samples that no other has.
        (
            "ca_nv_srtm3_hgt",
            &plain,
            [13201, 4801],
            [-85.0, 4404.0],
            4 * 1200 * 1200,
        ),
        (
            "moon_gld100_lon000-064_lat00-48.tif",
            &plain,
            [16384, 12288],
            [-6572.0, 3585.0],
            0,
        ),
    ];
    for (name, options, size, range, holes) in cases {
        let Some(path) = real(name) else { continue };
        let folder = TempDir::new().unwrap();
        let dataset = build_file(folder.path(), path, options);
        let manifest = dataset.manifest();
        assert_eq!(manifest.samples, size, "{name}");
        let samples = u64::from(size[0]) * u64::from(size[1]);
        assert_eq!(samples - manifest.valid_samples, holes, "{name}");
        let [_, _, z] = manifest.extent_m();
        for (found, expected) in z.iter().zip(range) {
            assert!(
                (found - expected).abs() < 0.06,
                "{name}: {z:?}, published {range:?}"
            );
        }
    }
}
