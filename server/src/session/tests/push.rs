//! What a view needs comes unasked.

use super::*;
use std::collections::HashMap;

/// Small enough that a selection ends soon on a dataset of noise.
fn few() -> Limits {
    Limits {
        pushed_pages: 40,
        ..Limits::default()
    }
}

/// From far above: the root's bound is above the tolerance, those of its children are not.
fn far() -> View {
    View {
        eye_m: [60_000.0, 60_000.0, 60_000.0],
        direction: [0.0, 0.0, -1.0],
        ..view()
    }
}

/// From where some hundred pages are needed.
fn near() -> View {
    View {
        eye_m: [20_000.0, 20_000.0, 500.0],
        max_screen_error_px: 0.2,
        ..view()
    }
}

/// Where chunks end, page by page; every one must join on to what came before.
fn joined(chunks: &[Chunk], parts: &mut HashMap<u64, u8>) {
    for chunk in chunks {
        let next = parts.get(&chunk.page).map_or(0, |last| last + 1);
        assert_eq!(chunk.first_part, next, "page {:x}", chunk.page);
        parts.insert(chunk.page, chunk.last_part);
    }
}

#[test]
fn a_view_is_answered_by_what_it_needs_and_then_by_idle() {
    let mut peer = Peer::pushed(1 << 30, few());
    peer.look(1, far());
    let got = peer.harvest();
    let mut parts = HashMap::new();
    joined(&got.chunks, &mut parts);
    assert_eq!(got.chunks[0].page, PageId::ROOT.key(), "coarse first");
    assert_eq!(got.idles, [1]);
    peer.pass(SECOND);
    peer.look(2, far());
    let again = peer.harvest();
    assert!(again.chunks.is_empty(), "it has all of that");
    assert_eq!(again.idles, [2]);
}

#[test]
fn without_the_capability_nothing_comes_unasked() {
    for (capabilities, pushed_pages) in [(0, 40), (capability::PUSH, 0)] {
        let mut peer = Peer::new(Limits {
            pushed_pages,
            ..few()
        });
        peer.say(ClientMessage::Hello(Hello {
            capabilities,
            ..hello(1 << 30)
        }));
        let Some(ServerMessage::Welcome(welcome)) = peer.hear() else {
            panic!("no welcome")
        };
        assert_eq!(welcome.capabilities, 0);
        peer.look(1, far());
        let got = peer.harvest();
        assert!(got.chunks.is_empty());
        assert_eq!(got.idles, [1]);
    }
}

#[test]
fn a_selection_larger_than_its_limit_goes_on_until_all_is_sent() {
    let all = |pushed_pages| {
        let mut peer = Peer::pushed(
            1 << 30,
            Limits {
                pushed_pages,
                ..few()
            },
        );
        peer.look(1, near());
        let got = peer.harvest();
        assert_eq!(got.idles, [1]);
        let mut parts = HashMap::new();
        joined(&got.chunks, &mut parts);
        parts
    };
    let whole = all(100_000);
    assert!(whole.len() > 100, "{} pages", whole.len());
    assert!(all(7).len() >= 7);
}

#[test]
fn what_the_client_has_is_not_sent_and_what_is_stale_is_named() {
    let mut peer = Peer::pushed(1 << 30, few());
    let stale = Have {
        revision: 1,
        ..have(stored_pages()[0], 5)
    };
    let unknown = Have {
        page: PageId::new(20, 0, 0).unwrap().key(),
        ..stale
    };
    peer.say(ClientMessage::Have(vec![
        have(PageId::ROOT, 5),
        stale,
        unknown,
    ]));
    let expected = ServerMessage::Stale(vec![stale.page, unknown.page]);
    assert_eq!(peer.hear(), Some(expected));
    peer.look(1, far());
    let got = peer.harvest();
    assert!(
        got.chunks
            .iter()
            .all(|chunk| chunk.page != PageId::ROOT.key())
    );
}

#[test]
fn lists_of_held_pages_are_looked_up_one_at_a_time() {
    let mut peer = Peer::open(0);
    peer.say(ClientMessage::Have(vec![have(PageId::ROOT, 1)]));
    assert!(!peer.session.can_receive());
    assert_eq!(peer.hear(), Some(ServerMessage::Stale(Vec::new())));
    assert!(peer.session.can_receive());
}

#[test]
fn an_evicted_page_comes_again_with_the_next_view_and_is_counted() {
    let mut peer = Peer::pushed(1 << 30, few());
    peer.look(1, far());
    peer.hear_all();
    peer.say(ClientMessage::Evict(vec![PageId::ROOT.key()]));
    peer.pass(SECOND);
    peer.look(2, far());
    let got = peer.harvest();
    assert!(
        got.chunks
            .iter()
            .any(|chunk| chunk.page == PageId::ROOT.key() && chunk.first_part == 0)
    );
    let root: u64 = got
        .chunks
        .iter()
        .filter(|chunk| chunk.page == PageId::ROOT.key())
        .take(1)
        .map(|chunk| chunk.bytes.len() as u64)
        .sum();
    assert_eq!(peer.session.stats().repeated_bytes, root);
}

#[test]
fn a_want_that_crosses_pushed_parts_costs_nothing_twice() {
    let mut peer = Peer::pushed(1 << 30, few());
    peer.look(1, far());
    let first = peer.harvest();
    let mut parts = HashMap::new();
    joined(&first.chunks, &mut parts);
    peer.say(ClientMessage::Want(vec![want(
        PageId::ROOT,
        Class::Blocker,
        9.0,
    )]));
    let second = peer.harvest();
    joined(&second.chunks, &mut parts);
    assert_eq!(parts[&PageId::ROOT.key()], 5);
    assert_eq!(second.idles, [1]);
}

#[test]
fn a_newer_view_drops_what_only_the_older_needs() {
    let mut peer = Peer::pushed(
        40_000,
        Limits {
            pushed_pages: 4000,
            ..few()
        },
    );
    peer.look(1, near());
    while peer.hear().is_some() {}
    let before = peer.session.stats();
    assert!(before.waiting > 0 && before.credit_stalls > 0);
    peer.pass(SECOND);
    peer.look(2, far());
    while peer.hear().is_some() {}
    let after = peer.session.stats();
    assert_eq!(after.cancelled_pieces, before.waiting);
    assert!(after.waiting < before.waiting);
}

#[test]
fn a_page_that_cannot_be_remembered_is_not_pushed() {
    let limits = Limits {
        held_pages: 5,
        ..few()
    };
    let mut peer = Peer::pushed(1 << 30, limits);
    for sequence in 1..4 {
        peer.look(sequence, near());
        let got = peer.harvest();
        assert_eq!(got.idles, [sequence]);
        assert!(sequence == 1 || got.chunks.is_empty());
        peer.pass(SECOND);
    }
    assert_eq!(peer.session.stats().held_pages, 5);
}

#[test]
fn what_lies_ahead_is_at_most_a_quarter_and_does_not_hold_up_idle() {
    let mut peer = Peer::pushed(
        1 << 30,
        Limits {
            pushed_pages: 400,
            ..few()
        },
    );
    for sequence in 1..20 {
        let eye_m = [f64::from(sequence) * 500.0, 20_000.0, 500.0];
        peer.look(
            sequence,
            View {
                eye_m,
                velocity_m_s: [5_000.0, 0.0, 0.0],
                ..near()
            },
        );
        assert_eq!(peer.harvest().idles, [sequence]);
        peer.pass(SECOND / 10);
    }
    let stats = peer.session.stats();
    let all = stats.pushed_bytes + stats.predicted_bytes;
    assert!(
        stats.predicted_bytes > 0 && 4 * stats.predicted_bytes <= all,
        "{stats:?}"
    );
}

#[test]
fn a_new_generation_is_announced_and_all_that_was_known_is_forgotten() {
    let mut peer = Peer::pushed(1 << 30, few());
    peer.look(1, far());
    peer.hear_all();
    peer.say(wants_nothing_there());
    let next = Arc::new(FakeSource::of_generation(4));
    let hosted = peer.session.hosted().unwrap().clone();
    hosted.publish(next.clone());
    peer.session.handle_publication(hosted.published());
    let Some(ServerMessage::GenChange {
        generation,
        manifest,
    }) = peer.hear()
    else {
        panic!("no GenChange")
    };
    assert_eq!((generation, manifest.as_slice()), (4, next.manifest_json()));
    assert_eq!(
        peer.hear(),
        None,
        "nothing of what was wanted, or looked at"
    );
    answer(&mut peer);
    peer.say(ClientMessage::Have(vec![have(PageId::ROOT, 2)]));
    assert_eq!(peer.hear(), Some(ServerMessage::Stale(Vec::new())));
    peer.look(2, far());
    let got = peer.harvest();
    let root = got
        .chunks
        .iter()
        .find(|chunk| chunk.page == PageId::ROOT.key());
    assert!(root.is_none_or(|chunk| chunk.first_part == 3));
    peer.session.handle_publication(hosted.published());
    assert_eq!(peer.hear(), None, "it is the same");
}

/// The client has seen a GenChange.
fn answer(peer: &mut Peer) {
    peer.say(ClientMessage::Have(Vec::new()));
    assert_eq!(peer.hear(), Some(ServerMessage::Stale(Vec::new())));
}

fn publish(peer: &mut Peer, generation: u64) {
    let hosted = peer.session.hosted().unwrap().clone();
    hosted.publish(Arc::new(FakeSource::of_generation(generation)));
    peer.session.handle_publication(hosted.published());
}

#[test]
fn what_was_said_before_a_new_generation_was_heard_of_is_not_taken_for_news_of_it() {
    let mut peer = Peer::pushed(1 << 30, few());
    publish(&mut peer, 4);
    assert!(matches!(peer.hear(), Some(ServerMessage::GenChange { .. })));
    // Such a list is said at any time, and what it names may be gone by now.
    let old = ClientMessage::Have(vec![have(PageId::ROOT, 5)]);
    peer.say(old.clone());
    assert_eq!(peer.hear(), Some(ServerMessage::Stale(Vec::new())));
    peer.look(1, far());
    peer.say(wants_nothing_there());
    assert_eq!(peer.hear(), None);
    assert_eq!(peer.session.client_has(PageId::ROOT), None);
    answer(&mut peer);
    peer.say(old);
    assert_eq!(peer.hear(), Some(ServerMessage::Stale(Vec::new())));
    assert_eq!(peer.session.client_has(PageId::ROOT), Some(5));
    peer.look(2, far());
    assert_eq!(peer.harvest().idles, [2]);
}

#[test]
fn of_several_new_generations_each_that_was_told_is_answered() {
    let mut peer = Peer::pushed(1 << 30, few());
    publish(&mut peer, 4);
    publish(&mut peer, 5);
    let told = |peer: &mut Peer| match peer.hear() {
        Some(ServerMessage::GenChange { generation, .. }) => generation,
        other => panic!("{other:?}"),
    };
    assert_eq!(told(&mut peer), 5, "the one before was never told");
    publish(&mut peer, 6);
    assert_eq!(told(&mut peer), 6);
    answer(&mut peer);
    peer.look(1, far());
    assert_eq!(peer.hear(), None, "of generation 5");
    answer(&mut peer);
    peer.look(2, far());
    assert_eq!(peer.harvest().idles, [2]);
}

#[test]
fn what_a_client_says_it_has_of_a_page_is_all_that_it_has() {
    let mut peer = Peer::pushed(1 << 30, few());
    for parts in [5, 2, 4] {
        peer.say(ClientMessage::Have(vec![have(PageId::ROOT, parts)]));
        assert_eq!(peer.hear(), Some(ServerMessage::Stale(Vec::new())));
        assert_eq!(peer.session.client_has(PageId::ROOT), Some(parts));
    }
}

fn wants_nothing_there() -> ClientMessage {
    let nothing = PageId::new(20, 0, 0).unwrap();
    ClientMessage::Want(vec![want(nothing, Class::InView, 1.0)])
}

#[test]
fn a_dataset_that_is_removed_ends_the_session_with_those_that_are_left() {
    let mut peer = Peer::open(0);
    peer.session.handle_removal();
    let Some(CloseReason::Server(error)) = peer.session.close_reason() else {
        panic!("open")
    };
    assert_eq!(error.code, ErrorCode::NoDataset);
}
