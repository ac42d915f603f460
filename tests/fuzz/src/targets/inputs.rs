//! Files that claim to be DEMs.

use escarp_tiles::dem::{MAX_HEIGHT_M, OpenOptions, RawShape, RgbCoding, open};
use flate2::Compression;
use flate2::write::GzEncoder;
use std::fs;
use std::io::{Cursor, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Samples that are read of a DEM: enough to reach every decoder, few enough to go on.
const MOST_SAMPLES: u64 = 1 << 18;

/// A single file. The first byte says under which name and with which options it is opened.
pub fn dem(data: &[u8]) {
    let Some((&how, content)) = data.split_first() else {
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(NAMES[usize::from(how & 7)]);
    fs::write(&path, content).expect("a file");
    read(&path, &options(how >> 3));
}

const NAMES: [&str; 8] = [
    "input",
    "N36W115.hgt",
    "input.tif",
    "input.png",
    "input.asc",
    "input.dt0",
    "input.dem",
    "input.hdr",
];

fn options(how: u8) -> OpenOptions {
    let plain = OpenOptions {
        spacing_m: Some(1.0),
        ..OpenOptions::default()
    };
    match how & 7 {
        1 => OpenOptions {
            rgb: Some(RgbCoding::Mapbox),
            tile: Some([3, 1, 2]),
            ..plain
        },
        2 => OpenOptions {
            rgb: Some(RgbCoding::Terrarium),
            ..plain
        },
        3 => OpenOptions {
            max_height_m: Some(100.0),
            ..plain
        },
        4 => OpenOptions {
            raw: "4x4:i16:be:2".parse::<RawShape>().ok(),
            ..plain
        },
        5 => OpenOptions::default(),
        6 => OpenOptions {
            height_step_m: Some(0.3),
            height_offset_m: Some(-1e5),
            nodata: Some(0.0),
            ..plain
        },
        _ => plain,
    }
}

/// Opens and reads some rows; heights are heights or holes.
fn read(path: &Path, options: &OpenOptions) {
    let Ok(mut source) = open(path, options) else {
        return;
    };
    let info = source.info();
    let (width, height) = (info.width, info.height);
    let place = info.placement;
    assert!(
        width > 0 && height > 0 && place.dx > 0.0 && place.dy > 0.0,
        "{info:?}"
    );
    assert!(
        [place.x0, place.y0, place.dx, place.dy]
            .iter()
            .all(|v| v.is_finite()),
        "{info:?}"
    );
    assert!(info.height_step_m.is_finite(), "{info:?}");
    let rows = (MOST_SAMPLES / u64::from(width)).clamp(1, u64::from(height)) as u32;
    let mut band = vec![0.0; rows as usize * width as usize];
    for first in [0, height - rows] {
        source.data_columns(first, rows);
        if source.read_rows(first, rows, &mut band).is_ok() {
            let sound = |v: &f64| v.is_nan() || v.abs() <= MAX_HEIGHT_M;
            assert!(band.iter().all(sound), "a height out of range");
        }
    }
    let (row, column) = (height / 2, width / 2);
    let mut one = [0.0];
    let _ = source.read_window(row..row + 1, column..column + 1, &mut one);
}

/// Files beside each other, split at NUL: samples that a header, a world file and a `.prj`
/// describe. The first byte says what the samples are.
pub fn side(data: &[u8]) {
    let Some((&how, texts)) = data.split_first() else {
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, bytes: &[u8]| fs::write(folder.path().join(name), bytes);
    let mut texts = texts.split(|byte| *byte == 0);
    for name in ["a.hdr", "a.wld", "a.prj"] {
        if let Some(text) = texts.next().filter(|text| !text.is_empty()) {
            write(name, text).expect("a file");
        }
    }
    let name = ["a.bil", "a.flt", "a.img", "a.asc", "a.pgm", "a.bsq"][usize::from(how % 6)];
    let samples: Vec<u8> = match name {
        "a.asc" => b"1 2 3\n4 5 6\n7 8 9.5\n".to_vec(),
        "a.pgm" => b"P2 2 2 9\n1 2 3 4\n".to_vec(),
        _ => (0..144).collect(),
    };
    write(name, &samples).expect("a file");
    read(&folder.path().join(name), &options(how >> 5));
    if folder.path().join("a.hdr").exists() {
        read(&folder.path().join("a.hdr"), &options(how >> 5));
    }
}

/// Packed files: what the input has, in a gzip or zip whose sums are right. The first byte says
/// how, the second how long the first member is.
pub fn packed(data: &[u8]) {
    let Some((&[how, cut], content)) = data.split_first_chunk() else {
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let (name, bytes) = match how & 3 {
        0 => ("input.tif.gz", gzip(content)),
        1 => ("input.zip", zip(content, usize::from(cut), how)),
        2 => ("input.gz", gzip(&zip(content, usize::from(cut), how))),
        _ => ("input.zip", content.to_vec()),
    };
    let path = folder.path().join(name);
    fs::write(&path, bytes).expect("a file");
    read(&path, &options(how >> 5));
}

fn gzip(content: &[u8]) -> Vec<u8> {
    let mut out = GzEncoder::new(Vec::new(), Compression::fast());
    out.write_all(content).expect("memory");
    out.finish().expect("memory")
}

/// A zip of members: name up to a line's end, and what follows.
fn zip(content: &[u8], cut: usize, how: u8) -> Vec<u8> {
    let method = match how & 4 {
        0 => CompressionMethod::Stored,
        _ => CompressionMethod::Deflated,
    };
    let options = SimpleFileOptions::default().compression_method(method);
    let mut out = ZipWriter::new(Cursor::new(Vec::new()));
    let (first, second) = content.split_at(cut.min(content.len()));
    for member in [second, first] {
        let Some(at) = member.iter().position(|byte| *byte == b'\n') else {
            continue;
        };
        let name = String::from_utf8_lossy(&member[..at]).into_owned();
        if out.start_file(name, options).is_ok() {
            out.write_all(&member[at + 1..]).expect("memory");
        }
    }
    out.finish().map(Cursor::into_inner).unwrap_or_default()
}
