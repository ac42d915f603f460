//! What the selection lists, given to a mesh tree: it wants no more, and little less would do.

use escarp_client::mesh::MeshTree;
use escarp_proto::geometry::PageId;
use escarp_proto::page::{Bounds, BoxError};
use escarp_proto::select::{Eyes, Known, Look, Need, Scope, Selection, Sketch};
use escarp_proto::view::View;
use escarp_proto::wire::Class;
use escarp_tests::drive::{view_over, view_to};
use escarp_tests::feed::Feed;
use escarp_tests::report::leave_out::used_bytes;
use escarp_tests::selected::{AllPages, part_bytes, select, select_for, tree_of};
use escarp_tests::terrain::{TempDataset, cliff, hash, hills, holed_hills, spike};
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

const NO_LIMIT: usize = 1 << 20;

fn terrains() -> Vec<(&'static str, TempDataset)> {
    vec![
        ("hills", TempDataset::of(300, 280, hills)),
        ("holes", TempDataset::of(200, 160, holed_hills)),
        ("cliff", TempDataset::of(260, 140, cliff)),
        ("spike", TempDataset::of(200, 200, spike)),
        ("flat", TempDataset::of(100, 70, |_, _| 12.0)),
        ("cut", TempDataset::coarse(300, 260, hills, 25.0)),
        ("one page", TempDataset::of(9, 9, hills)),
    ]
}

/// Views that look random: near and far, inside the ground and high above, narrow and wide.
fn views(data: &TempDataset, count: u32, seed: u32) -> Vec<View> {
    let extent = data.dataset.manifest().extent_m();
    let random = |i: u32, what: u32| f64::from(hash(seed ^ i << 8, what) % 10_000) / 10_000.0;
    let view = |i: u32| {
        let along =
            |axis: usize, at: f64| extent[axis][0] + at * (extent[axis][1] - extent[axis][0]);
        let far = [0.5, 1.2, 4.0][i as usize % 3];
        let at = |axis: usize| along(axis, 0.5 + (random(i, axis as u32) - 0.5) * 2.0 * far);
        let high = extent[2][0].max(-500.0) + random(i, 2).powi(3) * 4000.0;
        let direction = std::array::from_fn(|axis| random(i, 3 + axis as u32) as f32 - 0.5);
        View {
            eye_m: [at(0), at(1), high],
            direction,
            fov_y: [0.2, 1.0, 2.5][random(i, 7).mul_add(3.0, 0.0) as usize],
            ..view_to(
                [0.0; 3],
                [1.0; 3],
                [0.5, 1.0, 2.0, 8.0, 40.0][(random(i, 8) * 5.0) as usize],
            )
        }
    };
    (0..count).map(view).collect()
}

#[test]
fn a_tree_that_has_what_is_listed_is_within_the_tolerance_and_wishes_for_nothing() {
    for (name, data) in terrains() {
        let mut known = AllPages::new(&data.dataset);
        let mut views = views(&data, 24, 1);
        views.push(view_over(&data, 1.0));
        for view in views {
            let (needs, outcome) = select(&mut known, &view, Scope::All, NO_LIMIT);
            assert!(
                !outcome.truncated && outcome.excess <= 1.0,
                "{name}: {outcome:?}"
            );
            let mut tree = tree_of(&data.dataset, &needs);
            let stats = tree.update(&view);
            assert_eq!(tree.wishes(), [], "{name}: {view:?}");
            assert!(stats.excess <= 1.0, "{name}: {stats:?} {view:?}");
            assert!(needs.iter().all(|need| !need.guessed));
        }
    }
}

#[test]
fn what_is_listed_for_a_picture_leaves_no_wish_in_it() {
    for (name, data) in terrains() {
        let mut known = AllPages::new(&data.dataset);
        for view in views(&data, 24, 2) {
            let (all, _) = select(&mut known, &view, Scope::All, NO_LIMIT);
            let (needs, _) = select(&mut known, &view, Scope::InView, NO_LIMIT);
            let mut tree = tree_of(&data.dataset, &needs);
            let stats = tree.update(&view);
            assert!(stats.excess <= 1.0, "{name}: {stats:?} {view:?}");
            let wishes = tree.wishes();
            let ring = wishes.iter().all(|wish| wish.class == Class::Ring);
            assert!(ring, "{name}: {wishes:?} {view:?}");
            let parts: HashMap<PageId, u8> = all.iter().map(|n| (n.page, n.last_part)).collect();
            assert!(needs.iter().all(|need| need.last_part <= parts[&need.page]));
        }
    }
}

/// A way of an eye through a terrain, as long as it is from a bit to all of it, and places on it
/// and beside it.
fn flight(data: &TempDataset, view: &View, seed: u32) -> (Eyes, Vec<View>) {
    let extent = data.dataset.manifest().extent_m();
    let side_m = extent[0][1] - extent[0][0];
    let random = |i: u32, what: u32| f64::from(hash(seed ^ i << 8, what) % 10_001) / 10_000.0;
    let long_m = side_m * [0.003, 0.03, 0.3][seed as usize % 3];
    let end_m = std::array::from_fn(|i| view.eye_m[i] + long_m * (random(0, i as u32) - 0.5));
    let beside_m = 0.25 * long_m * random(0, 3);
    let eyes = Eyes::between(view.eye_m, end_m, beside_m);
    let place = |i: u32| {
        let eye_m: [f64; 3] = std::array::from_fn(|axis| {
            let (a, b) = (view.eye_m[axis], end_m[axis]);
            let (low, high) = (a.min(b) - beside_m, a.max(b) + beside_m);
            // Often at a corner, where what is selected has no room to spare.
            let share = (random(i, axis as u32) * 1.6 - 0.3).clamp(0.0, 1.0);
            low + share * (high - low)
        });
        View { eye_m, ..*view }
    };
    let places = (1..7).map(place).filter(|view| eyes.hold(view.eye_m));
    (eyes, places.chain([*view]).collect())
}

#[test]
fn what_is_listed_for_a_way_is_enough_wherever_on_it_the_eye_is() {
    for (name, data) in terrains() {
        let mut known = AllPages::new(&data.dataset);
        for (i, view) in views(&data, 15, 7).into_iter().enumerate() {
            let (eyes, places) = flight(&data, &view, i as u32);
            assert!(places.len() >= 5, "few are beyond the box by rounding");
            for scope in [Scope::All, Scope::InView] {
                let view = &view;
                let (needs, outcome) = select_for(&mut known, Look { view, eyes, scope }, NO_LIMIT);
                assert!(!outcome.truncated && outcome.excess <= 1.0);
                let mut tree = tree_of(&data.dataset, &needs);
                for place in &places {
                    let stats = tree.update(place);
                    assert!(stats.excess <= 1.0, "{name}: {stats:?} {place:?}");
                    let wishes = tree.wishes();
                    let left = |class| scope == Scope::InView && class == Class::Ring;
                    let none = wishes.iter().all(|wish| left(wish.class));
                    assert!(none, "{name}: {wishes:?} {place:?}");
                }
            }
        }
    }
}

#[test]
fn what_is_listed_for_one_place_is_what_is_listed_for_a_way_of_no_length() {
    let data = TempDataset::of(300, 280, hills);
    let mut known = AllPages::new(&data.dataset);
    for view in views(&data, 12, 8) {
        for scope in [Scope::All, Scope::InView] {
            let (point, _) = select(&mut known, &view, scope, NO_LIMIT);
            let eyes = Eyes::between(view.eye_m, view.eye_m, 0.0);
            let view = &view;
            let (way, _) = select_for(&mut known, Look { view, eyes, scope }, NO_LIMIT);
            assert_eq!(point, way);
        }
    }
}

/// Bytes that are listed, and those of them that the mesh uses.
fn bytes(data: &TempDataset, needs: &[Need], tree: &MeshTree) -> (f64, f64) {
    let listed = needs
        .iter()
        .map(|need| part_bytes(&data.dataset, need.page, need.last_part));
    let used = used_bytes(&data.dataset, tree).unwrap();
    (listed.sum::<usize>() as f64, used as f64)
}

#[test]
fn a_client_that_asks_page_by_page_gets_no_fewer_bytes_than_are_listed() {
    for (name, data) in terrains() {
        let mut known = AllPages::new(&data.dataset);
        let (mut listed, mut pulled) = (0.0, 0.0);
        for view in views(&data, 8, 3) {
            let (needs, _) = select(&mut known, &view, Scope::All, NO_LIMIT);
            let mut feed = Feed::new(&data.dataset);
            feed.converge(&view);
            let tree = tree_of(&data.dataset, &needs);
            listed += bytes(&data, &needs, &tree).0;
            let stored = |id| data.dataset.record(id).unwrap().is_some();
            let pages = feed.tree.pages().filter(|page| stored(page.id()));
            let pages = pages.map(|page| part_bytes(&data.dataset, page.id(), page.parts()));
            pulled += pages.sum::<usize>() as f64;
        }
        assert!(
            listed <= pulled * 1.01,
            "{name}: {listed} listed, {pulled} pulled"
        );
    }
}

#[test]
fn every_page_comes_once_after_the_page_above_it_and_no_more_than_are_allowed() {
    let data = TempDataset::of(300, 280, hills);
    let mut known = AllPages::new(&data.dataset);
    for view in views(&data, 6, 4) {
        let (all, _) = select(&mut known, &view, Scope::All, NO_LIMIT);
        for limit in [0, 1, 2, 7, 40, all.len(), all.len() + 1] {
            let (needs, outcome) = select(&mut known, &view, Scope::All, limit);
            assert!(needs.len() <= limit);
            assert_eq!(outcome.truncated, limit < all.len());
            assert_eq!(outcome.excess > 1.0, outcome.truncated, "{outcome:?}");
            let mut before = HashSet::new();
            for need in &needs {
                let above = need.page.parent().map(|(above, _)| above);
                assert!(above.is_none_or(|above| before.contains(&above)));
                assert!(before.insert(need.page));
            }
        }
    }
}

#[test]
fn a_page_stands_further_beyond_the_tolerance_the_fewer_of_its_parts_are_here() {
    let data = TempDataset::of(300, 280, hills);
    let mut known = AllPages::new(&data.dataset);
    for view in views(&data, 6, 5) {
        let (needs, _) = select(&mut known, &view, Scope::All, NO_LIMIT);
        for need in needs {
            assert!(need.excess.is_sorted_by(|a, b| a >= b), "{need:?}");
            let last = usize::from(need.last_part);
            assert!(need.excess[last..].iter().all(|&excess| excess == 0.0));
            assert!(need.excess[0] > 0.0, "{need:?}");
        }
    }
}

#[test]
fn any_view_that_is_in_order_is_selected_for() {
    let data = TempDataset::of(200, 160, holed_hills);
    let mut known = AllPages::new(&data.dataset);
    let usual = view_over(&data, 1.0);
    for eye_m in [
        usual.eye_m,
        [0.0; 3],
        [1e12; 3],
        [-1e12, 5.0, 1e12],
        [2000.0, 3000.0, 0.0],
    ] {
        for (fov_y, px) in [(0.001, 0.05), (3.0, 1024.0), (3.0, 0.05), (0.001, 1024.0)] {
            for viewport_px in [[1, 1], [32_768, 32_768], [32_768, 1]] {
                let view = View {
                    eye_m,
                    fov_y,
                    max_screen_error_px: px,
                    viewport_px,
                    ..usual
                };
                view.check().unwrap();
                let (needs, outcome) = select(&mut known, &view, Scope::All, NO_LIMIT);
                assert!(!outcome.truncated);
                let mut tree = tree_of(&data.dataset, &needs);
                assert!(tree.update(&view).excess <= 1.0, "{view:?}");
                assert_eq!(tree.wishes(), [], "{view:?}");
            }
        }
    }
}

/// The pages of a tree.
struct Resident<'a>(&'a MeshTree, &'a TempDataset);

impl Resident<'_> {
    fn promise(&self, id: PageId) -> Option<BoxError> {
        let (above, slot) = id.parent()?;
        let page = self.0.page(above)?;
        Some(Bounds::cell(page, slot, self.promise(above)))
    }
}

impl Known for Resident<'_> {
    fn sketch(&mut self, id: PageId) -> Option<Arc<Sketch>> {
        let manifest = self.1.dataset.manifest();
        let page = self.0.page(id)?;
        let (grid, georef) = (manifest.grid_levels, &manifest.georef);
        Some(Arc::new(Sketch::of(page, self.promise(id), grid, georef)))
    }
}

#[test]
fn what_a_client_lists_of_what_it_has_has_all_that_its_mesh_wishes_for() {
    for (name, data) in terrains() {
        let manifest = data.dataset.manifest();
        let at = (manifest.grid_levels, &manifest.georef);
        for (i, view) in views(&data, 6, 6).into_iter().enumerate() {
            let mut feed = Feed::new(&data.dataset);
            for round in 0..40 {
                feed.tree.update(&view);
                let wishes = feed.tree.wishes();
                let mut needs = Vec::new();
                let mut known = Resident(&feed.tree, &data);
                let limit = NO_LIMIT;
                Selection::default().select(at, &view, Scope::All, &mut known, limit, &mut needs);
                for wish in &wishes {
                    let need = needs.iter().find(|need| need.page == wish.page);
                    assert!(
                        need.is_some_and(|need| need.last_part > wish.resident),
                        "{name}: {wish:?} {need:?}"
                    );
                }
                // Only some of them, and other ones each time.
                for (j, wish) in wishes.iter().enumerate() {
                    if !hash(i as u32 * 64 + round, j as u32).is_multiple_of(3) {
                        feed.grant(wish);
                    }
                }
                if wishes.is_empty() {
                    let parts = |page| feed.tree.page(page).map_or(0, |page| page.parts());
                    let lacking = needs
                        .iter()
                        .filter(|need| parts(need.page) < need.last_part);
                    assert!(lacking.count() * 20 <= needs.len(), "{name}");
                    break;
                }
            }
        }
    }
}
