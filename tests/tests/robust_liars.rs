//! Servers that lie without being asked: pages that nobody wanted, and generations and stale pages
//! that there are not. A client shows no gap, keeps within its memory, and goes on.

use escarp_client::app::TerrainClient;
use escarp_client::app::headless::Driver;
use escarp_proto::geometry::PageId;
use escarp_proto::wire::{Chunk, Class, ClientMessage, ServerMessage, Want, capability};
use escarp_tests::drive::{tree, view_over};
use escarp_tests::files::flip;
use escarp_tests::host::PATIENCE;
use escarp_tests::liar::{Liar, chunk, welcome};
use escarp_tests::measure::check_cover;
use escarp_tests::terrain::{TempDataset, hash, hills};
use escarp_tiles::dataset::Dataset;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

const NAP: Duration = Duration::from_millis(5);
/// Lies are told so often; then the server says the truth.
const LIES: u32 = 6;
/// Messages that may wait in a client: what its credit allows is far less.
const MOST_WAITING: usize = 1 << 15;

/// All pages of a dataset of at most 256 cells a side, whole, the root first.
fn all(dataset: &Dataset) -> Vec<Chunk> {
    let root = [PageId::ROOT].into_iter();
    let finest = (0..256).filter_map(|i| PageId::new(4, i % 16, i / 16));
    let want = |page: PageId| Want {
        page: page.key(),
        first_part: 0,
        last_part: 5,
        class: Class::InView,
        priority: 1.0,
    };
    let pages = root.chain(finest);
    pages
        .filter_map(|page| chunk(dataset, &want(page)))
        .collect()
}

fn pages(chunk: Chunk) -> Vec<u8> {
    ServerMessage::Pages(vec![chunk]).encode()
}

/// The truth, by pulling.
fn truth(dataset: &Dataset, message: ClientMessage) -> Vec<Vec<u8>> {
    match message {
        ClientMessage::Hello(_) => vec![welcome(dataset, capability::PUSH).encode()],
        ClientMessage::Ping(number) => vec![ServerMessage::Pong(number).encode()],
        ClientMessage::View { sequence, .. } => {
            let view_sequence = sequence;
            vec![ServerMessage::Idle { view_sequence }.encode()]
        }
        ClientMessage::Want(wants) => {
            let chunks = wants.iter().filter_map(|want| chunk(dataset, want));
            chunks.map(pages).collect()
        }
        ClientMessage::Have(_) => vec![ServerMessage::Stale(Vec::new()).encode()],
        _ => vec![],
    }
}

/// Runs a client against a server that lies before some of its answers to View and Ping, until it
/// has settled and all lies are told.
fn deceive(
    what: &str,
    lie: impl Fn(&Dataset, u32) -> Vec<Vec<u8>> + Send + Sync + 'static,
) -> (TempDataset, Driver) {
    let data = TempDataset::of(130, 110, hills);
    let told = std::sync::Arc::new(AtomicU32::new(0));
    let count = told.clone();
    let liar = Liar::speaking(
        data.open(),
        Box::new(move |dataset, message| {
            let lies = matches!(
                message,
                ClientMessage::View { .. } | ClientMessage::Ping(_) | ClientMessage::Want(_)
            );
            let round = match lies {
                true => count.fetch_add(1, Ordering::Relaxed),
                false => LIES,
            };
            let lies = match round {
                0..LIES => lie(dataset, round),
                _ => vec![],
            };
            [lies, truth(dataset, message)].concat()
        }),
    );
    let mut driver = liar.client();
    let mut frame = 0.0;
    loop {
        frame += 1.0;
        // It looks elsewhere as long as there is something to be lied to about.
        let all_told = told.load(Ordering::Relaxed) >= LIES;
        let mut view = view_over(&data, 1.0);
        if !all_told {
            view.eye_m[0] += frame;
        }
        let stats = driver.step(&view);
        let link = driver.client.link().stats();
        assert!(link.waiting_events < MOST_WAITING, "{what}: {link:?}");
        if let Some(terrain) = driver.client.terrain() {
            let cells = terrain.manifest().grid_levels.cells_per_side();
            check_cover(terrain.tree(), cells).unwrap_or_else(|why| panic!("{what}: {why}"));
        }
        if all_told && driver.client.is_connected() && driver.client.is_settled() {
            return (data, driver);
        }
        let status = driver.client.status();
        assert!(driver.now() < PATIENCE, "{what}: stuck: {status} {stats:?}");
        driver.nap(NAP);
    }
}

/// Pages of a tree that have a record.
fn resident(driver: &Driver) -> usize {
    tree(driver).resident()
}

/// What a client has that nobody lied to.
fn honest() -> usize {
    resident(&deceive("the truth", |_, _| vec![]).1)
}

#[test]
fn forged_pages_that_nobody_asked_for_are_refused() {
    let forge = |dataset: &Dataset, round: u32| {
        let forged = all(dataset).into_iter().map(|mut page| {
            let seed = hash(page.page as u32, round);
            match seed % 3 {
                0 => _ = flip(&mut page.bytes, seed),
                1 => page.bytes.truncate(page.bytes.len() / 2),
                _ => page.revision ^= 1 << (seed % 32),
            }
            pages(page)
        });
        forged.collect()
    };
    let (_, driver) = deceive("forged pages", forge);
    assert!(driver.client.terrain().is_some());
}

#[test]
fn pages_without_end_that_nobody_asked_for_take_no_memory() {
    let flood = |_: &Dataset, round: u32| {
        let noise = (0..400u32).map(|i| {
            let number = round * 400 + i;
            let page = PageId::new(4, number % 16, number / 16 % 16).unwrap_or(PageId::ROOT);
            let bytes = (0..8000).map(|byte| hash(byte, number) as u8).collect();
            pages(Chunk {
                page: page.key(),
                revision: number,
                first_part: 0,
                last_part: 5,
                bytes,
            })
        });
        noise.collect()
    };
    let (_, driver) = deceive("a flood", flood);
    let link = driver.client.link().stats();
    assert!(link.held_pages <= 257, "{link:?}");
}

#[test]
fn true_pages_in_the_wrong_order_or_of_parts_that_do_not_follow_do_no_harm() {
    let orphans = |dataset: &Dataset, round: u32| {
        let mut chunks = all(dataset);
        chunks.reverse();
        if round % 2 == 1 {
            for chunk in &mut chunks {
                (chunk.first_part, chunk.last_part) = (3, 3);
            }
        }
        chunks.into_iter().map(pages).collect()
    };
    let (_, driver) = deceive("orphans", orphans);
    assert!(resident(&driver) >= honest());
}

#[test]
fn a_storm_of_generations_that_there_are_not_leaves_a_client_that_goes_on() {
    let storm = |dataset: &Dataset, round: u32| {
        let mut manifest = dataset.manifest().clone();
        let messages = (1..50u64).map(|i| {
            manifest.generation = i + u64::from(round) * 50;
            let manifest = match i % 7 {
                0 => b"{\"format\":\"escarp\"".to_vec(),
                1 => vec![0xff; 100],
                _ => manifest.to_json(),
            };
            // Most rounds are well-formed throughout.
            (i % 7 > 1 || round == 2).then(|| {
                ServerMessage::GenChange {
                    generation: i + u64::from(round) * 50,
                    manifest,
                }
                .encode()
            })
        });
        messages.flatten().collect()
    };
    deceive("a storm of generations", storm);
}

#[test]
fn pages_said_to_be_stale_that_a_client_never_had_or_has_do_no_harm() {
    let stale = |dataset: &Dataset, round: u32| {
        let had = all(dataset).into_iter().map(|chunk| chunk.page);
        let never = (0..500).map(|i| u64::from(hash(i, round)) << (i % 33));
        let keys: Vec<u64> = had.chain(never).collect();
        vec![ServerMessage::Stale(keys).encode(); 5]
    };
    deceive("stale pages", stale);
}
