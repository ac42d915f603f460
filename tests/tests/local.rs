//! The quadtree by the article's own errors: sound as a mesh, its bound stated, and not kept.

use escarp_client::mesh::{MeshOptions, Metric};
use escarp_proto::view::View;
use escarp_tests::drive::view_to as view;
use escarp_tests::feed::{Feed, anew};
use escarp_tests::measure::{check_cracks, check_stated, measure, triangles};
use escarp_tests::terrain::{KINDS_SIZE, TempDataset, hash, hills, kinds};

fn local() -> MeshOptions {
    MeshOptions {
        metric: Metric::Local,
        ..MeshOptions::default()
    }
}

/// Eyes that wander and leap.
fn flight(steps: u32) -> impl Iterator<Item = (u32, View)> {
    let mut eye_m = [2000.0, 2500.0, 1e4];
    (0..steps).map(move |step| {
        let random = |n: u32, span: u32| f64::from(hash(step * 16 + n, 5) % span);
        eye_m = match hash(step, 6) % 6 {
            0 => [random(1, 5000), random(2, 5000), random(3, 3000)],
            _ => [
                eye_m[0] + random(4, 60) - 30.0,
                eye_m[1] + random(5, 60),
                eye_m[2],
            ],
        };
        let error_px = 1.0 + (hash(step, 7) % 3) as f32;
        (
            step,
            view(eye_m, [random(7, 4000), random(8, 4000), 0.0], error_px),
        )
    })
}

#[test]
fn while_pages_come_and_go_there_is_no_crack_no_history_and_the_stated_bound_holds() {
    for (name, data) in &kinds() {
        let cells = data.dataset.grid().cells_per_side();
        let mut feed = Feed::with_options(&data.dataset, local());
        for (step, view) in flight(40) {
            let case = format!("{name}, step {step}");
            let stats = feed.tree.update(&view);
            check_cracks(&feed.tree, cells).unwrap_or_else(|why| panic!("{case}: {why}"));
            let anew = anew(&feed.tree, &data.dataset, &view, local());
            assert_eq!(feed.tree.flags(), anew.flags(), "{case}");
            if step % 5 == 0 {
                check_stated(&feed.tree, data, &view, stats.excess, &case);
            }
            let some = hash(step, 8) as usize % 40;
            for wish in feed.tree.wishes().into_iter().take(some) {
                feed.grant(&wish);
            }
            if hash(step, 9).is_multiple_of(6) {
                feed.tree.evict(hash(step, 10) as usize % 800_000);
            }
        }
    }
}

#[test]
fn it_comes_to_rest_with_fewer_triangles_and_more_error_than_the_tolerance_and_can_be_evicted() {
    let (w, h) = KINDS_SIZE;
    let data = TempDataset::of(w, h, hills);
    let view = view([2150.0, 2950.0, 3000.0], [2150.0, 2951.0, 0.0], 4.0);
    let mut feed = Feed::with_options(&data.dataset, local());
    let stats = feed.converge(&view);
    let mut bounded = Feed::new(&data.dataset);
    bounded.converge(&view);
    let [ours, theirs] = [&feed, &bounded].map(|feed| triangles(&feed.tree).len());
    assert!(8 < ours && ours < theirs, "{ours}, by bounds {theirs}");
    let [found, kept] = [&feed, &bounded].map(|feed| measure(&feed.tree, &data, &view, true));
    assert!(kept.largest <= 1.0, "{kept:?}");
    assert!(found.largest > 1.0, "{found:?}");
    assert!(found.largest <= stats.excess, "{found:?} {stats:?}");
    let away = self::view([2000.0, 3000.0, 5e6], [2000.0, 3001.0, 0.0], 1.0);
    feed.tree.update(&away);
    feed.tree.evict(0);
    assert_eq!(feed.tree.resident(), 1);
}
