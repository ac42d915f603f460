//! ROAM over real datasets: its limits, its queues, and the quadtree's mesh without them.

use escarp_client::mesh::{MeshOptions, MeshTree, MesherKind, Metric};
use escarp_proto::geometry::PageId;
use escarp_proto::view::View;
use escarp_tests::drive::view_to as view;
use escarp_tests::feed::{Feed, anew};
use escarp_tests::measure::{check_cracks, check_stated, triangles};
use escarp_tests::terrain::{KINDS_SIZE, TempDataset, hash, hills, kinds};
use std::collections::HashSet;

const ROAM: MeshOptions = MeshOptions {
    mesher: MesherKind::Roam,
    metric: Metric::Bounding,
    max_triangles: None,
    max_changes: None,
    split_ratio: None,
    level: None,
    cull: false,
    morph: 0.0,
};

/// Straight down, with all in view.
fn from_above(error_px: f32) -> View {
    view([2150.0, 2950.0, 6000.0], [2150.0, 2950.0, 0.0], error_px)
}

fn limited(triangles: u32) -> MeshOptions {
    MeshOptions {
        max_triangles: Some(triangles),
        ..ROAM
    }
}

/// The views of a flight with jumps, turns, and a tolerance that drifts.
fn flight(steps: u32, seed: u32) -> impl Iterator<Item = (u32, View)> {
    let mut last = view([2000.0, 2500.0, 1e4], [2001.0, 2501.0, 0.0], 2.0);
    (0..steps).map(move |step| {
        let random = |n: u32, span: u32| f64::from(hash(step * 16 + n, seed) % span);
        let eye = match hash(step, seed + 1) % 9 {
            0 => [random(1, 5000), random(2, 5000), random(3, 3000)],
            _ => [
                last.eye_m[0] + random(4, 60) - 30.0,
                last.eye_m[1] + random(5, 60),
                last.eye_m[2],
            ],
        };
        let error_px = match hash(step, seed + 2) % 3 {
            0 => last.max_screen_error_px * (0.98 + random(6, 5) as f32 / 100.0),
            _ => last.max_screen_error_px,
        };
        last = view(eye, [random(7, 4000), random(8, 4000), 0.0], error_px);
        (step, last)
    })
}

/// Grants some wishes, and now and then evicts.
fn supply(feed: &mut Feed<'_>, step: u32, seed: u32) {
    let some = hash(step, seed + 3) as usize % 40;
    for wish in feed.tree.wishes().into_iter().take(some) {
        feed.grant(&wish);
    }
    if hash(step, seed + 4).is_multiple_of(6) {
        feed.tree.evict(hash(step, seed + 5) as usize % 800_000);
    }
}

#[test]
fn without_limits_it_is_the_mesh_of_the_quadtree_after_any_flight() {
    for (name, data) in &kinds() {
        for seed in [0, 100] {
            let mut feed = Feed::with_options(&data.dataset, ROAM);
            for (step, view) in flight(40, seed) {
                feed.tree.update(&view);
                supply(&mut feed, step, seed);
                feed.tree.update(&view);
                if step % 10 == 9 {
                    let quadtree = anew(&feed.tree, &data.dataset, &view, MeshOptions::default());
                    assert_eq!(feed.tree.flags(), quadtree.flags(), "{name} {seed} {step}");
                }
            }
        }
    }
}

#[test]
fn a_limit_on_triangles_is_kept_in_every_frame_and_the_stated_bound_holds() {
    for (name, data) in &kinds() {
        let cells = data.dataset.grid().cells_per_side();
        for (seed, most) in [(0, 4), (100, 60), (200, 700), (300, 5000)] {
            let mut feed = Feed::with_options(&data.dataset, limited(most));
            for (step, view) in flight(60, seed) {
                let case = format!("{name}, {most} triangles, step {step}");
                feed.tree.update(&view);
                supply(&mut feed, step, seed);
                let stats = feed.tree.update(&view);
                feed.tree
                    .check(&view)
                    .unwrap_or_else(|why| panic!("{case}: {why}"));
                let found =
                    check_cracks(&feed.tree, cells).unwrap_or_else(|why| panic!("{case}: {why}"));
                assert!(found <= most as usize, "{case}: {found}");
                if step % 10 == 0 {
                    check_stated(&feed.tree, data, &view, stats.excess, &case);
                }
            }
        }
    }
}

#[test]
fn with_a_limit_the_mesh_follows_from_view_and_pages_alone() {
    for (name, data) in &kinds() {
        for (seed, most) in [(0, 90), (100, 900)] {
            let mut feed = Feed::with_options(&data.dataset, limited(most));
            for (step, view) in flight(40, seed) {
                feed.tree.update(&view);
                supply(&mut feed, step, seed);
                feed.tree.update(&view);
                if step % 8 == 7 {
                    let anew = anew(&feed.tree, &data.dataset, &view, limited(most));
                    assert_eq!(feed.tree.flags(), anew.flags(), "{name} {most} {step}");
                }
            }
        }
    }
}

#[test]
fn no_mesh_with_so_few_triangles_has_a_smaller_largest_bound() {
    let mut limits = 0;
    let fine = from_above(0.1);
    for (name, data) in &kinds() {
        // Bounds get smaller as parts of pages arrive: all meshes are made of the same ones.
        let mut all = Feed::new(&data.dataset);
        all.converge(&fine);
        for most in [30, 200, 1000, 3000] {
            let mut limited = anew(&all.tree, &data.dataset, &fine, limited(most));
            let excess = limited.update(&fine).excess;
            if excess <= 1.0 {
                continue;
            }
            limits += 1;
            // The quadtree has no triangle that its tolerance does not ask for, and has either all
            // or none of those whose bounds are equal.
            let count = |scale: f64| {
                let error_px = (f64::from(fine.max_screen_error_px) * excess * scale) as f32;
                let view = from_above(error_px);
                triangles(&anew(
                    &all.tree,
                    &data.dataset,
                    &view,
                    MeshOptions::default(),
                ))
                .len()
            };
            let found = triangles(&limited).len();
            let counts = [count(1.0001), count(0.9999)];
            assert!(
                counts[0] <= found && found <= most as usize,
                "{name} {most}: {found} {counts:?}"
            );
            assert!(
                counts[1] > most as usize,
                "{name} {most}: {found} {counts:?}"
            );
        }
    }
    assert!(limits > 10, "{limits} limits were of effect");
}

fn enabled(tree: &MeshTree) -> HashSet<(PageId, u16)> {
    let flags = tree.flags().into_iter().filter(|flag| flag.enabled);
    flags.map(|flag| (flag.page, flag.sample)).collect()
}

#[test]
fn a_limit_on_changes_bounds_the_work_of_a_frame_and_the_mesh_comes_to_the_same() {
    const MOST: u32 = 100;
    let options = MeshOptions {
        max_changes: Some(MOST),
        ..ROAM
    };
    for (name, data) in &kinds() {
        let cells = data.dataset.grid().cells_per_side();
        let mut feed = Feed::with_options(&data.dataset, options);
        let mut view = from_above(1.0);
        let mut before = HashSet::new();
        for (step, next) in flight(60, 7) {
            view = next;
            let case = format!("{name}, step {step}");
            let stats = feed.tree.update(&view);
            let now = enabled(&feed.tree);
            // Those on borders are in two pages; and a forced split goes to its end: on each level
            // a few vertices.
            let changed = now.symmetric_difference(&before).count();
            assert!(
                changed < 2 * (MOST as usize + 30),
                "{case}: {changed} changed"
            );
            before = now;
            feed.tree
                .check(&view)
                .unwrap_or_else(|why| panic!("{case}: {why}"));
            check_cracks(&feed.tree, cells).unwrap_or_else(|why| panic!("{case}: {why}"));
            if step % 10 == 0 {
                check_stated(&feed.tree, data, &view, stats.excess, &case);
            }
            supply(&mut feed, step, 7);
        }
        let mut rounds = 0;
        while feed.tree.update(&view).changes > 0 || !feed.tree.wishes().is_empty() {
            supply(&mut feed, 3, 9);
            rounds += 1;
            assert!(rounds < 3000, "{name} goes on without end");
        }
        let anew = anew(&feed.tree, &data.dataset, &view, ROAM);
        assert_eq!(feed.tree.flags(), anew.flags(), "{name}");
    }
}

#[test]
fn by_variance_too_there_is_no_crack_and_the_stated_bound_holds() {
    let options = MeshOptions {
        metric: Metric::Local,
        ..ROAM
    };
    for (name, data) in &kinds() {
        let cells = data.dataset.grid().cells_per_side();
        let mut feed = Feed::with_options(&data.dataset, options);
        for (step, view) in flight(40, 5) {
            let case = format!("{name}, step {step}");
            feed.tree.update(&view);
            supply(&mut feed, step, 5);
            let stats = feed.tree.update(&view);
            feed.tree
                .check(&view)
                .unwrap_or_else(|why| panic!("{case}: {why}"));
            check_cracks(&feed.tree, cells).unwrap_or_else(|why| panic!("{case}: {why}"));
            if step % 5 == 0 {
                check_stated(&feed.tree, data, &view, stats.excess, &case);
            }
        }
        let few = triangles(&feed.tree).len();
        let view = from_above(1.0);
        feed.converge(&view);
        assert!(
            *name == "flat" || triangles(&feed.tree).len() > 8,
            "{name}: {few}"
        );
    }
}

#[test]
fn what_is_no_longer_needed_can_be_evicted() {
    let data = TempDataset::of(KINDS_SIZE.0, KINDS_SIZE.1, hills);
    for options in [ROAM, limited(2000)] {
        let mut feed = Feed::with_options(&data.dataset, options);
        feed.converge(&view([2100.0, 2900.0, 60.0], [2100.0, 3900.0, 0.0], 1.0));
        let pages = feed.tree.resident();
        assert!(pages > 20, "{pages}");
        let away = view([2000.0, 3000.0, 5e6], [2000.0, 3000.0, 0.0], 1.0);
        feed.tree.update(&away);
        feed.tree.evict(0);
        // The root is always of use.
        assert_eq!(feed.tree.resident(), 1);
        feed.tree.check(&away).unwrap();
    }
}
