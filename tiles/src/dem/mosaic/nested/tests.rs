//! A fine patch in a coarse base, from files to a dataset.

use super::super::super::testing::{Folder, Tag, Tiff};
use super::super::{JoinOptions, Mosaic, Priority, Seam};
use crate::build::{BuildOptions, Coarsened, Quantum, Tolerances, build};
use crate::dataset::Dataset;
use crate::dem::{DemError, DemSource, OpenOptions, SampleType, open};
use crate::verify::{Share, verify};
use std::path::{Path, PathBuf};

/// Metres between samples of the patch.
const FINE_M: f64 = 5.0;

fn grid(folder: &Folder, name: &str, at: [f64; 2], step_m: f64, side: u32, seed: i32) -> PathBuf {
    // The reader moves a cell's corner to its centre.
    let corner = [at[0] - step_m / 2.0, at[1] + step_m / 2.0];
    let tiff = Tiff::plain(side, side, SampleType::I16)
        .with(
            33922,
            Tag::Double(vec![0.0, 0.0, 0.0, corner[0], corner[1], 0.0]),
        )
        .with(33550, Tag::Double(vec![step_m, step_m, 0.0]));
    let rough = move |row: i32, column: i32| {
        let mixed = (row * 7919 + column * 104_729 + seed).wrapping_mul(0x9E37) >> 7;
        f64::from(3 * row - 2 * column + mixed.rem_euclid(61))
    };
    folder.write(
        name,
        &tiff.bytes(|row, column| rough(row as i32, column as i32)),
    )
}

/// A base of 65 x 65 samples, and a patch over 8 x 8 of its cells.
fn files(folder: &Folder, ratio: u32) -> [PathBuf; 2] {
    let step_m = FINE_M * f64::from(ratio);
    let origin = [500_000.0, 5_000_000.0];
    let at = [origin[0] + 20.0 * step_m, origin[1] - 30.0 * step_m];
    [
        grid(folder, "base.tif", origin, step_m, 65, 1),
        grid(folder, "patch.tif", at, FINE_M, 8 * ratio + 1, 5),
    ]
}

fn mosaic(paths: &[PathBuf], join: JoinOptions) -> Result<Mosaic, DemError> {
    Mosaic::open(paths, &OpenOptions::default(), join)
}

fn read(source: &mut dyn DemSource) -> Vec<f64> {
    let (width, height) = (source.info().width, source.info().height);
    let mut out = vec![0.0; (width * height) as usize];
    source.read_rows(0, height, &mut out).unwrap();
    out
}

/// A dataset as the command line builds it.
fn built(folder: &Path, name: &str, source: Box<dyn DemSource>) -> Dataset {
    let info = source.info().clone();
    let tolerances = Tolerances::open(&[], &info).unwrap();
    let tolerances = tolerances.with_base(None, 1.0, &info).unwrap();
    let mut source = Coarsened::new(source, 1.0, tolerances).unwrap();
    let path = folder.join(name);
    let options = BuildOptions {
        quantum: Quantum::Metres(1.0),
        ..BuildOptions::default()
    };
    build(&mut source, &path, Vec::new(), options, &|_, _| {}).unwrap();
    let dataset = Dataset::open(&path).unwrap();
    let report = verify(&dataset, Share::Full, &|_, _| {}).unwrap();
    assert!(report.broken.is_empty(), "{:?}", report.broken);
    dataset
}

#[test]
fn at_the_spacing_of_page_corners_a_base_and_a_patch_cost_what_they_cost_alone() {
    let folder = Folder::new();
    let paths = files(&folder, 16);
    let joined = mosaic(&paths, JoinOptions::default()).unwrap();
    let nested = built(folder.path(), "nested.escarp", Box::new(joined));
    let alone = |path: &PathBuf, name: &str| {
        let source = open(path, &OpenOptions::default()).unwrap();
        built(folder.path(), name, source).total_bytes()
    };
    let parts = alone(&paths[0], "base.escarp") + alone(&paths[1], "patch.escarp");
    let bytes = nested.total_bytes();
    assert!(bytes * 10 < parts * 13, "{bytes} bytes, {parts} alone");
    let [elsewhere, base] = &nested.manifest().tolerances[..] else {
        panic!()
    };
    assert_eq!((elsewhere.largest_error_m, base.tolerance_m), (0.0, 2.0));
    assert_eq!(base.region.as_deref(), Some("coarser inputs"));
    assert!(base.largest_error_m <= 1.5 + 1e-9);
}

#[test]
fn samples_of_both_inputs_are_exact_and_those_between_keep_to_the_stated_error() {
    for ratio in [4, 16] {
        let folder = Folder::new();
        let paths = files(&folder, ratio);
        let mut source = mosaic(&paths, JoinOptions::default()).unwrap();
        let plain = read(&mut source);
        let info = source.info().clone();
        let tolerances = Tolerances::open(&[], &info).unwrap();
        let tolerances = tolerances.with_base(None, 1.0, &info).unwrap();
        let mut coarse = Coarsened::new(Box::new(source), 1.0, tolerances).unwrap();
        let stored = read(&mut coarse);
        let stated_m = coarse.tolerances()[1].largest_error_m;
        let [base, patch] =
            paths.map(|path| read(&mut *open(&path, &OpenOptions::default()).unwrap()));
        let (side, across) = (64 * ratio + 1, 8 * ratio + 1);
        let (west, north) = (20 * ratio, 30 * ratio);
        let mut seen = [0, 0];
        for (at, height) in stored.iter().enumerate() {
            let (x, y) = (at as u32 % side, at as u32 / side);
            let (u, v) = (x.wrapping_sub(west), y.wrapping_sub(north));
            if u < across && v < across {
                assert_eq!(*height, patch[(v * across + u) as usize], "{x} {y}");
                seen[0] += 1;
            } else if x.is_multiple_of(ratio) && y.is_multiple_of(ratio) {
                assert_eq!(
                    *height,
                    base[(y / ratio * 65 + x / ratio) as usize],
                    "{x} {y}"
                );
                seen[1] += 1;
            }
            assert!((height - plain[at]).abs() <= stated_m, "{x} {y}");
        }
        assert_eq!(seen, [across * across, 65 * 65 - 81]);
    }
}

#[test]
fn the_finest_counts_unless_another_order_is_asked_for() {
    let folder = Folder::new();
    let [base, patch] = files(&folder, 4);
    let under = |paths: &[PathBuf], priority| {
        let seam = Seam::Exact;
        read(&mut mosaic(paths, JoinOptions { priority, seam }).unwrap())
    };
    let (forth, back) = ([base.clone(), patch.clone()], [patch, base]);
    let fine = under(&forth, Priority::Finest);
    assert!(fine == under(&back, Priority::Finest));
    assert!(fine == under(&back, Priority::First) && fine == under(&forth, Priority::Last));
    let coarse = under(&forth, Priority::First);
    assert!(fine != coarse && coarse == under(&back, Priority::Last));
    let blend = JoinOptions {
        seam: Seam::Blend(3),
        ..JoinOptions::default()
    };
    let blended = read(&mut mosaic(&forth, blend).unwrap());
    let inside = (0..blended.len()).filter(|&at| fine[at] != coarse[at]);
    let moved = (0..blended.len()).filter(|&at| blended[at] != fine[at]);
    let moved: Vec<usize> = moved.collect();
    assert!(moved.len() > 100 && moved.len() < inside.count());
}

#[test]
fn rows_and_grains_do_not_depend_on_the_bands_that_are_asked_for() {
    let folder = Folder::new();
    let mut source = mosaic(&files(&folder, 16), JoinOptions::default()).unwrap();
    let all = read(&mut source);
    let width = source.info().width;
    let mut grains = vec![super::Grain::Finest; all.len()];
    let height = source.info().height;
    source.grains(0, height, &mut grains).unwrap();
    assert!(grains.contains(&super::Grain::Facets(16)));
    for row in (0..height).rev().step_by(37) {
        let at = (row * width) as usize..((row + 1) * width) as usize;
        let mut line = vec![0.0; width as usize];
        source.read_rows(row, 1, &mut line).unwrap();
        assert!(line == all[at.clone()], "row {row}");
        let mut line = vec![super::Grain::Finest; width as usize];
        source.grains(row, 1, &mut line).unwrap();
        assert!(line == grains[at], "row {row}");
    }
}

#[test]
fn nearly_equal_spacings_and_grids_beyond_any_dataset_are_refused() {
    let folder = Folder::new();
    let origin = [500_000.0, 5_000_000.0];
    let fine = grid(&folder, "fine.tif", origin, 5.0, 9, 1);
    let near = grid(&folder, "near.tif", origin, 6.0, 9, 1);
    let refused = |paths: &[PathBuf]| {
        let error = mosaic(paths, JoinOptions::default()).err().unwrap();
        error.to_string()
    };
    let text = refused(&[fine.clone(), near]);
    assert!(
        text.contains("near.tif") && text.contains("1.5 times"),
        "{text}"
    );
    let vast = grid(&folder, "vast.tif", origin, 200_000.0, 9, 1);
    let text = refused(&[fine, vast]);
    assert!(
        text.contains("fine.tif") && text.contains("68719476736"),
        "{text}"
    );
}
