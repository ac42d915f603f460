//! An updated dataset is the one of the merged inputs.

use crate::case::{Case, Patches, Rectangle, higher, nothing, part, same, terrace};
use escarp_tests::terrain::{
    FunctionSource, Heights, TempDataset, cliff, hills, holed_hills, read_samples,
};
use escarp_tiles::dem::Filled;
use escarp_tiles::update::{Edit, compact, update};
use escarp_tiles::verify::{Share, verify};
use proptest::prelude::*;

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
