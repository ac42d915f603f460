//! Filled voids, from the source to the dataset and back.

use escarp_tests::terrain::{FunctionSource, TempDataset, hills};
use escarp_tiles::dem::{DemSource, Filled};
use escarp_tiles::verify::{Share, compare, verify};
use std::fs;

const SIZE: (u32, u32) = (300, 270);

/// Hills with a round void, a speck, and a bay that is open to the west.
fn holed(column: u32, row: u32) -> f64 {
    let (dx, dy) = (f64::from(column) - 150.0, f64::from(row) - 120.0);
    let void = dx * dx + dy * dy < 1600.0;
    let bay = column < 40 && (200..215).contains(&row);
    if void || bay || (column, row) == (256, 7) {
        f64::NAN
    } else {
        hills(column, row)
    }
}

fn source() -> Box<dyn DemSource> {
    Box::new(FunctionSource::new(SIZE.0, SIZE.1, holed))
}

#[test]
fn a_dataset_knows_which_of_its_samples_are_fill() {
    let mut filled = Filled::new(source(), 1 << 18, &|_, _| {}).unwrap();
    let data = TempDataset::build(&mut filled);
    let stated = data.dataset.manifest().filled.unwrap();
    let runs = data.dataset.filled().unwrap();
    assert_eq!(stated.samples, runs.samples());
    assert!(runs.samples() > 5000);
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let given = holed(x, SIZE.1 - 1 - y);
            let bay = x < 40 && given.is_nan();
            assert_eq!(runs.contains(x, y), given.is_nan() && !bay, "{x}, {y}");
            assert_eq!(data.sample(x, y).is_none(), bay, "{x}, {y}");
        }
    }
    let found = compare(&data.dataset, &mut *source(), &|_, _| {}).unwrap();
    assert_eq!((found.filled, found.invented), (runs.samples(), 0));
    assert_eq!(found.largest_difference_m, 0.0);
    let mut again = Filled::new(source(), 1 << 18, &|_, _| {}).unwrap();
    let found = compare(&data.dataset, &mut again, &|_, _| {}).unwrap();
    assert_eq!(
        (found.filled, found.invented, found.largest_difference_m),
        (0, 0, 0.0)
    );
}

#[test]
fn without_a_wish_to_fill_voids_stay_holes_and_no_file_says_otherwise() {
    let data = TempDataset::build(&mut *source());
    assert!(data.dataset.manifest().filled.is_none());
    assert!(data.dataset.filled().unwrap().runs().is_empty());
    assert!(data.sample(150, SIZE.1 - 1 - 120).is_none());
}

#[test]
fn a_damaged_file_of_fills_is_refused_by_name() {
    let mut filled = Filled::new(source(), 1 << 18, &|_, _| {}).unwrap();
    let data = TempDataset::build(&mut filled);
    let path = data.path().join("filled-1");
    let bytes = fs::read(&path).unwrap();
    let refusal = || verify(&data.open(), Share::PagesALevel(1, 1), &|_, _| {}).unwrap_err();
    let mut flipped = bytes.clone();
    flipped[30] ^= 1;
    for damage in [&flipped[..], &bytes[..bytes.len() - 1], &[]] {
        fs::write(&path, damage).unwrap();
        assert!(refusal().to_string().contains("filled-1"), "{}", refusal());
    }
    fs::remove_file(&path).unwrap();
    assert!(refusal().to_string().contains("missing"), "{}", refusal());
}
