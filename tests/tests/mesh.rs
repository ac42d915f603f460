//! The mesh tree over real datasets: cracks, bounds, history.

use escarp_client::mesh::{MeshOptions, MeshTree, MesherKind};
use escarp_proto::view::View;
use escarp_tests::drive::view_to as view;
use escarp_tests::feed::Feed;
use escarp_tests::measure::{check_cracks, measure};
use escarp_tests::terrain::{TempDataset, cliff, hash, hills, holed_hills, spike};

const SIZE: (u32, u32) = (230, 190);

fn by(mesher: MesherKind) -> MeshOptions {
    MeshOptions {
        mesher,
        ..MeshOptions::default()
    }
}

fn terrains() -> Vec<(&'static str, TempDataset)> {
    let (w, h) = SIZE;
    vec![
        ("hills", TempDataset::of(w, h, hills)),
        ("holed hills", TempDataset::of(w, h, holed_hills)),
        ("coarse hills", TempDataset::coarse(w, h, hills, 25.0)),
        (
            "coarse holed hills",
            TempDataset::coarse(w, h, holed_hills, 9.0),
        ),
        ("cliff", TempDataset::of(w, h, cliff)),
        ("spike", TempDataset::of(w, h, spike)),
        ("flat", TempDataset::of(w, h, |_, _| 12.0)),
        (
            "noise",
            TempDataset::of(w, h, |x, y| f64::from(hash(x, y) % 4000)),
        ),
    ]
}

/// Eyes in the valley, inside a box, above, far away, outside the data.
fn views(error_px: f32) -> Vec<View> {
    let middle = [2100.0, 2900.0, 0.0];
    [
        [2100.0, 2900.0, 60.0],
        [1003.0, 2001.0, 400.0],
        [1500.0, 2500.0, 2000.0],
        [-4000.0, 9000.0, 5000.0],
        [2000.0, 3000.0, 120_000.0],
    ]
    .map(|eye| view(eye, middle, error_px))
    .to_vec()
}

/// For the meshers that keep the tolerance.
fn the_bound_holds_at_every_sample(mesher: MesherKind) {
    assert!(mesher.keeps_tolerance());
    for (name, data) in &terrains() {
        for error_px in [1.0, 2.0, 8.0] {
            for view in views(error_px) {
                let mut feed = Feed::with_options(&data.dataset, by(mesher));
                let stats = feed.converge(&view);
                assert!(stats.excess <= 1.0, "{name}: {} tolerances", stats.excess);
                let found = measure(&feed.tree, data, &view, false);
                assert!(
                    found.largest <= 1.0 + 1e-9,
                    "{name} {error_px} px {view:?}: {found:?}"
                );
                assert_eq!(
                    (found.left_out, found.covered),
                    (0, 0),
                    "{name} {error_px} px {view:?}"
                );
            }
        }
    }
}

#[test]
fn the_bound_holds_at_every_sample_of_every_terrain_at_1_2_and_8_px() {
    the_bound_holds_at_every_sample(MesherKind::Quadtree);
}

#[test]
fn with_roam_the_bound_holds_at_every_sample_of_every_terrain_at_1_2_and_8_px() {
    the_bound_holds_at_every_sample(MesherKind::Roam);
}

/// Pages come one at a time, in no order.
fn there_is_no_crack_and_the_stated_bound_holds(mesher: MesherKind) {
    for (name, data) in &terrains() {
        let cells = data.dataset.grid().cells_per_side();
        for (i, view) in views(1.0).into_iter().enumerate() {
            let mut feed = Feed::with_options(&data.dataset, by(mesher));
            for step in 0..400u32 {
                let stats = feed.tree.update(&view);
                check_cracks(&feed.tree, cells).unwrap_or_else(|why| panic!("{name}: {why}"));
                if stats.excess.is_finite() && step % 7 == 0 {
                    let found = measure(&feed.tree, data, &view, true);
                    assert!(
                        found.largest <= stats.excess.max(1.0) + 1e-9,
                        "{name}: {found:?} {stats:?}"
                    );
                    feed.tree
                        .check(&view)
                        .unwrap_or_else(|why| panic!("{name}: {why}"));
                }
                let wishes = feed.tree.wishes();
                if wishes.is_empty() {
                    break;
                }
                feed.grant(&wishes[hash(step, i as u32) as usize % wishes.len()]);
            }
        }
    }
}

#[test]
fn while_pages_are_missing_there_is_no_crack_and_the_stated_bound_holds() {
    there_is_no_crack_and_the_stated_bound_holds(MesherKind::Quadtree);
}

#[test]
fn with_roam_while_pages_are_missing_there_is_no_crack_and_the_stated_bound_holds() {
    there_is_no_crack_and_the_stated_bound_holds(MesherKind::Roam);
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
        last = view(
            eye,
            [random(6, 4000), random(7, 4000), 0.0],
            1.0 + random(8, 4) as f32,
        );
        feed.tree.update(&last);
        for wish in feed
            .tree
            .wishes()
            .into_iter()
            .take(hash(step, seed + 2) as usize % 40)
        {
            feed.grant(&wish);
        }
        if hash(step, seed + 3).is_multiple_of(6) {
            feed.tree.evict(hash(step, seed + 4) as usize % 800_000);
        }
        feed.tree.update(&last);
        if step % 6 == 5 {
            let right = feed.tree.check(&last);
            right.unwrap_or_else(|why| panic!("{name} step {step}: {why}"));
        }
        check_cracks(&feed.tree, cells).unwrap_or_else(|why| panic!("{name} step {step}: {why}"));
    }
    last
}

fn flags_and_counts_follow_from_view_and_pages(mesher: MesherKind) {
    for (name, data) in &terrains() {
        let cells = data.dataset.grid().cells_per_side();
        for seed in 0..6 {
            let mut feed = Feed::with_options(&data.dataset, by(mesher));
            let last = wander(&mut feed, name, cells, 60, seed * 100);
            let anew = anew(&feed, data, &last);
            assert_eq!(feed.tree.flags(), anew.flags(), "{name}, seed {seed}");
        }
    }
}

#[test]
fn flags_and_counts_follow_from_view_and_pages_alone_after_any_flight() {
    flags_and_counts_follow_from_view_and_pages(MesherKind::Quadtree);
}

#[test]
fn with_roam_flags_and_counts_follow_from_view_and_pages_alone_after_any_flight() {
    flags_and_counts_follow_from_view_and_pages(MesherKind::Roam);
}

#[test]
fn what_cannot_be_seen_is_left_out_and_the_bound_still_holds_in_view() {
    let culling = MeshOptions {
        cull: true,
        ..by(MesherKind::Quadtree)
    };
    for (name, data) in &terrains() {
        let cells = data.dataset.grid().cells_per_side();
        let mut saved = 0;
        for view in views(1.0) {
            let mut feed = Feed::with_options(&data.dataset, culling);
            let stats = feed.converge(&view);
            assert!(stats.excess <= 1.0, "{name}: {} tolerances", stats.excess);
            let found = measure(&feed.tree, data, &view, true);
            assert!(found.largest <= 1.0 + 1e-9, "{name} {view:?}: {found:?}");
            assert_eq!((found.left_out, found.covered), (0, 0), "{name} {view:?}");
            let mut whole = Feed::new(&data.dataset);
            whole.converge(&view);
            let [few, all] = [&mut feed, &mut whole].map(|feed| feed.tree.triangulate());
            assert!(few <= all, "{name}: {few} of {all}");
            saved += all - few;
        }
        assert!(saved > 0 || *name == "flat", "{name}");
        for seed in 0..2 {
            let mut feed = Feed::with_options(&data.dataset, culling);
            let last = wander(&mut feed, name, cells, 60, seed * 100);
            let anew = anew(&feed, data, &last);
            assert_eq!(feed.tree.flags(), anew.flags(), "{name}, seed {seed}");
        }
    }
}

/// Another tree with the same pages, updated for a view from nothing.
fn anew(feed: &Feed<'_>, data: &TempDataset, view: &View) -> MeshTree {
    let manifest = data.dataset.manifest();
    let (grid, georef) = (data.dataset.grid(), manifest.georef.clone());
    let mut anew = MeshTree::with_options(grid, georef, *feed.tree.options());
    let mut pages: Vec<_> = feed.tree.pages().cloned().collect();
    pages.sort_by_key(|page| page.id().key());
    for page in pages {
        anew.link(page).unwrap();
    }
    anew.update(view);
    anew
}

#[test]
fn a_vertex_is_enabled_on_both_sides_of_a_border_or_on_none() {
    let data = TempDataset::of(SIZE.0, SIZE.1, hills);
    let mut feed = Feed::new(&data.dataset);
    wander(
        &mut feed,
        "hills",
        data.dataset.grid().cells_per_side(),
        40,
        9,
    );
    let flags = feed.tree.flags();
    let mut borders = 0;
    for flag in flags
        .iter()
        .filter(|flag| flag.enabled && flag.sample % 17 == 16)
    {
        let Some(east) = flag.page.neighbour(escarp_proto::geometry::Edge::East) else {
            continue;
        };
        let twin = flags
            .iter()
            .find(|f| f.page == east && f.sample == flag.sample - 16);
        assert!(twin.is_some_and(|twin| twin.enabled), "{flag:?}");
        borders += 1;
    }
    assert!(borders > 0);
}

#[test]
fn a_flat_terrain_needs_few_triangles_and_no_page_but_the_first() {
    let data = TempDataset::of(257, 257, |_, _| 12.0);
    let mut feed = Feed::new(&data.dataset);
    feed.converge(&view([1100.0, 2100.0, 300.0], [2000.0, 3000.0, 0.0], 1.0));
    let drawn = {
        let mut drawn = 0;
        feed.tree
            .visit_triangles(|triangle| drawn += u32::from(triangle.drawn));
        drawn
    };
    assert!(drawn <= 8, "{drawn} triangles");
    assert_eq!(data.dataset.manifest().pages, 1);
}
