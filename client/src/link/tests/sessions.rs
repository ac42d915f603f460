//! From Hello to the end, and on into the next session.

use super::*;
use crate::link::LinkState;
use escarp_proto::wire::{Miss, MissReason};

fn config() -> LinkConfig {
    LinkConfig {
        credit_window_bytes: 40_000,
        ..LinkConfig::new("moon")
    }
}

#[test]
fn hello_names_the_dataset_and_before_welcome_only_the_view_is_said_behind_it() {
    let mut link = Link::new(LinkConfig {
        token: Some("secret".into()),
        ..config()
    });
    link.set_wants(&wants(0..3), ms(0));
    link.set_view(&view(0.0), ms(0)).unwrap();
    assert!(said(&mut link, ms(0)).is_empty());
    assert!(link.poll_connect(ms(0)) && !link.poll_connect(ms(0)));
    link.on_connected(ms(0));
    let all = said(&mut link, ms(0));
    let [
        ClientMessage::Hello(hello),
        ClientMessage::View { sequence: 1, .. },
    ] = &all[..]
    else {
        panic!("{all:?}")
    };
    assert_eq!(hello.capabilities, capability::PUSH);
    assert_eq!(
        (hello.dataset.as_str(), hello.credit_bytes),
        ("moon", 40_000)
    );
    assert_eq!(hello.token.as_deref(), Some("secret"));
}

#[test]
fn the_first_manifest_is_a_changed_one_and_the_same_again_is_not() {
    let mut world = World::new(config());
    let changes = |world: &World| {
        let change = |event: &Event| match event {
            Event::Welcome { changed, .. } => Some(*changed),
            _ => None,
        };
        world.events.iter().filter_map(change).collect::<Vec<_>>()
    };
    world.run_until("a session", |w| w.link.is_open());
    world.cut();
    world.run_until("a second session", |w| w.link.is_open());
    assert_eq!(changes(&world), [true, false]);
    world.cut();
    world.server.generation = 2;
    world.run_until("a third session", |w| w.link.is_open());
    assert_eq!(changes(&world), [true, false, true]);
    assert_eq!(world.link.stats().reconnects(), 2);
}

#[test]
fn all_pages_arrive_most_urgent_first_within_the_credit() {
    let mut world = World::new(config());
    world.run_until("a session", |w| w.link.is_open());
    let mut list = wants(0..200);
    list.reverse();
    list.sort_by(|a, b| b.priority.total_cmp(&a.priority));
    world.run_until("all pages", |w| {
        w.link.set_wants(&list, w.now);
        assert!(w.server.sent <= w.server.credit);
        assert!(w.server.credit <= w.link.stats().page_bytes + 40_000);
        w.complete().len() == 200
    });
    let order: Vec<u64> = list.iter().map(|want| want.page).collect();
    assert_eq!(world.complete(), order);
    assert_eq!(world.link.stats().dropped_chunks, 0);
    assert_eq!(world.link.stats().in_flight_pages, 0);
    assert!(world.server.sent > 40_000 * 4);
}

#[test]
fn disconnects_lose_nothing_and_nothing_is_sent_twice_that_had_arrived() {
    let mut world = World::new(config());
    world.server.parts_a_chunk = 2;
    let list = wants(0..60);
    let mut steps = 0;
    world.run_until("all pages", |w| {
        w.link.set_wants(&list, w.now);
        steps += 1;
        if steps % 90 == 0 {
            w.cut();
        }
        w.complete().len() == 60
    });
    assert!(world.link.stats().reconnects() >= 2);
    let mut parts: BTreeMap<u64, Vec<u8>> = BTreeMap::new();
    for event in &world.events {
        if let Event::Chunk(chunk) = event {
            parts
                .entry(chunk.page)
                .or_default()
                .extend(chunk.first_part..=chunk.last_part);
        }
    }
    assert!(
        parts.values().all(|parts| *parts == [0, 1, 2, 3, 4, 5]),
        "{parts:?}"
    );
}

#[test]
fn pages_held_are_announced_in_the_next_session() {
    let mut world = World::new(config());
    world.run_until("pages", |w| {
        w.link.set_wants(&wants(0..20), w.now);
        w.complete().len() == 20
    });
    world.link.evict(&[page(3)]);
    world.cut();
    world.run_until("have", |w| !w.server.have.is_empty());
    let have = &world.server.have;
    assert_eq!(have.len(), 19);
    assert!(
        have.iter()
            .all(|h| h.revision == 7 && h.parts == 5 && h.page != page(3).key())
    );
    world.run_until("a second session", |w| w.link.is_open());
    world.cut();
    world.server.generation = 2;
    world.run_until("another generation", |w| w.link.stats().sessions == 3);
    (0..20).for_each(|_| world.step());
    assert_eq!(world.server.have.len(), 19);
    assert_eq!(world.link.stats().held_pages, 0);
    let none = Event::Confirmed { same: Vec::new() };
    assert_eq!(world.events.last(), Some(&none));
}

#[test]
fn what_is_held_goes_out_right_behind_hello() {
    let mut world = World::new(config());
    world.link.set_view(&view(1.0), ms(0)).unwrap();
    world.run_until("pages", |w| {
        w.link.set_wants(&wants(0..20), w.now);
        w.complete().len() == 20
    });
    world.link.on_disconnected(world.now, "cut");
    let later = world.now + Duration::from_secs(60);
    assert!(world.link.poll_connect(later));
    world.link.on_connected(later);
    let all = said(&mut world.link, later);
    let [
        ClientMessage::Hello(_),
        ClientMessage::Have(have),
        ClientMessage::Ping(_),
        ClientMessage::View { .. },
    ] = &all[..]
    else {
        panic!("{all:?}")
    };
    assert_eq!(have.len(), 20);
}

#[test]
fn a_silent_server_is_left_and_a_pause_of_the_program_is_no_silence() {
    let mut world = World::new(config());
    world.run_until("a pong", |w| w.link.stats().round_trip_ms.is_some());
    assert!((100.0..=120.0).contains(&world.link.stats().round_trip_ms.unwrap()));
    world.now += Duration::from_secs(3600);
    world.step();
    assert!(world.link.is_open());
    world.server.silent = true;
    world.run_until("left", |w| !w.link.is_open());
    assert!(world.link.trouble().unwrap().contains("silent"));
    assert!(!world.link.has_socket());
}

#[test]
fn a_line_that_takes_nothing_any_more_is_left_and_a_pause_of_the_program_does_not_count() {
    let mut link = open_link(config());
    tell(&mut link, &ServerMessage::Pong(1), ms(10));
    link.handle_timeout(ms(10));
    link.handle_timeout(Duration::from_secs(1000));
    assert!(link.is_open());
    link.handle_timeout(Duration::from_millis(1_014_999));
    assert!(link.is_open());
    link.handle_timeout(Duration::from_secs(1015));
    assert!(link.trouble().unwrap().contains("silent"));
}

#[test]
fn a_server_without_welcome_is_left() {
    let mut world = World::new(config());
    world.server.silent = true;
    world.run_until("left", |w| w.link.trouble().is_some());
    assert!(world.link.trouble().unwrap().contains("Welcome"));
}

#[test]
fn a_server_out_of_reach_is_tried_again_with_growing_pauses() {
    let mut world = World::new(config());
    world.reachable = false;
    world.run_until("a minute", |w| w.now > Duration::from_secs(60));
    let attempts = world.link.stats().disconnects;
    assert!(
        (8..=14).contains(&attempts),
        "{attempts} attempts in a minute"
    );
    let events = world
        .events
        .iter()
        .filter(|e| matches!(e, Event::Disconnected { .. }));
    assert_eq!(events.count() as u64, attempts);
    world.reachable = true;
    world.run_until("a session", |w| w.link.is_open());
}

#[test]
fn only_refusals_for_good_end_the_attempts() {
    use ErrorCode::*;
    let codes = [
        Version,
        NoDataset,
        Denied,
        Protocol,
        Limit,
        ShuttingDown,
        Internal,
    ];
    for (i, code) in codes.into_iter().enumerate() {
        let mut link = open_link(config());
        tell(&mut link, &refusal(code), ms(5));
        let fatal = i < 3;
        let text = "because".to_owned();
        assert_eq!(events(&mut link)[0], Event::Refused { fatal, code, text });
        assert_eq!(link.state() == LinkState::Refused, fatal);
        assert!(link.trouble().unwrap().contains("because"));
        assert_eq!(link.poll_connect(Duration::from_secs(3600)), !fatal);
        assert_eq!(link.next_timeout(), None);
    }
}

#[test]
fn a_missing_dataset_is_told_with_those_there_are() {
    let trouble = |dataset: &str, names: &str| {
        let mut link = open_link(LinkConfig::new(dataset));
        let error = PeerError::new(ErrorCode::NoDataset, names);
        tell(&mut link, &ServerMessage::Error(error), ms(0));
        link.trouble().unwrap().to_owned()
    };
    assert_eq!(
        trouble("mon", "mars\nmoon"),
        "the server has no dataset \"mon\"; it has: mars, moon"
    );
    assert_eq!(
        trouble("", "mars\nmoon"),
        "the address names no dataset; the server has: mars, moon"
    );
    assert_eq!(
        trouble("mon", ""),
        "the server has no dataset \"mon\"; it has: none"
    );
}

#[test]
fn views_go_out_at_most_twenty_a_second_the_newest_wins_and_the_same_is_not_repeated() {
    let mut link = open_link(config());
    let mut sent = Vec::new();
    for tick in 0..1000u32 {
        link.set_view(&view(f64::from(tick)), ms(tick.into()))
            .unwrap();
        let views =
            said(&mut link, ms(tick.into()))
                .into_iter()
                .filter_map(|message| match message {
                    ClientMessage::View { sequence, view, .. } => {
                        Some((tick, sequence, view.eye_m[0]))
                    }
                    _ => None,
                });
        sent.extend(views);
    }
    assert_eq!(sent.len(), 20);
    assert!(sent.iter().all(|(tick, _, x)| f64::from(*tick) == *x));
    assert_eq!(link.next_timeout(), Some(ms(1000)));
    assert_eq!(said(&mut link, ms(1000)).len(), 1);
    link.set_view(&view(999.0), ms(2000)).unwrap();
    assert!(said(&mut link, ms(2000)).is_empty() && !link.view_pending());
    assert_eq!(link.view_sequence(), 21);
    assert_eq!(
        link.set_view(&view(f64::NAN), ms(2000)).unwrap_err().field,
        "eye"
    );
}

#[test]
fn a_new_session_is_told_the_view_again() {
    let mut world = World::new(config());
    world.link.set_view(&view(1.0), ms(0)).unwrap();
    world.run_until("a view", |w| w.server.views == [1]);
    world.cut();
    world.run_until("the view again", |w| w.server.views == [2]);
}

#[test]
fn busy_pages_are_asked_for_again_later_and_missing_ones_in_the_next_session() {
    let mut link = open_link(config());
    let list = wants(0..3);
    let ask = |link: &mut Link, now| {
        link.set_wants(&list, now);
        let asked = said(link, now)
            .into_iter()
            .filter_map(|message| match message {
                ClientMessage::Want(wants) => Some(wants.len()),
                _ => None,
            });
        asked.sum::<usize>()
    };
    assert_eq!(ask(&mut link, ms(0)), 3);
    let reasons = [MissReason::NotFound, MissReason::Damaged, MissReason::Busy];
    for (number, reason) in (0..).zip(reasons) {
        let page = page(number).key();
        tell(
            &mut link,
            &ServerMessage::Miss(Miss { page, reason }),
            ms(100),
        );
    }
    assert_eq!(events(&mut link).len(), 2);
    assert_eq!(ask(&mut link, ms(1099)), 0);
    assert_eq!(link.next_timeout(), Some(ms(1100)));
    assert_eq!(ask(&mut link, ms(1100)), 1);
    assert_eq!(ask(&mut link, Duration::from_secs(4)), 0);
    link.on_disconnected(ms(5000), "cut");
    assert_eq!(ask(&mut link, ms(5000)), 0);
    assert!(link.poll_connect(ms(6000)));
    link.on_connected(ms(6000));
    assert_eq!(ask(&mut link, ms(6000)), 0);
    tell(&mut link, &welcome(1), ms(6000));
    assert_eq!(ask(&mut link, ms(6000)), 3);
}
