//! Timeouts, the rate of views, and when Idle comes.

use super::*;

fn view_message(sequence: u32) -> ClientMessage {
    ClientMessage::View {
        sequence,
        view: view(),
        scope: Scope::All,
    }
}

#[test]
fn without_hello_the_session_ends_after_its_time() {
    let mut peer = Peer::new(Limits::default());
    assert_eq!(peer.session.poll_timeout(), Some(10 * SECOND));
    peer.pass(10 * SECOND - Duration::from_nanos(1));
    assert_eq!(peer.session.close_reason(), None);
    peer.pass(Duration::from_nanos(1));
    assert_eq!(peer.harvest().errors[0].code, ErrorCode::Limit);
}

#[test]
fn a_silent_client_is_left_and_any_sign_of_life_keeps_it() {
    let mut peer = Peer::open(0);
    for _ in 0..5 {
        peer.pass(59 * SECOND);
        peer.session.handle_sign_of_life(peer.now);
    }
    assert_eq!(peer.session.close_reason(), None);
    peer.pass(60 * SECOND);
    assert_eq!(peer.harvest().errors[0].code, ErrorCode::Limit);
    assert_eq!(peer.session.poll_timeout(), None);
}

#[test]
fn idle_comes_once_after_each_view_and_names_it() {
    let mut peer = Peer::open(0);
    assert!(peer.hear_all().is_empty());
    peer.say(view_message(7));
    assert_eq!(peer.hear_all(), [ServerMessage::Idle { view_sequence: 7 }]);
    peer.pass(SECOND);
    assert!(peer.hear_all().is_empty());
}

#[test]
fn idle_waits_for_what_is_wanted_and_comes_for_misses_too() {
    let mut peer = Peer::open(0);
    let wish = want(stored_pages()[0], Class::InView, 1.0);
    peer.say(ClientMessage::Want(vec![wish]));
    peer.say(view_message(1));
    assert!(peer.hear_all().is_empty());
    peer.say(ClientMessage::Credit {
        total_bytes: 1 << 20,
    });
    assert_eq!(peer.harvest().idles, [1]);
    peer.say(ClientMessage::Want(vec![Want {
        page: u64::MAX,
        ..wish
    }]));
    assert_eq!(peer.harvest().idles, [1]);
    peer.say(ClientMessage::Cancel(vec![0]));
    peer.say(ClientMessage::Want(vec![]));
    assert!(peer.hear_all().is_empty());
}

#[test]
fn of_too_many_views_the_newest_is_looked_at_when_its_time_comes() {
    let mut peer = Peer::open(0);
    for sequence in 1..=100 {
        peer.say(view_message(sequence));
    }
    assert_eq!(peer.session.view().map(|(sequence, _)| sequence), Some(1));
    assert_eq!(peer.harvest().idles, [1]);
    let due = peer.session.poll_timeout().unwrap();
    assert_eq!(due, SECOND / 20);
    peer.pass(due);
    assert_eq!(peer.harvest().idles, [100]);
    assert_eq!(peer.session.poll_timeout(), Some(60 * SECOND));
}
