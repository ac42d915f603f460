//! The mesh as it is displayed while vertices come and go gradually: the promise, cracks, jumps,
//! and the average of meshes that it is.

use escarp_client::mesh::{MeshOptions, MeshTree, MesherKind};
use escarp_client::render::{DrawParams, Gpu, Output, Scene, render_to_image};
use escarp_proto::view::View;
use escarp_tests::displayed::{
    Average, check_displayed, displayed_deviation, displayed_heights, weighted,
};
use escarp_tests::drive::view_to as view;
use escarp_tests::feed::Feed;
use escarp_tests::measure::check_cover;
use escarp_tests::terrain::{TempDataset, cliff, hash, hills, holed_hills, spike};

const SIZE: (u32, u32) = (230, 190);

fn options(morph: f64) -> MeshOptions {
    MeshOptions {
        morph,
        ..MeshOptions::default()
    }
}

fn noise(x: u32, y: u32) -> f64 {
    f64::from(hash(x, y) % 4000)
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
        ("noise", TempDataset::of(w, h, noise)),
    ]
}

/// Eyes in the valley, inside a box, above, far away, outside the data.
const EYES: [[f64; 3]; 5] = [
    [2100.0, 2900.0, 60.0],
    [1003.0, 2001.0, 400.0],
    [1500.0, 2500.0, 2000.0],
    [-4000.0, 9000.0, 5000.0],
    [2000.0, 3000.0, 120_000.0],
];
const MIDDLE: [f64; 3] = [2100.0, 2900.0, 0.0];

/// Whether any vertex is on its way.
fn any_moved(tree: &MeshTree) -> bool {
    let mut moved = false;
    tree.visit_displayed(|triangle, displayed| {
        let heights = triangle.corners.map(|(_, _, height)| f64::from(height));
        moved |= heights != displayed;
    });
    moved
}

/// Converges, and holds all that is promised against the tree.
fn check(feed: &mut Feed<'_>, data: &TempDataset, view: &View, what: &str) -> f64 {
    let stats = feed.converge(view);
    assert!(stats.excess <= 1.0, "{what}: {stats:?}");
    let (largest, at) = displayed_deviation(&feed.tree, data, view, false);
    assert!(largest <= 1.0, "{what}: {largest} tolerances at {at:?}");
    check_displayed(&feed.tree).unwrap_or_else(|why| panic!("{what}: {why}"));
    largest
}

#[test]
fn the_displayed_mesh_keeps_the_promise_on_every_terrain_from_half_a_pixel_to_32() {
    let (mut largest, mut moved) = (0.0f64, 0);
    for (name, data) in &terrains() {
        for (error_px, morph) in [
            (0.5, 0.25),
            (1.0, 0.1),
            (2.0, 0.25),
            (8.0, 0.5),
            (32.0, 0.25),
        ] {
            for eye in EYES {
                let what = format!("{name} {error_px} px {morph} from {eye:?}");
                let mut feed = Feed::with_options(&data.dataset, options(morph));
                let view = view(eye, MIDDLE, error_px);
                largest = largest.max(check(&mut feed, data, &view, &what));
                moved += u32::from(any_moved(&feed.tree));
            }
        }
    }
    println!("{largest} tolerances at most, {moved} views with vertices on their way");
    assert!(largest > 0.5 && moved > 50, "{largest} {moved}");
}

/// A flight of steps small and large, with jumps, and another tolerance now and then.
fn flight(seed: u32, steps: u32) -> impl Iterator<Item = View> {
    let random = move |step: u32, n: u32, span: u32| f64::from(hash(step * 16 + n, seed) % span);
    let mut eye = [2000.0, 2500.0, 800.0];
    (0..steps).map(move |step| {
        let stride = [0.3, 5.0, 60.0, 900.0][hash(step / 5, seed + 1) as usize % 4];
        for (axis, w) in eye.iter_mut().enumerate() {
            *w += (random(step, axis as u32, 2000) / 1000.0 - 0.8) * stride;
        }
        if hash(step, seed + 2).is_multiple_of(17) {
            eye = [
                random(step, 4, 5000),
                random(step, 5, 5000),
                random(step, 6, 3000),
            ];
        }
        let error_px = [0.5, 1.0, 4.0][hash(step / 20, seed) as usize % 3];
        view(eye, MIDDLE, error_px)
    })
}

#[test]
fn the_displayed_mesh_keeps_the_promise_on_the_way() {
    let meshers = [MesherKind::Quadtree, MesherKind::Roam];
    let terrains = terrains();
    let cases = terrains
        .iter()
        .flat_map(|case| meshers.map(|mesher| (mesher, case)));
    for (seed, (mesher, (name, data))) in (0..).zip(cases) {
        let options = MeshOptions {
            mesher,
            ..options(0.25)
        };
        let mut feed = Feed::with_options(&data.dataset, options);
        for (step, view) in flight(seed * 100, 20).enumerate() {
            check(
                &mut feed,
                data,
                &view,
                &format!("{name} step {step} {view:?}"),
            );
        }
    }
}

#[test]
fn while_pages_are_missing_there_is_no_crack_and_the_stated_bound_holds() {
    for (seed, (name, data)) in (0..).zip(&terrains()) {
        let cells = data.dataset.grid().cells_per_side();
        let mut feed = Feed::with_options(&data.dataset, options(0.25));
        for (step, view) in (0..).zip(flight(seed * 100 + 7, 40)) {
            let stats = feed.tree.update(&view);
            for wish in feed
                .tree
                .wishes()
                .iter()
                .take(hash(step, seed) as usize % 9)
            {
                feed.grant(wish);
            }
            if hash(step, seed + 3).is_multiple_of(6) {
                feed.tree.evict(hash(step, seed + 4) as usize % 800_000);
            }
            check_displayed(&feed.tree).unwrap_or_else(|why| panic!("{name}: {why}"));
            check_cover(&feed.tree, cells).unwrap_or_else(|why| panic!("{name}: {why}"));
            if stats.excess.is_finite() {
                let (largest, at) = displayed_deviation(&feed.tree, data, &view, true);
                let bound = stats.excess * (1.0 + 1e-9);
                assert!(largest <= bound, "{name}: {largest} at {at:?}, {stats:?}");
            }
        }
    }
}

#[test]
fn the_displayed_mesh_is_the_average_of_meshes_made_one_by_one() {
    let mut compared = 0;
    for (seed, (name, data)) in (0..).zip(&terrains()) {
        let grid = data.dataset.grid();
        let mut feed = Feed::with_options(&data.dataset, options(0.5));
        for view in flight(seed * 100 + 13, 12) {
            feed.converge(&view);
            let vertices = weighted(&feed.tree, grid).unwrap_or_else(|why| panic!("{name}: {why}"));
            let average = Average::of(&feed.tree, &vertices, grid.cells_per_side());
            let mut displayed = std::collections::HashMap::new();
            feed.tree.visit_displayed(|triangle, heights| {
                for ((x, y, _), height) in triangle.corners.into_iter().zip(heights) {
                    displayed.insert((x, y), height);
                }
            });
            let moving = vertices.iter().filter(|(_, vertex)| vertex.weight < 1.0);
            let moving = moving.filter_map(|(at, vertex)| Some((*at, vertex.height?)));
            for (at, height) in moving.take(60) {
                let (expected, found) = (average.at(at), displayed[&at]);
                let allowed = 1e-5 * (expected - f64::from(height)).abs() + 1e-6;
                let off = (expected - found).abs();
                assert!(
                    off <= allowed,
                    "{name} {at:?}: {found}, expected {expected}"
                );
                compared += 1;
            }
        }
    }
    println!("{compared} vertices");
    assert!(compared > 1000, "{compared}");
}

/// A slow flight over a terrain, half a metre a frame.
fn slow(frame: u32, error_px: f32) -> View {
    let way = f64::from(frame) * 0.5;
    let eye = [1500.0 + 0.6 * way, 1800.0 + 0.8 * way, 1500.0 - 0.1 * way];
    view(eye, [eye[0] + 600.0, eye[1] + 800.0, 0.0], error_px)
}

/// Largest jump of the displayed surface at any sample between two frames of a slow flight, in
/// tolerances, and how many jumps there were of more than a tenth.
fn largest_jump(
    data: &TempDataset,
    options: MeshOptions,
    frames: u32,
    error_px: f32,
) -> (f64, u64) {
    let georef = &data.dataset.manifest().georef;
    let samples = data.dataset.manifest().samples;
    let mut feed = Feed::with_options(&data.dataset, options).whole();
    let mut before: Option<Vec<f64>> = None;
    let (mut largest, mut many) = (0.0f64, 0);
    for frame in 0..frames {
        let view = slow(frame, error_px);
        feed.converge(&view);
        let heights = displayed_heights(&feed.tree, samples);
        for (i, (now, before)) in heights.iter().zip(before.iter().flatten()).enumerate() {
            let jump_m = (now - before).abs() * georef.quantum_m;
            if jump_m.is_nan() || jump_m == 0.0 {
                continue;
            }
            let (x, y) = (i as u32 % samples[0], i as u32 / samples[0]);
            let at = georef.world(x, y, *now as i32);
            let distance_m = (0..3)
                .map(|w| (at[w] - view.eye_m[w]).abs())
                .fold(0.0, f64::max);
            let jump = jump_m * view.threshold() / distance_m;
            largest = largest.max(jump);
            many += u64::from(jump > 0.1);
        }
        before = Some(heights);
    }
    (largest, many)
}

#[test]
fn in_a_slow_flight_nothing_jumps_by_more_than_a_twentieth_of_the_tolerance() {
    // Without holes: an outline jumps as triangles come and go along it.
    let side = 257;
    for (name, data, jumps) in [
        ("hills", TempDataset::of(side, side, hills), 100),
        ("noise", TempDataset::of(side, side, noise), 1),
    ] {
        let roam = MeshOptions {
            mesher: MesherKind::Roam,
            ..options(0.25)
        };
        let (with, _) = largest_jump(&data, roam, 60, 4.0);
        println!("{name} 4 px, roam: {with}");
        assert!(with <= 0.05, "{name}, roam: {with}");
        for error_px in [1.0, 4.0] {
            let (with, _) = largest_jump(&data, options(0.25), 60, error_px);
            let (without, many) = largest_jump(&data, options(0.0), 60, error_px);
            println!("{name} {error_px} px: {with} with, {without} without ({many} jumps)");
            assert!(with <= 0.05, "{name} {error_px} px: {with}");
            let jumps = if error_px > 1.0 { jumps } else { 0 };
            assert!(
                many >= jumps && (jumps == 0 || without > 0.1),
                "{without} {many}"
            );
        }
    }
}

#[test]
fn a_vertex_comes_and_goes_where_it_lies_on_the_edge_that_it_splits() {
    let data = TempDataset::of(SIZE.0, SIZE.1, hills);
    let grid = data.dataset.grid();
    let mut feed = Feed::with_options(&data.dataset, options(0.25));
    let mut before = None;
    let mut changes = 0;
    for frame in 0..120 {
        feed.converge(&slow(frame, 1.0));
        let now = weighted(&feed.tree, grid).expect("equal on both sides");
        if let Some(before) = &before {
            for (one, other) in [(before, &now), (&now, before)] {
                for (at, vertex) in one.iter().filter(|(at, _)| !other.contains_key(at)) {
                    assert!(vertex.weight <= 0.04, "frame {frame} {at:?}: {vertex:?}");
                    changes += 1;
                }
            }
        }
        before = Some(now);
    }
    assert!(changes > 60, "{changes}");
}

#[test]
fn without_morph_nothing_is_moved_and_no_vertex_more_is_enabled() {
    let data = TempDataset::of(SIZE.0, SIZE.1, hills);
    let view = view(EYES[2], MIDDLE, 1.0);
    let mut plain = Feed::new(&data.dataset);
    plain.converge(&view);
    for off in [0.0, -1.0, f64::NAN, 1e-9] {
        let mut feed = Feed::with_options(&data.dataset, options(off));
        feed.converge(&view);
        assert!(!any_moved(&feed.tree) && feed.tree.weights().is_empty());
        assert_eq!(feed.tree.flags(), plain.tree.flags());
    }
    for huge in [f64::INFINITY, 1e300] {
        let mut feed = Feed::with_options(&data.dataset, options(huge));
        check(&mut feed, &data, &view, "a huge share");
    }
}

/// Pictures of the meshes of a slow flight, all from one place: they differ by the mesh alone.
fn pictures(data: &TempDataset, morph: f64, frames: u32) -> Vec<image::RgbaImage> {
    let gpu = Gpu::headless().unwrap_or_else(|error| panic!("{error}"));
    let manifest = data.dataset.manifest();
    let output = Output::image(4);
    let mut scene = Scene::new(&gpu, &manifest.georef, manifest.height_range, output);
    let mut feed = Feed::with_options(&data.dataset, options(morph)).whole();
    let mut params = DrawParams::new(View {
        viewport_px: [640, 360],
        ..slow(0, 4.0)
    });
    params.wireframe = false;
    let draw = |frame| {
        feed.converge(&slow(frame, 4.0));
        feed.tree.triangulate();
        scene.sync(feed.tree.meshes());
        render_to_image(&gpu, &mut scene, &params).unwrap_or_else(|error| panic!("{error}"))
    };
    (0..frames).map(draw).collect()
}

/// Pixels whose colour changes by more than so many steps of 255 from one picture to the next.
fn changed(pictures: &[image::RgbaImage], steps: u8) -> u64 {
    let pairs = pictures.windows(2);
    let count = |pair: &[image::RgbaImage]| {
        let pixels = pair[0].pixels().zip(pair[1].pixels());
        let off = |(a, b): &(&image::Rgba<u8>, &image::Rgba<u8>)| {
            (0..3).any(|c| a.0[c].abs_diff(b.0[c]) > steps)
        };
        pixels.filter(off).count() as u64
    };
    pairs.map(count).sum()
}

#[test]
fn pictures_of_a_slow_flight_change_little_by_little() {
    let data = TempDataset::of(257, 257, hills);
    let (with, without) = (pictures(&data, 0.25, 40), pictures(&data, 0.0, 40));
    for steps in [1, 2, 4, 8, 16, 32] {
        println!(
            "{steps}: {} with, {} without",
            changed(&with, steps),
            changed(&without, steps)
        );
    }
    let many = [&with, &without].map(|pictures| changed(pictures, 4));
    assert!(many[1] > 100 && many[0] * 3 < many[1], "{many:?}");
    if let Some(folder) = std::env::var_os("ESCARP_PICTURES") {
        let folder = std::path::PathBuf::from(folder);
        with[0].save(folder.join("with.png")).expect("a picture");
        without[0]
            .save(folder.join("without.png"))
            .expect("a picture");
    }
}
