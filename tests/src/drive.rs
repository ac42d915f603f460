//! Driving a client from view to view, and holding it against a tree without a network.

use crate::host::PATIENCE;
use crate::terrain::TempDataset;
use escarp_client::app::headless::Driver;
use escarp_client::app::{StepStats, TerrainClient};
use escarp_client::mesh::MeshTree;
use escarp_proto::page::{Page, RecordHeader};
use escarp_proto::view::View;
use std::time::Duration;

/// How long a step waits for news at most.
const NAP: Duration = Duration::from_millis(5);

/// A view from one place to another, 1280 x 720, a radian high.
pub fn view_to(eye_m: [f64; 3], look_m: [f64; 3], error_px: f32) -> View {
    View {
        eye_m,
        direction: std::array::from_fn(|i| (look_m[i] - eye_m[i]) as f32),
        velocity_m_s: [0.0; 3],
        fov_y: 1.0,
        viewport_px: [1280, 720],
        max_screen_error_px: error_px,
    }
}

/// A view from the southern edge of a terrain down over all of it.
pub fn view_over(data: &TempDataset, error_px: f32) -> View {
    let extent = data.dataset.manifest().extent_m();
    View {
        eye_m: [
            (extent[0][0] + extent[0][1]) / 2.0,
            extent[1][0] - 100.0,
            extent[2][1] + 250.0,
        ],
        direction: [0.1, 0.9, -0.4],
        velocity_m_s: [0.0; 3],
        fov_y: 1.2,
        viewport_px: [1280, 720],
        max_screen_error_px: error_px,
    }
}

/// Steps until a condition holds of the client and its figures.
///
/// # Panics
/// If it never does.
pub fn step_until(
    driver: &mut Driver,
    view: &View,
    what: &str,
    done: impl Fn(&Driver, &StepStats) -> bool,
) -> StepStats {
    let until = driver.now() + PATIENCE;
    loop {
        let now = driver.now();
        let stats = driver.client.step(view, now);
        if done(driver, &stats) {
            return stats;
        }
        assert!(
            now < until,
            "not within {PATIENCE:?}: {what}; {}; {stats:?}",
            driver.client.status()
        );
        driver.nap(NAP);
    }
}

/// Steps until all is here, which must be enough for the tolerance.
///
/// # Panics
/// If it is not.
pub fn settle(driver: &mut Driver, view: &View) -> StepStats {
    let stats = step_until(driver, view, "settled", |driver, _| {
        driver.client.is_settled()
    });
    let error_px = f64::from(view.max_screen_error_px);
    assert!(stats.converged && stats.bound_px <= error_px, "{stats:?}");
    stats
}

/// A client's mesh tree.
///
/// # Panics
/// If it has none yet.
pub fn tree(driver: &Driver) -> &MeshTree {
    driver.client.terrain().expect("a terrain").tree()
}

/// A tree with the same parts of the same pages, straight from the dataset.
///
/// # Panics
/// If the dataset does not have them.
pub fn same_pages(data: &TempDataset, theirs: &MeshTree) -> MeshTree {
    let manifest = data.dataset.manifest();
    let mut tree = MeshTree::new(manifest.grid_levels, manifest.georef.clone());
    let mut pages: Vec<_> = theirs
        .pages()
        .map(|page| (page.id(), page.parts()))
        .collect();
    pages.sort_by_key(|(id, _)| id.key());
    for (id, parts) in pages {
        let finest = data.dataset.grid().is_finest(id);
        // Pages without a record are linked by the tree itself.
        if let Some(record) = data.dataset.record(id).expect("sound") {
            let header = RecordHeader::read(id, finest, record.bytes).expect("a header");
            let bytes = header.part_bytes(0, parts).expect("parts");
            let page = Page::decode(id, finest, parts, &record.bytes[bytes]);
            tree.link(page.expect("it decodes")).expect("it fits");
        }
    }
    tree
}
