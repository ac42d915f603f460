//! The meshers that go by distance and by fixed levels: cracks, stated bounds, counts, history.

use escarp_client::mesh::{BLOCK_LEVELS, MeshOptions, MeshTree, MesherKind, SPLIT_RATIOS};
use escarp_proto::view::View;
use escarp_tests::drive::view_to as view;
use escarp_tests::feed::{Feed, anew};
use escarp_tests::measure::{check_cracks, check_stated, measure, triangles};
use escarp_tests::terrain::{KINDS_SIZE, TempDataset, hash, hills, kinds};
use std::collections::{BTreeSet, HashMap};

/// Straight down, so high that all is in view.
fn from_above(height_m: f64) -> View {
    view([2280.0, 3280.0, height_m], [2280.0, 3280.0, 0.0], 2.0)
}

fn of(mesher: MesherKind) -> MeshOptions {
    MeshOptions {
        mesher,
        ..MeshOptions::default()
    }
}

fn at_level(level: u8) -> MeshOptions {
    MeshOptions {
        level: Some(level),
        ..of(MesherKind::Levels)
    }
}

fn all_options() -> Vec<MeshOptions> {
    let mut options = vec![
        of(MesherKind::Distance),
        of(MesherKind::Levels),
        MeshOptions {
            split_ratio: Some(3.5),
            ..of(MesherKind::Distance)
        },
        MeshOptions {
            split_ratio: Some(9.0),
            ..of(MesherKind::Levels)
        },
    ];
    options.extend((BLOCK_LEVELS[0]..=BLOCK_LEVELS[1]).map(at_level));
    options
}

fn views(error_px: f32) -> Vec<View> {
    let middle = [2100.0, 2900.0, 0.0];
    [
        [2100.0, 2900.0, 60.0],
        [1003.0, 2001.0, 1400.0],
        [-4000.0, 9000.0, 5000.0],
        [2000.0, 3000.0, 120_000.0],
    ]
    .map(|eye| view(eye, middle, error_px))
    .to_vec()
}

#[test]
fn the_stated_bound_holds_at_every_sample_of_a_converged_mesh_of_every_kind() {
    for (name, data) in &kinds() {
        for options in all_options() {
            let mut finite = 0;
            for view in [0.5, 4.0].into_iter().flat_map(views) {
                let mut feed = Feed::with_options(&data.dataset, options);
                let stats = feed.converge(&view);
                check_stated(&feed.tree, data, &view, stats.excess, name);
                finite += u32::from(stats.excess.is_finite());
            }
            assert!(finite > 0, "{name} {options:?}: no bound was ever stated");
        }
    }
}

#[test]
fn the_stated_bound_is_the_largest_of_a_triangle_and_no_looser_than_it_must_be() {
    // One spike of 1000 m in a plain: a mesh without it is 1000 m off, whatever else it has.
    let data = TempDataset::of(
        257,
        257,
        |x, y| if (x, y) == (77, 101) { 1000.0 } else { 0.0 },
    );
    let view = from_above(20_000.0);
    let mut feed = Feed::with_options(&data.dataset, at_level(4));
    let stats = feed.converge(&view);
    let found = measure(&feed.tree, &data, &view, true);
    assert!(found.largest > 1.0, "{found:?}");
    assert!(stats.excess >= found.largest, "{stats:?} {found:?}");
    assert!(stats.excess <= 1.2 * found.largest, "{stats:?} {found:?}");
}

#[test]
fn while_pages_are_missing_there_is_no_crack_and_the_stated_bound_holds() {
    for (name, data) in &kinds() {
        let cells = data.dataset.grid().cells_per_side();
        for (i, options) in all_options().into_iter().enumerate() {
            // Each kind from some eye, and from every eye some kind.
            for (j, view) in views(1.0).into_iter().enumerate().skip(i % 4).step_by(4) {
                let mut feed = Feed::with_options(&data.dataset, options);
                for step in 0..50u32 {
                    let stats = feed.tree.update(&view);
                    let wishes = feed.tree.wishes();
                    check_cracks(&feed.tree, cells).unwrap_or_else(|why| panic!("{name}: {why}"));
                    if step % 20 == 7 {
                        check_stated(&feed.tree, data, &view, stats.excess, name);
                    }
                    // A few at a time, in no order.
                    for n in 0..1 + wishes.len() / 6 {
                        let wish = hash(step * 64 + n as u32, (i * 8 + j) as u32) as usize;
                        if !wishes.is_empty() {
                            feed.grant(&wishes[wish % wishes.len()]);
                        }
                    }
                }
            }
        }
    }
}

/// A flight with jumps, pages arriving late and being evicted.
fn wander(feed: &mut Feed<'_>, name: &str, cells: u32, steps: u32, seed: u32) -> View {
    let mut last = view([0.0, 0.0, 1e4], [1.0, 1.0, 0.0], 2.0);
    for step in 0..steps {
        let random = |n: u32, span: u32| f64::from(hash(step * 16 + n, seed) % span);
        let eye = match hash(step, seed + 1) % 5 {
            0 => [random(1, 5000), random(2, 5000), random(3, 3000)],
            _ => [
                last.eye_m[0] + random(4, 60) - 30.0,
                last.eye_m[1] + random(5, 60),
                last.eye_m[2],
            ],
        };
        let look = [random(6, 4000), random(7, 4000), 0.0];
        last = view(eye, look, 1.0 + random(8, 4) as f32);
        feed.tree.update(&last);
        let granted = hash(step, seed + 2) as usize % 60;
        for wish in feed.tree.wishes().into_iter().take(granted) {
            feed.grant(&wish);
        }
        if hash(step, seed + 3).is_multiple_of(6) {
            feed.tree.evict(hash(step, seed + 4) as usize % 800_000);
        }
        feed.tree.update(&last);
        check_cracks(&feed.tree, cells).unwrap_or_else(|why| panic!("{name} step {step}: {why}"));
    }
    last
}

#[test]
fn flags_and_counts_follow_from_view_and_pages_alone_after_any_flight() {
    for (name, data) in &kinds() {
        let cells = data.dataset.grid().cells_per_side();
        for (seed, options) in all_options().into_iter().enumerate() {
            let mut feed = Feed::with_options(&data.dataset, options);
            let last = wander(&mut feed, name, cells, 25, seed as u32 * 100);
            let anew = anew(&feed.tree, &data.dataset, &last, options);
            assert_eq!(feed.tree.flags(), anew.flags(), "{name}, {options:?}");
        }
    }
}

#[test]
fn after_looking_away_all_pages_but_the_first_can_be_evicted() {
    let data = TempDataset::of(KINDS_SIZE.0, KINDS_SIZE.1, hills);
    for options in all_options() {
        let mut feed = Feed::with_options(&data.dataset, options);
        feed.converge(&view([1900.0, 2700.0, 400.0], [2100.0, 2900.0, 0.0], 1.0));
        assert!(feed.tree.resident() > 1, "{options:?}");
        let eye = [2000.0, -9000.0, 60.0];
        feed.converge(&view(eye, [2000.0, -99_000.0, 60.0], 1.0));
        feed.tree.evict(0);
        assert_eq!(feed.tree.resident(), 1, "{options:?}");
    }
}

#[test]
fn a_chosen_level_has_exactly_its_triangles_on_flat_and_on_any_other_ground() {
    let flat = TempDataset::of(257, 257, |_, _| 12.0);
    let hilly = TempDataset::of(257, 257, hills);
    for data in [&flat, &hilly] {
        for (level, side) in [(1, 16), (2, 8), (3, 4), (4, 2)] {
            let mut feed = Feed::with_options(&data.dataset, at_level(level));
            feed.converge(&from_above(4000.0));
            let blocks = 16 * 16;
            assert_eq!(
                triangles(&feed.tree).len(),
                blocks * side * side * 2,
                "level {level}"
            );
        }
    }
}

/// Levels of the blocks, by column and row: 1 to 4, 5 where one is not split.
fn block_levels(tree: &MeshTree) -> HashMap<(u32, u32), u32> {
    let mut levels = HashMap::new();
    for triangle in triangles(tree) {
        let side = |w: [u32; 3]| w.iter().max().unwrap() - w.iter().min().unwrap();
        let [xs, ys] = [triangle.corners.map(|c| c.0), triangle.corners.map(|c| c.1)];
        let block = (
            *xs.iter().min().unwrap() / 16,
            *ys.iter().min().unwrap() / 16,
        );
        let level = side(xs).max(side(ys)).ilog2() + 1;
        let known = levels.entry(block).or_insert(level);
        *known = (*known).max(level.min(5));
    }
    levels
}

#[test]
fn a_border_between_any_two_levels_is_closed() {
    let data = TempDataset::of(257, 257, |x, y| f64::from(hash(x, y) % 5));
    let cells = data.dataset.grid().cells_per_side();
    let mut pairs = BTreeSet::new();
    for ratio in [1.5, 2.0, 3.0, 5.0, 8.0] {
        for place in 0..8 {
            let options = MeshOptions {
                split_ratio: Some(ratio),
                ..of(MesherKind::Levels)
            };
            let mut feed = Feed::with_options(&data.dataset, options);
            let at = f64::from(place) * 20.0;
            // Close above the ground: near blocks are much finer than those beside them.
            let mut view = view([2280.0 + at, 3280.0, 15.0], [2280.0 + at, 3280.0, 0.0], 1.0);
            view.fov_y = 3.0;
            feed.converge(&view);
            check_cracks(&feed.tree, cells).unwrap();
            let levels = block_levels(&feed.tree);
            for (&(x, y), &level) in &levels {
                for beside in [(x + 1, y), (x, y + 1)] {
                    pairs.extend(levels.get(&beside).map(|&b| (level.min(b), level.max(b))));
                }
            }
        }
    }
    for a in 1..=4 {
        for b in a..=4 {
            assert!(
                pairs.contains(&(a, b)),
                "no level {a} beside {b}: {pairs:?}"
            );
        }
    }
}

#[test]
fn a_finer_tolerance_or_a_larger_ratio_makes_more_triangles_up_to_a_stated_limit() {
    let data = TempDataset::of(KINDS_SIZE.0, KINDS_SIZE.1, hills);
    let eye = [1003.0, 2001.0, 400.0];
    let count = |options, error_px| {
        let mut feed = Feed::with_options(&data.dataset, options);
        feed.converge(&view(eye, [2100.0, 2900.0, 0.0], error_px));
        triangles(&feed.tree).len()
    };
    for mesher in [MesherKind::Distance, MesherKind::Levels] {
        let counts = [64.0, 16.0, 4.0].map(|error_px| count(of(mesher), error_px));
        assert!(counts.is_sorted_by(|a, b| a < b), "{mesher} {counts:?}");
        let by_ratio = |ratio| {
            let split_ratio = Some(ratio);
            let options = MeshOptions {
                split_ratio,
                ..of(mesher)
            };
            count(options, 4.0)
        };
        let counts = [1.5, 6.0, 24.0].map(by_ratio);
        assert!(counts.is_sorted_by(|a, b| a < b), "{mesher} {counts:?}");
        // Unchecked options are held within the limits, too.
        assert_eq!(by_ratio(1e300), by_ratio(SPLIT_RATIOS[1]), "{mesher}");
        assert_eq!(by_ratio(-7.0), by_ratio(SPLIT_RATIOS[0]), "{mesher}");
        assert_eq!(by_ratio(f64::NAN), count(of(mesher), 4.0), "{mesher}");
    }
}

#[test]
fn flat_ground_is_not_split_by_distance_below_the_pages_that_are_stored() {
    let data = TempDataset::of(257, 257, |_, _| 12.0);
    for mesher in [MesherKind::Distance, MesherKind::Levels] {
        let mut feed = Feed::with_options(&data.dataset, of(mesher));
        let stats = feed.converge(&view([1100.0, 2100.0, 30.0], [2000.0, 3000.0, 0.0], 0.05));
        assert_eq!(feed.tree.resident(), 1, "{mesher}");
        assert_eq!(stats.excess, 0.0, "{mesher}");
    }
}

#[test]
fn options_out_of_range_are_refused_with_the_range_that_is_allowed() {
    let refusal = |options: MeshOptions| options.check().unwrap_err().to_string();
    for split_ratio in [0.0, -1.0, 128.5, f64::INFINITY, f64::NAN] {
        let options = MeshOptions {
            split_ratio: Some(split_ratio),
            ..MeshOptions::default()
        };
        let expected = format!("split_ratio is {split_ratio}, allowed is 1..=128");
        assert_eq!(refusal(options), expected);
    }
    for level in [0, 5, 255] {
        let expected = format!("level is {level}, allowed is 1..=4");
        assert_eq!(refusal(at_level(level)), expected);
    }
    for options in all_options() {
        assert_eq!(options.check(), Ok(()));
    }
}
