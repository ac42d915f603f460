//! Updates: a dataset that was patched is the one that would have been built from the merged
//! inputs, page for page; it costs what the patch costs; and no reader of it is disturbed.

use escarp_proto::geometry::PageId;
use escarp_tests::files::{Copy, contents, files, flip};
use escarp_tests::terrain::{
    FunctionSource, Heights, TempDataset, cliff, hash, hills, holed_hills, read_samples,
};
use escarp_tiles::build::BuildError;
use escarp_tiles::dataset::{Dataset, DatasetError, DatasetWriter};
use escarp_tiles::dem::{DemError, DemInfo, DemSource, Filled};
use escarp_tiles::update::{Edit, UpdateReport, compact, update};
use escarp_tiles::verify::{Share, verify};
use proptest::prelude::*;
use std::collections::BTreeMap;

/// Samples of a grid, ends included: west, south, east, north.
type Rectangle = [u32; 4];

/// A part of a function's grid, as a source of its own.
struct Part {
    info: DemInfo,
    whole: [u32; 2],
    place: Rectangle,
    heights: Box<dyn Fn(u32, u32) -> f64 + Send>,
}

/// The patch of a grid of `whole` samples that covers a rectangle; heights by column and row of
/// the whole grid, row 0 the northern one.
fn part(
    whole: [u32; 2],
    place: Rectangle,
    heights: impl Fn(u32, u32) -> f64 + Send + 'static,
) -> Part {
    let mut info = FunctionSource::new(whole[0], whole[1], hills)
        .info()
        .clone();
    let [west, south, east, north] = place;
    info.placement.x0 += f64::from(west) * info.placement.dx;
    info.placement.y0 -= f64::from(whole[1] - 1 - north) * info.placement.dy;
    (info.width, info.height) = (east - west + 1, north - south + 1);
    Part {
        info,
        whole,
        place,
        heights: Box::new(heights),
    }
}

impl DemSource for Part {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        let top = self.whole[1] - 1 - self.place[3] + first_row;
        let width = self.info.width as usize;
        for (i, out) in out.iter_mut().enumerate().take(rows as usize * width) {
            *out = (self.heights)(self.place[0] + (i % width) as u32, top + (i / width) as u32);
        }
        Ok(())
    }
}

/// World coordinates of a rectangle of samples.
fn bounds(place: Rectangle) -> [f64; 4] {
    let [w, s, e, n] = place.map(f64::from);
    [
        1000.0 + 10.0 * w,
        2000.0 + 10.0 * s,
        1000.0 + 10.0 * e,
        2000.0 + 10.0 * n,
    ]
}

/// Patches, each with its heights.
type Patches = Vec<(Rectangle, Heights)>;

/// Patches and removed rectangles.
struct Case {
    size: [u32; 2],
    base: Heights,
    patches: Patches,
    removed: Vec<Rectangle>,
}

impl Case {
    /// Height of the merged inputs at a column and row, row 0 the northern one.
    fn merged(&self, column: u32, row: u32) -> f64 {
        let y = self.size[1] - 1 - row;
        let inside = |&[w, s, e, n]: &Rectangle| (w..=e).contains(&column) && (s..=n).contains(&y);
        let patched = self.patches.iter().filter(|(place, _)| inside(place));
        let mut heights = patched.map(|(_, heights)| heights(column, row));
        match heights.find(|height| !height.is_nan()) {
            Some(height) => height,
            None if self.removed.iter().any(inside) => f64::NAN,
            None => (self.base)(column, row),
        }
    }

    fn apply(&self, dataset: &Dataset) -> Result<UpdateReport, BuildError> {
        let mut parts: Vec<Part> = self
            .patches
            .iter()
            .map(|&(place, heights)| part(self.size, place, heights))
            .collect();
        let edit = Edit {
            patches: parts
                .iter_mut()
                .map(|part| part as &mut dyn DemSource)
                .collect(),
            remove: self.removed.iter().map(|&place| bounds(place)).collect(),
            sources: vec!["patch".into()],
        };
        update(dataset, edit, &|_, _| {})
    }

    /// Updates, and compares with a dataset that is built from the merged inputs.
    fn check(&self, what: &str) -> TempDataset {
        let data = TempDataset::of(self.size[0], self.size[1], self.base);
        let before = records(&data.dataset);
        let report = self
            .apply(&data.dataset)
            .unwrap_or_else(|e| panic!("{what}: {e}"));
        let rebuilt = TempDataset::of(self.size[0], self.size[1], |x, y| self.merged(x, y));
        let updated = data.open();
        same(&updated, &rebuilt.dataset, what);
        assert_eq!(updated.manifest().generation, report.generation, "{what}");
        let differing = data.samples.iter().zip(&rebuilt.samples);
        let differing = differing.filter(|(a, b)| a != b).count() as u64;
        assert_eq!(report.changed, differing, "{what}");
        // Whoever had the old generation open goes on with it.
        assert!(records(&data.dataset) == before, "{what}");
        data
    }
}

/// All records of a dataset by page.
fn records(dataset: &Dataset) -> BTreeMap<PageId, Vec<u8>> {
    let mut records = BTreeMap::new();
    for entry in dataset.families() {
        for record in dataset.family(&entry).expect("a table").records() {
            let record = record.expect("a record");
            records.insert(record.page, record.bytes.to_vec());
        }
    }
    records
}

/// The same pages with the same records, and the same said of them.
fn same(updated: &Dataset, rebuilt: &Dataset, what: &str) {
    let (ours, theirs) = (records(updated), records(rebuilt));
    let differs = |id: &&PageId| ours.get(*id) != theirs.get(*id);
    let differing: Vec<_> = ours.keys().chain(theirs.keys()).filter(differs).collect();
    assert!(differing.is_empty(), "{what}: pages differ: {differing:?}");
    let (a, b) = (updated.manifest(), rebuilt.manifest());
    assert_eq!(a.pages, b.pages, "{what}");
    assert_eq!(a.valid_samples, b.valid_samples, "{what}");
    assert_eq!(a.height_range, b.height_range, "{what}");
    assert_eq!(a.georef, b.georef, "{what}");
    assert!(a.storage_error_m >= b.storage_error_m, "{what}");
}

fn terrace(_: u32, _: u32) -> f64 {
    250.0
}

fn higher(x: u32, y: u32) -> f64 {
    hills(x, y) + 1000.0
}

fn nothing(_: u32, _: u32) -> f64 {
    f64::NAN
}

#[test]
fn an_update_is_the_dataset_of_the_merged_inputs_wherever_the_patch_lies() {
    let size = [610, 590];
    let places: [Rectangle; 10] = [
        [0, 0, 0, 0],
        [609, 589, 609, 589],
        [256, 256, 256, 256],
        [255, 0, 257, 589],
        [16, 16, 32, 32],
        [17, 33, 18, 34],
        [300, 200, 420, 330],
        [0, 300, 609, 300],
        [512, 512, 609, 589],
        [0, 0, 609, 589],
    ];
    for (i, place) in places.into_iter().enumerate() {
        for (base, patch) in [
            (hills as Heights, higher as Heights),
            (holed_hills, terrace),
            (cliff, holed_hills),
        ] {
            let case = Case {
                size,
                base,
                patches: vec![(place, patch)],
                removed: Vec::new(),
            };
            case.check(&format!("place {i}, {place:?}"));
        }
    }
}

#[test]
fn removed_rectangles_become_holes_except_where_a_patch_has_data() {
    for base in [hills as Heights, holed_hills] {
        let case = Case {
            size: [400, 380],
            base,
            patches: vec![
                ([150, 150, 180, 160], higher),
                ([170, 140, 300, 155], cliff),
            ],
            removed: vec![[100, 100, 260, 300], [0, 370, 399, 379], [256, 0, 256, 379]],
        };
        let data = case.check("patches and removals");
        let now = read_samples(&data.open());
        let at = |x: usize, y: usize| now[y * 400 + x];
        assert_eq!((at(110, 110), at(256, 20), at(20, 375)), (None, None, None));
        assert_eq!(at(155, 152), Some(higher(155, 379 - 152) as i32));
    }
}

#[test]
fn a_dataset_can_be_filled_emptied_and_filled_again() {
    let size = [300, 280];
    let data = TempDataset::of(size[0], size[1], hills);
    let steps: [(Patches, Vec<Rectangle>); 4] = [
        (vec![([5, 5, 9, 9], terrace)], vec![[0, 0, 299, 279]]),
        (vec![([0, 0, 299, 279], holed_hills)], vec![]),
        (vec![([0, 0, 299, 279], terrace)], vec![]),
        (vec![([0, 0, 299, 279], hills)], vec![]),
    ];
    for (step, (patches, removed)) in steps.into_iter().enumerate() {
        let case = Case {
            size,
            base: hills,
            patches,
            removed,
        };
        let now = data.open();
        let before = read_samples(&now);
        case.apply(&now).unwrap();
        let after = |x: u32, row: u32| {
            let at = (size[1] - 1 - row) * size[0] + x;
            let here = Case {
                base: nothing,
                size,
                patches: case.patches.clone(),
                removed: vec![],
            };
            let patched = here.merged(x, row);
            match before[at as usize] {
                _ if !patched.is_nan() => patched,
                Some(height) if case.removed.is_empty() => f64::from(height),
                _ => f64::NAN,
            }
        };
        let rebuilt = TempDataset::of(size[0], size[1], after);
        same(&data.open(), &rebuilt.dataset, &format!("step {step}"));
    }
    assert_eq!(data.open().manifest().generation, 5);
    let report = verify(&data.open(), Share::Full, &|_, _| {}).unwrap();
    assert_eq!(report.broken, Vec::<String>::new());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_patches_and_removals_give_the_merged_dataset(
        rectangles in prop::collection::vec((0u32..330, 0u32..300, 1u32..60, 1u32..60), 1..4),
        kinds in prop::collection::vec(0usize..5, 4),
        base in 0usize..3,
    ) {
        let size = [330, 300];
        let heights = [hills as Heights, holed_hills, cliff, higher, terrace];
        let places = rectangles.iter().map(|&(x, y, w, h)| {
            [x, y, (x + w - 1).min(size[0] - 1), (y + h - 1).min(size[1] - 1)]
        });
        let (mut patches, mut removed) = (Vec::new(), Vec::new());
        for (place, kind) in places.zip(&kinds) {
            match kind {
                4 => removed.push(place),
                &kind => patches.push((place, heights[kind + usize::from(kind > 0)])),
            }
        }
        let case = Case { size, base: heights[base], patches, removed };
        case.check("any");
    }
}

#[test]
fn lone_samples_at_the_far_border_are_kept_and_can_be_joined() {
    // One sample in a corner that belongs to no page but by its border.
    let lone = |x: u32, y: u32| match (x, y) {
        (256, 0) | (3, 200) => 7.0,
        _ => f64::NAN,
    };
    let data = TempDataset::of(257, 257, lone);
    assert_eq!(data.sample(256, 256), Some(7));
    let mut patch = part([257, 257], [255, 255, 255, 256], terrace);
    let edit = Edit {
        patches: vec![&mut patch],
        remove: vec![],
        sources: vec![],
    };
    update(&data.dataset, edit, &|_, _| {}).unwrap();
    let rebuilt = TempDataset::of(257, 257, |x, y| match (x, y) {
        (255, 0 | 1) => 250.0,
        _ => lone(x, y),
    });
    same(&data.open(), &rebuilt.dataset, "a joined sample");
}

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

/// A dataset after some updates.
fn updated_often() -> TempDataset {
    let data = TempDataset::of(600, 500, hills);
    for round in 0..5 {
        let (x, y) = (hash(round, 1) % 400, hash(round, 2) % 300);
        let case = Case {
            size: [600, 500],
            base: hills,
            patches: vec![(
                [x, y, x + 150, y + 100],
                [higher as Heights, cliff, terrace][round as usize % 3],
            )],
            removed: vec![[x + 20, y + 20, x + 40, y + 60]],
        };
        case.apply(&data.open()).unwrap();
    }
    data
}

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

#[test]
fn fill_is_known_as_fill_until_data_replaces_it_or_it_is_removed() {
    // A hole of 21 x 21 samples, filled; rows from the north.
    let holed = |x: u32, y: u32| match (40..=60).contains(&x) && (40..=60).contains(&y) {
        true => f64::NAN,
        false => hills(x, y),
    };
    let source = Box::new(FunctionSource::new(300, 300, holed));
    let mut source = Filled::new(source, 1000, &|_, _| {}).unwrap();
    let data = TempDataset::build(&mut source);
    assert_eq!(data.dataset.filled().unwrap().samples(), 441);
    let case = Case {
        size: [300, 300],
        base: hills,
        // Data over the eastern half, nothing over the rest of the row.
        patches: vec![([50, 0, 299, 299], hills)],
        removed: vec![[0, 255, 44, 257]],
    };
    let report = case.apply(&data.dataset).unwrap();
    assert!(report.changed > 0);
    let filled = data.open().filled().unwrap();
    for y in 0..300 {
        for x in 0..300 {
            let was = (40..=60).contains(&x) && (40..=60).contains(&(299 - y));
            let gone = x >= 50 || (x <= 44 && (255..=257).contains(&y));
            assert_eq!(filled.contains(x, y), was && !gone, "{x}, {y}");
        }
    }
    compact(&data.open(), 0.0, &|_, _| {}).unwrap();
    assert_eq!(data.open().filled().unwrap(), filled);
    verify(&data.open(), Share::PagesALevel(0, 1), &|_, _| {}).unwrap();
}
