//! Pages held against what is known of them: honest ones are never refused, those of a liar are
//! named, asked for again once, and then missing.

use escarp_client::app::TerrainClient;
use escarp_client::app::headless::Driver;
use escarp_client::mesh::MeshTree;
use escarp_proto::geometry::{PAGE_SLOTS, PageId, Slot};
use escarp_proto::page::{Codec, PAGE_AREA, Page, Record, RecordHeader, revision};
use escarp_proto::wire::{Chunk, ServerMessage};
use escarp_tests::drive::{settle, tree, view_over};
use escarp_tests::host::PATIENCE;
use escarp_tests::liar::Liar;
use escarp_tests::measure::{check_cracks, measure};
use escarp_tests::terrain::{TempDataset, cliff, hash, hills, holed_hills, spike};
use escarp_tiles::dataset::Dataset;
use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

const NAP: Duration = Duration::from_millis(2);

fn terrains() -> Vec<(&'static str, TempDataset)> {
    let noise = |x, y| f64::from(hash(x, y) % 4000);
    let holed_noise = |x, y| match hash(x / 5, y / 7).is_multiple_of(3) {
        true => f64::NAN,
        false => f64::from(hash(x, y) % 4000) - 2000.0,
    };
    vec![
        ("hills", TempDataset::of(300, 270, hills)),
        ("holed hills", TempDataset::of(300, 270, holed_hills)),
        ("coarse hills", TempDataset::coarse(230, 190, hills, 25.0)),
        (
            "coarse holed hills",
            TempDataset::coarse(230, 190, holed_hills, 9.0),
        ),
        ("cliff", TempDataset::of(300, 190, cliff)),
        ("spike", TempDataset::of(230, 190, spike)),
        ("flat", TempDataset::of(230, 190, |_, _| 12.0)),
        ("noise", TempDataset::of(230, 190, noise)),
        ("holed noise", TempDataset::of(230, 190, holed_noise)),
    ]
}

/// The first parts of a stored page.
fn prefix(dataset: &Dataset, id: PageId, parts: u8) -> Option<Page> {
    let finest = dataset.grid().is_finest(id);
    let record = dataset.record(id).expect("sound")?;
    let header = RecordHeader::read(id, finest, record.bytes).expect("a header");
    let parts = parts.min(header.last_part());
    let bytes = header.part_bytes(0, parts).expect("parts");
    Some(Page::decode(id, finest, parts, &record.bytes[bytes]).expect("it decodes"))
}

/// Links a page, stored or implied, and all below it, in growing prefixes and no order.
fn link_all(tree: &mut MeshTree, dataset: &Dataset, id: PageId, seed: u32) -> usize {
    let last = |parts: u8| Some(prefix(dataset, id, parts)?.parts());
    let mut linked = 0;
    let whole = match last(u8::MAX) {
        None => {
            let (above, slot) = id.parent().expect("the root is stored");
            let above = tree.page(above).expect("resident");
            let page = above.implied_child(slot, dataset.grid()).expect("implied");
            tree.link(page.clone())
                .unwrap_or_else(|why| panic!("{why}"));
            page
        }
        Some(most) => {
            for parts in 1..=most {
                let skips = hash(id.key() as u32, seed + u32::from(parts)).is_multiple_of(2);
                if parts < most && skips {
                    continue;
                }
                let page = prefix(dataset, id, parts).expect("a record");
                tree.link(page).unwrap_or_else(|why| panic!("{why}"));
                linked += 1;
            }
            tree.page(id).expect("resident").clone()
        }
    };
    if !whole.has_slots() {
        return linked;
    }
    let mut slots: Vec<u8> = (0..PAGE_SLOTS).map(|i| i as u8).collect();
    slots.sort_by_key(|&i| hash(u32::from(i), seed));
    for slot in slots.into_iter().map(Slot::from_index) {
        let child = id.child(slot).expect("a child");
        // Implied pages go on to the finest; a few of them stand for all.
        let stored = whole.slot(slot).has_record();
        if stored || hash(child.key() as u32, seed).is_multiple_of(16) {
            linked += link_all(tree, dataset, child, seed);
        }
    }
    linked
}

#[test]
fn an_honest_dataset_never_contradicts_itself_in_any_order_and_prefix() {
    for (name, data) in &terrains() {
        for seed in 0..3 {
            let manifest = data.dataset.manifest();
            let mut tree = MeshTree::new(manifest.grid_levels, manifest.georef.clone());
            let linked = link_all(&mut tree, &data.dataset, PageId::ROOT, seed * 1000);
            assert!(linked as u64 >= manifest.pages, "{name}: {linked} pages");
        }
    }
}

/// What a liar makes of a true page.
type Change = fn(&mut [Option<i32>; PAGE_AREA]);

/// A server that lies of one page, as often as said, and counts how often pages are asked for
/// from their first part.
struct Lying {
    driver: Driver,
    asked: Arc<Mutex<HashMap<u64, u32>>>,
    /// As long as the driver: the server ends with it.
    _liar: Liar,
}

fn lying(data: &TempDataset, of: PageId, change: Change, times: u32) -> Lying {
    let finest = data.dataset.grid().is_finest(of);
    let truth = prefix(&data.dataset, of, u8::MAX).expect("a record");
    let mut samples = std::array::from_fn(|at| truth.is_valid(at).then(|| truth.height(at)));
    change(&mut samples);
    let page = Page::new(of, &samples, None).expect("heights that are allowed");
    let record = Record::encode(&page, Codec::Plain).bytes().to_vec();
    let header = RecordHeader::read(of, finest, &record).expect("a header");
    let asked: Arc<Mutex<HashMap<u64, u32>>> = Arc::default();
    let counted = asked.clone();
    let lie = move |chunk: Chunk| {
        let mut counted = counted.lock().expect("no test has failed");
        let count = counted.entry(chunk.page).or_insert(0);
        *count += u32::from(chunk.first_part == 0);
        let chunk = match chunk.page == of.key() && *count <= times {
            true => {
                let parts = header.part_bytes(chunk.first_part, chunk.last_part);
                Chunk {
                    revision: revision(of, &record),
                    bytes: record[parts.expect("parts")].to_vec(),
                    ..chunk
                }
            }
            false => chunk,
        };
        vec![ServerMessage::Pages(vec![chunk]).encode()]
    };
    let liar = Liar::start(data.open(), Box::new(lie));
    Lying {
        driver: liar.client(),
        asked,
        _liar: liar,
    }
}

/// The page that the mesh of a view uses most: of which all parts are wanted, in the middle.
fn used_page(data: &TempDataset) -> PageId {
    let liar = Liar::start(
        data.open(),
        Box::new(|chunk| vec![ServerMessage::Pages(vec![chunk]).encode()]),
    );
    let mut driver = liar.client();
    settle(&mut driver, &view_over(data, 1.0));
    let grid = data.dataset.grid();
    let mut pages: Vec<PageId> = tree(&driver)
        .pages()
        .filter(|page| grid.is_finest(page.id()) && page.parts() == page.last_part())
        .filter(|page| !page.has_holes())
        .map(Page::id)
        .filter(|&id| data.dataset.record(id).expect("sound").is_some())
        .collect();
    pages.sort_by_key(|page| page.key());
    pages[pages.len() / 2]
}

/// Steps until nothing more comes; the mesh never cracks, and the stated bound always holds.
fn fly_past(data: &TempDataset, lying: &mut Lying) -> bool {
    let view = view_over(data, 1.0);
    let cells = data.dataset.grid().cells_per_side();
    loop {
        let now = lying.driver.now();
        let stats = lying.driver.client.step(&view, now);
        if let Some(terrain) = lying.driver.client.terrain() {
            check_cracks(terrain.tree(), cells).unwrap_or_else(|why| panic!("{why}"));
        }
        if lying.driver.client.is_settled() {
            let found = measure(tree(&lying.driver), data, &view, true);
            let bound = stats.bound_px / f64::from(stats.tolerance_px);
            assert!(
                found.largest <= bound.max(1.0) + 1e-9,
                "{found:?} {stats:?}"
            );
            return stats.converged;
        }
        assert!(now < PATIENCE, "stuck: {stats:?}");
        lying.driver.nap(NAP);
    }
}

const LIES: [(&str, Change); 4] = [
    ("quanta off", |samples| {
        samples[8 * 17 + 8] = samples[8 * 17 + 8].map(|height| height + 5000);
    }),
    ("quanta off", |samples| {
        // A vertex of the last part.
        samples[3 * 17 + 5] = samples[3 * 17 + 5].map(|height| height - 5000);
    }),
    ("a corner has height", |samples| {
        samples[0] = samples[0].map(|height| height + 1);
    }),
    ("surface everywhere", |samples| samples[100] = None),
];

#[test]
fn a_contradiction_is_named_asked_for_again_once_and_then_missing() {
    let data = TempDataset::of(300, 270, hills);
    let of = used_page(&data);
    for (what, change) in LIES {
        let mut lying = lying(&data, of, change, u32::MAX);
        fly_past(&data, &mut lying);
        let client = &lying.driver.client;
        let (lost, reasons) = client.lost_pages();
        assert_eq!((lost, client.refusals()), (1, 2), "{what}: {reasons:?}");
        let named = |reason: &String| reason.contains(what) && reason.contains(&of.to_string());
        assert!(reasons.iter().any(named), "{what}: {reasons:?}");
        assert!(
            client.status().contains("1 pages lost"),
            "{}",
            client.status()
        );
        // However long it is looked at, it is not asked for any more.
        let asked = || lying.asked.lock().expect("no test has failed")[&of.key()];
        let before = asked();
        assert!(before >= 2, "{what}: asked {before} times");
        for error_px in [1.1, 0.9, 1.0] {
            let view = view_over(&data, error_px);
            for _ in 0..10 {
                let now = lying.driver.now();
                lying.driver.client.step(&view, now);
                lying.driver.nap(NAP);
            }
        }
        assert_eq!(
            (asked(), lying.driver.client.refusals()),
            (before, 2),
            "{what}"
        );
    }
}

#[test]
fn a_page_that_comes_right_when_asked_for_again_is_not_lost() {
    let data = TempDataset::of(300, 270, hills);
    let of = used_page(&data);
    for (what, change) in LIES {
        let mut lying = lying(&data, of, change, 1);
        assert!(fly_past(&data, &mut lying), "{what}");
        let client = &lying.driver.client;
        let (lost, reasons) = client.lost_pages();
        assert_eq!((lost, client.refusals()), (0, 1), "{what}: {reasons:?}");
        assert!(client.status().contains("asked for again"));
        let page = tree(&lying.driver).page(of).expect("it is here");
        let truth = prefix(&data.dataset, of, page.parts()).expect("a record");
        assert_eq!(*page, truth, "{what}");
    }
}
