//! Building and verifying: every bound of every shape, the same bytes each time, and no half-built
//! dataset taken for a whole one.

use escarp_tests::files::{Copy, contents as bytes, files};
use escarp_tests::terrain::{
    FunctionSource, Heights, TempDataset, build_with, cliff, hash, hills, holed_hills,
    read_samples, spike,
};
use escarp_tiles::build::{BuildError, Quantum};
use escarp_tiles::dataset::{Dataset, DatasetError, DatasetWriter, FamilyBytes, FamilyId};
use escarp_tiles::dem::{DemError, DemInfo, DemSource};
use escarp_tiles::verify::{Share, compare, verify};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Builds a dataset, verifies all of it, and holds it against its source.
fn check(name: &str, width: u32, height: u32, quantum: Quantum, heights: Heights) {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("checked.escarp");
    let mut source = FunctionSource::new(width, height, heights);
    let what = format!("{name}, {width} x {height}");
    let manifest = build_with(&path, &mut source, quantum, false);
    let manifest = manifest.unwrap_or_else(|error| panic!("{what}: {error}"));
    let dataset = Dataset::open(&path).unwrap_or_else(|error| panic!("{what}: {error}"));
    assert_eq!(dataset.manifest(), &manifest, "{what}");
    let report = verify(&dataset, Share::Full, &|_, _| {}).expect("checksums match");
    assert_eq!(report.broken, Vec::<String>::new(), "{what}");
    assert!(report.largest_ratio <= 1.0, "{what}: {report:?}");
    assert_eq!(report.records, manifest.pages, "{what}");
    let found = compare(&dataset, &mut source, &|_, _| {}).expect("sizes match");
    assert!(
        found.largest_difference_m <= manifest.storage_error_m,
        "{what}: {found:?}"
    );
    assert_eq!(found.invented, 0, "{what}");
    // One sample in a row or column of its own, or among holes, is part of no surface.
    let lone = width == 1 || height == 1 || name.contains("holes");
    assert!(lone || found.missing == 0, "{what}: {found:?}");
}

#[test]
fn every_bound_holds_for_every_terrain_and_size() {
    let terrains: [(&str, Heights); 6] = [
        ("hills", hills),
        ("holes", holed_hills),
        ("cliff", cliff),
        ("spike", spike),
        ("noise", |x, y| f64::from(hash(x, y) % 40_000) - 20_000.0),
        ("flat", |_, _| -7.0),
    ];
    for (name, heights) in terrains {
        check(name, 257, 300, Quantum::Natural, heights);
        for [width, height] in [[2, 2], [16, 17], [17, 17], [18, 18], [33, 5], [5, 270]] {
            if name != "holes" {
                check(name, width, height, Quantum::Natural, heights);
            }
        }
    }
}

#[test]
fn one_row_one_column_and_one_sample_are_built() {
    for [width, height] in [[300, 1], [1, 300], [1, 1], [17, 1], [1, 16]] {
        check("hills", width, height, Quantum::Natural, hills);
    }
}

#[test]
fn heights_from_trench_to_summit_are_stored_in_millimetres() {
    let heights = |x: u32, y: u32| f64::from(hash(x, y)) / f64::from(u32::MAX) * 20_000.0 - 11e3;
    check("millimetres", 150, 90, Quantum::Metres(1e-3), heights);
}

#[test]
fn heights_that_do_not_fit_stop_the_build_and_are_named() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("unfit.escarp");
    let mut source = FunctionSource::new(120, 90, spike);
    let error = build_with(&path, &mut source, Quantum::Metres(0.1), false).unwrap_err();
    let text = error.to_string();
    assert!(matches!(error, BuildError::Unfit { .. }), "{text}");
    assert!(
        text.contains("column 101") && text.contains("row 67"),
        "{text}"
    );
    refused(&path);
}

#[test]
fn an_input_without_any_data_is_refused() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("empty.escarp");
    let mut source = FunctionSource::new(40, 30, |_, _| f64::NAN);
    let error = build_with(&path, &mut source, Quantum::Natural, false).unwrap_err();
    assert!(error.to_string().contains("hole"), "{error}");
    refused(&path);
}

/// The folder is there, but is not taken for a dataset, and a message says so.
fn refused(path: &Path) {
    let error = Dataset::open(path).expect_err("no finished dataset");
    assert!(matches!(error, DatasetError::NotADataset { .. }), "{error}");
    let text = error.to_string();
    assert!(
        text.contains(&path.display().to_string()) && text.contains("build"),
        "{text}"
    );
}

#[test]
fn building_again_gives_the_same_bytes_whatever_the_number_of_threads() {
    let folder = TempDir::new().unwrap();
    let build = |threads: usize| {
        let path = folder.path().join(format!("{threads}.escarp"));
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let mut source = FunctionSource::new(700, 610, holed_hills);
        pool.install(|| build_with(&path, &mut source, Quantum::Natural, false))
            .unwrap();
        bytes(&path)
    };
    let one = build(1);
    assert!(
        one.len() >= 4,
        "{:?}",
        one.iter().map(|(name, _)| name).collect::<Vec<_>>()
    );
    for threads in [2, 3, 8] {
        assert!(build(threads) == one, "{threads} threads");
    }
}

#[test]
fn a_dataset_is_replaced_only_if_so_wished() {
    let data = TempDataset::of(100, 80, hills);
    let before = bytes(&data.path());
    let mut source = FunctionSource::new(60, 50, cliff);
    let error = build_with(&data.path(), &mut source, Quantum::Natural, false).unwrap_err();
    assert!(error.to_string().contains("--overwrite"), "{error}");
    assert!(
        bytes(&data.path()) == before,
        "the refused build left something behind"
    );
    let manifest = build_with(&data.path(), &mut source, Quantum::Natural, true).unwrap();
    assert_eq!((manifest.generation, manifest.samples), (2, [60, 50]));
    assert!(
        files(&data.path()).iter().all(|name| !name.contains("-1")),
        "the old one is left"
    );
    // Whoever had the old one open goes on with it.
    assert_eq!(read_samples(&data.dataset), data.samples);
}

#[test]
fn files_of_others_are_never_written_over() {
    let folder = TempDir::new().unwrap();
    std::fs::write(folder.path().join("thesis.txt"), "years of work").unwrap();
    let mut source = FunctionSource::new(60, 50, hills);
    let error = build_with(folder.path(), &mut source, Quantum::Natural, true).unwrap_err();
    assert!(error.to_string().contains("other files"), "{error}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

/// A terrain whose file ends in the middle.
struct CutShort(FunctionSource<Heights>);

impl DemSource for CutShort {
    fn info(&self) -> &DemInfo {
        self.0.info()
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        if first_row + rows > 300 {
            return Err(DemError::Damaged {
                path: PathBuf::from("cut.tif"),
                place: "row 300".into(),
                found: "the end".into(),
                expected: "more".into(),
            });
        }
        self.0.read_rows(first_row, rows, out)
    }
}

#[test]
fn a_build_that_fails_on_the_way_leaves_what_was_published() {
    let data = TempDataset::of(100, 80, hills);
    let mut source = CutShort(FunctionSource::new(400, 600, hills));
    let error = build_with(&data.path(), &mut source, Quantum::Natural, true).unwrap_err();
    assert!(error.to_string().contains("cut.tif") && error.to_string().contains("row 300"));
    assert_eq!(read_samples(&data.open()), data.samples);
    // Without one before, there is none after.
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("new.escarp");
    build_with(&path, &mut source, Quantum::Natural, false).unwrap_err();
    refused(&path);
}

#[test]
fn an_interrupted_build_is_refused_and_the_next_build_replaces_it() {
    let data = TempDataset::of(100, 80, hills);
    let whole = bytes(&data.path());
    // As after a crash: everything but the last step is there, and a little of a next try.
    let copy = Copy::of(&data.path());
    std::fs::remove_file(copy.path().join("CURRENT")).unwrap();
    std::fs::write(copy.path().join("seg-2-0"), b"half a segm").unwrap();
    std::fs::write(copy.path().join(".tmpAbc123"), b"escarp 1\ngener").unwrap();
    refused(&copy.path());
    let mut source = FunctionSource::new(100, 80, hills);
    build_with(&copy.path(), &mut source, Quantum::Natural, false).expect("no --overwrite needed");
    assert!(bytes(&copy.path()) == whole, "{:?}", files(&copy.path()));
}

#[test]
fn a_writer_that_goes_before_it_publishes_leaves_no_dataset() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("dropped.escarp");
    let mut writer = DatasetWriter::create(&path, false).unwrap();
    let slot = escarp_proto::geometry::Slot::at(0, 0);
    let family = FamilyBytes::encode(FamilyId::ROOT, &[(slot, vec![1, 2, 3])]);
    writer.append(&family.unwrap()).unwrap();
    drop(writer);
    refused(&path);
    let mut source = FunctionSource::new(60, 50, hills);
    build_with(&path, &mut source, Quantum::Natural, false).expect("nothing stands in its way");
    Dataset::open(&path).expect("it is whole");
}

#[test]
fn a_second_writer_is_refused_while_one_is_at_work() {
    let data = TempDataset::of(60, 50, hills);
    let writer = DatasetWriter::create(&data.path(), true).unwrap();
    let error = DatasetWriter::create(&data.path(), true).unwrap_err();
    assert!(matches!(error, DatasetError::Usage { .. }), "{error}");
    assert!(
        error.to_string().contains("another program is writing"),
        "{error}"
    );
    // Readers are not in its way, nor it in theirs.
    assert_eq!(read_samples(&data.open()), data.samples);
    drop(writer);
    DatasetWriter::create(&data.path(), true).expect("the first one is gone");
}
