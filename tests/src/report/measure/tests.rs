//! The fast measure against the naive one.

use super::surface::{FullSurface, Heights, surface_height};
use super::*;
use crate::feed::Feed;
use crate::measure::measure as naive;
use crate::terrain::{TempDataset, cliff, hills, holed_hills};
use escarp_client::mesh::Frustum;
use escarp_proto::georef::WorldBox;
use std::collections::HashSet;

fn view(eye_m: [f64; 3], error_px: f32) -> View {
    let look_m = [2100.0, 2900.0, 0.0];
    View {
        eye_m,
        direction: std::array::from_fn(|i| (look_m[i] - eye_m[i]) as f32),
        velocity_m_s: [0.0; 3],
        fov_y: 1.0,
        viewport_px: [1280, 720],
        max_screen_error_px: error_px,
    }
}

fn views() -> Vec<View> {
    [
        ([2100.0, 2890.0, 60.0], 2.0),
        ([1500.0, 2500.0, 2000.0], 8.0),
        ([-4000.0, 9000.0, 5000.0], 1.0),
    ]
    .map(|(eye, px)| view(eye, px))
    .to_vec()
}

/// Samples in view under a drawn triangle, each once.
fn in_view(data: &TempDataset, triangles: &[Triangle], view: &View) -> usize {
    let georef = &data.dataset.manifest().georef;
    let frustum = Frustum::of(view);
    let mut seen = HashSet::new();
    for triangle in triangles.iter().filter(|triangle| triangle.drawn) {
        let all = Area {
            x: [0, u32::MAX],
            y: [0, u32::MAX],
        };
        scan::scan(&triangle.corners, all, 1, |point| {
            if let Some(sample) = data.sample(point.x, point.y) {
                let at = georef.world(point.x, point.y, sample);
                if frustum.may_see(&WorldBox { min: at, max: at }) {
                    seen.insert((point.x, point.y));
                }
            }
        });
    }
    seen.len()
}

#[test]
fn the_fast_measure_finds_what_the_naive_one_finds() {
    let terrains = [
        TempDataset::of(230, 190, hills),
        TempDataset::of(230, 190, holed_hills),
        TempDataset::of(200, 190, cliff),
        // Data up to a border of pages, beyond which there is no page.
        TempDataset::of(100, 100, |column, row| match column < 90 && row < 35 {
            true => f64::NAN,
            false => hills(column, row),
        }),
    ];
    let mut worst_px = 0.0f64;
    for data in &terrains {
        let full = FullSurface::open(&data.dataset, u64::MAX).unwrap();
        for view in views() {
            let mut feed = Feed::new(&data.dataset);
            // Half-way there, and converged.
            for rounds in [2, 200] {
                for _ in 0..rounds {
                    feed.tree.update(&view);
                    let wishes = feed.tree.wishes();
                    wishes.iter().for_each(|wish| assert!(feed.grant(wish)));
                    if wishes.is_empty() {
                        break;
                    }
                }
                feed.tree.update(&view);
                let expected = naive(&feed.tree, data, &view, true);
                let triangles = triangles(&feed.tree);
                let promise = Promise::of(f64::from(view.max_screen_error_px), 1.0);
                let found = full.measure(&triangles, &view, promise).unwrap();
                let close = (found.max_ratio - expected.largest).abs();
                assert!(close <= 1e-9 * expected.largest, "{found:?} {expected:?}");
                assert_eq!(found.left_out, expected.left_out);
                assert_eq!(found.covered, expected.covered);
                let samples = in_view(data, &triangles, &view);
                assert_eq!(
                    (found.compared, found.samples),
                    (samples as u64, samples as f64)
                );
                assert!((found.px.total() - found.samples).abs() < 1e-6);
                assert_eq!(found.crooked_edges, 0, "all crossings are samples");
                assert!(found.rms_px() <= found.max_px);
                worst_px = found.max_px.max(worst_px);
            }
        }
    }
    assert!(worst_px > 0.0);
}

#[test]
fn a_share_of_the_samples_estimates_all_of_them() {
    let data = TempDataset::of(900, 700, hills);
    let whole = FullSurface::open(&data.dataset, u64::MAX).unwrap();
    let shared = FullSurface::open(&data.dataset, 0).unwrap();
    for view in views() {
        let mut feed = Feed::new(&data.dataset);
        feed.converge(&view);
        let triangles = triangles(&feed.tree);
        let measure = |full: &FullSurface<'_>| {
            let promise = Promise::of(f64::from(view.max_screen_error_px), 1.0);
            full.measure(&triangles, &view, promise).unwrap()
        };
        let (exact, estimate) = (measure(&whole), measure(&shared));
        assert!(estimate.max_ratio <= exact.max_ratio);
        assert!(estimate.max_ratio >= 0.5 * exact.max_ratio);
        let near = |a: f64, b: f64, share: f64| (a - b).abs() <= share * b;
        assert!(
            near(estimate.samples, exact.samples, 0.15),
            "{} {}",
            estimate.samples,
            exact.samples
        );
        assert!(
            near(estimate.rms_px(), exact.rms_px(), 0.15),
            "{} {}",
            estimate.rms_px(),
            exact.rms_px()
        );
        assert_eq!(estimate.tiles[0], estimate.tiles[1]);
    }
}

/// Heights of a plane but for one sample.
struct Spike;

impl Heights for Spike {
    fn height(&self, x: u32, y: u32) -> Option<i32> {
        (x < 9 && y < 9).then_some(if (x, y) == (3, 2) { 100 } else { 0 })
    }
}

#[test]
fn the_surface_between_samples_is_the_finest_triangulation() {
    let at = |x: f64, y: f64| surface_height(&Spike, x, y);
    assert_eq!(at(3.0, 2.0), Some(100.0));
    assert_eq!(at(3.5, 2.0), Some(50.0));
    // 3 + 2 is odd: no diagonal ends at the spike, so the cells' middles are at 0.
    assert_eq!(at(3.5, 2.5), Some(0.0));
    assert_eq!(at(2.75, 2.125), Some(62.5));
    assert_eq!(at(8.0, 8.0), Some(0.0));
    assert_eq!(at(8.5, 8.0), None);
}
