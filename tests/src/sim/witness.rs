//! A witness of what is said in a session: nothing untrue, nothing twice.

use super::ground::Ground;
use crate::terrain::TempDataset;
use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;
use escarp_proto::page::{RecordHeader, last_part};
use escarp_proto::wire::{Chunk, ClientMessage, Have, PeerError, ServerMessage};
use escarp_server::Limits;
use std::collections::BTreeSet;

/// No dataset of the simulation has more pages.
const ALL_PAGES: usize = 1000;

/// What was said in a session.
pub struct Witness<'a> {
    ground: &'a Ground,
    /// Whether the server can remember all pages that there are.
    remembers_all: bool,
    /// The generation that the client was told of last.
    pub told: Option<&'a TempDataset>,
    /// The view that the last Idle answered, if nothing came since.
    pub idle: Option<u32>,
    /// GenChanges that the client has not answered: what it says until then is of before.
    changes: u32,
    /// Parts that the server knows to be with the client.
    held: BTreeSet<(u64, u8)>,
}

impl<'a> Witness<'a> {
    /// Of a session that begins.
    pub fn new(ground: &'a Ground, limits: &Limits) -> Witness<'a> {
        Witness {
            ground,
            remembers_all: limits.held_pages >= ALL_PAGES,
            told: None,
            idle: None,
            changes: 0,
            held: BTreeSet::new(),
        }
    }

    /// The server says something.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn server_says(&mut self, message: &[u8]) -> Result<(), String> {
        let message = ServerMessage::decode(message).map_err(|error| error.to_string())?;
        match message {
            ServerMessage::Welcome(welcome) => self.told = self.generation(&welcome.manifest)?,
            ServerMessage::GenChange { manifest, .. } => {
                self.told = self.generation(&manifest)?;
                self.held.clear();
                self.changes += 1;
                self.idle = None;
            }
            ServerMessage::Pages(chunks) => {
                self.idle = None;
                for chunk in &chunks {
                    self.send(chunk)?;
                }
            }
            ServerMessage::Miss(_) => self.idle = None,
            ServerMessage::Idle { view_sequence } => self.idle = Some(view_sequence),
            ServerMessage::Error(PeerError { code, text }) if !is_expected(&text) => {
                return Err(format!("the server ends it: {code:?}: {text}"));
            }
            ServerMessage::Error(_) | ServerMessage::Pong(_) | ServerMessage::Stale(_) => {}
        }
        Ok(())
    }

    fn generation(&self, json: &[u8]) -> Result<Option<&'a TempDataset>, String> {
        let manifest = Manifest::from_json(json)?;
        let found = self.ground.samples(&manifest);
        let none = || format!("a manifest of generation {}", manifest.generation);
        found.map(Some).ok_or_else(none)
    }

    fn send(&mut self, chunk: &Chunk) -> Result<(), String> {
        let name = || {
            format!(
                "page {} parts {}..={}",
                chunk.page, chunk.first_part, chunk.last_part
            )
        };
        if truth(self.told, chunk).as_ref() != Some(chunk) {
            return Err(format!("{} are not those of the generation", name()));
        }
        for part in chunk.first_part..=chunk.last_part {
            if !self.held.insert((chunk.page, part)) && self.remembers_all {
                return Err(format!("{} are sent though part {part} was there", name()));
            }
        }
        Ok(())
    }

    /// The server hears something.
    ///
    /// # Errors
    /// What a client may not say.
    pub fn client_says(&mut self, message: &[u8]) -> Result<(), String> {
        let message = ClientMessage::decode(message).map_err(|error| error.to_string())?;
        match message {
            ClientMessage::Have(haves) if haves.is_empty() => {
                self.changes = self.changes.saturating_sub(1);
            }
            ClientMessage::Have(_) | ClientMessage::Evict(_) if self.changes > 0 => {}
            ClientMessage::Have(haves) => {
                for have in haves {
                    self.have(have)?;
                }
            }
            ClientMessage::Evict(keys) => {
                self.held.retain(|(page, _)| !keys.contains(page));
            }
            ClientMessage::Error(error) => return Err(format!("the client leaves: {error:?}")),
            _ => {}
        }
        Ok(())
    }

    fn have(&mut self, have: Have) -> Result<(), String> {
        let Some((data, page)) = self.told.zip(PageId::from_key(have.page)) else {
            return Err(format!("{have:?} before Welcome, or of no page"));
        };
        let most = last_part(data.dataset.grid().is_finest(page));
        if have.parts > most {
            return Err(format!("{have:?}: page {page} has parts to {most}"));
        }
        let record = data
            .dataset
            .record(page)
            .map_err(|error| error.to_string())?;
        if record.is_some_and(|record| record.revision == have.revision) {
            self.held.retain(|(page, _)| *page != have.page);
            self.held
                .extend((0..=have.parts).map(|part| (have.page, part)));
        }
        Ok(())
    }
}

/// Errors by which a server may end these sessions.
fn is_expected(text: &str) -> bool {
    let reasons = ["going down", "nothing heard", "no Hello within"];
    reasons.iter().any(|reason| text.contains(reason))
}

/// The chunk as it should be.
fn truth(data: Option<&TempDataset>, chunk: &Chunk) -> Option<Chunk> {
    let (dataset, page) = (&data?.dataset, PageId::from_key(chunk.page)?);
    let record = dataset.record(page).ok()??;
    let header = RecordHeader::read(page, dataset.grid().is_finest(page), record.bytes).ok()?;
    let bytes = header.part_bytes(chunk.first_part, chunk.last_part)?;
    Some(Chunk {
        page: chunk.page,
        revision: record.revision,
        first_part: chunk.first_part,
        last_part: chunk.last_part,
        bytes: record.bytes[bytes].to_vec(),
    })
}
