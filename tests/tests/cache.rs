//! What a client keeps on disk, in whole sessions with a server and without one.

use escarp_client::app::TerrainClient;
use escarp_client::app::headless::Driver;
use escarp_client::cache::CacheOptions;
use escarp_client::net::Url;
use escarp_client::remote::RemoteTerrain;
use escarp_server::PageSource;
use escarp_tests::drive::{settle, step_until, tree, view_over};
use escarp_tests::host::{Host, MEMORY};
use escarp_tests::terrain::TempDataset;
use escarp_tiles::update::{Edit, update};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

fn rough(x: u32, y: u32) -> f64 {
    let hills = 300.0 * (f64::from(x) / 41.0).sin() * (f64::from(y) / 53.0).cos();
    (hills + f64::from(((x * 31) ^ (y * 17)) % 23)).round()
}

fn client(url: &Url, folder: &Path, offline: bool) -> Driver {
    let mut terrain = RemoteTerrain::open(url.clone(), MEMORY);
    let options = CacheOptions {
        folder: folder.to_path_buf(),
        cap_bytes: 64 << 20,
    };
    terrain.keep_on_disk(options, url);
    if offline {
        terrain.stay_offline();
    }
    Driver::new(terrain)
}

/// Publishes a generation in which some samples of the middle are holes.
fn make_hole(data: &TempDataset) {
    let [x, y, _] = data.dataset.manifest().extent_m();
    let [west, south] = [x, y].map(|[least, most]| (least + most) / 2.0);
    let edit = Edit {
        patches: Vec::new(),
        remove: vec![[west, south, west + 200.0, south + 150.0]],
        sources: vec!["a hole".into()],
    };
    let report = update(&data.dataset, edit, &|_, _| {}).unwrap();
    assert!(report.removed > 0, "{report:?}");
}

#[test]
fn the_second_run_downloads_next_to_nothing_and_shows_the_same() {
    let data = TempDataset::of(700, 700, rough);
    let folder = tempfile::tempdir().unwrap();
    let host = Host::of("land", data.open());
    let url = host.url("land");
    let view = view_over(&data, 1.0);
    let mut first = client(&url, folder.path(), false);
    let before = settle(&mut first, &view);
    let resident = tree(&first).resident();
    first.client.close();
    let mut second = client(&url, folder.path(), false);
    let after = settle(&mut second, &view);
    assert!(before.converged && after.converged, "{after:?}");
    assert_eq!(after.triangles, before.triangles);
    assert_eq!(tree(&second).resident(), resident);
    let page_bytes = second.client.link().stats().page_bytes;
    assert!(before.bytes_received > 50_000, "{before:?}");
    assert!(
        page_bytes * 100 < before.bytes_received,
        "{page_bytes} bytes"
    );
    drop(second);
    // Without a server: the same picture.
    drop(host);
    let mut offline = client(&url, folder.path(), true);
    let kept = settle(&mut offline, &view);
    assert_eq!(kept.triangles, before.triangles);
    assert!(kept.converged && kept.bytes_received == 0, "{kept:?}");
    assert!(offline.client.status().contains("offline"));
}

#[test]
fn what_an_update_left_as_it_was_is_used_in_the_next_run_and_in_all_after_it() {
    let data = TempDataset::of(700, 700, rough);
    let folder = tempfile::tempdir().unwrap();
    let view = view_over(&data, 1.0);
    let run = |host: &Host| {
        let url = host.url("land");
        let mut driver = client(&url, folder.path(), false);
        let stats = settle(&mut driver, &view);
        let found = driver.client.link().stats().page_bytes;
        (stats, found, driver.client.manifest().unwrap().generation)
    };
    let host = Host::of("land", data.open());
    let port = host.address().port();
    let (_, all, generation) = run(&host);
    assert_eq!(generation, 1);
    host.stop();
    make_hole(&data);
    let new = || -> Arc<dyn PageSource> { Arc::new(data.newest().dataset) };
    let host = Host::start_on(port, &[("land", new())]);
    let (second, changed, generation) = run(&host);
    assert!(generation == 2 && changed > 0, "{changed} bytes");
    assert!(changed * 4 < all, "{changed} of {all} bytes");
    let (third, again, _) = run(&host);
    assert!(again * 100 < all, "{again} of {all} bytes");
    assert_eq!(third.triangles, second.triangles);
}

#[test]
fn another_dataset_at_the_same_address_is_shown_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let old = TempDataset::of(500, 500, rough);
    let host = Host::of("land", old.open());
    let (url, port) = (host.url("land"), host.address().port());
    let view = view_over(&old, 2.0);
    let mut first = client(&url, folder.path(), false);
    settle(&mut first, &view);
    first.client.close();
    host.stop();
    let new = TempDataset::of(500, 500, |x, y| rough(y, x) + 40.0);
    let host = Host::start_on(port, &[("land", Arc::new(new.open()))]);
    let mut second = client(&url, folder.path(), false);
    let current = new.dataset.manifest().clone();
    step_until(&mut second, &view, "the new manifest", |driver, _| {
        driver
            .client
            .manifest()
            .is_some_and(|manifest| *manifest == current)
    });
    let stats = settle(&mut second, &view);
    assert!(stats.converged, "{stats:?}");
    for page in tree(&second).pages() {
        let stored = new.dataset.record(page.id()).unwrap();
        if let Some(record) = stored {
            let finest = new.dataset.grid().is_finest(page.id());
            let whole = escarp_proto::page::Page::decode(
                page.id(),
                finest,
                escarp_proto::page::last_part(finest),
                record.bytes,
            )
            .unwrap();
            assert_eq!(page.height(0), whole.height(0), "page {}", page.id());
        }
    }
    drop(host);
}

#[test]
fn without_anything_kept_an_offline_client_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let url = "http://127.0.0.1:1/land".parse().unwrap();
    let mut driver = client(&url, folder.path(), true);
    let error = driver.connect(Duration::from_secs(30)).unwrap_err();
    assert!(error.to_string().contains("nothing is kept"), "{error}");
}
