//! Clients that are slow, silent, many, hostile or gone: the server goes on, and the others do not
//! notice.

use escarp_client::app::TerrainClient;
use escarp_proto::geometry::PageId;
use escarp_proto::wire::{Class, ClientMessage, Have, Scope, ServerMessage, Want};
use escarp_server::{Limits, PageSource};
use escarp_tests::drive::{settle, view_over};
use escarp_tests::files::flip;
use escarp_tests::host::{Host, PATIENCE};
use escarp_tests::programs::{Desk, ServerProcess};
use escarp_tests::raw::{COMPRESSED, FINAL, RawSocket, frame, head, hello, message, opcode};
use escarp_tests::terrain::{TempDataset, hash, hills};
use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::time::{Duration, Instant};

fn hosted(data: &TempDataset, limits: Limits) -> Host {
    let source: Arc<dyn PageSource> = Arc::new(data.open());
    Host::start_with(0, &[("moon", source)], limits)
}

/// All finest pages of a dataset of at most 256 cells a side.
fn all_pages() -> Vec<u64> {
    let places = (0..256).filter_map(|i| PageId::new(4, i % 16, i / 16));
    places.map(PageId::key).collect()
}

fn want(page: u64) -> Want {
    Want {
        page,
        first_part: 0,
        last_part: 5,
        class: Class::InView,
        priority: 1.0,
    }
}

/// Asks for all pages over and over, and reads nothing, for so long, or until the server no longer
/// listens. Whether it came to that.
fn ask_without_reading(socket: &mut RawSocket, time: Duration) -> bool {
    let pages = all_pages();
    let wants = ClientMessage::Want(pages.iter().map(|&page| want(page)).collect());
    let round = [message(&ClientMessage::Evict(pages)), message(&wants)].concat();
    let nap = Some(Duration::from_secs(2));
    socket.0.set_write_timeout(nap).expect("a timeout");
    let began = Instant::now();
    while began.elapsed() < time {
        if socket.send(&round).is_err() {
            return true;
        }
    }
    false
}

#[test]
fn clients_that_read_a_byte_a_second_do_not_hold_up_one_that_reads() {
    let data = TempDataset::of(230, 190, hills);
    let host = hosted(&data, Limits::default());
    let mut slow: Vec<RawSocket> = Vec::new();
    for _ in 0..8 {
        let mut socket = RawSocket::open(host.address()).expect("a session");
        socket.send(&message(&hello(u64::MAX))).expect("it listens");
        ask_without_reading(&mut socket, Duration::from_millis(500));
        slow.push(socket);
    }
    let mut driver = host.client("moon");
    let mut read_at = Instant::now();
    for error_px in [8.0, 2.0, 1.0, 8.0, 1.0] {
        settle(&mut driver, &view_over(&data, error_px));
        if read_at.elapsed() >= Duration::from_secs(1) {
            read_at = Instant::now();
            for socket in &mut slow {
                assert!(socket.0.read_exact(&mut [0]).is_ok(), "it was dropped");
            }
        }
    }
    assert_eq!(driver.client.status(), "connected");
}

#[test]
fn a_client_that_never_reads_is_dropped_and_leaves_its_place_to_another() {
    let data = TempDataset::of(230, 190, hills);
    let limits = Limits {
        sessions: 1,
        send_timeout: Duration::from_secs(1),
        ..Limits::default()
    };
    let host = hosted(&data, limits);
    let mut deaf = RawSocket::open(host.address()).expect("a session");
    deaf.send(&message(&hello(u64::MAX))).expect("it listens");
    assert!(ask_without_reading(&mut deaf, PATIENCE), "it listens on");
    // There is one place, and it is taken until the deaf client is dropped.
    let mut driver = host.client("moon");
    settle(&mut driver, &view_over(&data, 2.0));
    // It is told so by its connection, behind what it never read.
    let mut bytes = vec![0; 1 << 16];
    loop {
        match deaf.0.read(&mut bytes) {
            Ok(0) => break,
            Ok(_) => {}
            Err(error) => {
                assert!(
                    !matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut),
                    "the connection goes on"
                );
                break;
            }
        }
    }
}

#[test]
fn ten_thousand_connection_attempts_leave_the_server_and_its_sessions_alone() {
    let desk = Desk::new();
    let mut server = ServerProcess::start(&[&desk.dataset()]);
    let address = server.address();
    let mut session = RawSocket::open(address).expect("a session");
    let open = |socket: &mut RawSocket, number| {
        socket.send(&message(&ClientMessage::Ping(number))).is_ok()
            && socket.message() == Some(ServerMessage::Pong(number))
    };
    let Hello(greeting) = Hello::to("demo");
    session.send(&greeting).expect("it listens");
    assert!(matches!(session.message(), Some(ServerMessage::Welcome(_))));
    for wave in 0..40u64 {
        let attempts: Vec<Option<TcpStream>> = (0..250).map(|i| attempt(address, i)).collect();
        drop(attempts);
        assert!(server.lives(), "after wave {wave}: {}", server.log());
        assert!(open(&mut session, wave), "the session ended in wave {wave}");
    }
    let began = Instant::now();
    let mut late = loop {
        // What is left of the waves may still take up the places.
        match RawSocket::open(address) {
            Ok(socket) => break socket,
            Err(error) => assert!(began.elapsed() < PATIENCE, "{error}"),
        }
        std::thread::sleep(Duration::from_millis(50));
    };
    late.send(&greeting).expect("it listens");
    assert!(matches!(late.message(), Some(ServerMessage::Welcome(_))));
    assert!(!server.log().contains("panicked"), "{}", server.log());
}

/// A Hello for another dataset than `moon`, as a frame.
struct Hello(Vec<u8>);

impl Hello {
    fn to(dataset: &str) -> Hello {
        let ClientMessage::Hello(mut greeting) = hello(1 << 20) else {
            unreachable!("hello is a Hello");
        };
        greeting.dataset = dataset.into();
        Hello(message(&ClientMessage::Hello(greeting)))
    }
}

/// One of several kinds of connection, half of them not even tried to the end.
fn attempt(address: SocketAddr, kind: u32) -> Option<TcpStream> {
    // A server that has enough may let an attempt wait, or refuse it.
    let mut stream = TcpStream::connect_timeout(&address, Duration::from_secs(5)).ok()?;
    let upgrade = "GET /session HTTP/1.1\r\nHost: a\r\nConnection: Upgrade\r\n\
                   Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
                   Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n";
    let said: &[u8] = match kind % 5 {
        0 => b"",
        1 => b"GET / HTT",
        2 => b"GET /datasets HTTP/1.1\r\nHost: a\r\n\r\n",
        3 => upgrade.as_bytes(),
        _ => &[0xff; 300],
    };
    let _ = stream.write_all(said);
    Some(stream)
}

/// A frame, or several, that no client may send, and the status by which the server closes.
fn forbidden() -> Vec<(&'static str, Vec<u8>)> {
    let binary = FINAL | opcode::BINARY;
    let ping = ClientMessage::Ping(1).encode();
    let mut unmasked = head(binary, 0, ping.len() as u64);
    unmasked.extend(&ping);
    let endless = || frame(opcode::CONTINUATION, &[0; 4096]);
    let too_long = (0..64).flat_map(|_| endless());
    let promised = |length| [head(binary, 0x80, length), vec![0; 4]].concat();
    vec![
        ("not masked", unmasked),
        ("compressed", frame(binary | COMPRESSED, &ping)),
        ("all reserved bits", frame(binary | 0x70, &ping)),
        ("a text", frame(FINAL | opcode::TEXT, b"hello")),
        ("no UTF-8", frame(FINAL | opcode::TEXT, &[0xff, 0xfe])),
        ("an opcode that is none", frame(FINAL | 5, &ping)),
        ("a control that is none", frame(FINAL | 0xd, b"")),
        ("a ping in parts", frame(opcode::PING, b"a")),
        ("a long ping", frame(FINAL | opcode::PING, &[1; 126])),
        (
            "a part of nothing",
            frame(FINAL | opcode::CONTINUATION, &ping),
        ),
        (
            "a message within another",
            [frame(opcode::BINARY, &ping), frame(binary, &ping)].concat(),
        ),
        (
            "parts without end",
            frame(opcode::BINARY, &[0; 9])
                .into_iter()
                .chain(too_long)
                .collect(),
        ),
        ("a length of 2^63", promised(1 << 63)),
        ("a length of 2^40", promised(1 << 40)),
        (
            "a close of half a status",
            frame(FINAL | opcode::CLOSE, &[3]),
        ),
        (
            "a message longer than any",
            frame(binary, &vec![0; 100 << 10]),
        ),
        ("an empty message", frame(binary, b"")),
    ]
}

#[test]
fn frames_that_no_client_may_send_end_its_session_and_no_other() {
    let data = TempDataset::of(130, 110, hills);
    let host = hosted(&data, Limits::default());
    let mut witness = RawSocket::open(host.address()).expect("a session");
    witness.send(&message(&hello(0))).expect("it listens");
    assert!(matches!(witness.message(), Some(ServerMessage::Welcome(_))));
    for (number, (what, bytes)) in forbidden().into_iter().enumerate() {
        let mut socket = RawSocket::open(host.address()).expect("a session");
        socket.send(&message(&hello(0))).expect("it listens");
        // The server may close before all has gone.
        let _ = socket.send(&bytes);
        let status = socket.end();
        assert!(
            status.is_none_or(|status| (1000..1015).contains(&status)),
            "{what}: {status:?}"
        );
        let ping = ClientMessage::Ping(number as u64);
        witness.send(&message(&ping)).expect("it listens");
        let pong = ServerMessage::Pong(number as u64);
        assert_eq!(witness.message(), Some(pong), "after {what}");
    }
    host.stop();
}

#[test]
fn a_message_in_parts_of_a_byte_with_pings_between_them_is_a_message() {
    let data = TempDataset::of(130, 110, hills);
    let host = hosted(&data, Limits::default());
    let mut socket = RawSocket::open(host.address()).expect("a session");
    let bytes = hello(0).encode();
    for (i, byte) in bytes.iter().enumerate() {
        let first = match i {
            0 => opcode::BINARY,
            _ => opcode::CONTINUATION,
        };
        let last = i + 1 == bytes.len();
        let first = first | if last { FINAL } else { 0 };
        socket.send(&frame(first, &[*byte])).expect("it listens");
        let ping = frame(FINAL | opcode::PING, b"between");
        socket.send(&ping).expect("it listens");
    }
    assert!(matches!(socket.message(), Some(ServerMessage::Welcome(_))));
}

#[test]
fn a_flood_of_pings_that_are_not_read_takes_no_more_than_a_session() {
    let data = TempDataset::of(130, 110, hills);
    let limits = Limits {
        send_timeout: Duration::from_secs(1),
        ..Limits::default()
    };
    let host = hosted(&data, limits);
    let mut floods: Vec<RawSocket> = Vec::new();
    for kind in 0..2 {
        let mut socket = RawSocket::open(host.address()).expect("a session");
        socket.send(&message(&hello(0))).expect("it listens");
        let ping = match kind {
            0 => frame(FINAL | opcode::PING, &[1; 125]),
            _ => message(&ClientMessage::Ping(u64::MAX)),
        };
        let nap = Some(Duration::from_millis(300));
        socket.0.set_write_timeout(nap).expect("a timeout");
        let many = ping.repeat(1000);
        for _ in 0..300 {
            if socket.send(&many).is_err() {
                break;
            }
        }
        floods.push(socket);
    }
    settle(&mut host.client("moon"), &view_over(&data, 2.0));
}

/// A message of every kind, each with fields that look random.
fn some_message(seed: u32) -> ClientMessage {
    let n = |salt: u32| hash(seed, salt);
    let page = |salt| match n(salt) % 8 {
        0 => u64::from(n(salt + 50)) << (n(salt + 51) % 64),
        _ => all_pages()[n(salt) as usize % 256],
    };
    let list = || 0..n(1) % 40;
    match n(0) % 9 {
        0 => hello(n(2).into()),
        1 => ClientMessage::View {
            sequence: n(2) % 100,
            view: escarp_tests::drive::view_to([f64::from(n(3)), 1.0, 2.0], [4.0, 5.0, 6.0], 1.0),
            scope: if n(4) % 2 == 0 {
                Scope::All
            } else {
                Scope::InView
            },
        },
        2 | 3 => ClientMessage::Want(
            list()
                .map(|i| Want {
                    first_part: n(i + 100) as u8 % 8,
                    last_part: n(i + 200) as u8 % 8,
                    priority: f32::from_bits(n(i + 300)),
                    ..want(page(i + 400))
                })
                .collect(),
        ),
        4 => ClientMessage::Cancel(list().map(|i| page(i + 2)).collect()),
        5 => ClientMessage::Credit {
            total_bytes: u64::from(n(2)) << (n(3) % 33),
        },
        6 => ClientMessage::Have(
            list()
                .map(|i| Have {
                    page: page(i + 2),
                    revision: n(i + 100),
                    parts: n(i + 200) as u8,
                })
                .collect(),
        ),
        7 => ClientMessage::Evict(list().map(|i| page(i + 2)).collect()),
        _ => ClientMessage::Ping(n(2).into()),
    }
}

#[test]
fn messages_in_any_order_and_with_changed_bytes_are_answered_or_end_the_session() {
    let data = TempDataset::of(230, 190, hills);
    let host = hosted(&data, Limits::default());
    let mut answered = 0;
    for seed in 0..120 {
        let mut socket = RawSocket::open(host.address()).expect("a session");
        let mut bytes = message(&hello(1 << 20));
        for i in 0..20 {
            let mut encoded = some_message(hash(seed, i)).encode();
            if hash(seed, i + 1000).is_multiple_of(6) {
                flip(&mut encoded, hash(seed, i));
            }
            bytes.extend(frame(FINAL | opcode::BINARY, &encoded));
        }
        bytes.extend(message(&ClientMessage::Ping(4711)));
        let _ = socket.send(&bytes);
        // Either it gets there, or it is told why not.
        loop {
            match socket.message() {
                Some(ServerMessage::Pong(4711)) => {
                    answered += 1;
                    break;
                }
                Some(ServerMessage::Error(_)) | None => break,
                Some(_) => {}
            }
        }
    }
    assert!(answered < 120, "nothing was wrong with any of them");
    settle(&mut host.client("moon"), &view_over(&data, 2.0));
    host.stop();
}

#[test]
fn a_client_killed_at_any_moment_leaves_no_session() {
    let data = TempDataset::of(130, 110, hills);
    let limits = Limits {
        sessions: 4,
        ..Limits::default()
    };
    let host = hosted(&data, limits);
    let wants = ClientMessage::Want(all_pages().into_iter().map(want).collect());
    let said = [
        message(&hello(1 << 16)),
        message(&wants),
        message(&ClientMessage::Ping(1)),
    ];
    let (greeting, said) = (said[0].len(), said.concat());
    let began = Instant::now();
    let mut killed = 0;
    while killed < 200 {
        // A place may not be free at once: its session ends when the server hears of it.
        let Ok(mut socket) = RawSocket::open(host.address()) else {
            assert!(began.elapsed() < PATIENCE, "places are not given back");
            continue;
        };
        let length = hash(killed, 1) as usize % said.len();
        let _ = socket.send(&said[..length]);
        // Welcome, or not even that.
        if length >= greeting && killed % 2 == 0 {
            let _ = socket.receive();
        }
        killed += 1;
    }
    // All places are free again.
    let mut drivers: Vec<_> = (0..4).map(|_| host.client("moon")).collect();
    for driver in &mut drivers {
        settle(driver, &view_over(&data, 4.0));
    }
    host.stop();
}
