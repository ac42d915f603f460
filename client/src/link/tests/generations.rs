//! Data that is published anew, during a session and between two.

use super::*;

fn link() -> Link {
    let mut link = push_link(LinkConfig::new("moon"));
    link.set_view(&view(0.0), ms(0)).unwrap();
    let chunks = (0..3).map(|n| chunk(n, 0, 5)).collect();
    tell(&mut link, &ServerMessage::Pages(chunks), ms(0));
    events(&mut link);
    said(&mut link, ms(0));
    link
}

fn change(generation: u64) -> Event {
    let manifest = manifest(generation).into();
    Event::GenChange { manifest }
}

fn confirmed(numbers: impl IntoIterator<Item = u32>) -> Event {
    let same = numbers.into_iter().map(page).collect();
    Event::Confirmed { same }
}

/// The number of the Ping behind the Haves.
fn barrier(said: &[ClientMessage]) -> u64 {
    let ping = said.iter().find_map(|message| match message {
        ClientMessage::Ping(number) => Some(*number),
        _ => None,
    });
    ping.unwrap_or_else(|| panic!("{said:?}"))
}

#[test]
fn a_new_generation_is_told_all_and_what_it_has_too_is_confirmed() {
    let mut link = link();
    tell(&mut link, &gen_change(2), ms(10));
    assert_eq!(events(&mut link), [change(2)]);
    let all = said(&mut link, ms(60));
    let [
        ClientMessage::Have(marker),
        ClientMessage::Have(have),
        ClientMessage::Ping(_),
        ClientMessage::View { sequence: 2, .. },
    ] = &all[..]
    else {
        panic!("{all:?}")
    };
    assert_eq!((marker.len(), have.len()), (0, 3));
    let number = barrier(&all);
    tell(
        &mut link,
        &ServerMessage::Stale(vec![page(1).key()]),
        ms(80),
    );
    assert_eq!(events(&mut link), []);
    tell(&mut link, &ServerMessage::Pong(number), ms(80));
    assert_eq!(events(&mut link), [confirmed([0, 2])]);
    assert_eq!([0, 1, 2].map(|n| link.holds(page(n))), [true, false, true]);
    let newer = Chunk {
        revision: 8,
        ..chunk(1, 0, 5)
    };
    tell(
        &mut link,
        &ServerMessage::Pages(vec![newer.clone()]),
        ms(90),
    );
    assert_eq!(events(&mut link), [Event::Chunk(newer)]);
}

#[test]
fn parts_of_two_generations_are_never_joined() {
    let mut link = push_link(LinkConfig::new("moon"));
    tell(
        &mut link,
        &ServerMessage::Pages(vec![chunk(1, 0, 2)]),
        ms(0),
    );
    link.set_wants(&wants([1]), ms(0));
    events(&mut link);
    said(&mut link, ms(0));
    tell(&mut link, &gen_change(2), ms(10));
    // The wish for the rest crossed the change.
    let rest = Chunk {
        revision: 8,
        ..chunk(1, 3, 5)
    };
    tell(&mut link, &ServerMessage::Pages(vec![rest]), ms(11));
    assert_eq!(events(&mut link), [change(2)]);
    let number = barrier(&said(&mut link, ms(20))[..]);
    tell(
        &mut link,
        &ServerMessage::Stale(vec![page(1).key()]),
        ms(30),
    );
    tell(&mut link, &ServerMessage::Pong(number), ms(30));
    assert_eq!(events(&mut link), [confirmed([])]);
    assert!(!link.holds(page(1)));
    link.set_wants(&wants([1]), ms(1000));
    let evict = ClientMessage::Evict(vec![page(1).key()]);
    let all = said(&mut link, ms(1000));
    assert_eq!(all[..2], [evict, ClientMessage::Want(wants([1]))]);
}

#[test]
fn a_caller_that_skips_a_generation_is_not_given_its_pages() {
    let mut link = link();
    tell(&mut link, &gen_change(2), ms(10));
    let newer = |number, first, last| Chunk {
        revision: 8,
        ..chunk(number, first, last)
    };
    let chunks = vec![newer(7, 0, 2), newer(7, 3, 5), newer(8, 0, 5)];
    tell(&mut link, &ServerMessage::Pages(chunks), ms(20));
    tell(&mut link, &gen_change(3), ms(30));
    assert_eq!(events(&mut link), [change(3)]);
    assert_eq!(link.stats().held_pages, 3);
    let ClientMessage::Have(have) = &said(&mut link, ms(40))[0] else {
        panic!()
    };
    assert!(have.iter().all(|have| have.revision == 7), "{have:?}");
}

#[test]
fn what_is_confirmed_of_a_generation_has_none_of_its_new_pages_though_the_next_is_known() {
    let mut link = link();
    tell(&mut link, &gen_change(2), ms(10));
    assert_eq!(events(&mut link), [change(2)]);
    let number = barrier(&said(&mut link, ms(20)));
    let newer = Chunk {
        revision: 8,
        ..chunk(1, 0, 5)
    };
    // All of this comes before the caller takes the next event.
    let stale = ServerMessage::Stale(vec![page(1).key()]);
    tell(&mut link, &stale, ms(30));
    tell(&mut link, &ServerMessage::Pong(number), ms(30));
    let pages = ServerMessage::Pages(vec![newer.clone()]);
    tell(&mut link, &pages, ms(30));
    tell(&mut link, &gen_change(3), ms(30));
    let told = [confirmed([0, 2]), Event::Chunk(newer), change(3)];
    assert_eq!(events(&mut link), told);
    let number = barrier(&said(&mut link, ms(40)));
    tell(&mut link, &ServerMessage::Pong(number), ms(50));
    assert_eq!(events(&mut link), [confirmed([0, 1, 2])]);
}

#[test]
fn each_new_generation_is_answered_by_an_empty_list_of_its_own_and_no_new_session_is() {
    let mut link = link();
    tell(&mut link, &gen_change(2), ms(10));
    tell(&mut link, &gen_change(3), ms(10));
    let empty = |said: &[ClientMessage]| {
        let none = ClientMessage::Have(Vec::new());
        said.iter().take_while(|&message| *message == none).count()
    };
    let all = said(&mut link, ms(20));
    assert_eq!(empty(&all), 2, "{all:?}");
    assert!(matches!(&all[2], ClientMessage::Have(have) if have.len() == 3));
    tell(&mut link, &gen_change(4), ms(30));
    link.on_disconnected(ms(30), "cut");
    assert!(link.poll_connect(ms(1000)));
    link.on_connected(ms(1000));
    let all = said(&mut link, ms(1000));
    assert!(!all.contains(&ClientMessage::Have(Vec::new())), "{all:?}");
}

#[test]
fn another_place_on_earth_shares_no_page() {
    let mut link = link();
    let mut elsewhere = manifest(2);
    elsewhere.georef.origin_m = [5.0, 0.0];
    let message = ServerMessage::GenChange {
        generation: 2,
        manifest: elsewhere.to_json(),
    };
    tell(&mut link, &message, ms(10));
    assert_eq!(link.stats().held_pages, 0);
    let all = said(&mut link, ms(60));
    let number = barrier(&all);
    tell(&mut link, &ServerMessage::Pong(number), ms(80));
    assert_eq!(events(&mut link).last(), Some(&confirmed([])));
}

#[test]
fn a_page_found_stale_where_nothing_changed_makes_the_caller_start_anew() {
    let mut link = link();
    link.on_disconnected(ms(100), "cut");
    assert!(link.poll_connect(ms(1000)));
    link.on_connected(ms(1000));
    let all = said(&mut link, ms(1000));
    let number = barrier(&all[1..]);
    tell(&mut link, &push_welcome(1), ms(1100));
    tell(
        &mut link,
        &ServerMessage::Stale(vec![page(2).key()]),
        ms(1100),
    );
    // A second time, and a page that was never announced, are no news.
    let again = vec![page(2).key(), page(9).key(), u64::MAX];
    tell(&mut link, &ServerMessage::Stale(again), ms(1100));
    tell(&mut link, &ServerMessage::Pong(number), ms(1100));
    let told = events(&mut link);
    assert!(
        matches!(told[1], Event::Welcome { changed: false, .. }),
        "{told:?}"
    );
    assert_eq!(told[2..], [change(1), confirmed([0, 1])]);
    assert!(link.holds(page(0)) && !link.holds(page(2)));
}

#[test]
fn a_manifest_that_is_none_ends_the_session() {
    let mut link = link();
    let message = ServerMessage::GenChange {
        generation: 2,
        manifest: b"{".into(),
    };
    let error = link.handle_message(&message.encode(), ms(0)).unwrap_err();
    assert!(error.to_string().contains("manifest"), "{error}");
    assert!(!link.has_socket());
}
