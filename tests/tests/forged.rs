//! Damage that checksums do not tell, and damaged files that not every dataset has: each is
//! refused with its place, or does no harm.

use escarp_tests::files::{Copy, files, flip};
use escarp_tests::terrain::{FunctionSource, TempDataset, hills};
use escarp_tiles::build::{BuildOptions, build};
use escarp_tiles::dataset::{Dataset, Figures};
use escarp_tiles::dem::Filled;
use escarp_tiles::update::{Edit, update};
use std::fs;
use std::path::Path;

/// A dataset with a filled void.
fn filled() -> TempDataset {
    let holed = |column: u32, row: u32| match (40..60).contains(&column) && row % 30 < 9 {
        true => f64::NAN,
        false => hills(column, row),
    };
    let source = Box::new(FunctionSource::new(100, 80, holed));
    let mut source = Filled::new(source, 1 << 18, &|_, _| {}).expect("voids are filled");
    let data = TempDataset::build(&mut source);
    assert!(data.dataset.manifest().filled.is_some());
    data
}

/// A dataset of two generations, the second of which shares the first one's segment.
fn updated() -> TempDataset {
    let data = TempDataset::of(600, 600, hills);
    let edit = Edit {
        patches: Vec::new(),
        remove: vec![[1100.0, 2100.0, 1200.0, 2200.0]],
        sources: Vec::new(),
    };
    update(&data.dataset, edit, &|_, _| {}).expect("an update");
    let names = files(&data.path());
    assert!(names.contains(&"seg-1-0".into()) && names.contains(&"seg-2-0".into()));
    data
}

fn refused(copy: &Copy, name: &str, what: &str) {
    let error = copy.verdict().expect_err(what);
    assert!(error.contains(name), "{what}: {name} is not named: {error}");
}

#[test]
fn a_changed_or_cut_file_of_fills_is_refused_by_name() {
    let data = filled();
    let copy = Copy::of(&data.path());
    let path = copy.path().join("filled-1");
    let sound = fs::read(&path).unwrap();
    for round in 0..200 {
        copy.change("filled-1", |bytes| _ = flip(bytes, round));
        refused(&copy, "filled-1", &format!("round {round}"));
        fs::write(&path, &sound).unwrap();
    }
    for length in 0..sound.len() {
        fs::write(&path, &sound[..length]).unwrap();
        refused(&copy, "filled-1", &format!("{length} bytes"));
    }
    fs::write(&path, &sound).unwrap();
    copy.verdict().expect("it is sound again");
}

#[test]
fn each_file_of_an_update_is_checked_and_old_generations_do_no_harm() {
    let data = updated();
    let published = ["index-2", "manifest-2.json", "seg-1-0", "seg-2-0"];
    for name in published {
        for round in 0..40 {
            let copy = Copy::of(&data.path());
            let is_dead = |copy: &Copy| name == "seg-1-0" && copy.verdict().is_ok();
            copy.change(name, |bytes| _ = flip(bytes, round));
            // What an update replaced lies in the old segment, and nobody reads it any more.
            if !is_dead(&copy) {
                refused(&copy, name, &format!("{name}, round {round}"));
            }
        }
        let copy = Copy::of(&data.path());
        copy.change(name, |bytes| bytes.truncate(bytes.len() - 1));
        refused(&copy, name, "one byte less");
        fs::remove_file(copy.path().join(name)).unwrap();
        refused(&copy, name, "no file");
    }
    let copy = Copy::of(&data.path());
    for name in ["manifest-1.json", "index-1"] {
        copy.change(name, |bytes| _ = flip(bytes, 7));
    }
    copy.verdict().expect("generation 2 needs neither");
    let error = Dataset::open_generation(&copy.path(), 1).unwrap_err();
    assert!(error.to_string().contains("-1"), "{error}");
}

#[test]
fn segments_of_two_generations_that_changed_places_are_refused() {
    let data = updated();
    let copy = Copy::of(&data.path());
    let place = |name: &str| copy.path().join(name);
    fs::rename(place("seg-1-0"), place("other")).unwrap();
    fs::rename(place("seg-2-0"), place("seg-1-0")).unwrap();
    fs::rename(place("other"), place("seg-2-0")).unwrap();
    refused(&copy, "seg-", "swapped segments");
}

#[test]
fn a_manifest_under_the_name_of_another_generation_is_refused() {
    let data = updated();
    let copy = Copy::of(&data.path());
    let (first, second) = ("manifest-1.json", "manifest-2.json");
    fs::copy(copy.path().join(second), copy.path().join(first)).unwrap();
    let error = Dataset::open_generation(&copy.path(), 1)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains(first) && error.contains("generation 2"),
        "{error}"
    );
    copy.verdict().expect("the published generation is sound");
}

#[test]
fn figures_of_a_build_that_make_no_sense_are_passed_over() {
    let data = TempDataset::of(40, 30, hills);
    let path = data.path().join("build-1.json");
    let nested = "[".repeat(60_000);
    let long = format!("{{\"wall_s\": 1{}", " ".repeat(1 << 20));
    for text in [
        "",
        "{",
        "null",
        "{\"wall_s\": \"x\"}",
        &nested,
        &long,
        "\u{0}",
    ] {
        fs::write(&path, text).unwrap();
        assert_eq!(Figures::of(&data.dataset), None, "{:.40}", text);
        Copy::of(&data.path())
            .verdict()
            .expect("nothing depends on it");
    }
    fs::remove_file(&path).unwrap();
    fs::create_dir(&path).unwrap();
    assert_eq!(Figures::of(&data.dataset), None);
}

/// Builds over whatever lies in a folder.
fn overwrite(folder: &Path) -> Result<(), String> {
    let mut source = FunctionSource::new(40, 30, hills);
    let options = BuildOptions {
        overwrite: true,
        ..BuildOptions::default()
    };
    build(&mut source, folder, Vec::new(), options, &|_, _| {})
        .map(|_| ())
        .map_err(|error| error.to_string())
}

#[test]
fn a_generation_after_which_there_is_none_is_refused() {
    let data = TempDataset::of(40, 30, hills);
    for generation in [0, u64::MAX, u64::MAX - 1] {
        let copy = Copy::of(&data.path());
        let text = format!("escarp 1\ngeneration {generation}\nmanifest 800 01234567\n");
        fs::write(copy.path().join("CURRENT"), text).unwrap();
        refused(&copy, "CURRENT", &format!("generation {generation}"));
        // What is damaged can be built anew, under a number that was not there.
        overwrite(&copy.path()).expect("a build over it");
        copy.verdict().expect("it is sound again");
    }
}

#[test]
fn a_file_with_the_number_of_no_generation_is_somebody_elses() {
    let data = TempDataset::of(40, 30, hills);
    for name in ["seg-18446744073709551615-0", "resume-18446744073709551616"] {
        let copy = Copy::of(&data.path());
        fs::write(copy.path().join(name), "x").unwrap();
        copy.verdict().expect("a reader does not mind");
        let error = overwrite(&copy.path()).unwrap_err();
        assert!(error.contains("other files"), "{error}");
        assert!(copy.path().join(name).exists());
    }
}
