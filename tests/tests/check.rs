//! What `verify`, `diff` and `info` say: nothing of a sound dataset, and the place of what is
//! wrong with a forged one, whose checksums all match.

use escarp_proto::geometry::{PAGE_SAMPLES, PageId};
use escarp_proto::page::{ChildSlot, Codec, PAGE_AREA, Page, Record, last_part};
use escarp_tests::programs::{Desk, run};
use escarp_tests::terrain::{FunctionSource, read_samples};
use escarp_tests::terrain::{Heights, TempDataset, build_with, hash, hills, holed_hills};
use escarp_tiles::build::Quantum;
use escarp_tiles::dataset::{Dataset, DatasetWriter, FamilyBytes, FamilyId};
use escarp_tiles::verify::{Share, diff, survey, verify};
use std::collections::BTreeMap;
use tempfile::TempDir;

/// A copy of a dataset with other records: `None` leaves one out.
fn forged(
    data: &Dataset,
    change: impl Fn(PageId, Option<&[u8]>) -> Option<Vec<u8>>,
) -> (TempDir, Dataset) {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("forged.escarp");
    let mut writer = DatasetWriter::create(&path, false).unwrap();
    let mut families: BTreeMap<FamilyId, BTreeMap<_, Vec<u8>>> = BTreeMap::new();
    for page in all_pages(data) {
        let record = data.record(page).unwrap().map(|record| record.bytes);
        if let Some(record) = change(page, record) {
            let slot = page
                .parent()
                .map_or(escarp_proto::geometry::Slot::at(0, 0), |(_, s)| s);
            families
                .entry(FamilyId::of(page))
                .or_default()
                .insert(slot, record);
        }
    }
    for (family, records) in families {
        let records: Vec<_> = records.into_iter().collect();
        writer
            .append(&FamilyBytes::encode(family, &records).unwrap())
            .unwrap();
    }
    writer.publish(data.manifest().clone()).unwrap();
    let dataset = Dataset::open(&path).unwrap();
    (folder, dataset)
}

/// Every page that the data reaches, with or without a record.
fn all_pages(data: &Dataset) -> Vec<PageId> {
    let [mut columns, mut rows] = data.manifest().samples.map(|n| (n - 1).div_ceil(16).max(1));
    let mut pages = Vec::new();
    for level in (0..=data.grid().finest_page_level()).rev().step_by(4) {
        for y in 0..rows {
            pages.extend((0..columns).map(|x| PageId::new(level, x, y).unwrap()));
        }
        (columns, rows) = (columns.div_ceil(16), rows.div_ceil(16));
    }
    pages
}

/// A page with one sample changed.
fn with_sample(data: &Dataset, id: PageId, record: &[u8], at: usize, by: i32) -> Vec<u8> {
    let finest = data.grid().is_finest(id);
    let page = Page::decode(id, finest, last_part(finest), record).unwrap();
    let mut samples = [None; PAGE_AREA];
    for (i, sample) in samples.iter_mut().enumerate() {
        *sample = page.is_valid(i).then(|| page.height(i));
    }
    samples[at] = samples[at].map(|height| height + by);
    let slots =
        std::array::from_fn(|i| page.slot(escarp_proto::geometry::Slot::from_index(i as u8)));
    let slots = (!finest).then(|| Box::new(slots));
    let page = Page::new(id, &samples, slots).unwrap();
    Record::encode(&page, Codec::Dense).bytes().to_vec()
}

fn broken(dataset: &Dataset) -> Vec<String> {
    verify(dataset, Share::PagesALevel(0, 1), &|_, _| {})
        .unwrap()
        .broken
}

#[test]
fn a_sample_that_differs_on_a_shared_border_or_corner_is_found_and_its_pages_named() {
    let data = TempDataset::of(600, 500, hills);
    let finest = data.dataset.grid().finest_page_level();
    assert_eq!(broken(&data.dataset), Vec::<String>::new());
    // Inside a family, across families, at a corner of the parent's, and in the parent itself.
    let last = PAGE_SAMPLES - 1;
    let cases = [
        (finest, [3, 4], 7 * PAGE_SAMPLES + last),
        (finest, [15, 4], 7 * PAGE_SAMPLES + last),
        (finest, [20, 15], last * PAGE_SAMPLES + 5),
        (finest, [16, 16], 3),
        (finest, [0, 0], 0),
        (finest - 4, [1, 0], 5 * PAGE_SAMPLES + 5),
    ];
    for (level, [x, y], at) in cases {
        let page = PageId::new(level, x, y).unwrap();
        let (_folder, forged) = forged(&data.dataset, |id, record| {
            let record = record?;
            Some(match id == page {
                true => with_sample(&data.dataset, id, record, at, 3),
                false => record.to_vec(),
            })
        });
        let found = broken(&forged);
        assert!(!found.is_empty(), "{page}, sample {at}");
        assert!(
            found.iter().any(|what| what.contains(&page.to_string())),
            "{page}: {found:?}"
        );
        assert!(found[0].contains("share a sample"), "{found:?}");
    }
}

#[test]
fn an_inner_sample_is_shared_with_nobody() {
    let data = TempDataset::of(200, 200, hills);
    let page = PageId::new(data.dataset.grid().finest_page_level(), 2, 2).unwrap();
    let (_folder, forged) = forged(&data.dataset, |id, record| {
        let record = record?;
        Some(match id == page {
            true => with_sample(&data.dataset, id, record, 5 * PAGE_SAMPLES + 5, 3000),
            false => record.to_vec(),
        })
    });
    assert_eq!(broken(&forged), Vec::<String>::new());
    // But a bound above does not hold any more.
    let all = verify(&forged, Share::Full, &|_, _| {}).unwrap();
    assert!(!all.broken.is_empty() && all.largest_ratio > 1.0, "{all:?}");
}

#[test]
fn a_record_of_which_its_parent_knows_nothing_and_a_missing_one_are_found() {
    // Flat in the south, so that pages without a record are there.
    let half = |x: u32, y: u32| if y > 250 { 5.0 } else { hills(x, y) };
    let data = TempDataset::of(500, 500, half);
    let finest = data.dataset.grid().finest_page_level();
    let flat = PageId::new(finest, 3, 3).unwrap();
    assert!(data.dataset.record(flat).unwrap().is_none());
    let (_folder, orphan) = forged(&data.dataset, |id, record| match id == flat {
        true => {
            let page = Page::new(id, &[Some(5); PAGE_AREA], None).unwrap();
            Some(Record::encode(&page, Codec::Dense).bytes().to_vec())
        }
        false => record.map(<[u8]>::to_vec),
    });
    let found = broken(&orphan);
    assert!(
        found
            .iter()
            .any(|what| what.contains(&format!("page {flat} has a record"))),
        "{found:?}"
    );
    let gone = PageId::new(finest, 7, 28).unwrap();
    let (_folder, without) = forged(&data.dataset, |id, record| {
        record.filter(|_| id != gone).map(<[u8]>::to_vec)
    });
    let error = verify(&without, Share::PagesALevel(0, 1), &|_, _| {}).unwrap_err();
    assert!(error.to_string().contains(&gone.to_string()), "{error}");
}

#[test]
fn a_share_of_pages_is_the_same_each_time_and_another_seed_gives_another() {
    let data = TempDataset::of(500, 500, holed_hills);
    let few = |seed| verify(&data.dataset, Share::PagesALevel(5, seed), &|_, _| {}).unwrap();
    assert_eq!(few(1), few(1));
    assert_ne!(few(1).comparisons, few(2).comparisons);
    assert_eq!(few(1).pages_a_level.values().sum::<u64>(), 1 + 4 + 5);
}

/// What differs, sample by sample: both heights, only the first, only the second; the largest.
fn naive(first: &TempDataset, second: &TempDataset) -> (u64, u64, u64, i32) {
    let mut found = (0, 0, 0, 0);
    let (a, b) = (read_samples(&first.open()), read_samples(&second.open()));
    for pair in a.into_iter().zip(b) {
        match pair {
            (Some(a), Some(b)) if a != b => {
                found.0 += 1;
                found.3 = found.3.max((a - b).abs());
            }
            (Some(_), None) => found.1 += 1,
            (None, Some(_)) => found.2 += 1,
            _ => {}
        }
    }
    found
}

#[test]
fn a_difference_is_what_a_comparison_of_all_samples_gives() {
    let changed: [Heights; 5] = [
        |x, y| hills(x, y) + f64::from((x, y) == (256, 300)) * 9.0,
        |x, y| hills(x, y) + f64::from(x == 256 || y == 255) * f64::from(hash(x, y) % 3),
        |x, y| {
            if x > 250 && y > 400 {
                f64::NAN
            } else {
                hills(x, y)
            }
        },
        |x, y| {
            if hash(x / 7, y / 5).is_multiple_of(9) {
                hills(x, y) + 1.0
            } else {
                holed_hills(x, y)
            }
        },
        |x, y| {
            if (100..=256).contains(&x) {
                f64::NAN
            } else {
                -hills(x, y)
            }
        },
    ];
    for base in [hills as Heights, holed_hills] {
        let first = TempDataset::of(600, 530, base);
        for (i, heights) in changed.into_iter().enumerate() {
            let second = TempDataset::of(600, 530, heights);
            let found = diff(&first.dataset, &second.dataset, &|_, _| {}).unwrap();
            let (samples, first_alone, second_alone, largest) = naive(&first, &second);
            assert_eq!(
                (found.samples, found.only_in_first, found.only_in_second),
                (samples, first_alone, second_alone),
                "case {i}"
            );
            assert_eq!(found.largest_m, f64::from(largest), "case {i}");
            assert_eq!(found.largest_at_m.is_some(), largest > 0, "case {i}");
            assert!(!found.is_none());
        }
    }
}

#[test]
fn datasets_of_the_same_data_have_no_difference_and_nothing_is_compared() {
    let (first, second) = (
        TempDataset::of(400, 300, hills),
        TempDataset::of(400, 300, hills),
    );
    let found = diff(&first.dataset, &second.dataset, &|_, _| {}).unwrap();
    assert!(found.is_none() && found.families_compared == 0, "{found:?}");
}

#[test]
fn the_place_of_the_largest_difference_is_named() {
    let first = TempDataset::of(400, 300, hills);
    let second = TempDataset::of(400, 300, |x, y| match (x, y) {
        (256, 43) => hills(x, y) + 50.0,
        (10, 10) => hills(x, y) - 20.0,
        _ => hills(x, y),
    });
    let found = diff(&first.dataset, &second.dataset, &|_, _| {}).unwrap();
    assert_eq!((found.samples, found.largest_m), (2, 50.0));
    // Samples are 10 m apart; row 43 from the north is row 256 from the south.
    assert_eq!(found.largest_at_m, Some([1000.0 + 2560.0, 2000.0 + 2560.0]));
}

#[test]
fn datasets_in_other_steps_are_compared_in_metres_and_other_grids_refused() {
    let first = TempDataset::of(300, 200, hills);
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("fine.escarp");
    let mut source = FunctionSource::new(300, 200, hills);
    build_with(&path, &mut source, Quantum::Metres(0.25), false).unwrap();
    let fine = Dataset::open(&path).unwrap();
    let found = diff(&first.dataset, &fine, &|_, _| {}).unwrap();
    assert_eq!((found.samples, found.largest_m), (0, 0.0), "{found:?}");
    let other = TempDataset::of(301, 200, hills);
    let error = diff(&first.dataset, &other.dataset, &|_, _| {}).unwrap_err();
    assert!(error.to_string().contains("cannot be compared"), "{error}");
}

#[test]
fn a_survey_accounts_for_every_byte_and_every_slot() {
    for heights in [hills as Heights, holed_hills] {
        let data = TempDataset::of(600, 500, heights);
        let found = survey(&data.dataset).unwrap();
        let manifest = data.dataset.manifest();
        let segments: u64 = manifest.segments.iter().map(|s| s.bytes).sum();
        assert_eq!(found.parts.iter().sum::<u64>() + found.tables, segments);
        let levels = found.levels.values();
        assert_eq!(levels.map(|level| level.pages).sum::<u64>(), manifest.pages);
        // Slots by hand: each page above the finest has 256.
        let mut by_hand: BTreeMap<u8, u64> = BTreeMap::new();
        let (mut mixed, mut empty) = (0, 0);
        for id in all_pages(&data.dataset)
            .into_iter()
            .filter(|id| id.level() < 8)
        {
            let Some(record) = data.dataset.record(id).unwrap() else {
                continue;
            };
            let page = Page::decode(id, false, 5, record.bytes).unwrap();
            for slot in (0..=255).map(escarp_proto::geometry::Slot::from_index) {
                match page.slot(slot) {
                    ChildSlot::Full(error) | ChildSlot::Cut(error) => {
                        *by_hand.entry(error.0).or_default() += 1
                    }
                    ChildSlot::Mixed(_) => mixed += 1,
                    ChildSlot::Empty => empty += 1,
                }
            }
        }
        assert_eq!((found.mixed_slots, found.empty_slots), (mixed, empty));
        let full: u64 = found.slot_errors.iter().map(|bin| bin.slots).sum();
        assert_eq!(full, by_hand.values().sum::<u64>());
        for bin in &found.slot_errors {
            let within = by_hand.iter().filter(|(code, _)| {
                f64::from(escarp_proto::err8::Err8(**code).bound()) <= bin.most_m
            });
            let up_to = found.slot_errors.iter().filter(|b| b.most_m <= bin.most_m);
            let (within, up_to): (u64, u64) =
                (within.map(|(_, n)| n).sum(), up_to.map(|b| b.slots).sum());
            assert_eq!(within, up_to, "{bin:?}");
        }
    }
}

#[test]
fn the_programs_update_compare_describe_and_compact() {
    let desk = Desk::new();
    let out = desk.dataset().to_str().expect("UTF-8").to_owned();
    let patch = desk.name("patch.tif");
    // The same place, other heights.
    run(
        "escarp-tiles",
        &["sample", "-o", &patch, "--size", "300", "--seed", "9"],
    )
    .ok();
    let updated = run(
        "escarp-tiles",
        &["update", &out, "--with", &patch, "--json"],
    )
    .ok();
    let updated: serde_json::Value = serde_json::from_str(&updated).unwrap();
    assert_eq!(updated["update"]["generation"], 2);
    run("escarp-tiles", &["verify", &out, "--against", &patch]).ok();
    let rebuilt = desk.name("rebuilt.escarp");
    run("escarp-tiles", &["build", &patch, "-o", &rebuilt]).ok();
    let same = run("escarp-tiles", &["diff", &out, &rebuilt]).ok();
    assert!(same.contains("no difference"), "{same}");
    let other = run(
        "escarp-tiles",
        &["diff", &format!("{out}@1"), &out, "--json"],
    );
    assert_eq!(other.code, Some(1), "{other:?}");
    let other: serde_json::Value = serde_json::from_str(&other.out).unwrap();
    assert!(other["samples"].as_u64() > Some(80_000), "{other}");
    let info = run("escarp-tiles", &["info", &out, "--json"]).ok();
    let info: serde_json::Value = serde_json::from_str(&info).unwrap();
    assert_eq!(info["disk"]["generations"], serde_json::json!([1, 2]));
    assert!(info["disk"]["dead_bytes"].as_u64() > Some(10_000), "{info}");
    assert_eq!(info["coverage"], 1.0);
    run("escarp-tiles", &["compact", &out, "--full"]).ok();
    let text = run("escarp-tiles", &["info", &out]).ok();
    assert!(
        text.contains("0.0 MB of it dead") && text.contains("child slots"),
        "{text}"
    );
    run("escarp-tiles", &["diff", &out, &rebuilt]).ok();
    // A hole, in the DEM's coordinates; the dataset is 10 m grid at its own place.
    let extent = &info["extent_m"];
    let at = |axis: usize| extent[axis][0].as_f64().expect("a number");
    let remove = format!(
        "{},{},{},{}",
        at(0) - 1.0,
        at(1) - 1.0,
        at(0) + 45.0,
        at(1) + 25.0
    );
    let holed = run("escarp-tiles", &["update", &out, "--remove", &remove]).ok();
    assert!(holed.contains("15 are holes now"), "{holed}");
    let wrong = run("escarp-tiles", &["update", &out]);
    assert_eq!(wrong.code, Some(2), "{wrong:?}");
}
