//! What a small update of a dataset costs those who look at it.

use escarp_client::app::TerrainClient;
use escarp_client::app::headless::Driver;
use escarp_client::net::Url;
use escarp_client::remote::RemoteTerrain;
use escarp_proto::geometry::PageId;
use escarp_proto::page::RecordHeader;
use escarp_proto::view::View;
use escarp_server::{Catalog, Limits};
use escarp_tests::drive::view_to;
use escarp_tests::files::Copy;
use escarp_tests::host::{Host, MEMORY, PATIENCE};
use escarp_tests::terrain::{TempDataset, hills};
use escarp_tiles::dataset::Dataset;
use escarp_tiles::update::{Edit, update};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// Bytes of records.
#[derive(Debug, Clone, Copy, Default)]
struct Bytes {
    /// Of all that the client had when the update came.
    before: u64,
    /// Sent after the update.
    sent: u64,
    /// Of pages with another record than before, as far as the client has them now.
    changed: u64,
    /// Of parts of other pages that it had not.
    new: u64,
}

/// The parts that a client has, from the first: how many of each page.
fn resident(client: &RemoteTerrain) -> BTreeMap<PageId, u8> {
    let terrain = client.terrain().expect("a terrain");
    let pages = terrain.tree().pages();
    pages.map(|page| (page.id(), page.parts())).collect()
}

/// Length of a page's parts `from..=last`. A page without a record, which follows from the one
/// above, has none.
fn length(dataset: &Dataset, page: PageId, from: u8, last: u8) -> u64 {
    let Some(record) = dataset.record(page).expect("sound") else {
        return 0;
    };
    let finest = dataset.grid().is_finest(page);
    let header = RecordHeader::read(page, finest, record.bytes).expect("a header");
    let bytes = header.part_bytes(from, last);
    bytes.map_or(0, |bytes| bytes.len() as u64)
}

/// A view over the middle of a dataset.
fn view(dataset: &Dataset) -> View {
    let [x, y, z] = dataset.manifest().extent_m();
    let at = |[low, high]: [f64; 2], share: f64| low + share * (high - low);
    let above = z[1] + 0.1 * (x[1] - x[0]);
    view_to(
        [at(x, 0.5), at(y, 0.2), above],
        [at(x, 0.5), at(y, 0.6), z[0]],
        2.0,
    )
}

/// Makes a rectangle in view a hole, whose sides are these shares of the dataset's; `nth` of them
/// lie side by side.
fn cut(dataset: &Dataset, share: f64, nth: u32) {
    let manifest = dataset.manifest();
    let at = |share: f64, axis: usize| (share * f64::from(manifest.samples[axis])) as u32;
    let x = |share| manifest.georef.world_x(at(share, 0));
    let y = |share| manifest.georef.world_y(at(share, 1));
    let from = 0.5 - 2.0 * share * f64::from(nth);
    let edit = Edit {
        patches: Vec::new(),
        remove: vec![[x(from), y(0.5), x(from + share), y(0.5 + share)]],
        sources: Vec::new(),
    };
    let report = update(dataset, edit, &|_, _| {}).expect("an update");
    assert!(report.changed > 0);
}

fn settled_at(driver: &mut Driver, view: &View, generation: u64) {
    let began = Instant::now();
    let shown = |driver: &Driver| driver.client.manifest().map(|manifest| manifest.generation);
    while shown(driver) != Some(generation) {
        assert!(began.elapsed() < PATIENCE, "{}", driver.client.status());
        driver.step(view);
        driver.nap(PATIENCE / 1000);
    }
    driver.settle(view, PATIENCE).expect("it settles");
}

/// What a client that stands is sent for updates of the dataset, which lies in a folder of its own,
/// one right behind the other.
fn sent_again(path: &Path, share: f64, updates: u32) -> Bytes {
    let old = Dataset::open(path).expect("a dataset");
    let catalog = Arc::new(Catalog::default());
    let hosted = Arc::new(Dataset::open(path).expect("a dataset"));
    catalog.add("land", hosted).expect("a name");
    let host = Host::of_catalog(0, catalog.clone(), Limits::default());
    let url: Url = host.url("land");
    let mut driver = Driver::new(RemoteTerrain::open(url, MEMORY));
    driver.connect(PATIENCE).expect("a session");
    let view = view(&old);
    settled_at(&mut driver, &view, old.manifest().generation);
    let had = resident(&driver.client);
    let received = driver.client.link().stats().page_bytes;

    for nth in 0..updates {
        cut(&Dataset::open(path).expect("a dataset"), share, nth);
        for hosted in catalog.all() {
            hosted.publish(Arc::new(Dataset::open(path).expect("a dataset")));
        }
    }
    let new = Dataset::open(path).expect("a dataset");
    settled_at(&mut driver, &view, new.manifest().generation);
    let stats = driver.client.link().stats();
    assert_eq!(
        (stats.sessions, driver.client.refusals()),
        (1, 0),
        "{stats:?}"
    );
    let mut bytes = Bytes {
        before: had
            .iter()
            .map(|(&page, &parts)| length(&old, page, 0, parts))
            .sum(),
        sent: stats.page_bytes - received,
        ..Bytes::default()
    };
    let revision =
        |dataset: &Dataset, page| dataset.record(page).expect("sound").map(|r| r.revision);
    for (page, parts) in resident(&driver.client) {
        let is_same = revision(&old, page) == revision(&new, page);
        match had.get(&page).filter(|_| is_same) {
            None => bytes.changed += length(&new, page, 0, parts),
            Some(&had) if had < parts => bytes.new += length(&new, page, had + 1, parts),
            Some(_) => {}
        }
    }
    bytes
}

fn check(path: &Path, share: f64, updates: u32) -> Bytes {
    let bytes = sent_again(path, share, updates);
    println!(
        "{}: {bytes:?}: sent / changed {:.3}, sent / before {:.3}",
        path.display(),
        bytes.sent as f64 / bytes.changed as f64,
        bytes.sent as f64 / bytes.before as f64
    );
    assert!(bytes.changed > 0 && bytes.sent > 0, "{bytes:?}");
    bytes
}

#[test]
fn after_a_small_update_only_what_changed_is_sent_again() {
    let data = TempDataset::of(1000, 900, hills);
    let bytes = check(&data.path(), 0.02, 1);
    assert!(bytes.sent <= bytes.changed + bytes.new, "{bytes:?}");
    assert!(2 * bytes.sent < bytes.before, "{bytes:?}");
    let several = check(&TempDataset::of(1000, 900, hills).path(), 0.02, 3);
    assert!(several.sent <= several.changed + several.new, "{several:?}");
    // Another one, named from without: `ESCARP_DATASET`.
    if let Some(named) = std::env::var_os("ESCARP_DATASET") {
        let copy = Copy::of(&PathBuf::from(named));
        for share in [0.002, 0.01, 0.05] {
            let copy = Copy::of(&copy.path());
            let bytes = check(&copy.path(), share, 1);
            assert!(bytes.sent <= bytes.changed + bytes.new, "{bytes:?}");
        }
    }
}
