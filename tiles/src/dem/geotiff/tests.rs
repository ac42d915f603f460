//! GeoTIFF against files made byte by byte.

use super::super::testing::{Folder, Tag, Tiff, real_data};
use super::super::{DemError, DemSource, OpenOptions, Placement, Registration, SampleType, open};
use super::*;

/// Exact in every sample type and registration: whole numbers, linear in both directions.
fn ramp(row: u32, column: u32) -> f64 {
    f64::from(row) * 3.0 + f64::from(column)
}

fn open_bytes(folder: &Folder, bytes: &[u8]) -> Result<Box<dyn DemSource>, DemError> {
    open(&folder.write("a.tif", bytes), &OpenOptions::default())
}

fn read(bytes: &[u8]) -> Result<Vec<f64>, DemError> {
    let folder = Folder::new();
    let mut dem = open_bytes(&folder, bytes)?;
    let (width, height) = (dem.info().width, dem.info().height);
    let mut rows = vec![0.0; (width * height) as usize];
    dem.read_rows(0, height, &mut rows)?;
    Ok(rows)
}

fn error(tiff: &Tiff) -> DemError {
    read(&tiff.bytes(ramp)).expect_err("an error")
}

fn assert_ramp(heights: &[f64], width: u32, what: &str) {
    for (at, height) in heights.iter().enumerate() {
        let at = at as u32;
        assert_eq!(*height, ramp(at / width, at % width), "{what}, sample {at}");
    }
}

#[test]
fn a_ramp_is_exact_in_every_type_order_cut_and_compression() {
    use SampleType as S;
    let cuts = [None, Some((16, 16)), Some((32, 16))];
    for sample in [
        S::U8,
        S::I8,
        S::U16,
        S::I16,
        S::U32,
        S::I32,
        S::U64,
        S::I64,
        S::F32,
        S::F64,
    ] {
        for tile in cuts {
            for compression in [1, 5, 8] {
                for (predictor, big_endian, big) in [
                    (1, false, false),
                    (1, true, false),
                    (2, false, true),
                    (2, true, true),
                ] {
                    let tiff = Tiff {
                        tile,
                        compression,
                        predictor,
                        big_endian,
                        big,
                        ..Tiff::plain(21, 19, sample)
                    };
                    let what =
                        format!("{sample:?} {tile:?} {compression} {predictor} {big_endian} {big}");
                    let heights = read(&tiff.bytes(ramp)).unwrap_or_else(|e| panic!("{what}: {e}"));
                    assert_ramp(&heights, 21, &what);
                }
            }
        }
    }
}

#[test]
fn the_floating_point_predictor_and_packbits_are_undone() {
    for (tile, compression, predictor) in [
        (None, 8, 3),
        (Some((16, 16)), 5, 3),
        (Some((32, 32)), 1, 3),
        (None, 32773, 1),
    ] {
        let tiff = Tiff {
            tile,
            compression,
            predictor,
            ..Tiff::plain(21, 19, SampleType::F32)
        };
        assert_ramp(
            &read(&tiff.bytes(ramp)).unwrap(),
            21,
            &format!("{compression} {predictor}"),
        );
    }
}

#[test]
fn bands_in_any_order_and_size_agree_with_the_whole() {
    let folder = Folder::new();
    for tile in [None, Some((16, 16))] {
        let tiff = Tiff {
            tile,
            ..Tiff::plain(21, 50, SampleType::I16)
        };
        let mut dem = open_bytes(&folder, &tiff.bytes(ramp)).unwrap();
        let bands = [
            (0, 17),
            (16, 17),
            (32, 18),
            (49, 1),
            (3, 1),
            (40, 2),
            (0, 50),
            (7, 0),
        ];
        for (first, rows) in bands {
            let mut out = vec![0.0; (rows * 21) as usize];
            dem.read_rows(first, rows, &mut out).unwrap();
            for (at, height) in out.iter().enumerate() {
                let at = at as u32;
                assert_eq!(
                    *height,
                    ramp(first + at / 21, at % 21),
                    "{first}+{rows}: {at}"
                );
            }
        }
        assert!(matches!(
            dem.read_rows(49, 2, &mut [0.0; 42]),
            Err(DemError::Usage { .. })
        ));
        assert!(matches!(
            dem.read_rows(0, 1, &mut [0.0; 20]),
            Err(DemError::Usage { .. })
        ));
    }
}

#[test]
fn both_registrations_put_samples_at_their_centres() {
    let folder = Folder::new();
    let keys = |raster| {
        Tag::Short(vec![
            1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, raster, 3072, 0, 1, 32632,
        ])
    };
    for (raster, registration, x0, y0) in [
        (1, Registration::Cell, 500_005.0, 4_999_990.0),
        (2, Registration::Grid, 5e5, 5e6),
    ] {
        let tiff = Tiff::plain(5, 4, SampleType::I16).with(34735, keys(raster));
        let dem = open_bytes(&folder, &tiff.bytes(ramp)).unwrap();
        assert_eq!(dem.info().registration, registration);
        assert_eq!(
            dem.info().placement,
            Placement {
                x0,
                y0,
                dx: 10.0,
                dy: 20.0
            }
        );
        let name = "EPSG:32632".into();
        assert_eq!(
            dem.info().crs,
            Crs::Projected {
                name,
                metres_per_unit: 1.0
            }
        );
    }
}

#[test]
fn a_south_up_file_is_turned_over() {
    let folder = Folder::new();
    let matrix = vec![
        10., 0., 0., 5e5, 0., 20., 0., 4e6, 0., 0., 0., 0., 0., 0., 0., 1.,
    ];
    let south_up = Tiff {
        tile: Some((16, 16)),
        ..Tiff::plain(5, 40, SampleType::I16)
    }
    .without(33550)
    .without(33922)
    .with(34264, Tag::Double(matrix));
    let mut dem = open_bytes(&folder, &south_up.bytes(ramp)).unwrap();
    assert_eq!(dem.info().placement.y0, 4e6 + 39.5 * 20.0);
    for (first, rows) in [(0, 7), (7, 20), (27, 13), (0, 40)] {
        let mut out = vec![0.0; (rows * 5) as usize];
        dem.read_rows(first, rows, &mut out).unwrap();
        for (at, height) in out.iter().enumerate() {
            let at = at as u32;
            assert_eq!(*height, ramp(39 - first - at / 5, at % 5));
        }
    }
}

#[test]
fn nodata_and_nan_are_holes() {
    let nodata = Tiff::plain(5, 4, SampleType::I16).with(42113, Tag::Text("4"));
    let heights = read(&nodata.bytes(ramp)).unwrap();
    let holes: Vec<usize> = (0..20).filter(|at| heights[*at].is_nan()).collect();
    assert_eq!(holes, [4, 6], "4 at (0, 4) and (1, 1)");
    let nan = Tiff::plain(2, 1, SampleType::F32).bytes(|_, c| [f64::NAN, 7.0][c as usize]);
    let heights = read(&nan).unwrap();
    assert!(heights[0].is_nan() && heights[1] == 7.0);
    let lowest = Tiff::plain(2, 1, SampleType::F32)
        .with(42113, Tag::Text("-3.4028234663852886e+38"))
        .bytes(|_, c| [f64::from(f32::MIN), 7.0][c as usize]);
    assert!(read(&lowest).unwrap()[0].is_nan());
}

#[test]
fn a_sparse_chunk_is_a_hole() {
    for compression in [1, 8] {
        let tiff = Tiff {
            tile: Some((16, 16)),
            sparse: Some(1),
            compression,
            ..Tiff::plain(20, 16, SampleType::I16)
        };
        let heights = read(&tiff.bytes(ramp)).unwrap();
        for (at, height) in heights.iter().enumerate() {
            assert_eq!(height.is_nan(), at % 20 >= 16, "sample {at}");
        }
    }
}

#[test]
fn scale_offset_and_units_give_metres() {
    let metadata = "<GDALMetadata><Item name=\"OFFSET\" sample=\"0\" role=\"offset\">100</Item>\
        <Item name=\"SCALE\" sample=\"0\" role=\"scale\">0.5</Item>\
        <Item name=\"UNITTYPE\" sample=\"0\" role=\"unittype\">ft</Item></GDALMetadata>";
    let tiff = Tiff::plain(5, 4, SampleType::I16).with(42112, Tag::Text(metadata));
    let heights = read(&tiff.bytes(ramp)).unwrap();
    assert!((heights[7] - (5.0 * 0.5 + 100.0) * 0.3048).abs() < 1e-12);
}

#[test]
fn heights_that_are_none_name_row_and_column() {
    let bytes = Tiff::plain(5, 4, SampleType::F32)
        .bytes(|r, c| if (r, c) == (2, 3) { f64::INFINITY } else { 0.0 });
    let error = read(&bytes).unwrap_err().to_string();
    assert!(
        error.contains("row 2, column 3") && error.contains("inf"),
        "{error}"
    );
}

#[test]
fn a_file_without_place_needs_a_spacing() {
    let folder = Folder::new();
    let bare = Tiff::plain(5, 4, SampleType::I16)
        .without(33550)
        .without(33922)
        .without(34735);
    let path = folder.write("a.tif", &bare.bytes(ramp));
    let error = open(&path, &OpenOptions::default()).err().unwrap();
    assert!(matches!(&error, DemError::Usage { .. }));
    assert!(error.to_string().contains("--spacing"), "{error}");
    let options = OpenOptions {
        spacing_m: Some(30.0),
        ..OpenOptions::default()
    };
    let dem = open(&path, &options).unwrap();
    assert_eq!(dem.info().crs, Crs::Local);
    assert_eq!(dem.info().placement.dx, 30.0);
}

#[test]
fn what_is_not_supported_names_the_command_that_converts() {
    let plain = Tiff::plain(5, 4, SampleType::U8);
    let lerc = Tiff {
        compression: 34887,
        ..plain.clone()
    };
    let lzma = Tiff {
        compression: 34925,
        ..plain.clone()
    };
    let jpeg = Tiff {
        compression: 7,
        ..plain.clone()
    };
    let bands = plain
        .clone()
        .with(277, Tag::Short(vec![3]))
        .with(258, Tag::Short(vec![8; 3]));
    let palette = plain.clone().with(262, Tag::Short(vec![3]));
    let white_is_zero = plain.clone().with(262, Tag::Short(vec![0]));
    let twelve_bits = plain.with(258, Tag::Short(vec![12]));
    for tiff in [lerc, lzma, jpeg, bands, palette, white_is_zero, twelve_bits] {
        let error = error(&tiff);
        assert!(matches!(&error, DemError::Unsupported { .. }), "{error}");
        assert!(error.to_string().contains("gdal_translate"), "{error}");
    }
}

#[test]
fn a_size_that_lies_is_found_before_memory_is_taken() {
    let huge = 1 << 31;
    let one_strip = [(256, huge), (257, huge), (278, u32::MAX)];
    let mut tiff = Tiff::plain(3, 3, SampleType::F32);
    for (tag, value) in one_strip {
        tiff = tiff.with(tag, Tag::Long(vec![value]));
    }
    assert!(matches!(error(&tiff), DemError::Limits { .. }));
    let strip = Tiff::plain(3, 3, SampleType::F32)
        .with(256, Tag::Long(vec![1 << 20]))
        .with(257, Tag::Long(vec![1 << 20]))
        .with(278, Tag::Long(vec![1 << 20]));
    let error_text = error(&strip).to_string();
    assert!(
        error_text.contains("TIFF strip") && error_text.contains("268435456"),
        "{error_text}"
    );
    let taller = Tiff::plain(3, 3, SampleType::F32).with(257, Tag::Long(vec![3000]));
    assert!(matches!(error(&taller), DemError::Damaged { .. }));
    let wider = Tiff::plain(3, 3, SampleType::F32).with(256, Tag::Long(vec![3000]));
    assert!(matches!(error(&wider), DemError::Damaged { .. }));
}

#[test]
fn every_short_prefix_is_an_error_and_no_panic() {
    for tile in [None, Some((16, 16))] {
        for (compression, big) in [(1, false), (8, true)] {
            let tiff = Tiff {
                tile,
                compression,
                big,
                ..Tiff::plain(9, 7, SampleType::I16)
            };
            let bytes = tiff.bytes(ramp);
            for length in 0..bytes.len() {
                assert!(
                    read(&bytes[..length]).is_err(),
                    "{length} of {} bytes",
                    bytes.len()
                );
            }
        }
    }
}

#[test]
fn a_file_cut_short_says_so_when_it_is_opened() {
    let folder = Folder::new();
    let bytes = Tiff::plain(9, 7, SampleType::I16).bytes(ramp);
    let error = open_bytes(&folder, &bytes[..bytes.len() - 1])
        .err()
        .unwrap()
        .to_string();
    assert!(
        error.contains("strip 2 of 3") && error.contains("cut short"),
        "{error}"
    );
}

#[test]
fn flipped_bytes_never_panic() {
    let tiff = Tiff {
        compression: 8,
        predictor: 2,
        tile: Some((16, 16)),
        ..Tiff::plain(20, 18, SampleType::I16)
    };
    let bytes = tiff.bytes(ramp);
    for at in 0..bytes.len() {
        for flip in [0x01, 0x80, 0xff] {
            let mut damaged = bytes.clone();
            damaged[at] ^= flip;
            let _ = read(&damaged); // an error, or other heights: the format has no checksum
        }
    }
}

#[test]
fn the_real_files_lie_where_gdal_puts_them() {
    let Some(data) = real_data() else { return };
    // Centre of the north-west sample by `gdalinfo`, and a sample by `gdallocationinfo`.
    for (name, placement, (column, row), height) in [
        (
            "mt_everest_90m.tif",
            (86.0, 28.0, 1.0 / 1200.0),
            (600, 100),
            4998.0,
        ),
        (
            "N49W123.tif",
            (-123.0, 50.0, 1.0 / 1200.0),
            (511, 300),
            1982.0,
        ),
        (
            "greenriver_lidar_1m_f32.tif",
            (561_000.5, 4_304_999.5, 1.0),
            (1000, 500),
            f64::from(1_313.37_f32),
        ),
        (
            "moon_gld100_lon000-064_lat00-48.tif",
            (0.5 / 256.0, 48.0 - 0.5 / 256.0, 1.0 / 256.0),
            (16000, 12000),
            -2596.0,
        ),
    ] {
        let mut dem = open(&data.join(name), &OpenOptions::default()).unwrap();
        let info = dem.info().clone();
        let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
        let Placement { x0, y0, dx, .. } = info.placement;
        assert!(
            near(x0, placement.0) && near(y0, placement.1) && near(dx, placement.2),
            "{name}"
        );
        let mut out = vec![0.0; info.width as usize];
        dem.read_rows(row, 1, &mut out).unwrap();
        assert_eq!(out[column], height, "{name}");
    }
}
