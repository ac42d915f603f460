//! The driver over real loopback, against servers that are scripted.

use super::*;
use crate::link::tests::welcome;
use crate::link::{Event, LinkConfig, LinkState};
use escarp_proto::geometry::PageId;
use escarp_proto::wire::{Chunk, Class, ClientMessage, ServerMessage, Want};
use futures_util::{SinkExt, StreamExt};
use std::io::{Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;
use tokio_tungstenite::tungstenite::Message;

/// A test that waits longer has failed.
const PATIENCE: Duration = Duration::from_secs(60);

fn want(x: u32) -> Want {
    Want {
        page: PageId::new(4, x, 0).unwrap().key(),
        first_part: 0,
        last_part: 5,
        class: Class::InView,
        priority: 1.0,
    }
}

fn link() -> Link {
    Link::new(LinkConfig {
        backoff_min: Duration::from_millis(5),
        backoff_max: Duration::from_millis(20),
        ..LinkConfig::new("moon")
    })
}

/// Drives until the condition holds, sleeping as an event loop would.
fn drive(connection: &mut Connection, link: &mut Link, done: impl Fn(&Link) -> bool) -> Vec<Event> {
    let start = Instant::now();
    let mut events = Vec::new();
    while !done(link) {
        assert!(start.elapsed() < PATIENCE, "stuck: {:?}", link.trouble());
        connection.drive(link, start.elapsed());
        events.extend(std::iter::from_fn(|| link.poll_event()));
        std::thread::sleep(Duration::from_millis(1));
    }
    events
}

/// A server that takes these sessions one after the other: each sends so many pages, then ends.
fn serve(pages_a_session: Vec<usize>) -> Url {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    listener.set_nonblocking(true).unwrap();
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .unwrap();
        runtime.block_on(async {
            let listener = tokio::net::TcpListener::from_std(listener).unwrap();
            for pages in pages_a_session {
                let (stream, _) = listener.accept().await.unwrap();
                session(stream, pages).await;
            }
        });
    });
    format!("http://127.0.0.1:{port}/moon").parse().unwrap()
}

async fn session(stream: tokio::net::TcpStream, mut pages: usize) {
    let mut socket = tokio_tungstenite::accept_async(stream).await.unwrap();
    while let Some(Ok(message)) = socket.next().await {
        let Message::Binary(bytes) = message else {
            continue;
        };
        let answers = match ClientMessage::decode(&bytes).unwrap() {
            ClientMessage::Hello(_) => vec![welcome(1)],
            ClientMessage::Ping(number) => vec![ServerMessage::Pong(number)],
            ClientMessage::Want(wants) => wants.iter().map(page).collect(),
            _ => vec![],
        };
        for answer in answers {
            if matches!(answer, ServerMessage::Pages(_)) {
                // The stream is dropped in mid-flight, without a close frame.
                let Some(left) = pages.checked_sub(1) else {
                    return;
                };
                pages = left;
            }
            socket.send(Message::binary(answer.encode())).await.unwrap();
        }
    }
}

fn page(want: &Want) -> ServerMessage {
    ServerMessage::Pages(vec![Chunk {
        page: want.page,
        revision: 1,
        first_part: want.first_part,
        last_part: want.last_part,
        bytes: vec![1; 100],
    }])
}

#[test]
fn a_connection_dropped_in_mid_flight_is_made_again_and_all_pages_arrive() {
    let url = serve(vec![3, 4, 100]);
    let woken = Arc::new(AtomicUsize::new(0));
    let count = Arc::clone(&woken);
    let waker = Box::new(move || {
        count.fetch_add(1, Ordering::Relaxed);
    });
    let mut connection = Connection::with_waker(url, waker);
    let mut link = link();
    let mut events = drive(&mut connection, &mut link, Link::is_open);
    let list: Vec<Want> = (0..16).map(want).collect();
    link.set_wants(&list, Duration::ZERO);
    events.extend(drive(&mut connection, &mut link, |link| {
        link.stats().held_pages == 16
    }));
    events.extend(std::iter::from_fn(|| link.poll_event()));
    let mut pages: Vec<u64> = events
        .iter()
        .filter_map(|event| match event {
            Event::Chunk(chunk) => Some(chunk.page),
            _ => None,
        })
        .collect();
    pages.sort();
    assert_eq!(pages, list.iter().map(|want| want.page).collect::<Vec<_>>());
    assert_eq!(link.stats().reconnects(), 2);
    assert_eq!(link.stats().dropped_chunks, 0);
    assert!(woken.load(Ordering::Relaxed) > 0);
}

/// What the link says of a server that answers each connection with these bytes.
fn trouble_with(answer: &'static [u8]) -> String {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = stream.unwrap();
            let _ = stream.read(&mut [0; 4096]);
            let _ = stream.write_all(answer);
        }
    });
    trouble_at(&format!("127.0.0.1:{port}/moon")).replace(&port.to_string(), "PORT")
}

fn trouble_at(url: &str) -> String {
    let mut connection = Connection::open(url.parse().unwrap());
    let mut link = link();
    drive(&mut connection, &mut link, |link| link.trouble().is_some());
    assert!(matches!(link.state(), LinkState::Waiting { .. }));
    link.trouble().unwrap().to_owned()
}

#[test]
fn each_kind_of_wrong_server_has_its_own_message() {
    let not_found = trouble_with(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n");
    assert_eq!(
        not_found,
        "no Escarp server at 127.0.0.1:PORT: it has no /session (HTTP 404 Not Found)"
    );
    let plain = trouble_with(b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\nhi");
    assert!(
        plain.contains("answers as a plain web server (HTTP 200 OK)"),
        "{plain}"
    );
    let busy = trouble_with(b"HTTP/1.1 503 Service Unavailable\r\nContent-Length: 0\r\n\r\n");
    assert!(busy.contains("refuses the session: HTTP 503"), "{busy}");
    let garbage = trouble_with(b"220 mail.example ESMTP\r\n\r\n");
    assert!(garbage.contains("it does not speak WebSocket"), "{garbage}");
    let nothing = trouble_with(b"");
    assert!(
        nothing.contains("closed the connection before a session began"),
        "{nothing}"
    );
}

#[test]
fn a_server_that_is_not_there_is_told_apart_from_a_host_that_is_not() {
    let free = std::net::TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap();
    let refused = trouble_at(&format!("http://{free}/moon"));
    assert!(
        refused.contains(&format!("no server listens at {free}")),
        "{refused}"
    );
    let unknown = trouble_at("http://no-such-host.invalid:8787/moon");
    assert!(
        unknown.contains("\"no-such-host.invalid\" is not found"),
        "{unknown}"
    );
}

#[test]
fn dropping_the_connection_ends_its_thread_also_while_connecting() {
    // A server that accepts and never answers.
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let url: Url = format!("http://{}/moon", listener.local_addr().unwrap())
        .parse()
        .unwrap();
    let alive = Arc::new(());
    let held = Arc::clone(&alive);
    let waker = Box::new(move || {
        let _ = Arc::strong_count(&held);
    });
    let mut connection = Connection::with_waker(url, waker);
    connection.drive(&mut link(), Duration::ZERO);
    let (stream, _) = listener.accept().unwrap();
    drop(connection);
    assert_eq!(
        Arc::strong_count(&alive),
        1,
        "the thread has dropped its waker"
    );
    drop(stream);
}

#[test]
fn a_websocket_server_of_another_kind_is_left() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/moon", listener.local_addr().unwrap());
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .unwrap();
        listener.set_nonblocking(true).unwrap();
        runtime.block_on(async {
            let listener = tokio::net::TcpListener::from_std(listener).unwrap();
            for message in [Message::text("hello"), Message::binary(vec![255; 30])] {
                let (stream, _) = listener.accept().await.unwrap();
                let mut socket = tokio_tungstenite::accept_async(stream).await.unwrap();
                socket.send(message).await.unwrap();
                let _ = socket.next().await;
                let _ = socket.next().await;
            }
        });
    });
    let mut connection = Connection::open(url.parse().unwrap());
    let mut link = link();
    drive(&mut connection, &mut link, |link| {
        link.stats().disconnects == 1
    });
    assert_eq!(
        link.trouble(),
        Some("no Escarp server: it sent a text message")
    );
    drive(&mut connection, &mut link, |link| {
        link.stats().disconnects == 2
    });
    assert!(
        link.trouble()
            .unwrap()
            .starts_with("from the server: message of 30 bytes")
    );
}

#[test]
fn connections_of_one_program_have_seeds_of_their_own() {
    let seeds: std::collections::HashSet<u64> = (0..1000).map(|_| super::own_seed()).collect();
    assert_eq!(seeds.len(), 1000);
}
