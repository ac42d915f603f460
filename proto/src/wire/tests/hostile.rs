//! Bytes that are no message, and counts that lie.

use super::*;
use proptest::collection::vec;
use proptest::prelude::*;

#[test]
fn every_short_prefix_and_every_byte_too_many_is_refused() {
    for bytes in client_messages().iter().map(ClientMessage::encode) {
        for end in 0..bytes.len() {
            assert!(
                ClientMessage::decode(&bytes[..end]).is_err(),
                "{:x?}",
                &bytes[..end]
            );
        }
        let longer = [bytes.as_slice(), &[0]].concat();
        let read = bytes.len();
        assert_eq!(
            ClientMessage::decode(&longer),
            Err(WireError::Trailing { read, left: 1 })
        );
    }
    for bytes in server_messages().iter().map(ServerMessage::encode) {
        for end in 0..bytes.len() {
            assert!(
                ServerMessage::decode(&bytes[..end]).is_err(),
                "{:x?}",
                &bytes[..end]
            );
        }
        let longer = [bytes.as_slice(), &[0]].concat();
        let read = bytes.len();
        assert_eq!(
            ServerMessage::decode(&longer),
            Err(WireError::Trailing { read, left: 1 })
        );
    }
}

/// A tag, whatever stands before the count, and the count `2^60`.
fn forged(before: &[u8]) -> Vec<u8> {
    [before, &[0xfd, 0, 0, 0, 0, 0, 0, 0, 0x10]].concat()
}

fn is_limit<T: std::fmt::Debug>(result: Result<T, WireError>) -> bool {
    matches!(&result, Err(WireError::Malformed { why, .. }) if why.contains("LimitExceeded"))
}

#[test]
fn a_forged_count_is_refused_by_the_limit_before_memory_is_taken() {
    // Lists of Want, Cancel, Have, Evict; dataset name, token, error text.
    let lists: [&[u8]; 7] = [
        &[2],
        &[3],
        &[5],
        &[6],
        &[0, 1, 1, 0, 1],
        &[0, 1, 1, 0, 1, 0, 0, 1],
        &[8, 0],
    ];
    for before in lists {
        assert!(
            is_limit(ClientMessage::decode(&forged(before))),
            "{before:?}"
        );
    }
    // Manifests, list of chunks, a chunk's bytes, error text, stale pages.
    let lists: [&[u8]; 6] = [
        &[0, 1, 0],
        &[3, 0],
        &[1],
        &[1, 1, 0, 0, 0, 0, 0, 0],
        &[6, 0],
        &[7],
    ];
    for before in lists {
        assert!(
            is_limit(ServerMessage::decode(&forged(before))),
            "{before:?}"
        );
    }
}

#[test]
fn the_longest_lists_pass_and_one_entry_more_does_not() {
    let want = Want {
        page: u64::MAX,
        first_part: 0,
        last_part: 0,
        class: Class::Ring,
        priority: 0.0,
    };
    let have = Have {
        page: u64::MAX,
        revision: u32::MAX,
        parts: 0,
    };
    let of = |n: usize| {
        [
            ClientMessage::Want(vec![want; n]),
            ClientMessage::Have(vec![have; n]),
            ClientMessage::Cancel(vec![u64::MAX; n]),
            ClientMessage::Evict(vec![u64::MAX; n]),
        ]
    };
    for message in of(MAX_LIST) {
        assert_eq!(ClientMessage::decode(&message.encode()), Ok(message));
    }
    for message in of(MAX_LIST + 1) {
        let error = ClientMessage::decode(&message.encode()).unwrap_err();
        assert!(
            matches!(error, WireError::TooMany { found: 2049, .. }),
            "{error}"
        );
        assert_eq!(error.code(), ErrorCode::Limit);
    }
}

#[test]
fn the_longest_manifest_text_and_record_pass_and_one_byte_more_does_not() {
    let of = |more: usize| {
        let limits = SessionLimits {
            wanted_pages: u32::MAX,
            views_per_second: u32::MAX,
            held_pages: u32::MAX,
        };
        [
            ServerMessage::Welcome(Welcome {
                version: 1,
                capabilities: 0,
                manifest: vec![b' '; MAX_MANIFEST_BYTES + more],
                limits,
            }),
            ServerMessage::Pages(vec![Chunk {
                page: 0,
                revision: 0,
                first_part: 0,
                last_part: 0,
                bytes: vec![0; MAX_RECORD_BYTES + more],
            }]),
            ServerMessage::Error(PeerError {
                code: ErrorCode::Limit,
                text: "x".repeat(MAX_TEXT + more),
            }),
        ]
    };
    for message in of(0) {
        assert_eq!(ServerMessage::decode(&message.encode()), Ok(message));
    }
    for message in of(1) {
        let error = ServerMessage::decode(&message.encode()).unwrap_err();
        assert!(matches!(error, WireError::TooMany { .. }), "{error}");
    }
}

#[test]
fn a_message_longer_than_allowed_is_not_looked_at() {
    let client = vec![7; MAX_CLIENT_MESSAGE + 1];
    assert!(matches!(
        ClientMessage::decode(&client),
        Err(WireError::TooLong { .. })
    ));
    let server = vec![5; MAX_SERVER_MESSAGE + 1];
    assert!(matches!(
        ServerMessage::decode(&server),
        Err(WireError::TooLong { .. })
    ));
}

#[test]
fn an_error_text_is_cut_between_characters() {
    let error = PeerError::new(ErrorCode::Limit, "é".repeat(MAX_TEXT));
    assert_eq!(error.text.len(), MAX_TEXT);
    let error = PeerError::new(ErrorCode::Limit, format!("x{}", "é".repeat(MAX_TEXT)));
    assert_eq!(error.text.len(), MAX_TEXT - 1);
}

proptest! {
    #[test]
    fn any_bytes_decode_or_are_refused_and_what_decodes_comes_back(bytes in vec(any::<u8>(), 0..200)) {
        // Compared as bytes: a NaN does not equal itself.
        if let Ok(message) = ClientMessage::decode(&bytes) {
            let encoded = message.encode();
            prop_assert!(encoded.len() <= bytes.len());
            prop_assert_eq!(ClientMessage::decode(&encoded).unwrap().encode(), encoded);
        }
        if let Ok(message) = ServerMessage::decode(&bytes) {
            let encoded = message.encode();
            prop_assert!(encoded.len() <= bytes.len());
            prop_assert_eq!(ServerMessage::decode(&encoded).unwrap().encode(), encoded);
        }
    }

    #[test]
    fn a_message_with_a_changed_byte_does_no_harm(
        kind: prop::sample::Index,
        place: prop::sample::Index,
        value: u8,
    ) {
        let mut bytes = kind.get(&client_messages()).encode();
        let at = place.index(bytes.len());
        bytes[at] = value;
        let _ = ClientMessage::decode(&bytes);
        let mut bytes = kind.get(&server_messages()).encode();
        let at = place.index(bytes.len());
        bytes[at] = value;
        let _ = ServerMessage::decode(&bytes);
    }

    #[test]
    fn lists_come_back(
        wants in vec((any::<u64>(), any::<u8>(), any::<u8>(), -1e30f32..1e30), 0..50),
        keys in vec(any::<u64>(), 0..50),
        haves in vec((any::<u64>(), any::<u32>(), any::<u8>()), 0..50),
        chunks in vec((any::<u64>(), any::<u32>(), 0..16u8, vec(any::<u8>(), 0..300)), 0..9),
    ) {
        let wants = wants.into_iter().map(|(page, first_part, last_part, priority)| Want {
            page, first_part, last_part, class: Class::Predicted, priority,
        });
        let haves = haves.into_iter().map(|(page, revision, parts)| Have { page, revision, parts });
        let chunks = chunks.into_iter().map(|(page, revision, first_part, bytes)| Chunk {
            page, revision, first_part, last_part: 9, bytes,
        });
        let client = [
            ClientMessage::Want(wants.collect()),
            ClientMessage::Have(haves.collect()),
            ClientMessage::Cancel(keys.clone()),
            ClientMessage::Evict(keys),
        ];
        for message in client {
            prop_assert_eq!(ClientMessage::decode(&message.encode()), Ok(message));
        }
        let pages = ServerMessage::Pages(chunks.collect());
        prop_assert_eq!(ServerMessage::decode(&pages.encode()), Ok(pages));
    }
}
