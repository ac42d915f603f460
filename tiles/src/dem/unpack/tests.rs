use super::super::testing::{Folder, gzip_bytes, hgt_bytes, png_bytes, read_all, zip_many};
use super::super::{Crs, open};
use super::*;

const GRID: &[u8] = b"ncols 3\nnrows 2\nxllcenter 500000\nyllcenter 5000000\ncellsize 10\n\
                      1 2 3\n4 5 6.5\n";
const PRJ: &[u8] = b"Projection UTM\nZone 32\nDatum WGS84\n";
const HEIGHTS: [f64; 6] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.5];

fn read(path: &Path) -> Result<(DemInfo, Vec<f64>), DemError> {
    read_all(path, &OpenOptions::default())
}

#[test]
fn a_dem_comes_out_of_gzip_and_zip_and_both_with_its_side_files() {
    let folder = Folder::new();
    folder.write("outer.prj", PRJ);
    let zipped = zip_many(&[
        ("d/a.asc", GRID),
        ("d/a.PRJ", PRJ),
        ("d/readme.txt", b"hello"),
    ]);
    let bare = zip_many(&[("topography.asc", GRID)]);
    let paths = [
        folder.write("outer.asc.gz", &gzip_bytes(GRID)),
        folder.write("any", &zipped),
        folder.write("outer_asc.zip", &bare),
        folder.write("any.gz", &gzip_bytes(&zipped)),
        folder.write("nested.zip", &zip_many(&[("in.zip", &zipped)])),
    ];
    for path in paths {
        let (info, heights) = read(&path).unwrap();
        assert_eq!(heights, HEIGHTS, "{}", path.display());
        assert_eq!(info.path, path);
        assert!(matches!(info.crs, Crs::Projected { ref name, .. } if name == "EPSG:32632"));
    }
}

#[test]
fn the_dem_of_a_zip_is_told_by_content_and_previews_do_not_count() {
    let folder = Folder::new();
    let tile = hgt_bytes(1201, |row, _| row as i16);
    let preview = png_bytes(2, 2, false, |_, _| 0);
    let header = b"NROWS 1\nNCOLS 2\nULXMAP 0\nULYMAP 0\nXDIM 1\nYDIM 1\n";
    let bil = [
        ("a.bil", &[7u8, 8][..]),
        ("a.hdr", header),
        ("a.prj", PRJ),
        ("a.png", &preview),
    ];
    let (_, heights) = read(&folder.write("bil.zip", &zip_many(&bil))).unwrap();
    assert_eq!(heights, [7.0, 8.0]);
    let hgt = [("preview.png", &preview[..]), ("dir/N36W115.hgt", &tile)];
    let dem = open(
        &folder.write("hgt.zip", &zip_many(&hgt)),
        &OpenOptions::default(),
    )
    .unwrap();
    assert_eq!((dem.info().format, dem.info().width), ("SRTM hgt", 1201));
}

#[test]
fn a_zip_with_several_dems_names_them_and_one_without_says_so() {
    let folder = Folder::new();
    let two = zip_many(&[("a.asc", GRID), ("b/c.asc", GRID)]);
    let error = read(&folder.write("a.zip", &two)).unwrap_err().to_string();
    assert!(error.contains("a.asc, b/c.asc"), "{error}");
    let none = zip_many(&[("readme.txt", b"hello there")]);
    let error = read(&folder.write("a.zip", &none)).unwrap_err();
    assert!(matches!(error, DemError::NotADem { .. }), "{error}");
}

#[test]
fn errors_speak_of_the_packed_file_and_not_of_a_temporary_one() {
    let folder = Folder::new();
    folder.write("a.prj", PRJ);
    let cut = &GRID[..GRID.len() - 5];
    let gzip = folder.write("a.asc.gz", &gzip_bytes(cut));
    let error = read(&gzip).unwrap_err().to_string();
    assert!(
        error.starts_with(&format!("{}: damaged", gzip.display())),
        "{error}"
    );
    let zip = folder.write("b.zip", &zip_many(&[("x/a.asc", cut)]));
    let error = read(&zip).unwrap_err().to_string();
    assert!(
        error.starts_with(&format!("{}/a.asc: damaged", zip.display())),
        "{error}"
    );
    let bands = [
        ("d/a.bil", &[0u8; 8][..]),
        ("d/a.hdr", GRID_OF_TWO_BANDS),
        ("d/a.prj", PRJ),
    ];
    let zip = folder.write("c.zip", &zip_many(&bands));
    let error = read(&zip).unwrap_err().to_string();
    let gdal = format!("gdal_translate -b 1 '/vsizip/{}/d/a.bil'", zip.display());
    assert!(
        error.contains(&gdal) || error.contains("/vsizip/"),
        "{error}"
    );
}

const GRID_OF_TWO_BANDS: &[u8] =
    b"NROWS 2\nNCOLS 2\nNBANDS 2\nULXMAP 0\nULYMAP 0\nXDIM 1\nYDIM 1\n";

#[test]
fn every_short_prefix_and_any_flipped_bit_is_an_error() {
    let folder = Folder::new();
    folder.write("a.prj", PRJ);
    let gzip = gzip_bytes(GRID);
    for length in 0..gzip.len() {
        assert!(
            read(&folder.write("a.asc.gz", &gzip[..length])).is_err(),
            "{length}"
        );
    }
    let zip = zip_many(&[("a.asc", GRID)]);
    for length in 0..zip.len() {
        assert!(
            read(&folder.write("a.zip", &zip[..length])).is_err(),
            "{length}"
        );
    }
    // Data and checksum of the gzip; its header has bytes that mean nothing.
    for at in 10..gzip.len() {
        let mut changed = gzip.clone();
        changed[at] ^= 1;
        assert!(read(&folder.write("a.asc.gz", &changed)).is_err(), "{at}");
    }
}

#[test]
fn files_packed_without_end_are_refused() {
    let folder = Folder::new();
    folder.write("a.prj", PRJ);
    let packed = (0..5).fold(GRID.to_vec(), |inner, _| gzip_bytes(&inner));
    let error = read(&folder.write("a.asc.gz", &packed))
        .unwrap_err()
        .to_string();
    assert!(error.contains("in 3 others"), "{error}");
}

#[test]
fn what_is_no_dem_is_refused_before_it_is_unpacked() {
    let folder = Folder::new();
    // Cut short, so that to unpack it would fail in another way.
    let mut packed = gzip_bytes(&vec![0; 1 << 20]);
    packed.truncate(packed.len() - 20);
    let error = read(&folder.write("zeros.gz", &packed)).unwrap_err();
    assert!(matches!(error, DemError::NotADem { .. }), "{error}");
    // Samples beside a header are a DEM, though nothing in them says so.
    folder.write("a.prj", PRJ);
    folder.write(
        "a.hdr",
        b"NROWS 1\nNCOLS 2\nULXMAP 0\nULYMAP 0\nXDIM 1\nYDIM 1\n",
    );
    let path = folder.write("a.bil.gz", &gzip_bytes(&[7, 8]));
    assert_eq!(read(&path).unwrap().1, [7.0, 8.0]);
}

#[test]
fn names_in_a_zip_cannot_lead_elsewhere() {
    for (name, expected) in [
        ("../../etc/passwd", "passwd"),
        ("a\\b\\c.asc", "c.asc"),
        ("x/..", "member"),
        ("", "member"),
    ] {
        assert_eq!(base_name(name), expected);
    }
    let folder = Folder::new();
    folder.write("b.prj", PRJ);
    let path = folder.write("b.zip", &zip_many(&[("../../a.asc", GRID)]));
    assert_eq!(read(&path).unwrap().1, HEIGHTS);
}

#[test]
fn a_shape_that_is_given_goes_for_what_is_packed() {
    let folder = Folder::new();
    let options = OpenOptions {
        raw: Some("3x2:u8".parse().unwrap()),
        spacing_m: Some(1.0),
        ..OpenOptions::default()
    };
    let samples = [1, 2, 3, 4, 5, 6];
    for path in [
        folder.write("a.raw.gz", &gzip_bytes(&samples)),
        folder.write("a.zip", &zip_many(&[("a.raw", &samples), ("a.prj", PRJ)])),
    ] {
        assert_eq!(read_all(&path, &options).unwrap().1, samples.map(f64::from));
    }
}
