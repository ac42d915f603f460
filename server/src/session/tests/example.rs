//! The session that the specification shows, held against what the server does.

use super::*;
use crate::source::{GenerationId, Pack, Revised, SourceError};
use escarp_proto::manifest::Manifest;
use escarp_proto::page::{Codec, PAGE_AREA, Page, Record, revision};

const SPECIFICATION: &str = include_str!("../../../../proto/PROTOCOL.md");

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Client,
    Server,
}

/// The messages in the specification's hex blocks.
fn messages() -> Vec<(Side, Vec<u8>)> {
    let mut blocks = SPECIFICATION.split("```hex ").skip(1);
    let block = |text: &str| {
        let (text, _) = text.split_once("```").unwrap();
        let (side, lines) = text.split_once('\n').unwrap();
        let side = match side {
            "client" => Side::Client,
            "server" => Side::Server,
            other => panic!("a block of {other:?}"),
        };
        (side, lines.lines().flat_map(line).collect())
    };
    blocks.by_ref().map(block).collect()
}

fn line(line: &str) -> Vec<u8> {
    if let Some(text) = line.strip_prefix('|') {
        return text.as_bytes().to_vec();
    }
    let hex = line.split(';').next().unwrap_or_default();
    hex.split_whitespace()
        .map(|byte| u8::from_str_radix(byte, 16).unwrap())
        .collect()
}

/// The dataset of the example: a ramp in one page.
struct Ramp {
    json: Vec<u8>,
    manifest: Manifest,
    record: Record,
}

impl Ramp {
    fn new(json: Vec<u8>) -> Ramp {
        let height = |i: usize| Some((i % 17 + 2 * (i / 17)) as i32);
        let samples: [Option<i32>; PAGE_AREA] = std::array::from_fn(height);
        Ramp {
            manifest: Manifest::from_json(&json).unwrap(),
            json,
            record: Record::encode(
                &Page::new(PageId::ROOT, &samples, None).unwrap(),
                Codec::Plain,
            ),
        }
    }
}

impl PageSource for Ramp {
    fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    fn manifest_json(&self) -> &[u8] {
        &self.json
    }

    fn generation_id(&self) -> GenerationId {
        GenerationId::of(&self.manifest, &self.json)
    }

    fn record(&self, page: PageId) -> Result<Option<Revised>, SourceError> {
        let record = self.record.bytes();
        Ok((page == PageId::ROOT).then(|| Revised {
            revision: revision(page, record),
            bytes: record.to_vec().into(),
        }))
    }

    fn pack(&self, _: PageId) -> Result<Option<Pack>, SourceError> {
        Ok(None)
    }
}

fn example_peer(messages: &[(Side, Vec<u8>)]) -> Peer {
    let manifest = messages
        .iter()
        .find_map(|(side, bytes)| match (side, bytes) {
            (Side::Server, bytes) => match ServerMessage::decode(bytes) {
                Ok(ServerMessage::Welcome(welcome)) => Some(welcome.manifest),
                _ => None,
            },
            _ => None,
        });
    let catalog = Catalog::default();
    catalog
        .add("ramp", Arc::new(Ramp::new(manifest.unwrap())))
        .unwrap();
    Peer::of(catalog, Limits::default())
}

fn hex(messages: &[Vec<u8>]) -> String {
    let lines = messages.iter().map(|bytes| format!("{bytes:02x?}"));
    lines.collect::<Vec<_>>().join("\n")
}

#[test]
fn the_session_in_the_specification_is_what_the_server_does() {
    let messages = messages();
    let mut peer = example_peer(&messages);
    let mut rest = messages.as_slice();
    while !rest.is_empty() {
        let said = rest
            .iter()
            .take_while(|(side, _)| *side == Side::Client)
            .count();
        let heard = rest[said..]
            .iter()
            .take_while(|(side, _)| *side == Side::Server)
            .count();
        for (_, bytes) in &rest[..said] {
            assert_eq!(ClientMessage::decode(bytes).unwrap().encode(), *bytes);
            peer.session.handle_message(bytes, peer.now);
        }
        let mut answers: Vec<_> = std::iter::from_fn(|| peer.session.poll_message()).collect();
        if said + heard == rest.len() {
            peer.session
                .close(ErrorCode::ShuttingDown, "the server is going down");
            answers.extend(peer.session.poll_message());
        }
        let shown = rest[said..said + heard]
            .iter()
            .map(|(_, bytes)| bytes.clone());
        let shown: Vec<_> = shown.collect();
        assert_eq!(
            shown,
            answers,
            "shown:\n{}\nsent:\n{}",
            hex(&shown),
            hex(&answers)
        );
        rest = &rest[said + heard..];
    }
}

#[test]
fn the_specification_shows_a_message_of_nearly_every_kind() {
    let kinds = |side| {
        let of_side = messages()
            .into_iter()
            .filter(move |message| message.0 == side);
        let mut kinds: Vec<u8> = of_side.map(|(_, bytes)| bytes[0]).collect();
        kinds.sort_unstable();
        kinds.dedup();
        kinds
    };
    // All but the client's Error, which has the server's bytes, and GenChange.
    assert_eq!(kinds(Side::Client), [0, 1, 2, 3, 4, 5, 6, 7]);
    assert_eq!(kinds(Side::Server), [0, 1, 2, 4, 5, 6, 7]);
}
