//! Damaged datasets: refused with the file named, never a panic; and what of one is sound is
//! served and shown.

use escarp_client::app::TerrainClient;
use escarp_proto::geometry::PageId;
use escarp_proto::page::{Codec, last_part};
use escarp_proto::wire::{
    Class, ClientMessage, Hello, Miss, MissReason, PROTOCOL, ServerMessage, Want,
};
use escarp_tests::drive::view_over;
use escarp_tests::files::{Copy, files, flip};
use escarp_tests::host::{Host, PATIENCE};
use escarp_tests::measure::{check_cracks, measure};
use escarp_tests::terrain::{Heights, TempDataset, hills, holed_hills};
use escarp_tiles::dataset::Dataset;
use futures_util::{SinkExt, StreamExt};
use std::panic::{AssertUnwindSafe, catch_unwind};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream};

/// A damaged copy is refused, and the message names one of these files.
fn refused(copy: &Copy, names: &[&str], what: &str) {
    let verdict = catch_unwind(AssertUnwindSafe(|| copy.verdict()));
    let verdict = verdict.unwrap_or_else(|_| panic!("{what}: a panic"));
    let error = verdict.expect_err(what);
    let named = names.iter().any(|name| error.contains(name));
    let placed = error.contains(&copy.path().display().to_string());
    assert!(
        named && placed,
        "{what}: none of {names:?} is named: {error}"
    );
}

/// The files that a message about one of them may name: `CURRENT` says which manifest there is, so
/// that one may be missing.
fn culprits(name: &str) -> Vec<&str> {
    match name {
        "CURRENT" => vec!["CURRENT", "manifest-"],
        _ => vec![name],
    }
}

#[test]
fn a_dataset_has_the_files_of_its_format_and_no_others() {
    let data = TempDataset::of(100, 80, hills);
    let names = ["CURRENT", "index-1", "manifest-1.json", "seg-1-0"];
    assert_eq!(files(&data.path()), names);
    Copy::of(&data.path()).verdict().expect("a copy is as good");
}

#[test]
fn a_changed_byte_anywhere_is_found_and_its_file_named() {
    for (seed, heights) in [(1, hills as Heights), (2, holed_hills)] {
        let data = TempDataset::of(100, 80, heights);
        let copy = Copy::of(&data.path());
        for name in files(&data.path()) {
            let sound = std::fs::read(copy.path().join(&name)).unwrap();
            for round in 0..300 {
                let mut at = 0;
                copy.change(&name, |bytes| at = flip(bytes, seed * 1000 + round));
                refused(
                    &copy,
                    &culprits(&name),
                    &format!("{name}, byte {at}, round {round}"),
                );
                std::fs::write(copy.path().join(&name), &sound).unwrap();
            }
        }
        copy.verdict().expect("it is sound again");
    }
}

#[test]
fn a_file_cut_short_anywhere_or_longer_is_found_and_named() {
    let data = TempDataset::of(100, 80, hills);
    for name in files(&data.path()) {
        let length = std::fs::metadata(data.path().join(&name)).unwrap().len() as usize;
        let mut lengths = vec![0, 1, length / 3, length / 2, length - 2, length - 1];
        lengths.extend((1..20).map(|i| length * i / 20));
        for to in lengths {
            let copy = Copy::of(&data.path());
            copy.change(&name, |bytes| bytes.truncate(to));
            refused(
                &copy,
                &culprits(&name),
                &format!("{name}, {to} of {length} bytes"),
            );
        }
        for more in [&b"\n"[..], b"\0", b"x", &[0; 5000]] {
            let copy = Copy::of(&data.path());
            copy.change(&name, |bytes| bytes.extend(more));
            refused(
                &copy,
                &culprits(&name),
                &format!("{name}, {} more bytes", more.len()),
            );
        }
    }
}

#[test]
fn a_missing_file_is_found_and_named() {
    let data = TempDataset::of(100, 80, hills);
    for name in files(&data.path()) {
        let copy = Copy::of(&data.path());
        std::fs::remove_file(copy.path().join(&name)).unwrap();
        refused(&copy, &[&name], &format!("no {name}"));
        std::fs::create_dir(copy.path().join(&name)).unwrap();
        refused(&copy, &[&name], &format!("{name} is a folder"));
    }
}

#[test]
fn a_file_of_another_dataset_is_found_and_named() {
    let data = TempDataset::of(100, 80, hills);
    let other = TempDataset::of(100, 80, |x, y| hills(x, y) + f64::from(x % 2) * 1000.0);
    for name in files(&data.path()) {
        let copy = Copy::of(&data.path());
        std::fs::copy(other.path().join(&name), copy.path().join(&name)).unwrap();
        refused(
            &copy,
            &culprits(&name),
            &format!("{name} of another dataset"),
        );
    }
}

#[test]
fn records_that_changed_places_are_found() {
    let data = TempDataset::of(100, 80, hills);
    let copy = Copy::of(&data.path());
    // The second half of the segment in the place of the first: lengths and sums are all kept.
    copy.change("seg-1-0", |bytes| {
        let half = bytes.len() / 2;
        bytes.rotate_left(half);
    });
    refused(&copy, &["seg-1-0"], "a rotated segment");
}

/// A dataset with one damaged record, that of a finest page in the middle.
fn damaged(data: &TempDataset) -> (Copy, Dataset, PageId) {
    let level = data.dataset.grid().finest_page_level();
    let page = PageId::new(level, 3, 2).expect("a page");
    let record = data
        .dataset
        .record(page)
        .expect("sound")
        .expect("stored")
        .bytes
        .to_vec();
    let copy = Copy::of(&data.path());
    copy.change("seg-1-0", |bytes| {
        let at = bytes
            .windows(record.len())
            .position(|window| window == record);
        bytes[at.expect("the record") + record.len() / 2] ^= 0x10;
    });
    let dataset = Dataset::open(&copy.path()).expect("records are checked when they are read");
    (copy, dataset, page)
}

/// Says a message, and waits for an answer that fits.
async fn ask(
    socket: &mut WebSocketStream<MaybeTlsStream<TcpStream>>,
    message: ClientMessage,
    fits: impl Fn(&ServerMessage) -> bool,
) -> ServerMessage {
    socket
        .send(Message::binary(message.encode()))
        .await
        .expect("it is sent");
    let answer = async {
        while let Some(message) = socket.next().await {
            let message = ServerMessage::decode(&message.expect("open").into_data());
            let message = message.expect("a message");
            if fits(&message) {
                return message;
            }
        }
        panic!("the server closed the session");
    };
    tokio::time::timeout(PATIENCE, answer)
        .await
        .expect("an answer")
}

#[test]
fn a_server_says_which_page_is_damaged_and_goes_on() {
    let data = TempDataset::of(130, 110, hills);
    let (_copy, dataset, page) = damaged(&data);
    let (level, grid) = (page.level(), dataset.grid());
    let host = Host::of("moon", dataset);
    let want = |page: PageId| {
        ClientMessage::Want(vec![Want {
            page: page.key(),
            first_part: 0,
            last_part: last_part(grid.is_finest(page)),
            class: Class::InView,
            priority: 1.0,
        }])
    };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(async {
        let url = format!("ws://{}/session", host.address());
        let (mut socket, _) = tokio_tungstenite::connect_async(url)
            .await
            .expect("a session");
        let hello = ClientMessage::Hello(Hello {
            oldest: PROTOCOL,
            newest: PROTOCOL,
            capabilities: 0,
            codecs: Codec::KNOWN,
            dataset: "moon".into(),
            credit_bytes: 1 << 20,
            token: None,
        });
        ask(&mut socket, hello, |m| {
            matches!(m, ServerMessage::Welcome(_))
        })
        .await;
        for _ in 0..3 {
            let miss = ask(&mut socket, want(page), |m| {
                matches!(m, ServerMessage::Miss(_))
            })
            .await;
            let reason = MissReason::Damaged;
            assert_eq!(
                miss,
                ServerMessage::Miss(Miss {
                    page: page.key(),
                    reason
                })
            );
            // What was sent comes again only if the client has it no longer.
            let sound = PageId::new(level, 0, 0).unwrap();
            let evict = ClientMessage::Evict(vec![sound.key()]);
            socket
                .send(Message::binary(evict.encode()))
                .await
                .expect("it is sent");
            ask(&mut socket, want(sound), |m| {
                matches!(m, ServerMessage::Pages(_))
            })
            .await;
        }
    });
}

#[test]
fn a_client_goes_on_without_a_damaged_page_has_no_cracks_and_states_what_it_lacks() {
    let data = TempDataset::of(130, 110, hills);
    let (_copy, dataset, page) = damaged(&data);
    let cells = dataset.grid().cells_per_side();
    let host = Host::of("moon", dataset);
    let mut driver = host.client("moon");
    driver.connect(PATIENCE).expect("a session");
    let exact = view_over(&data, 0.05);
    let stats = driver
        .settle(&exact, PATIENCE)
        .expect("the session goes on");
    assert!(driver.client.is_settled(), "{stats:?}");
    let tree = driver.client.terrain().expect("a terrain").tree();
    assert!(
        tree.page(page).is_none() && tree.resident() > 40,
        "{} pages",
        tree.resident()
    );
    check_cracks(tree, cells).unwrap_or_else(|why| panic!("{why}"));
    // More than the tolerance, and still true.
    let excess = stats.bound_px / f64::from(exact.max_screen_error_px);
    assert!(
        !stats.converged && excess.is_finite() && excess > 1.0,
        "{stats:?}"
    );
    let found = measure(tree, &data, &exact, true);
    assert!(found.largest <= excess + 1e-9, "{found:?}, stated {excess}");
    assert!(
        driver.client.status().contains("connected"),
        "{}",
        driver.client.status()
    );
    // What the page is not needed for, converges.
    let coarse = view_over(&data, 500.0);
    assert!(
        driver
            .settle(&coarse, PATIENCE)
            .expect("the session goes on")
            .converged
    );
}

#[test]
fn a_segment_of_another_dataset_with_the_same_layout_is_found() {
    let [data, other] = [12.0, 13.0].map(|height| TempDataset::of(300, 300, move |_, _| height));
    let copy = Copy::of(&data.path());
    std::fs::copy(other.path().join("seg-1-0"), copy.path().join("seg-1-0")).unwrap();
    refused(&copy, &["seg-1-0"], "a segment that fits in every length");
}
