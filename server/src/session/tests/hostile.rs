//! Any bytes, in any order: no panic, and nothing grows beyond its limit.

use super::*;
use escarp_proto::wire::{Have, MAX_LIST};
use proptest::collection::vec;
use proptest::prelude::*;

/// Small limits, so that they are reached.
fn tight() -> Limits {
    Limits {
        wanted_pages: 20,
        queued_replies: 10,
        held_pages: 15,
        pushed_pages: 30,
        ..Limits::default()
    }
}

/// Keys of real pages, of every kind, and of none.
fn key() -> impl Strategy<Value = u64> {
    let real = (0u32..16, 0u32..16).prop_map(|(x, y)| PageId::new(4, x, y).unwrap().key());
    prop_oneof![8 => real, 1 => Just(0), 1 => any::<u64>()]
}

fn message() -> impl Strategy<Value = ClientMessage> {
    let wish = (key(), 0u8..7, 0u8..7).prop_map(|(page, first_part, last_part)| Want {
        page,
        first_part,
        last_part,
        class: Class::InView,
        priority: f32::from(first_part),
    });
    let real_key = (0u32..16, 0u32..16).prop_map(|(x, y)| PageId::new(4, x, y).unwrap().key());
    let have = real_key.clone().prop_map(|page| Have {
        page,
        revision: 1,
        parts: 200,
    });
    prop_oneof![
        6 => vec(wish, 0..30).prop_map(ClientMessage::Want),
        2 => vec(key(), 0..30).prop_map(ClientMessage::Cancel),
        // Offsets from what was allowed before: the test adds them up.
        6 => (0u64..20_000).prop_map(|total_bytes| ClientMessage::Credit { total_bytes }),
        2 => vec(have, 0..30).prop_map(ClientMessage::Have),
        1 => vec(real_key, 0..30).prop_map(ClientMessage::Evict),
        3 => any::<u64>().prop_map(ClientMessage::Ping),
        3 => any::<u32>().prop_map(|sequence| ClientMessage::View {
            sequence,
            view: view(),
            scope: Scope::All,
        }),
    ]
}

fn check_bounds(session: &Session) {
    let limits = &session.limits;
    if let State::Open(open) = &session.state {
        assert!(open.queue.len() <= limits.wanted_pages);
        let stats = open.stats();
        assert!(stats.held_pages as usize <= limits.held_pages);
        // Each page is cut into a few pieces, for now and for what lies ahead.
        let pieces = 2 * 6 * limits.pushed_pages;
        assert!(stats.waiting as usize <= limits.wanted_pages + pieces);
        assert!(open.replies() < limits.queued_replies + MAX_LIST);
    }
}

proptest! {
    #[test]
    fn bytes_sent_never_exceed_the_credit(
        first in 0u64..30_000,
        steps in vec((message(), 0usize..8, 0u64..100), 0..40),
    ) {
        let mut peer = Peer::open_with(first, tight());
        let (mut allowed, mut sent, mut looked) = (first, 0, 0);
        for (message, polls, ms) in steps {
            peer.pass(Duration::from_millis(ms));
            if peer.session.can_receive() {
                peer.say(match message {
                    ClientMessage::Credit { total_bytes } => {
                        allowed += total_bytes;
                        ClientMessage::Credit { total_bytes: allowed }
                    }
                    ClientMessage::View { view, scope, .. } => {
                        looked += 1;
                        ClientMessage::View { sequence: looked, view, scope }
                    }
                    other => other,
                });
            }
            for message in (0..polls).map_while(|_| peer.hear()) {
                if let ServerMessage::Pages(chunks) = message {
                    sent += chunks.iter().map(|chunk| chunk.bytes.len() as u64).sum::<u64>();
                }
                prop_assert!(sent <= allowed);
            }
            check_bounds(&peer.session);
        }
        prop_assert_eq!(peer.session.close_reason(), None);
    }

    #[test]
    fn any_bytes_are_followed_or_end_the_session(
        greet: bool,
        steps in vec((vec(any::<u8>(), 0..60), 0usize..3, 0u64..30_000), 0..20),
    ) {
        let mut peer = if greet { Peer::open_with(1 << 20, tight()) } else { Peer::new(tight()) };
        for (bytes, polls, ms) in steps {
            peer.pass(Duration::from_millis(ms));
            peer.session.handle_message(&bytes, peer.now);
            (0..polls).for_each(|_| drop(peer.hear()));
            check_bounds(&peer.session);
        }
        peer.hear_all();
        prop_assert_eq!(peer.hear(), None);
    }

    #[test]
    fn messages_with_a_few_bytes_changed_do_no_harm(
        steps in vec((message(), vec((any::<prop::sample::Index>(), any::<u8>()), 0..3)), 0..20),
    ) {
        let mut peer = Peer::open_with(50_000, tight());
        for (message, changes) in steps {
            let mut bytes = message.encode();
            for (place, value) in changes {
                let place = place.index(bytes.len());
                bytes[place] = value;
            }
            peer.session.handle_message(&bytes, peer.now);
            peer.hear();
            check_bounds(&peer.session);
        }
        peer.hear_all();
    }
}

#[test]
fn pings_that_nobody_hears_the_answers_of_are_not_hoarded() {
    let mut peer = Peer::open_with(0, tight());
    let mut taken = 0;
    while peer.session.can_receive() {
        peer.say(ClientMessage::Ping(taken));
        taken += 1;
    }
    assert_eq!(taken, 10);
    peer.say(ClientMessage::Ping(taken));
    assert_eq!(peer.harvest().errors[0].code, ErrorCode::Limit);
}

#[test]
fn a_message_that_is_too_long_is_refused_unread() {
    let mut peer = Peer::open(0);
    peer.session
        .handle_message(&vec![3; (64 << 10) + 1], peer.now);
    assert_eq!(peer.harvest().errors[0].code, ErrorCode::Limit);
    let mut peer = Peer::open(0);
    peer.say(ClientMessage::Evict(vec![0; MAX_LIST + 1]));
    assert_eq!(peer.harvest().errors[0].code, ErrorCode::Limit);
}
