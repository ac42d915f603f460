//! Peers that are not to be trusted: clients that say rubbish to the server, and a server that
//! lies to the client.

use escarp_client::app::TerrainClient;
use escarp_client::app::headless::Driver;
use escarp_proto::geometry::PageId;
use escarp_proto::page::Codec;
use escarp_proto::wire::{
    Chunk, Class, ClientMessage, Hello, Miss, MissReason, PROTOCOL, ServerMessage, Want,
};
use escarp_tests::drive::view_over;
use escarp_tests::files::flip;
use escarp_tests::host::{Host, PATIENCE};
use escarp_tests::liar::{Liar, chunk};
use escarp_tests::measure::{check_cover, check_cracks, measure};
use escarp_tests::terrain::{TempDataset, hash, hills};
use futures_util::{SinkExt, StreamExt};
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_tungstenite::connect_async;
use tokio_tungstenite::tungstenite::Message;

const NAP: Duration = Duration::from_millis(5);

fn hello() -> ClientMessage {
    ClientMessage::Hello(Hello {
        oldest: PROTOCOL,
        newest: PROTOCOL,
        capabilities: 0,
        codecs: Codec::KNOWN,
        dataset: "moon".into(),
        credit_bytes: 1 << 20,
        token: None,
    })
}

fn noise(length: usize, seed: u32) -> Vec<u8> {
    (0..length as u32).map(|i| hash(i, seed) as u8).collect()
}

/// What hostile clients say, after a Hello or without one.
fn rubbish(seed: u32) -> Message {
    let want = |page| Want {
        page,
        first_part: hash(seed, 3) as u8,
        last_part: hash(seed, 4) as u8,
        class: Class::Blocker,
        priority: f32::NAN,
    };
    match seed % 8 {
        0 => Message::binary(noise(100 + seed as usize, seed)),
        1 => Message::text("GET / HTTP/1.1"),
        2 => Message::binary(noise(100 << 10, seed)),
        3 => Message::binary(noise(3 << 20, seed)),
        4 => {
            let wants = (0..2000).map(|i| want(u64::from(hash(i, seed)) << (i % 40)));
            Message::binary(ClientMessage::Want(wants.collect()).encode())
        }
        5 => Message::binary(ClientMessage::Evict(vec![u64::MAX; 2000]).encode()),
        6 => {
            let mut bytes = hello().encode();
            flip(&mut bytes, seed);
            Message::binary(bytes)
        }
        _ => Message::Ping(noise(125, seed).into()),
    }
}

/// Says so many things, and reads whatever comes back, but never for long.
async fn pester(address: SocketAddr, seed: u32) {
    let Ok((mut socket, _)) = connect_async(format!("ws://{address}/session")).await else {
        return;
    };
    if !seed.is_multiple_of(3)
        && socket
            .send(Message::binary(hello().encode()))
            .await
            .is_err()
    {
        return;
    }
    for i in 0..8 {
        // A server that no longer listens to it is left in the middle of the message.
        let said = timeout(
            Duration::from_millis(300),
            socket.send(rubbish(hash(seed, i))),
        )
        .await;
        if !matches!(said, Ok(Ok(()))) {
            return;
        }
        for _ in 0..50 {
            if timeout(Duration::from_millis(2), socket.next())
                .await
                .is_err()
            {
                break;
            }
        }
    }
}

/// Bytes that are not even HTTP.
async fn pester_raw(address: SocketAddr, seed: u32) {
    let Ok(mut stream) = TcpStream::connect(address).await else {
        return;
    };
    let _ = stream.write_all(&noise(40_000, seed)).await;
    let _ = timeout(Duration::from_millis(20), stream.read(&mut [0; 100])).await;
}

#[test]
fn clients_that_say_rubbish_do_not_disturb_one_that_behaves() {
    let data = TempDataset::of(230, 190, hills);
    let host = Host::of("moon", data.open());
    let address = host.address();
    let over = Arc::new(AtomicBool::new(false));
    let rounds = Arc::new(AtomicU32::new(0));
    let (ended, counted) = (over.clone(), rounds.clone());
    let hostile = std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build();
        runtime.expect("a runtime").block_on(async {
            while !ended.load(Ordering::Relaxed) {
                let round = counted.fetch_add(1, Ordering::Relaxed) * 8;
                let pests = (0..6).map(|i| tokio::spawn(pester(address, round + i)));
                let pests: Vec<_> = pests.collect();
                pester_raw(address, round + 7).await;
                for pest in pests {
                    let _ = timeout(PATIENCE, pest)
                        .await
                        .expect("it is answered or thrown out");
                }
            }
        });
    });
    // Views back and forth, always to convergence, until there was rubbish enough.
    let mut driver = host.client("moon");
    driver.connect(PATIENCE).expect("a session");
    let mut turns = 0;
    while turns < 6 || (rounds.load(Ordering::Relaxed) < 5 && driver.now() < PATIENCE) {
        for error_px in [8.0, 1.0] {
            let stats = driver
                .settle(&view_over(&data, error_px), PATIENCE)
                .expect("it goes on");
            assert!(stats.converged, "{stats:?} {}", driver.client.status());
        }
        turns += 1;
    }
    assert!(rounds.load(Ordering::Relaxed) >= 5, "too little rubbish");
    over.store(true, Ordering::Relaxed);
    hostile.join().expect("the hostile clients end");
    assert_eq!(driver.client.status(), "connected");
    let tree = driver.client.terrain().expect("a terrain").tree();
    check_cracks(tree, data.dataset.grid().cells_per_side()).unwrap_or_else(|why| panic!("{why}"));
    host.client("moon")
        .connect(PATIENCE)
        .expect("there is room for others");
    host.stop();
}

fn pages(chunk: Chunk) -> Vec<u8> {
    ServerMessage::Pages(vec![chunk]).encode()
}

/// Runs a client against a lie until a condition holds; never do its triangles leave a gap.
fn deceive(
    data: &TempDataset,
    lie: impl Fn(Chunk) -> Vec<Vec<u8>> + Send + Sync + 'static,
    what: &str,
    done: impl Fn(&Driver) -> bool,
) -> Driver {
    let liar = Liar::start(data.open(), Box::new(lie));
    let mut driver = liar.client();
    let view = view_over(data, 1.0);
    let cells = data.dataset.grid().cells_per_side();
    while !done(&driver) {
        let now = driver.now();
        let stats = driver.client.step(&view, now);
        if let Some(terrain) = driver.client.terrain() {
            // Heights may be lies; the triangles still cover the plane.
            check_cover(terrain.tree(), cells).unwrap_or_else(|why| panic!("{what}: {why}"));
        }
        assert!(
            now < PATIENCE,
            "{what}: stuck: {} {stats:?}",
            driver.client.status()
        );
        driver.nap(NAP);
    }
    driver
}

fn resident(driver: &Driver) -> usize {
    driver
        .client
        .terrain()
        .map_or(0, |terrain| terrain.tree().resident())
}

#[test]
fn the_liar_without_a_lie_is_as_good_as_a_server() {
    let data = TempDataset::of(130, 110, hills);
    let driver = deceive(
        &data,
        |chunk| vec![pages(chunk)],
        "truth",
        |d| d.client.is_settled(),
    );
    let tree = driver.client.terrain().expect("a terrain").tree();
    let found = measure(tree, &data, &view_over(&data, 1.0), false);
    assert!(
        found.samples > 0 && found.largest <= 1.0 + 1e-9,
        "{found:?}"
    );
}

#[test]
fn corrupted_chunks_cannot_harm_a_client() {
    let data = TempDataset::of(130, 110, hills);
    for seed in 0..12 {
        let lie = move |mut chunk: Chunk| {
            // The root is true for most seeds, so that there is something below it to corrupt.
            let root = chunk.page == PageId::ROOT.key();
            let spared = root && seed % 4 != 0;
            if !(chunk.bytes.is_empty() || spared) {
                let page = hash(chunk.page as u32, chunk.first_part.into());
                match hash(page, seed) % 5 {
                    0 => drop(flip(&mut chunk.bytes, page ^ seed)),
                    1 => chunk.bytes.truncate(chunk.bytes.len() / 2),
                    2 => chunk.bytes = noise(chunk.bytes.len(), page),
                    3 => chunk.bytes.extend(noise(50, page)),
                    _ => {}
                }
            }
            vec![pages(chunk)]
        };
        deceive(&data, lie, "corrupted chunks", |driver| {
            driver.client.is_settled()
        });
    }
}

#[test]
fn wrong_pages_and_parts_cannot_harm_a_client() {
    let data = TempDataset::of(130, 110, hills);
    let truth = data.open();
    let other = move |page: PageId| {
        let want = Want {
            page: page.key(),
            first_part: 0,
            last_part: 2,
            class: Class::Ring,
            priority: 0.0,
        };
        chunk(&truth, &want)
    };
    let lie = move |chunk: Chunk| {
        let mut lies = Vec::new();
        // The bytes of another page, pages that are not there, parts that do not follow.
        if let Some(other) = PageId::new(4, 1, 1).and_then(&other) {
            let (page, first_part) = (chunk.page, chunk.first_part);
            lies.push(Chunk {
                page,
                first_part,
                ..other
            });
        }
        lies.push(Chunk {
            page: u64::MAX,
            ..chunk.clone()
        });
        lies.push(Chunk {
            page: chunk.page ^ (9 << 56),
            ..chunk.clone()
        });
        lies.push(Chunk {
            first_part: 3,
            last_part: 1,
            ..chunk.clone()
        });
        lies.push(Chunk {
            first_part: 250,
            last_part: 255,
            ..chunk.clone()
        });
        lies.push(Chunk {
            revision: 1,
            ..chunk.clone()
        });
        lies.push(chunk);
        lies.into_iter().map(pages).collect()
    };
    deceive(&data, lie, "wrong pages", |driver| {
        driver.client.is_settled()
    });
}

#[test]
fn pages_without_end_that_nobody_wants_take_no_memory() {
    let data = TempDataset::of(130, 110, hills);
    let sent = Arc::new(AtomicU32::new(0));
    let counted = sent.clone();
    let lie = move |chunk: Chunk| {
        let flood = |i: u32| {
            let page = PageId::new(8, i % 256, i / 256).map_or(0, PageId::key);
            let revision = i;
            let bytes = noise(8000, i);
            pages(Chunk {
                page,
                revision,
                first_part: 0,
                last_part: 5,
                bytes,
            })
        };
        let from = counted.fetch_add(400, Ordering::Relaxed);
        let mut messages: Vec<_> = (from..from + 400).map(flood).collect();
        messages.push(pages(chunk));
        messages
    };
    let driver = deceive(&data, lie, "a flood", |driver| driver.client.is_settled());
    let flood_bytes = u64::from(sent.load(Ordering::Relaxed)) * 8000;
    assert!(flood_bytes > 20 << 20, "{flood_bytes} bytes are no flood");
    // Not one page more than without the flood.
    let honest = deceive(
        &data,
        |chunk| vec![pages(chunk)],
        "truth",
        |d| d.client.is_settled(),
    );
    assert_eq!(resident(&driver), resident(&honest));
    assert_eq!(driver.client.lost_pages().0, 0);
}

#[test]
fn a_server_that_ends_in_the_middle_of_a_message_is_tried_again() {
    let data = TempDataset::of(130, 110, hills);
    let count = AtomicU32::new(0);
    let lie = move |chunk: Chunk| match count.fetch_add(1, Ordering::Relaxed) % 5 {
        // Half a frame, a message cut in the middle, one that is none, and one out of order.
        1 => vec![Vec::new()],
        2 => vec![pages(chunk.clone())[..20].to_vec(), pages(chunk)],
        3 => vec![noise(300, 5), pages(chunk)],
        _ => vec![pages(chunk)],
    };
    // Few sessions, as the client waits longer each time; the mesh only ever grows.
    let grown = |driver: &Driver| resident(driver) >= 3 || driver.client.is_settled();
    deceive(&data, lie, "half messages", grown);
}

#[test]
fn misses_of_everything_leave_a_client_without_a_picture_and_well() {
    let data = TempDataset::of(130, 110, hills);
    for reason in [MissReason::NotFound, MissReason::Damaged] {
        let lie = move |chunk: Chunk| {
            let page = chunk.page;
            let others = (0..500).map(|i| Miss {
                page: page ^ i,
                reason,
            });
            others
                .map(|miss| ServerMessage::Miss(miss).encode())
                .collect()
        };
        let driver = deceive(&data, lie, "misses", |driver| driver.client.is_settled());
        assert_eq!(resident(&driver), 0);
    }
}
