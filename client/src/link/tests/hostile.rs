//! Servers that lie, or send rubbish.

use super::*;
use crate::link::LinkError;
use escarp_proto::page::MAX_RECORD_BYTES;
use escarp_proto::wire::{Miss, MissReason, PAGES_FRAME, WireError};
use proptest::prelude::*;

const PLACES: usize = 8;

fn config() -> LinkConfig {
    LinkConfig {
        max_in_flight_pages: PLACES,
        ..LinkConfig::new("moon")
    }
}

fn link() -> Link {
    open_link(config())
}

#[test]
fn chunks_that_do_not_fit_are_dropped_and_counted() {
    let mut link = link();
    link.set_wants(&wants([1]), ms(0));
    said(&mut link, ms(0));
    let beyond = chunk(1, 0, 200);
    let back = Chunk {
        last_part: 0,
        ..chunk(1, 1, 1)
    };
    let no_page = Chunk {
        page: u64::MAX,
        ..chunk(1, 0, 5)
    };
    let lies = vec![chunk(2, 0, 5), chunk(1, 1, 5), beyond, back, no_page];
    tell(&mut link, &ServerMessage::Pages(lies), ms(0));
    assert_eq!(events(&mut link), []);
    assert_eq!(link.stats().dropped_chunks, 5);
    let evict = ClientMessage::Evict(vec![page(1).key()]);
    assert_eq!(
        said(&mut link, ms(0)),
        [evict, ClientMessage::Want(wants([1]))],
        "asked for again, and told that it is not here"
    );
    tell(
        &mut link,
        &ServerMessage::Pages(vec![chunk(1, 0, 5)]),
        ms(0),
    );
    assert_eq!(events(&mut link), [Event::Chunk(chunk(1, 0, 5))]);
}

#[test]
fn a_page_never_grows_beyond_the_longest_record() {
    let mut link = link();
    link.set_wants(&wants([1]), ms(0));
    let half = |part| Chunk {
        bytes: vec![0; MAX_RECORD_BYTES / 2 + 1],
        ..chunk(1, part, part)
    };
    tell(
        &mut link,
        &ServerMessage::Pages(vec![half(0), half(1)]),
        ms(0),
    );
    assert_eq!(events(&mut link), [Event::Chunk(half(0))]);
    assert_eq!(link.stats().dropped_chunks, 1);
}

#[test]
fn parts_of_another_revision_are_not_joined() {
    let mut link = link();
    link.set_wants(&wants([1]), ms(0));
    let other = Chunk {
        revision: 8,
        ..chunk(1, 3, 5)
    };
    tell(
        &mut link,
        &ServerMessage::Pages(vec![chunk(1, 0, 2), other]),
        ms(0),
    );
    let miss = Miss {
        page: page(1).key(),
        reason: MissReason::Damaged,
    };
    assert_eq!(
        events(&mut link),
        [Event::Chunk(chunk(1, 0, 2)), Event::Miss(miss)]
    );
}

#[test]
fn what_breaks_the_protocol_ends_the_session_with_its_reason() {
    let early = |message: &ServerMessage| {
        let mut link = Link::new(LinkConfig::new("moon"));
        link.poll_connect(ms(0));
        link.on_connected(ms(0));
        let error = link.handle_message(&message.encode(), ms(0)).unwrap_err();
        assert!(!link.has_socket());
        assert_eq!(link.trouble(), Some(error.to_string().as_str()));
        error.to_string()
    };
    let pages = ServerMessage::Pages(vec![]);
    assert_eq!(
        early(&pages),
        "from the server: Pages may not come before Welcome"
    );
    let ServerMessage::Welcome(good) = welcome(1) else {
        panic!()
    };
    let version = ServerMessage::Welcome(Welcome {
        version: 9,
        capabilities: 0,
        ..good.clone()
    });
    assert_eq!(
        early(&version),
        "in Welcome: protocol version 9, allowed is 2"
    );
    let manifest = ServerMessage::Welcome(Welcome {
        manifest: b"{".into(),
        ..good
    });
    assert!(early(&manifest).starts_with("in Welcome: not a manifest"));
    let mut link = link();
    let twice = link.handle_message(&welcome(1).encode(), ms(0));
    assert!(matches!(
        twice,
        Err(LinkError::Order {
            message: "Welcome",
            when: "twice"
        })
    ));
    let mut link = open_link(LinkConfig::new("moon"));
    let rubbish = link.handle_message(&[255; 40], ms(0));
    assert!(matches!(
        rubbish,
        Err(LinkError::Wire(WireError::Malformed { .. }))
    ));
}

#[test]
fn a_text_cannot_write_to_the_terminal_or_fill_it() {
    let mut link = link();
    let text = "\u{1b}[2Jx".repeat(200);
    let code = ErrorCode::Denied;
    tell(
        &mut link,
        &ServerMessage::Error(PeerError { code, text }),
        ms(0),
    );
    let Event::Refused { text, .. } = &events(&mut link)[0] else {
        panic!()
    };
    assert!(text.chars().count() <= 1024 && !text.contains('\u{1b}'));
}

fn message() -> impl Strategy<Value = ServerMessage> {
    let reason = prop_oneof![
        Just(MissReason::NotFound),
        Just(MissReason::Damaged),
        Just(MissReason::Busy)
    ];
    let chunks = (0u32..12, 0u8..7, 0u8..8, 6u32..8, 0usize..9000).prop_map(
        |(number, first, last, revision, bytes)| Chunk {
            revision,
            bytes: vec![0; bytes],
            ..chunk(number, first, last)
        },
    );
    prop_oneof![
        10 => prop::collection::vec(chunks, 0..4).prop_map(ServerMessage::Pages),
        5 => (0u32..12, reason).prop_map(|(number, reason)| {
            ServerMessage::Miss(Miss { page: page(number).key(), reason })
        }),
        2 => any::<u32>().prop_map(|view_sequence| ServerMessage::Idle { view_sequence }),
        1 => any::<u64>().prop_map(|generation| ServerMessage::GenChange {
            generation,
            manifest: Vec::new(),
        }),
        2 => (1u64..4).prop_map(gen_change),
        2 => prop::collection::vec(0u32..12, 0..9).prop_map(|numbers| {
            ServerMessage::Stale(numbers.into_iter().map(|number| page(number).key()).collect())
        }),
        2 => (0u64..5).prop_map(ServerMessage::Pong),
        1 => (1u64..3).prop_map(welcome),
        1 => Just(refusal(ErrorCode::Internal)),
    ]
}

#[derive(Debug, Clone)]
enum Act {
    Tell(ServerMessage),
    Rubbish(Vec<u8>),
    Wants(Vec<u32>),
    Transmit,
    TakeEvents,
    Evict(u32),
    Discard(u32),
    Wait(u64),
    Cut,
}

fn act() -> impl Strategy<Value = Act> {
    prop_oneof![
        10 => message().prop_map(Act::Tell),
        1 => prop::collection::vec(any::<u8>(), 0..60).prop_map(Act::Rubbish),
        5 => prop::collection::vec(0u32..12, 0..12).prop_map(Act::Wants),
        5 => Just(Act::Transmit),
        2 => Just(Act::TakeEvents),
        1 => (0u32..12).prop_map(Act::Evict),
        1 => (0u32..12).prop_map(Act::Discard),
        3 => (0u64..3000).prop_map(Act::Wait),
        1 => Just(Act::Cut),
    ]
}

/// Opens a session if there is none, so that most messages meet one.
fn reopen(link: &mut Link, now: &mut Duration, pushes: bool) {
    if let Some(at) = link.next_timeout()
        && !link.has_socket()
    {
        *now = (*now).max(at);
        assert!(link.poll_connect(*now));
        link.on_connected(*now);
        assert!(link.poll_transmit(*now).is_some());
        let welcome = if pushes { push_welcome(1) } else { welcome(1) };
        tell(link, &welcome, *now);
    }
}

proptest! {
    #[test]
    fn random_servers_never_exceed_the_bounds(
        acts in prop::collection::vec(act(), 1..120),
        pushes in any::<bool>(),
    ) {
        let mut link = if pushes { push_link(config()) } else { link() };
        let mut now = ms(0);
        let mut base = link.stats().page_bytes;
        let mut granted = 1u64 << 20;
        for act in acts {
            reopen(&mut link, &mut now, pushes);
            let session = link.stats().sessions;
            match act {
                Act::Tell(message) => drop(link.handle_message(&message.encode(), now)),
                Act::Rubbish(bytes) => drop(link.handle_message(&bytes, now)),
                Act::Wants(numbers) => link.set_wants(&wants(numbers), now),
                Act::Transmit => for message in said(&mut link, now) {
                    let received = link.stats().page_bytes - base;
                    if let ClientMessage::Credit { total_bytes } = message {
                        prop_assert!(total_bytes > granted);
                        prop_assert!(total_bytes <= received + (1 << 20));
                        granted = total_bytes;
                    }
                    prop_assert!(granted.saturating_sub(received) > 1 << 19 || !link.is_open());
                },
                Act::TakeEvents => drop(events(&mut link)),
                Act::Evict(number) => link.evict(&[page(number)]),
                Act::Discard(number) => link.discard(&[page(number)]),
                Act::Wait(wait) => {
                    now += ms(wait);
                    link.handle_timeout(now);
                }
                Act::Cut => link.on_disconnected(now, "cut"),
            }
            if !link.has_socket() || link.stats().sessions != session {
                base = link.stats().page_bytes;
                granted = 1 << 20;
            }
            let stats = link.stats();
            prop_assert!(stats.in_flight_pages <= PLACES);
            prop_assert!(stats.held_pages <= 12);
            // Six chunks a page in flight or waiting, or of each that is pushed, and one event of
            // each of seven other kinds.
            let most = 6 * if pushes { 12 } else { PLACES } + 7;
            prop_assert!(link.events.len() <= most, "{} events", link.events.len());
        }
    }

    #[test]
    fn any_bytes_are_a_message_or_refused(bytes: Vec<u8>) {
        let _ = link().handle_message(&bytes, ms(0));
    }
}

#[test]
fn a_flood_of_unsolicited_pages_takes_no_memory() {
    let mut link = link();
    let chunks: Vec<Chunk> = (0..PAGES_FRAME as u32 / 100)
        .map(|n| chunk(n, 0, 5))
        .collect();
    let flood = ServerMessage::Pages(chunks).encode();
    for _ in 0..100 {
        link.handle_message(&flood, ms(0)).unwrap();
    }
    assert_eq!((link.events.len(), link.stats().held_pages), (0, 0));
    assert!(link.stats().dropped_chunks > 10_000);
}
