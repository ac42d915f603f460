//! How a session begins, and everything that ends it.

use super::*;

/// The code of the Error that answers a message, if one does. After it, nothing may come.
fn refusal(mut peer: Peer, message: ClientMessage) -> Option<ErrorCode> {
    peer.say(message);
    let closed = peer.session.close_reason().is_some();
    let messages = peer.hear_all();
    peer.say(ClientMessage::Ping(1));
    if closed {
        assert_eq!((messages.len(), peer.hear()), (1, None));
    }
    match messages.into_iter().next() {
        Some(ServerMessage::Error(error)) => Some(error.code),
        _ => None,
    }
}

fn every_message_but_hello() -> Vec<ClientMessage> {
    vec![
        ClientMessage::View {
            sequence: 1,
            view: view(),
            scope: Scope::All,
        },
        ClientMessage::Want(vec![]),
        ClientMessage::Cancel(vec![]),
        ClientMessage::Credit { total_bytes: 9 },
        ClientMessage::Have(vec![]),
        ClientMessage::Evict(vec![]),
        ClientMessage::Ping(1),
    ]
}

#[test]
fn hello_is_answered_by_welcome_with_manifest_and_limits() {
    let mut peer = Peer::new(Limits::default());
    peer.say(ClientMessage::Hello(hello(0)));
    let Some(ServerMessage::Welcome(welcome)) = peer.hear() else {
        panic!("no welcome")
    };
    assert_eq!(welcome.version, PROTOCOL);
    assert_eq!(welcome.manifest, SOURCE.manifest_json());
    assert_eq!(
        (welcome.limits.wanted_pages, welcome.limits.views_per_second),
        (2048, 20)
    );
    assert_eq!(peer.hear(), None);
}

#[test]
fn hello_comes_first_and_once_and_all_else_after_it() {
    for message in every_message_but_hello() {
        let before = Peer::new(Limits::default());
        assert_eq!(
            refusal(before, message.clone()),
            Some(ErrorCode::Protocol),
            "{message:?}"
        );
        assert_eq!(refusal(Peer::open(0), message.clone()), None, "{message:?}");
    }
    let again = ClientMessage::Hello(hello(0));
    assert_eq!(refusal(Peer::open(0), again), Some(ErrorCode::Protocol));
}

#[test]
fn hello_must_have_a_version_a_codec_and_a_dataset_in_common() {
    let answer = |change: fn(&mut Hello)| {
        let mut hello = hello(0);
        change(&mut hello);
        refusal(Peer::new(Limits::default()), ClientMessage::Hello(hello))
    };
    assert_eq!(answer(|_| ()), None);
    assert_eq!(answer(|h| h.newest = 9), None);
    assert_eq!(
        answer(|h| (h.oldest, h.newest) = (3, 9)),
        Some(ErrorCode::Version)
    );
    assert_eq!(
        answer(|h| (h.oldest, h.newest) = (2, 0)),
        Some(ErrorCode::Version)
    );
    assert_eq!(answer(|h| h.codecs = 0), Some(ErrorCode::Version));
    assert_eq!(answer(|h| h.codecs = !1), Some(ErrorCode::Version));
    assert_eq!(answer(|h| h.capabilities = u64::MAX), None);
    assert_eq!(
        answer(|h| h.dataset = "mars".into()),
        Some(ErrorCode::NoDataset)
    );
    assert_eq!(answer(|h| h.dataset.clear()), None);
}

#[test]
fn a_wrong_name_is_answered_by_the_right_ones_one_a_line() {
    let catalog = Catalog::default();
    for name in ["moon", "alps"] {
        catalog.add(name, SOURCE.clone()).unwrap();
    }
    let mut peer = Peer::of(catalog, Limits::default());
    let dataset = String::new();
    peer.say(ClientMessage::Hello(Hello {
        dataset,
        ..hello(0)
    }));
    assert_eq!(
        peer.harvest().errors,
        [PeerError::new(ErrorCode::NoDataset, "alps\nmoon")]
    );
}

#[test]
fn names_that_do_not_fit_an_error_are_left_out_whole() {
    let catalog = Catalog::default();
    for number in 100..200 {
        catalog
            .add(&format!("{number}{}", "n".repeat(97)), SOURCE.clone())
            .unwrap();
    }
    let mut peer = Peer::of(catalog, Limits::default());
    peer.say(ClientMessage::Hello(hello(0)));
    let text = &peer.harvest().errors[0].text;
    assert!(text.len() <= MAX_TEXT);
    assert_eq!(text.lines().count(), 10);
    assert!(text.lines().all(|line| line.len() == 100));
}

#[test]
fn what_breaks_the_rules_ends_the_session() {
    let broken = [
        ClientMessage::Credit { total_bytes: 99 },
        ClientMessage::View {
            sequence: 0,
            view: view(),
            scope: Scope::All,
        },
        ClientMessage::View {
            sequence: 1,
            view: View {
                fov_y: f32::NAN,
                ..view()
            },
            scope: Scope::All,
        },
        ClientMessage::Evict(vec![u64::MAX]),
    ];
    for message in broken {
        assert_eq!(
            refusal(Peer::open(100), message.clone()),
            Some(ErrorCode::Protocol),
            "{message:?}"
        );
    }
}

#[test]
fn bytes_that_are_no_message_end_the_session() {
    let ping = ClientMessage::Ping(300).encode();
    for bytes in [
        &[][..],
        &[9],
        &[255],
        &ping[..2],
        &[ping.as_slice(), &[0]].concat(),
    ] {
        let mut peer = Peer::open(0);
        peer.session.handle_message(bytes, peer.now);
        assert_eq!(
            peer.harvest().errors[0].code,
            ErrorCode::Protocol,
            "{bytes:?}"
        );
    }
}

#[test]
fn a_client_that_leaves_with_an_error_gets_no_answer() {
    let mut peer = Peer::open(0);
    let error = PeerError::new(ErrorCode::Internal, "out of memory");
    peer.say(ClientMessage::Error(error.clone()));
    assert_eq!(
        peer.session.close_reason(),
        Some(&CloseReason::Client(error))
    );
    assert_eq!(peer.hear(), None);
}

#[test]
fn the_last_message_goes_before_all_that_waits_and_only_the_first_reason_counts() {
    let mut peer = Peer::open(u64::MAX);
    let wishes = stored_pages()
        .into_iter()
        .map(|page| want(page, Class::InView, 1.0));
    peer.say(ClientMessage::Want(wishes.collect()));
    peer.session.close(ErrorCode::ShuttingDown, "bye");
    peer.session.close(ErrorCode::Internal, "again");
    let error = PeerError::new(ErrorCode::ShuttingDown, "bye");
    assert_eq!(peer.hear_all(), [ServerMessage::Error(error)]);
}
