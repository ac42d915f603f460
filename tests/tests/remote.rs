//! The client's terrain behind a server that publishes anew, is lost, or has more than there is
//! room for.

use escarp_client::app::{StepStats, TerrainClient};
use escarp_client::mesh::MeshTree;
use escarp_client::remote::ClientOptions;
use escarp_client::terrain::Terrain;
use escarp_proto::page::{Page, RecordHeader};
use escarp_proto::view::View;
use escarp_tests::carried::Carried;
use escarp_tests::drive::view_to;
use escarp_tests::measure::{check_cracks, measure};
use escarp_tests::terrain::{TempDataset, hash, hills};
use proptest::prelude::*;
use std::time::Duration;

const SIDE: u32 = 257;
const FRAME: Duration = Duration::from_millis(16);

fn step(carried: &mut Carried, view: &View) -> StepStats {
    carried.now += FRAME;
    carried.client.step(view, carried.now)
}

/// The hills, with rough ground in rectangles that seeds choose.
fn published(seeds: &[u32]) -> TempDataset {
    let seeds = seeds.to_vec();
    TempDataset::of(SIDE, SIDE, move |column, row| {
        let rough = |&seed: &u32| {
            let at = |n| hash(seed, n) % (SIDE - 40);
            let side = |n| 4 + hash(seed, n) % 36;
            let (x, y, w, h) = (at(1), at(2), side(3), side(4));
            let inside = (x..x + w).contains(&column) && (y..y + h).contains(&row);
            let height = f64::from(hash(column ^ seed, row) % 400) / 10.0;
            if inside { height } else { 0.0 }
        };
        hills(column, row) + seeds.iter().map(rough).sum::<f64>()
    })
}

/// A view into the terrain, by a seed.
fn view(seed: u32, error_px: f32) -> View {
    let at = |n| 1000.0 + f64::from(hash(seed, n) % (10 * SIDE));
    let eye = [
        at(11),
        at(12) + 1000.0,
        400.0 + f64::from(hash(seed, 13) % 900),
    ];
    view_to(eye, [at(14), at(15) + 1000.0, 0.0], error_px)
}

/// Whether all pages of a tree are pages of the dataset.
fn is_of(tree: &MeshTree, data: &TempDataset) -> bool {
    tree.pages().all(|page| {
        let id = page.id();
        let finest = data.dataset.grid().is_finest(id);
        let Some(record) = data.dataset.record(id).expect("sound") else {
            return true;
        };
        let header = RecordHeader::read(id, finest, record.bytes).expect("a header");
        let bytes = header.part_bytes(0, page.parts()).expect("parts");
        let truth = Page::decode(id, finest, page.parts(), &record.bytes[bytes]);
        truth.is_ok_and(|truth| truth == *page)
    })
}

/// Which of these the shown terrain is of; its mesh is without a crack, and not empty.
fn shown(terrain: &Terrain, generations: &[TempDataset]) -> usize {
    let manifest = terrain.manifest();
    let cells = terrain.manifest().grid_levels.cells_per_side();
    check_cracks(terrain.tree(), cells).expect("no crack");
    let known = generations.iter();
    let mut known = known.map(|data| data.dataset.manifest() == manifest.as_ref());
    let index = known.position(|same| same).expect("a generation");
    assert!(
        is_of(terrain.tree(), &generations[index]),
        "pages of two generations"
    );
    index
}

/// Steps until all is here; how many steps that took.
fn settle(carried: &mut Carried, view: &View, each: impl Fn(&Carried, &StepStats)) -> StepStats {
    for _ in 0..3000 {
        let stats = step(carried, view);
        each(carried, &stats);
        if carried.client.is_settled() && stats.steady {
            return stats;
        }
    }
    panic!("never settled: {}", carried.client.status());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 4, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn an_update_is_shown_at_once_without_a_crack_or_an_empty_frame(
        seed in 0u32..1000,
        times in prop::collection::vec(0u32..60, 2),
        loses in any::<bool>(),
    ) {
        let changes = [seed, seed + 5000, seed + 9000];
        let generations = [1, 2, 3].map(|n| published(&changes[..n]));
        let mut carried = Carried::new(generations[0].open(), ClientOptions::default());
        settle(&mut carried, &view(seed, 2.0), |_, _| ());
        let mut newest = 0;
        let mut published_at = times[0];
        for frame in 0..200 {
            if frame == published_at && newest < 2 {
                newest += 1;
                carried.served().publish(generations[newest].open());
                published_at = frame + 1 + times[1];
            }
            let cut = loses && (times[0] + 2..times[0] + 9).contains(&frame);
            carried.served().connected = !cut;
            let view = view(seed + frame / 70, 2.0);
            let stats = step(&mut carried, &view);
            prop_assert!(stats.triangles > 0 && stats.bound_px.is_finite());
            let terrain = carried.client.terrain().expect("a terrain");
            // Each mesh around a change, and some of the others.
            let near = (0..25).contains(&(i64::from(frame) - i64::from(times[0])));
            if near || frame % 20 == 0 {
                prop_assert!(shown(terrain, &generations) <= newest);
            }
        }
        let last = view(seed + 3, 2.0);
        let stats = settle(&mut carried, &last, |_, _| ());
        let terrain = carried.client.terrain().expect("a terrain");
        prop_assert_eq!(shown(terrain, &generations), 2);
        prop_assert!(stats.converged);
        prop_assert!(measure(terrain.tree(), &generations[2], &last, true).largest <= 1.0);
        let served = carried.served();
        let twice = served.parts_sent.values().filter(|&&sent| sent > 1).count();
        // What comes before it is known which pages are the same is lost by a second change.
        let most = if times[1] < 6 { 2 * 6 * served.chunks_a_step } else { 0 };
        prop_assert!(twice <= most, "{twice} parts sent twice");
    }

    #[test]
    fn a_memory_cap_is_kept_at_every_view_and_the_tolerance_follows(
        seed in 0u32..1000,
        cap_pages in 40usize..120,
    ) {
        let data = published(&[seed]);
        let cap = cap_pages * 14_000;
        let options = ClientOptions { memory_cap_bytes: cap, ..ClientOptions::default() };
        let mut carried = Carried::new(data.open(), options);
        carried.served().chunks_a_step = 20;
        for turn in 0..4 {
            let view = view(seed + turn, 0.3);
            let stats = settle(&mut carried, &view, |carried, stats| {
                if let Some(terrain) = carried.client.terrain() {
                    assert!(terrain.memory_bytes() <= cap, "{} of {cap}", terrain.memory_bytes());
                }
                assert!(stats.tolerance_px >= 0.3);
            });
            // It stays as it is.
            for _ in 0..50 {
                let later = step(&mut carried, &view);
                prop_assert_eq!(later.tolerance_px, stats.tolerance_px);
            }
            let terrain = carried.client.terrain().expect("a terrain");
            let used = View { max_screen_error_px: stats.tolerance_px, ..view };
            let largest = measure(terrain.tree(), &data, &used, true).largest;
            let stated = stats.bound_px / f64::from(stats.tolerance_px);
            prop_assert!(largest <= stated.max(1.0), "{largest} over {stated}");
            prop_assert!(stats.converged, "{stats:?} {}", carried.client.status());
            let widened = stats.tolerance_px > 0.3;
            prop_assert_eq!(carried.client.status().contains("memory cap"), widened);
        }
    }
}

#[test]
fn a_tolerance_that_was_widened_for_memory_narrows_again_when_there_is_room() {
    let data = published(&[7]);
    let options = ClientOptions {
        memory_cap_bytes: 900_000,
        ..ClientOptions::default()
    };
    let mut carried = Carried::new(data.open(), options);
    let near = settle(&mut carried, &view(3, 0.3), |_, _| ());
    assert!(near.tolerance_px > 0.3, "{near:?}");
    let mut far = view(3, 0.3);
    far.eye_m[2] += 60_000.0;
    let stats = settle(&mut carried, &far, |_, _| ());
    assert_eq!(stats.tolerance_px, 0.3);
    let again = settle(&mut carried, &view(3, 0.3), |_, _| ());
    assert!(again.tolerance_px > 0.3 && again.converged, "{again:?}");
}

#[test]
fn what_was_shown_stays_while_there_is_no_server_and_nothing_comes_twice() {
    let data = published(&[5]);
    let mut carried = Carried::new(data.open(), ClientOptions::default());
    let mut before = 0;
    for frame in 0..900 {
        let cut = frame % 150 > 75;
        carried.served().connected = !cut;
        let stats = step(&mut carried, &view(frame / 300, 1.0));
        assert!(before == 0 || stats.triangles > 0);
        before = stats.triangles;
    }
    let stats = settle(&mut carried, &view(2, 1.0), |_, _| ());
    assert!(stats.converged);
    let served = carried.served();
    assert!(served.parts_sent.values().all(|&sent| sent == 1));
    assert!(carried.client.link().stats().reconnects() >= 5);
}

#[test]
fn a_cap_on_the_gpu_widens_the_tolerance_and_says_so() {
    let data = published(&[5]);
    let settled = |gpu_cap_bytes| {
        let options = ClientOptions {
            gpu_cap_bytes,
            ..ClientOptions::default()
        };
        let mut carried = Carried::new(data.open(), options);
        carried.served().chunks_a_step = 20;
        let stats = settle(&mut carried, &view(1, 0.3), |_, _| ());
        let terrain = carried.client.terrain().expect("a terrain");
        (
            stats.tolerance_px,
            terrain.tree().mesh_bytes() as u64,
            carried.client.status(),
        )
    };
    let (wished, all, _) = settled(None);
    let (widened, bytes, status) = settled(Some(all / 2));
    assert_eq!(wished, 0.3);
    assert!(
        widened > 0.3 && bytes <= all / 2,
        "{widened} px, {bytes} of {all} bytes"
    );
    assert!(status.contains("GPU memory cap"), "{status}");
}
