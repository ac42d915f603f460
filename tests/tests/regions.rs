//! Cut pages: nothing is lost where no tolerance is given, and no more than the tolerance where
//! one is.

use escarp_proto::geometry::{PAGE_CELLS, PAGE_SAMPLES, PageId};
use escarp_proto::page::PAGE_AREA;
use escarp_tests::terrain::{FunctionSource, TempDataset, hash, hills, holed_hills};
use escarp_tiles::build::{Coarsened, Tolerances, Wish};
use escarp_tiles::dataset::{Dataset, PageReader};
use escarp_tiles::dem::{DemError, DemSource};
use escarp_tiles::verify::{Share, compare, verify};
use proptest::prelude::*;
use std::path::PathBuf;

type Heights = fn(u32, u32) -> f64;

fn everywhere(tolerance_m: f64) -> Vec<Wish> {
    vec![Wish {
        tolerance_m,
        region: None,
    }]
}

fn coarse(size: (u32, u32), heights: Heights, wishes: &[Wish]) -> Result<Coarsened, DemError> {
    let source = FunctionSource::new(size.0, size.1, heights);
    let tolerances = Tolerances::open(wishes, source.info())?;
    Coarsened::new(Box::new(source), 1.0, tolerances)
}

fn built(size: (u32, u32), heights: Heights, wishes: &[Wish]) -> TempDataset {
    TempDataset::build(&mut coarse(size, heights, wishes).unwrap())
}

/// Every finest page, those without a record included, says the same of each sample.
fn assert_single_valued(data: &TempDataset) {
    let mut reader = PageReader::new(&data.dataset);
    let [width, height] = data.dataset.manifest().samples;
    let level = data.dataset.grid().finest_page_level();
    let cells = PAGE_CELLS as u32;
    for row in 0..(height - 1).div_ceil(cells) {
        for column in 0..(width - 1).div_ceil(cells) {
            let page = reader
                .page(PageId::new(level, column, row).unwrap())
                .unwrap();
            for at in (0..PAGE_AREA).filter(|&at| page.is_valid(at)) {
                let x = column * cells + (at % PAGE_SAMPLES) as u32;
                let y = row * cells + (at / PAGE_SAMPLES) as u32;
                assert_eq!(Some(page.height(at)), data.sample(x, y), "{x}, {y}");
            }
        }
    }
}

fn assert_bounds_hold(dataset: &Dataset) {
    let report = verify(dataset, Share::Full, &|_, _| {}).unwrap();
    assert!(report.broken.is_empty(), "{:?}", report.broken);
}

/// The largest difference from the source, which is what the manifest promises at most.
fn assert_promise(data: &TempDataset, size: (u32, u32), heights: Heights) -> f64 {
    let mut plain = FunctionSource::new(size.0, size.1, heights);
    let found = compare(&data.dataset, &mut plain, &|_, _| {}).unwrap();
    assert_eq!(found.invented, 0);
    let promised_m = data.dataset.manifest().storage_error_m;
    assert!(
        found.largest_difference_m <= promised_m,
        "{found:?} {promised_m}"
    );
    found.largest_difference_m
}

#[test]
fn a_coarse_dataset_is_one_surface_within_the_tolerance_and_its_bounds_hold() {
    let size = (600, 540);
    let exact = TempDataset::of(size.0, size.1, hills);
    let mut last = 0;
    for tolerance_m in [12.0, 40.0, 120.0] {
        let data = built(size, hills, &everywhere(tolerance_m));
        assert_single_valued(&data);
        assert_bounds_hold(&data.dataset);
        let found = assert_promise(&data, size, hills);
        assert!(found <= tolerance_m && found > 0.0);
        assert!(data.dataset.manifest().storage_error_m <= tolerance_m + 1e-9);
        last = data.dataset.total_bytes();
    }
    assert!(last * 10 < exact.dataset.total_bytes(), "{last} bytes");
}

#[test]
fn holes_stay_where_they_are() {
    let size = (300, 290);
    let data = built(size, holed_hills, &everywhere(30.0));
    let exact = TempDataset::of(size.0, size.1, holed_hills);
    for (i, (a, b)) in data.samples.iter().zip(&exact.samples).enumerate() {
        assert_eq!(a.is_none(), b.is_none(), "sample {i}");
    }
    assert_single_valued(&data);
    assert_bounds_hold(&data.dataset);
    assert_promise(&data, size, holed_hills);
}

/// Roughness that grows to the east, so that large blocks, small ones and none are cut side by
/// side.
fn growing(column: u32, row: u32) -> f64 {
    let (x, y) = (f64::from(column), f64::from(row));
    let rough = f64::from(hash(column, row) % (1 + column / 40));
    (0.37 * x - 0.21 * y + rough + 3.0 * (y / 90.0).sin()).round()
}

#[test]
fn a_surface_that_was_cut_is_cut_again_without_any_tolerance() {
    let size = (1100, 530);
    let data = built(size, growing, &everywhere(9.0));
    let samples = data.samples.clone();
    let again = TempDataset::of(size.0, size.1, move |column, row| {
        let at = (size.1 - 1 - row) as usize * size.0 as usize + column as usize;
        samples[at].map_or(f64::NAN, f64::from)
    });
    assert!(again.samples == data.samples);
    assert_eq!(
        again.dataset.manifest().pages,
        data.dataset.manifest().pages
    );
    let exact = TempDataset::of(size.0, size.1, growing);
    assert!(data.dataset.manifest().pages * 4 < exact.dataset.manifest().pages * 3);
    assert_bounds_hold(&again.dataset);
    assert_single_valued(&again);
}

#[test]
fn rows_are_the_same_in_whatever_order_they_are_asked_for() {
    let size = (520, 770);
    let read = |rows: &mut dyn Iterator<Item = u32>| {
        let mut source = coarse(size, growing, &everywhere(6.0)).unwrap();
        let mut out = vec![0.0; (size.0 * size.1) as usize];
        for row in rows {
            let start = (row * size.0) as usize;
            source
                .read_rows(row, 1, &mut out[start..start + size.0 as usize])
                .unwrap();
        }
        out
    };
    let down = read(&mut (0..size.1));
    assert!(down == read(&mut (0..size.1).rev()));
    let shuffled = &mut (0..size.1).map(|i| i * 303 % size.1);
    assert!(down == read(shuffled));
    let moved =
        (0..size.0 * size.1).filter(|&i| down[i as usize] != growing(i % size.0, i / size.0));
    assert!(moved.count() > 1000);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn any_terrain_with_any_tolerance_is_one_surface_whose_promises_hold(
        seed in 0u32..1000, roughness in 1u32..40, slope in -90..90i32, tolerance_m in 0.0..30.0f64,
        size in (2u32..330, 2u32..330), lake: bool,
    ) {
        let heights = move |x: u32, y: u32| {
            let noise = hash(x ^ seed, y) % roughness;
            let patch = if lake && hash(x / 50, y / 70 + seed).is_multiple_of(3) { 0 } else { noise };
            f64::from(slope) * f64::from(x) / 16.0 + f64::from(patch) + f64::from(y / 3)
        };
        let heights = move |x, y| heights(x, y).round();
        let source = FunctionSource::new(size.0, size.1, heights);
        let tolerances = Tolerances::open(&everywhere(tolerance_m), source.info()).unwrap();
        let mut coarse = Coarsened::new(Box::new(source), 1.0, tolerances).unwrap();
        let data = TempDataset::build(&mut coarse);
        assert_single_valued(&data);
        assert_bounds_hold(&data.dataset);
        let mut plain = FunctionSource::new(size.0, size.1, heights);
        let found = compare(&data.dataset, &mut plain, &|_, _| {}).unwrap();
        let promised_m = data.dataset.manifest().storage_error_m;
        prop_assert!(found.largest_difference_m <= promised_m && promised_m <= tolerance_m + 1e-9);
    }
}

/// A road that winds from west to east, 60 m wide, as GeoJSON in the source's coordinates, and
/// whether a sample is on it.
fn road(size: (u32, u32)) -> (String, impl Fn(u32, u32) -> bool) {
    let north = move |x: f64| 2000.0 + 5.0 * f64::from(size.1) + 300.0 * (x / 700.0).sin();
    let stations: Vec<f64> = (0..=200)
        .map(|i| 1000.0 + 10.0 * f64::from(size.0) * f64::from(i) / 200.0)
        .collect();
    let there = stations
        .iter()
        .map(|&x| format!("[{x},{}]", north(x) + 30.0));
    let back = stations
        .iter()
        .rev()
        .map(|&x| format!("[{x},{}]", north(x) - 30.0));
    let mut ring: Vec<String> = there.chain(back).collect();
    ring.push(ring[0].clone());
    let json = format!(
        r#"{{"type":"Polygon","coordinates":[[{}]]}}"#,
        ring.join(",")
    );
    let on_road = move |x: u32, y: u32| {
        let (east, at) = (1000.0 + 10.0 * f64::from(x), 2000.0 + 10.0 * f64::from(y));
        (at - north(east)).abs() < 29.0
    };
    (json, on_road)
}

#[test]
fn beside_a_road_that_is_stored_exactly_the_hills_are_coarse() {
    let size = (900, 700);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("road.geojson");
    let (json, on_road) = road(size);
    std::fs::write(&path, json).unwrap();
    let wish = |tolerance_m, region: Option<&PathBuf>| Wish {
        tolerance_m,
        region: region.cloned(),
    };
    let data = built(size, hills, &[wish(60.0, None), wish(0.0, Some(&path))]);
    assert_single_valued(&data);
    assert_bounds_hold(&data.dataset);
    let (mut exact, mut moved) = (0, 0);
    for y in 0..size.1 {
        for x in 0..size.0 {
            let given = hills(x, size.1 - 1 - y);
            let stored = f64::from(data.sample(x, y).unwrap());
            if on_road(x, y) {
                assert_eq!(stored, given, "{x}, {y}");
                exact += 1;
            }
            assert!((stored - given).abs() <= 60.0);
            moved += u32::from(stored != given);
        }
    }
    assert!(
        exact > 3000 && moved > size.0 * size.1 / 2,
        "{exact} {moved}"
    );
    let [inside, outside] = &data.dataset.manifest().tolerances[..] else {
        panic!()
    };
    assert_eq!(inside.region.as_deref(), Some("road.geojson"));
    assert_eq!((inside.tolerance_m, inside.largest_error_m), (0.0, 0.0));
    assert_eq!((outside.tolerance_m, &outside.region), (60.0, &None));
    assert!(outside.largest_error_m > 0.0 && outside.largest_error_m <= 60.0);
    let whole = TempDataset::of(size.0, size.1, hills).dataset.total_bytes();
    let bytes = data.dataset.total_bytes();
    assert!(bytes * 3 < whole, "{bytes} of {whole}");
}

#[test]
fn a_wrong_tolerance_is_refused() {
    let wish = |tolerance_m, region: Option<&str>| Wish {
        tolerance_m,
        region: region.map(PathBuf::from),
    };
    let refused = |wishes: &[Wish]| coarse((40, 40), hills, wishes).err().unwrap().to_string();
    assert!(refused(&everywhere(-1.0)).contains("0 or more"));
    assert!(refused(&everywhere(f64::NAN)).contains("0 or more"));
    assert!(refused(&[wish(1.0, None), wish(2.0, None)]).contains("two tolerances"));
    assert!(refused(&[wish(1.0, Some("/nowhere/a.geojson"))]).contains("a.geojson"));
}
