use super::*;
use crate::dem::{OpenOptions, open};

fn rows(source: &mut SynthSource, first: u32, n: u32) -> Vec<f64> {
    let mut out = vec![0.0; (n * source.info.width) as usize];
    source.read_rows(first, n, &mut out).unwrap();
    out
}

#[test]
fn the_terrain_is_the_same_on_every_machine() {
    let mut digest = 0xcbf2_9ce4_8422_2325_u64;
    for seed in [0, 1, u64::MAX] {
        let mut source = SynthSource::new(3001, seed);
        for first in [0, 1499, 2980] {
            for height in rows(&mut source, first, 21) {
                digest ^= (height * 100.0).round() as u64;
                digest = digest.wrapping_mul(0x0000_0100_0000_01b3);
            }
        }
    }
    assert_eq!(digest, GOLDEN, "{digest:#x}");
}

#[test]
fn any_band_is_that_of_the_whole_in_whatever_order() {
    let mut source = SynthSource::new(203, 9);
    let whole = rows(&mut source, 0, 203);
    for (first, n) in [
        (200, 3),
        (0, 1),
        (15, 2),
        (16, 17),
        (7, 9),
        (1, 200),
        (64, 64),
    ] {
        let from = (first * 203) as usize;
        assert_eq!(
            rows(&mut source, first, n),
            whole[from..][..(n * 203) as usize]
        );
    }
}

#[test]
fn a_larger_size_has_the_smaller_one_in_its_corner() {
    let (small, large) = (
        rows(&mut SynthSource::new(100, 4), 0, 100),
        rows(&mut SynthSource::new(1000, 4), 0, 100),
    );
    for (small, large) in small.chunks(100).zip(large.chunks(1000)) {
        assert_eq!(small, &large[..100]);
    }
}

#[test]
fn it_has_flat_lakes_high_mountains_and_a_cliff() {
    let mut source = SynthSource::new(20_000, 7);
    let (mut lake, mut high, mut steepest, mut all) = (0, 0, 0.0_f64, 0);
    for first in (0..20_000).step_by(400) {
        let band = rows(&mut source, first, 8);
        all += band.len();
        lake += band
            .iter()
            .filter(|h| **h == f64::from(LAKE_CM) / 100.0)
            .count();
        high += band.iter().filter(|h| **h > 2000.0).count();
        steepest = band
            .windows(2)
            .map(|pair| (pair[0] - pair[1]).abs())
            .fold(steepest, f64::max);
    }
    assert!(lake > all / 200 && lake < all / 4, "{lake} of {all}");
    assert!(high > 0);
    assert!(steepest > 20.0, "{steepest} m from sample to sample");
}

#[test]
fn at_a_tenth_of_the_spacing_it_is_a_tenth_in_height() {
    let tall = rows(&mut SynthSource::new(300, 3), 0, 300);
    let small = rows(&mut SynthSource::with_spacing_cm(300, 3, 100), 0, 300);
    for (tall, small) in tall.iter().zip(small) {
        assert!((tall / 10.0 - small).abs() < 0.0061, "{tall} {small}");
    }
}

#[test]
fn the_file_reads_back_as_it_was_made() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("synth.tif");
    write_geotiff(&path, 300, 5).unwrap();
    let mut file = open(&path, &OpenOptions::default()).unwrap();
    let mut made = SynthSource::new(300, 5);
    assert_eq!(file.info().placement, made.info().placement);
    assert_eq!(file.info().crs, made.info().crs);
    assert_eq!(file.info().registration, Registration::Grid);
    let (mut a, mut b) = (vec![0.0; 90_000], vec![0.0; 90_000]);
    file.read_rows(0, 300, &mut a).unwrap();
    made.read_rows(0, 300, &mut b).unwrap();
    assert!(a.iter().zip(&b).all(|(a, b)| *a == f64::from(*b as f32)));
}

#[test]
fn sizes_that_make_no_grid_are_refused() {
    for size in [0, MAX_SIDE_SAMPLES + 1] {
        let written = write_geotiff(Path::new("none.tif"), size, 0);
        assert!(matches!(written, Err(DemError::Usage { .. })));
    }
}

#[test]
fn a_name_opens_the_terrain_that_it_tells() {
    let name = "synth:size=40,seed=12,spacing=0.5";
    let mut opened = open(Path::new(name), &OpenOptions::default()).unwrap();
    assert_eq!(opened.info().path, Path::new(name));
    assert_eq!(opened.info().placement.dx, 0.5);
    let mut out = vec![0.0; 1600];
    opened.read_rows(0, 40, &mut out).unwrap();
    assert_eq!(
        out,
        rows(&mut SynthSource::with_spacing_cm(40, 12, 50), 0, 40)
    );
}

#[test]
fn a_name_that_tells_no_terrain_is_refused_with_what_was_wrong() {
    for (name, word) in [
        ("synth:", "\"\""),
        ("synth:seed=1", "no size"),
        ("synth:size=0", "size=0"),
        ("synth:size=4194305", "4194304"),
        ("synth:size=-1", "size=-1"),
        ("synth:size=9,seed=x", "seed=x"),
        ("synth:size=9,spacing=0", "spacing=0"),
        ("synth:size=9,spacing=0.001", "centimetres"),
        ("synth:size=9,spacing=nan", "spacing=nan"),
        ("synth:size=9,colour=1", "colour=1"),
    ] {
        let error = open(Path::new(name), &OpenOptions::default())
            .err()
            .unwrap();
        assert!(matches!(error, DemError::Usage { .. }), "{name}");
        assert!(error.to_string().contains(word), "{name}: {error}");
    }
}

const GOLDEN: u64 = 0xb8d3_57bb_26de_fa0e;
