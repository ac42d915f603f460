//! Sequences of messages to a server's session, and to a client's link.

use super::slope::Slope;
use escarp_client::link::{Link, LinkConfig};
use escarp_proto::geometry::PageId;
use escarp_proto::view::View;
use escarp_proto::wire::{Class, ClientMessage, ServerMessage, Want};
use escarp_server::{Catalog, Limits, Session};
use escarp_tiles::build::{BuildOptions, build};
use escarp_tiles::dataset::Dataset;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// Messages that may follow from one.
const MOST_ANSWERS: usize = 20_000;
/// Events that may wait in a link that nobody takes them from.
const MOST_EVENTS: usize = 1 << 16;

/// A byte that says to whom, and how fast time goes; then messages, each after its length as two
/// bytes, little-endian. The last one may be cut short.
pub fn session(data: &[u8]) {
    let Some((&kind, data)) = data.split_first() else {
        return;
    };
    let step = Duration::from_millis(1 << (kind >> 1 & 15));
    match kind & 1 {
        0 => to_server(data, step),
        _ => to_client(data, step),
    }
}

fn messages(mut data: &[u8]) -> impl Iterator<Item = &[u8]> {
    std::iter::from_fn(move || {
        let (length, rest) = data.split_first_chunk()?;
        let length = usize::from(u16::from_le_bytes(*length)).min(rest.len());
        let (message, rest) = rest.split_at(length);
        data = rest;
        Some(message)
    })
}

/// One small dataset, made once. Its files are removed; what is open stays.
fn catalog() -> Arc<Catalog> {
    static CATALOG: OnceLock<Arc<Catalog>> = OnceLock::new();
    let make = || {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("slope.escarp");
        let mut source = Slope::new(60, 40, u32::MAX);
        let options = BuildOptions::default();
        build(&mut source, &path, Vec::new(), options, &|_, _| {}).expect("it builds");
        let dataset = Dataset::open(&path).expect("it opens");
        let catalog = Catalog::default();
        let added = catalog.add("slope", Arc::new(dataset));
        assert!(added.is_ok());
        Arc::new(catalog)
    };
    CATALOG.get_or_init(make).clone()
}

/// What a session says is well-formed and keeps to its client's credit, and it comes to an end.
fn to_server(data: &[u8], step: Duration) {
    let mut session = Session::new(catalog(), Limits::default());
    let (mut now, mut credit, mut sent) = (Duration::ZERO, 0, 0);
    for message in messages(data) {
        now += step;
        credit = match ClientMessage::decode(message) {
            Ok(ClientMessage::Hello(hello)) => credit.max(hello.credit_bytes),
            Ok(ClientMessage::Credit { total_bytes }) => credit.max(total_bytes),
            _ => credit,
        };
        session.handle_timeout(now);
        if session.can_receive() {
            session.handle_message(message, now);
        }
        let mut answers = 0;
        while let Some(answer) = session.poll_message() {
            answers += 1;
            assert!(answers < MOST_ANSWERS, "it never stops");
            match ServerMessage::decode(&answer).expect("own message") {
                ServerMessage::Pages(chunks) => {
                    sent += chunks.iter().map(|c| c.bytes.len() as u64).sum::<u64>();
                }
                ServerMessage::Error(_) => assert!(session.close_reason().is_some()),
                _ => {}
            }
            assert!(sent <= credit, "{sent} bytes, allowed are {credit}");
        }
    }
    session.handle_timeout(now + Duration::from_secs(3600));
    session.poll_message();
    assert!(session.close_reason().is_some(), "it never ends");
}

/// What a link says is well-formed, and what it keeps is bounded; it goes on with a new session.
fn to_client(data: &[u8], step: Duration) {
    let config = LinkConfig {
        max_in_flight_pages: 16,
        ..LinkConfig::new("slope")
    };
    let mut link = Link::new(config);
    let mut now = Duration::ZERO;
    let view = view();
    for (number, message) in (0u32..).zip(messages(data)) {
        now += step;
        link.handle_timeout(now);
        if !link.has_socket() {
            now += Duration::from_secs(20);
            if link.poll_connect(now) {
                link.on_connected(now);
            }
        }
        // An error is the link's to follow.
        let _ = link.handle_message(message, now);
        let _ = link.set_view(&view, now);
        link.set_wants(&wants(number), now);
        let mut said = 0;
        while let Some(message) = link.poll_transmit(now) {
            said += 1;
            assert!(said < MOST_ANSWERS, "it never stops");
            ClientMessage::decode(&message).expect("own message");
        }
        let stats = link.stats();
        assert!(stats.in_flight_pages <= 16, "{stats:?}");
        assert!(stats.waiting_events <= MOST_EVENTS, "{stats:?}");
        // Events are left where they are for a while, and some pages go.
        if number % 8 == 7 {
            while link.poll_event().is_some() {}
        }
        if number % 16 == 15 {
            link.evict(&[PageId::ROOT]);
        }
    }
}

fn view() -> View {
    View {
        eye_m: [30.0, -20.0, 5000.0],
        direction: [0.0, 1.0, -1.0],
        velocity_m_s: [0.0; 3],
        fov_y: 1.0,
        viewport_px: [640, 400],
        max_screen_error_px: 1.0,
    }
}

fn wants(number: u32) -> Vec<Want> {
    let finest = (0..4).filter_map(|i| PageId::new(4, i, number % 3));
    let want = |page: PageId| Want {
        page: page.key(),
        first_part: 0,
        last_part: 5,
        class: Class::InView,
        priority: 1.0,
    };
    [PageId::ROOT].into_iter().chain(finest).map(want).collect()
}
