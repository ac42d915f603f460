//! Sessions over WebSocket, well-behaved and not.

use super::*;
use escarp_proto::geometry::PageId;
use escarp_proto::wire::{Class, ErrorCode, MAX_CLIENT_MESSAGE, Want};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio_tungstenite::tungstenite::Error;

fn wants(last_x: u32) -> Vec<Want> {
    let pages = (0..16).flat_map(|y| (0..last_x).map(move |x| PageId::new(4, x, y).unwrap()));
    let wish = |page: PageId| Want {
        page: page.key(),
        first_part: 0,
        last_part: 5,
        class: Class::InView,
        priority: 1.0,
    };
    pages.map(wish).collect()
}

/// The code of the Error that ends the session.
async fn error_code(socket: &mut Socket) -> Option<ErrorCode> {
    while let Some(message) = hear(socket).await {
        if let ServerMessage::Error(error) = message {
            assert_eq!(hear(socket).await, None);
            return Some(error.code);
        }
    }
    None
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_wanted_comes_and_then_idle() {
    let server = Server::start(Limits::default()).await;
    let mut socket = server.open(u64::MAX).await;
    let wishes = wants(13);
    say(&mut socket, ClientMessage::Want(wishes.clone())).await;
    let mut got = Vec::new();
    let last = loop {
        match hear(&mut socket).await.unwrap() {
            ServerMessage::Pages(chunks) => got.extend(chunks),
            other => break other,
        }
    };
    assert_eq!(last, ServerMessage::Idle { view_sequence: 0 });
    assert_eq!(got.len(), wishes.len());
    for wish in &wishes {
        let chunk = got.iter().find(|chunk| chunk.page == wish.page).unwrap();
        assert_eq!(chunk.bytes, server.source.stored(wish.page_id().unwrap()));
    }
    server.stop().await;
}

#[tokio::test]
async fn a_client_that_leaves_in_the_middle_is_forgotten() {
    let limits = Limits {
        sessions: 1,
        ..Limits::default()
    };
    let server = Server::start(limits).await;
    for _ in 0..5 {
        let mut socket = loop {
            let url = format!("ws://{}/session", server.address);
            match tokio_tungstenite::connect_async(url).await {
                Ok((socket, _)) => break socket,
                // The place of the last one is not free yet.
                Err(Error::Http(answer)) => assert_eq!(answer.status(), 503),
                Err(error) => panic!("{error}"),
            }
        };
        say(&mut socket, ClientMessage::Hello(hello(u64::MAX))).await;
        say(&mut socket, ClientMessage::Want(wants(13))).await;
        assert!(hear(&mut socket).await.is_some());
        drop(socket);
    }
    server.stop().await;
}

#[tokio::test]
async fn one_session_too_many_is_told_to_come_later() {
    let limits = Limits {
        sessions: 1,
        ..Limits::default()
    };
    let server = Server::start(limits).await;
    let first = server.open(0).await;
    let url = format!("ws://{}/session", server.address);
    let Err(Error::Http(answer)) = tokio_tungstenite::connect_async(url).await else {
        panic!("no HTTP error")
    };
    assert_eq!(answer.status(), 503);
    assert_eq!(answer.headers()["retry-after"], "5");
    drop(first);
    server.stop().await;
}

#[tokio::test]
async fn rubbish_is_answered_by_an_error() {
    let server = Server::start(Limits::default()).await;
    let rubbish = [
        (Message::binary(vec![0xff; 100]), ErrorCode::Protocol),
        (Message::binary(vec![]), ErrorCode::Protocol),
        (Message::text("hello"), ErrorCode::Protocol),
        (
            Message::binary(vec![0; MAX_CLIENT_MESSAGE + 1]),
            ErrorCode::Limit,
        ),
    ];
    for (message, code) in rubbish {
        for mut socket in [server.connect().await, server.open(0).await] {
            socket.send(message.clone()).await.unwrap();
            assert_eq!(
                error_code(&mut socket).await,
                Some(code),
                "{:?}",
                message.len()
            );
        }
    }
    server.stop().await;
}

#[tokio::test]
async fn a_message_just_too_long_for_the_socket_is_told_which_limit_it_met() {
    use crate::limits::SOCKET_MESSAGE_BYTES;
    let server = Server::start(Limits::default()).await;
    for bytes in [SOCKET_MESSAGE_BYTES, SOCKET_MESSAGE_BYTES + 1] {
        let mut socket = server.open(0).await;
        socket.send(Message::binary(vec![0; bytes])).await.unwrap();
        assert_eq!(
            error_code(&mut socket).await,
            Some(ErrorCode::Limit),
            "{bytes}"
        );
    }
    server.stop().await;
}

#[tokio::test]
async fn a_client_that_says_that_it_goes_is_not_lost() {
    let server = Server::start(Limits::default()).await;
    let mut socket = server.open(0).await;
    socket.close(None).await.unwrap();
    while hear(&mut socket).await.is_some() {}
    let ended = async || {
        let answer = ask(server.address, "GET /metrics", "", "").await;
        let text = String::from_utf8(answer.body).unwrap();
        let lines = text
            .lines()
            .filter(|line| line.starts_with("escarp_sessions_ended_total"));
        lines.map(str::to_owned).collect::<Vec<_>>()
    };
    let mut found = ended().await;
    for _ in 0..100 {
        if !found.is_empty() {
            break;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
        found = ended().await;
    }
    assert_eq!(found, ["escarp_sessions_ended_total{reason=\"client\"} 1"]);
    server.stop().await;
}

#[tokio::test]
async fn a_message_far_too_long_ends_the_connection() {
    let server = Server::start(Limits::default()).await;
    let mut socket = server.open(0).await;
    // The server may be gone before it is sent.
    let _ = socket.send(Message::binary(vec![0; 8 << 20])).await;
    let code = error_code(&mut socket).await;
    assert!(code.is_none_or(|code| code == ErrorCode::Limit));
    drop(server.open(0).await);
    server.stop().await;
}

#[tokio::test]
async fn bytes_that_are_no_websocket_do_no_harm() {
    let server = Server::start(Limits::default()).await;
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    let upgrade = "GET /session HTTP/1.1\r\nHost: x\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
                   Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n";
    stream.write_all(upgrade.as_bytes()).await.unwrap();
    stream.write_all(&[0xff; 4096]).await.unwrap();
    let mut answer = Vec::new();
    // Either end of the connection is right.
    let _ = stream.read_to_end(&mut answer).await;
    assert!(answer.starts_with(b"HTTP/1.1 101"));
    drop(server.open(0).await);
    server.stop().await;
}

#[tokio::test]
async fn a_client_that_says_nothing_is_left() {
    let limits = Limits {
        hello_timeout: Duration::from_millis(50),
        ..Limits::default()
    };
    let server = Server::start(limits).await;
    let mut socket = server.connect().await;
    assert_eq!(error_code(&mut socket).await, Some(ErrorCode::Limit));
    let mut silent = TcpStream::connect(server.address).await.unwrap();
    let mut answer = Vec::new();
    silent.read_to_end(&mut answer).await.unwrap();
    server.stop().await;
}

#[tokio::test]
async fn a_client_that_only_answers_pings_stays() {
    let limits = Limits {
        ping_interval: Duration::from_millis(20),
        idle_timeout: Duration::from_secs(20),
        ..Limits::default()
    };
    let server = Server::start(limits).await;
    let mut socket = server.open(0).await;
    let mut pings = 0;
    while pings < 5 {
        // To read on is what answers them.
        if let Message::Ping(_) = socket.next().await.unwrap().unwrap() {
            pings += 1;
        }
    }
    say(&mut socket, ClientMessage::Ping(7)).await;
    assert_eq!(hear(&mut socket).await, Some(ServerMessage::Pong(7)));
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_never_reads_is_dropped() {
    let limits = Limits {
        sessions: 1,
        send_timeout: Duration::from_millis(100),
        ..Limits::default()
    };
    let server = Server::start(limits).await;
    let mut deaf = server.open(u64::MAX).await;
    // Wants for ever; the system's buffers take some of the answers, then nobody does.
    let message = ClientMessage::Want(wants(13)).encode();
    while deaf.send(Message::binary(message.clone())).await.is_ok() {}
    drop(deaf);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn at_shutdown_sessions_are_told_and_the_server_ends() {
    let server = Server::start(Limits::default()).await;
    let mut idle = server.open(0).await;
    let mut busy = server.open(u64::MAX).await;
    let mut waiting = server.connect().await;
    say(&mut busy, ClientMessage::Want(wants(13))).await;
    server.shutdown.send(()).unwrap();
    for socket in [&mut idle, &mut busy, &mut waiting] {
        assert_eq!(error_code(socket).await, Some(ErrorCode::ShuttingDown));
    }
    server.task.await.unwrap().unwrap();
    assert!(TcpStream::connect(server.address).await.is_err());
}

#[tokio::test(flavor = "multi_thread")]
async fn shutdown_does_not_wait_for_a_client_that_never_reads() {
    let limits = Limits {
        drain_timeout: Duration::from_millis(100),
        ..Limits::default()
    };
    let server = Server::start(limits).await;
    let mut deaf = server.open(u64::MAX).await;
    for _ in 0..50 {
        say(&mut deaf, ClientMessage::Want(wants(13))).await;
    }
    server.stop().await;
}
