//! Servers that send unasked, and wishes that wait for them.

use super::*;
use crate::link::claims::MAX_STRAYS;
use crate::link::session::NEEDS_NOTHING;
use escarp_proto::page::MAX_RECORD_BYTES;

fn link() -> Link {
    push_link(LinkConfig {
        credit_window_bytes: 40_000,
        ..LinkConfig::new("moon")
    })
}

fn push(link: &mut Link, chunks: Vec<Chunk>, now: u64) -> Vec<Event> {
    tell(link, &ServerMessage::Pages(chunks), ms(now));
    events(link)
}

fn idle(link: &mut Link, view_sequence: u32, now: u64) {
    tell(link, &ServerMessage::Idle { view_sequence }, ms(now));
    events(link);
}

/// Pages asked for now.
fn asked(link: &mut Link, now: u64) -> usize {
    let said = said(link, ms(now)).into_iter();
    let wants = said.map(|message| match message {
        ClientMessage::Want(wants) => wants.len(),
        _ => 0,
    });
    wants.sum()
}

#[test]
fn pushed_parts_that_continue_a_page_are_taken() {
    let mut link = link();
    let chunks = vec![chunk(1, 0, 2), chunk(2, 0, 5), chunk(1, 3, 5)];
    let taken: Vec<Event> = chunks.iter().cloned().map(Event::Chunk).collect();
    assert_eq!(push(&mut link, chunks, 0), taken);
    let stats = link.stats();
    assert_eq!((stats.pushed_chunks, stats.held_pages), (3, 2));
    link.set_wants(&wants([1, 2]), ms(0));
    assert_eq!(asked(&mut link, 0), 0);
}

#[test]
fn pushed_parts_that_do_not_continue_a_page_are_dropped() {
    let mut link = link();
    push(&mut link, vec![chunk(1, 0, 2)], 0);
    let wrong = vec![
        chunk(1, 4, 5),
        chunk(1, 0, 2),
        Chunk {
            revision: 8,
            ..chunk(1, 3, 3)
        },
        chunk(1, 3, 6),
        Chunk {
            last_part: 0,
            ..chunk(2, 1, 1)
        },
        chunk(2, 1, 5),
        Chunk {
            bytes: vec![0; MAX_RECORD_BYTES - 99],
            ..chunk(1, 3, 3)
        },
        Chunk {
            page: u64::MAX,
            ..chunk(1, 0, 5)
        },
        Chunk {
            page: PageId::new(16, 0, 0).unwrap().key(),
            ..chunk(1, 0, 4)
        },
    ];
    let count = wrong.len() as u64;
    assert_eq!(push(&mut link, wrong, 0), []);
    assert_eq!(link.stats().dropped_chunks, count);
    assert_eq!(push(&mut link, vec![chunk(1, 3, 5)], 0).len(), 1);
}

#[test]
fn wishes_wait_until_the_newest_view_is_answered() {
    let mut link = link();
    link.set_view(&view(0.0), ms(100)).unwrap();
    link.set_wants(&wants(0..9), ms(100));
    assert_eq!(asked(&mut link, 100), 0);
    push(&mut link, (0..6).map(|n| chunk(n, 0, 5)).collect(), 120);
    idle(&mut link, 0, 130);
    link.set_wants(&wants(0..9), ms(130));
    assert_eq!(asked(&mut link, 130), 0, "an answer to no view");
    idle(&mut link, 1, 140);
    link.set_wants(&wants(0..9), ms(140));
    assert_eq!(asked(&mut link, 140), 3);
}

#[test]
fn wishes_are_let_through_when_the_server_is_silent() {
    let mut link = link();
    link.set_view(&view(0.0), ms(100)).unwrap();
    link.set_wants(&wants(0..9), ms(100));
    assert_eq!(asked(&mut link, 100), 0);
    push(&mut link, vec![chunk(0, 0, 5)], 200);
    assert_eq!(link.next_timeout(), Some(ms(450)));
    link.handle_timeout(ms(449));
    assert_eq!(asked(&mut link, 449), 0);
    link.handle_timeout(ms(450));
    assert_eq!(asked(&mut link, 450), 8);
}

#[test]
fn a_server_that_sends_what_nobody_needs_does_not_starve_wishes() {
    let mut link = link();
    link.set_view(&view(0.0), ms(0)).unwrap();
    let first = (0..10_000u32).step_by(20).find(|&now| {
        push(&mut link, vec![chunk(100 + now, 0, 5)], now.into());
        link.evict(&[page(100 + now)]);
        link.set_wants(&wants(0..9), ms(now.into()));
        asked(&mut link, now.into()) > 0
    });
    assert_eq!(first, Some(3000));
}

#[test]
fn what_was_in_flight_waits_for_a_new_server_to_push_it() {
    let mut link = link();
    link.set_wants(&wants(0..4), ms(0));
    assert_eq!(asked(&mut link, 0), 4, "without a view nothing is pushed");
    link.set_view(&view(0.0), ms(0)).unwrap();
    link.on_disconnected(ms(0), "cut");
    assert!(link.poll_connect(ms(1000)));
    link.on_connected(ms(1000));
    said(&mut link, ms(1000));
    tell(&mut link, &push_welcome(1), ms(1000));
    assert_eq!(asked(&mut link, 1000), 0);
    push(&mut link, vec![chunk(0, 0, 5), chunk(1, 0, 5)], 1100);
    let newest = link.view_sequence();
    idle(&mut link, newest, 1200);
    link.handle_timeout(ms(1200));
    assert_eq!(asked(&mut link, 1200), 2);
}

#[test]
fn of_a_dropped_part_one_message_tells_before_its_page_is_wanted() {
    let mut link = link();
    push(&mut link, vec![chunk(1, 0, 1), chunk(1, 3, 5)], 0);
    said(&mut link, ms(0));
    link.set_wants(&wants([1]), ms(0));
    let have = Have {
        page: page(1).key(),
        revision: 7,
        parts: 1,
    };
    let want = Want {
        first_part: 2,
        ..wants([1])[0]
    };
    // After an Evict alone, the first parts would be pushed again.
    let expected = [
        ClientMessage::Have(vec![have]),
        ClientMessage::Want(vec![want]),
    ];
    assert_eq!(said(&mut link, ms(0)), expected);
}

#[test]
fn what_came_for_nothing_is_told_no_sooner_than_it_is_wanted() {
    let mut link = link();
    push(&mut link, vec![chunk(1, 0, 5)], 0);
    link.discard(&[page(1)]);
    assert_eq!(said(&mut link, ms(0)), []);
    assert_eq!(link.stats().held_pages, 0);
    link.set_wants(&wants([1]), ms(0));
    let evict = ClientMessage::Evict(vec![page(1).key()]);
    let want = ClientMessage::Want(wants([1]));
    assert_eq!(said(&mut link, ms(0)), [evict, want]);
}

#[test]
fn a_page_that_the_server_swallows_is_asked_for_again_later_each_time() {
    let mut link = link();
    link.set_wants(&wants([1, 2]), ms(0));
    assert_eq!(asked(&mut link, 0), 2);
    push(&mut link, vec![chunk(2, 0, 5)], 100);
    idle(&mut link, 0, 100);
    let mut times = Vec::new();
    for now in 100..14_000 {
        link.handle_timeout(ms(now));
        for message in said(&mut link, ms(now)) {
            match message {
                ClientMessage::Want(wants) => times.extend(wants.iter().map(|_| now)),
                ClientMessage::Ping(number) => {
                    tell(&mut link, &ServerMessage::Pong(number), ms(now))
                }
                ClientMessage::Evict(pages) => assert_eq!(pages, [page(1).key()]),
                ClientMessage::Credit { .. } => {}
                other => panic!("{other:?}"),
            }
        }
    }
    assert_eq!(times, [600, 1600, 3600, 7600]);
    assert_eq!(link.stats().in_flight_pages, 1);
    assert_eq!(link.stats().asked_again, 4);
}

#[test]
fn a_flood_of_pushed_pages_is_bounded_by_the_credit_and_in_number() {
    let bytes = |length: usize| {
        let mut link = link();
        for frame in 0..1000u32 {
            let chunks = (0..16).map(|n| Chunk {
                bytes: vec![0; length],
                ..chunk(16 * frame + n, 0, 5)
            });
            tell(&mut link, &ServerMessage::Pages(chunks.collect()), ms(0));
        }
        link
    };
    let full = bytes(1000);
    assert_eq!((full.events.pages(), full.stats().held_pages), (40, 40));
    let empty = bytes(0);
    assert_eq!(empty.events.pages(), 1024 + 40_000 / 32);
    assert!(empty.claims.strays() <= MAX_STRAYS);
}

#[test]
fn a_server_whose_pages_are_of_no_use_any_more_is_shown_a_view_that_needs_nothing() {
    let mut link = link();
    link.set_view(&view(0.0), ms(0)).unwrap();
    said(&mut link, ms(0));
    link.set_push(false);
    let looks = |link: &mut Link, x: f64, now: u64| {
        link.set_view(&view(x), ms(now)).unwrap();
        let mut said = said(link, ms(now));
        said.retain(|message| !matches!(message, ClientMessage::Ping(_)));
        said
    };
    let said = looks(&mut link, 1.0, 100);
    let [ClientMessage::View { view: told, .. }] = &said[..] else {
        panic!("{said:?}")
    };
    assert_eq!((told, told.check()), (&NEEDS_NOTHING, Ok(())));
    assert_eq!(looks(&mut link, 2.0, 200), [], "it is said once");
    // What was on its way is taken, and wishes do not wait for more.
    let last = chunk(1, 0, 5);
    let taken = push(&mut link, vec![last.clone()], 200);
    assert_eq!(taken, [Event::Chunk(last)]);
    link.set_wants(&wants([2]), ms(200));
    assert_eq!(asked(&mut link, 200), 1);
    link.set_push(true);
    let said = looks(&mut link, 3.0, 300);
    let [ClientMessage::View { view: told, .. }] = &said[..] else {
        panic!("{said:?}")
    };
    assert_eq!(*told, view(3.0));
}

#[test]
fn a_server_is_asked_to_push_only_where_that_is_of_use() {
    for (allowed, of_use) in [(true, true), (true, false), (false, true)] {
        let mut link = Link::new(LinkConfig {
            push: allowed,
            ..LinkConfig::new("moon")
        });
        link.set_push(of_use);
        assert!(link.poll_connect(ms(0)));
        link.on_connected(ms(0));
        let said = said(&mut link, ms(0));
        let [ClientMessage::Hello(hello)] = &said[..] else {
            panic!("{said:?}")
        };
        let asks = hello.capabilities == capability::PUSH;
        assert_eq!(asks, allowed && of_use);
    }
}
