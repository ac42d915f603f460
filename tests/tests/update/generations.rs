//! Generations that share files: compacted, read after each other, and damaged.

use crate::case::{records, same, updated_often};
use escarp_tests::files::{Copy, files, flip};
use escarp_tests::terrain::{TempDataset, read_samples};
use escarp_tiles::dataset::{Dataset, DatasetError};
use escarp_tiles::update::compact;

#[test]
fn compacting_drops_old_generations_and_keeps_every_record() {
    let data = updated_often();
    let (open, before) = (data.open(), records(&data.open()));
    // First only what no manifest names.
    let report = compact(&open, 1.0, &|_, _| {}).unwrap();
    assert_eq!((report.generation, report.segments), (6, 0));
    assert!(report.bytes_after < report.bytes_before);
    assert!(records(&data.open()) == before);
    assert!(!data.path().join("manifest-5.json").exists());
    // Then all that is dead.
    let report = compact(&data.open(), 0.0, &|_, _| {}).unwrap();
    assert!(report.segments > 0 && report.generation == 7, "{report:?}");
    assert!(records(&data.open()) == before && records(&open) == before);
    let samples = read_samples(&data.open());
    let rebuilt = TempDataset::of(600, 500, |x, y| {
        let at = (499 - y) * 600 + x;
        samples[at as usize].map_or(f64::NAN, f64::from)
    });
    same(&data.open(), &rebuilt.dataset, "compacted");
    let live: u64 = data
        .open()
        .families()
        .map(|entry| u64::from(entry.bytes))
        .sum();
    let segments: u64 = data
        .open()
        .manifest()
        .segments
        .iter()
        .map(|s| s.bytes)
        .sum();
    assert_eq!(live, segments);
    // There is nothing more to gain.
    let again = compact(&data.open(), 0.0, &|_, _| {}).unwrap();
    assert_eq!(
        (again.bytes_before, again.bytes_after),
        (report.bytes_after, report.bytes_after)
    );
}

#[test]
fn an_old_generation_can_be_opened_until_it_is_compacted() {
    let data = updated_often();
    let first = Dataset::open_generation(&data.path(), 1).unwrap();
    assert_eq!(read_samples(&first), data.samples);
    assert_eq!(
        Dataset::open_generation(&data.path(), 6)
            .unwrap()
            .manifest()
            .generation,
        6
    );
    let error = Dataset::open_generation(&data.path(), 7).unwrap_err();
    assert!(matches!(error, DatasetError::Usage { .. }), "{error}");
    compact(&data.open(), 0.25, &|_, _| {}).unwrap();
    let error = Dataset::open_generation(&data.path(), 1)
        .unwrap_err()
        .to_string();
    assert!(error.contains("no generation 1"), "{error}");
}

#[test]
fn a_changed_byte_in_any_shared_or_new_file_is_found_and_its_file_named() {
    let data = updated_often();
    let named: Vec<String> = data
        .open()
        .manifest()
        .segments
        .iter()
        .map(|s| s.file.clone())
        .collect();
    let copy = Copy::of(&data.path());
    for (round, name) in files(&data.path()).into_iter().enumerate() {
        let sound = std::fs::read(copy.path().join(&name)).unwrap();
        let counts = named.contains(&name) || name.contains("-6");
        for flips in 0..3 {
            let mut at = 0;
            copy.change(&name, |bytes| at = flip(bytes, round as u32 * 100 + flips));
            match copy.verdict() {
                Err(error) => assert!(
                    error.contains(&name) || name == "CURRENT",
                    "{name}: {error}"
                ),
                // Of old generations, or of records that are dead.
                Ok(_) => assert!(!counts || name.starts_with("seg-"), "{name}, byte {at}"),
            }
            std::fs::write(copy.path().join(&name), &sound).unwrap();
        }
    }
    copy.verdict().expect("it is sound again");
}

#[test]
fn shared_segments_that_are_swapped_cut_short_or_gone_are_found() {
    let data = updated_often();
    let named: Vec<String> = data
        .open()
        .manifest()
        .segments
        .iter()
        .map(|s| s.file.clone())
        .collect();
    assert!(named.len() > 2, "{named:?}");
    for pair in named.windows(2) {
        let copy = Copy::of(&data.path());
        let (a, b) = (copy.path().join(&pair[0]), copy.path().join(&pair[1]));
        let keep = copy.path().join("seg-0-0");
        std::fs::rename(&a, &keep).unwrap();
        std::fs::rename(&b, &a).unwrap();
        std::fs::rename(&keep, &b).unwrap();
        let error = copy.verdict().expect_err("swapped segments");
        assert!(pair.iter().any(|name| error.contains(name)), "{error}");
        std::fs::remove_file(&a).unwrap();
        assert!(
            copy.verdict()
                .expect_err("a missing one")
                .contains(&pair[0])
        );
    }
    let copy = Copy::of(&data.path());
    copy.change(&named[0], |bytes| bytes.truncate(bytes.len() / 2));
    assert!(copy.verdict().expect_err("a short one").contains(&named[0]));
}
