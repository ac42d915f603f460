//! What an update costs, what it refuses, and what it leaves alone.

use crate::case::{Case, Part, higher, nothing, part, same};
use escarp_tests::files::{contents, files};
use escarp_tests::terrain::{TempDataset, hills, read_samples};
use escarp_tiles::dataset::DatasetWriter;
use escarp_tiles::dem::{DemError, DemInfo, DemSource};
use escarp_tiles::update::{Edit, update};

#[test]
fn an_update_writes_what_the_patch_costs_and_shares_the_rest() {
    let data = TempDataset::of(1100, 1000, hills);
    let whole = std::fs::metadata(data.path().join("seg-1-0"))
        .unwrap()
        .len();
    let case = Case {
        size: [1100, 1000],
        base: hills,
        patches: vec![([400, 400, 404, 403], higher)],
        removed: vec![],
    };
    let report = case.apply(&data.dataset).unwrap();
    assert_eq!((report.changed, report.added, report.removed), (20, 0, 0));
    // The four pages around a corner, and one of each of the two levels above.
    assert!(report.families == 3 && report.pages == 6, "{report:?}");
    assert!(report.bytes < whole / 10, "{report:?} of {whole}");
    let names = [
        "CURRENT",
        "index-1",
        "index-2",
        "manifest-1.json",
        "manifest-2.json",
        "seg-1-0",
        "seg-2-0",
    ];
    assert_eq!(files(&data.path()), names);
    assert!(
        data.open()
            .manifest()
            .segments
            .iter()
            .any(|s| s.file == "seg-1-0")
    );
}

#[test]
fn a_patch_that_changes_nothing_publishes_nothing() {
    let data = TempDataset::of(200, 150, hills);
    let before = contents(&data.path());
    let case = Case {
        size: [200, 150],
        base: hills,
        patches: vec![([20, 30, 120, 90], hills), ([0, 0, 199, 149], nothing)],
        removed: vec![],
    };
    let report = case.apply(&data.dataset).unwrap();
    assert_eq!((report.changed, report.generation), (0, 1));
    assert!(contents(&data.path()) == before);
}

#[test]
fn a_patch_in_a_wrong_place_is_refused_and_nothing_is_left_behind() {
    let data = TempDataset::of(200, 150, hills);
    let before = contents(&data.path());
    let refuse = |change: fn(&mut DemInfo), words: &str| {
        let mut patch = part([200, 150], [20, 30, 120, 90], higher);
        change(&mut patch.info);
        let edit = Edit {
            patches: vec![&mut patch],
            remove: vec![],
            sources: vec![],
        };
        let error = update(&data.dataset, edit, &|_, _| {})
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("function") && error.contains(words),
            "{error}"
        );
    };
    refuse(|info| info.placement.x0 += 4.0, "whole numbers");
    refuse(|info| info.placement.y0 += 1e-1 * 4.0, "whole numbers");
    refuse(|info| info.placement.dx = 11.0, "samples 11 m apart");
    refuse(|info| info.placement.x0 -= 210.0, "it covers columns -1");
    refuse(
        |info| info.placement.y0 += 600.0,
        "dataset has 0 to 199 and 0 to 149",
    );
    refuse(
        |info| {
            info.crs = escarp_tiles::dem::Crs::Projected {
                name: "EPSG:32633".into(),
                metres_per_unit: 1.0,
            }
        },
        "EPSG:32633",
    );
    for (remove, words) in [
        ([0.0, 0.0, 1.0, 1.0], "no sample"),
        ([-1e9, -1e9, 1e9, 1e9], "data"),
    ] {
        let edit = Edit {
            patches: vec![],
            remove: vec![remove],
            sources: vec![],
        };
        let error = update(&data.dataset, edit, &|_, _| {})
            .unwrap_err()
            .to_string();
        assert!(error.contains(words), "{error}");
    }
    assert!(
        contents(&data.path()) == before,
        "{:?}",
        files(&data.path())
    );
}

/// A patch whose file ends in the middle.
struct CutShort(Part);

impl DemSource for CutShort {
    fn info(&self) -> &DemInfo {
        self.0.info()
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        if first_row > 0 {
            return Err(DemError::Damaged {
                path: "cut.tif".into(),
                place: "row 100".into(),
                found: "the end".into(),
                expected: "more".into(),
            });
        }
        self.0.read_rows(first_row, rows, out)
    }
}

#[test]
fn an_update_that_fails_or_was_killed_leaves_what_was_published() {
    let data = TempDataset::of(400, 600, hills);
    let before = contents(&data.path());
    let mut patch = CutShort(part([400, 600], [20, 30, 120, 590], higher));
    let edit = Edit {
        patches: vec![&mut patch],
        remove: vec![],
        sources: vec![],
    };
    let error = update(&data.dataset, edit, &|_, _| {}).unwrap_err();
    assert!(error.to_string().contains("cut.tif"), "{error}");
    assert!(contents(&data.path()) == before);
    // As a killed one leaves it: the next one is not in its way.
    std::fs::write(data.path().join("seg-2-0"), b"half a family").unwrap();
    std::fs::write(data.path().join("index-2"), b"ESCARP").unwrap();
    assert_eq!(read_samples(&data.open()), data.samples);
    let case = Case {
        size: [400, 600],
        base: hills,
        patches: vec![([20, 30, 120, 590], higher)],
        removed: vec![],
    };
    case.apply(&data.dataset).unwrap();
    let rebuilt = TempDataset::of(400, 600, |x, y| case.merged(x, y));
    same(&data.open(), &rebuilt.dataset, "after a killed one");
}

#[test]
fn an_update_waits_for_nobody_and_spoils_nobodys_work() {
    let data = TempDataset::of(200, 150, hills);
    let case = Case {
        size: [200, 150],
        base: hills,
        patches: vec![([20, 30, 40, 50], higher)],
        removed: vec![],
    };
    let writer = DatasetWriter::create(&data.path(), true).unwrap();
    let error = case.apply(&data.dataset).unwrap_err().to_string();
    assert!(error.contains("another program is writing"), "{error}");
    drop(writer);
    case.apply(&data.dataset).unwrap();
    // What is open is no more the published generation.
    let error = case.apply(&data.dataset).unwrap_err().to_string();
    assert!(error.contains("published meanwhile"), "{error}");
    // An unfinished build of a replacement lies there: a night's work.
    std::fs::write(data.path().join("resume-3"), b"something").unwrap();
    let error = case.apply(&data.open()).unwrap_err().to_string();
    assert!(error.contains("--resume"), "{error}");
    assert!(data.path().join("resume-3").exists());
}
