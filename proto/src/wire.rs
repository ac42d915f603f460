//! The messages of the protocol, and their one place of encoding. `proto/PROTOCOL.md` is the
//! specification: byte map, order, limits, and an example.
//!
//! Encoding is bincode with a byte limit. Decoding is safe on untrusted input: what a count
//! claims is held against the limit before memory is taken, nothing recurses, and bytes left over
//! are an error.

mod lists;

use crate::geometry::PageId;
use crate::manifest::MAX_MANIFEST_BYTES;
use crate::page::MAX_RECORD_BYTES;
use crate::view::View;
use bincode::{Decode, Encode};
use lists::{to_differences, to_keys};
use thiserror::Error;

/// The protocol's version.
pub const PROTOCOL: u16 = 2;
/// No message of a client is longer, bytes.
pub const MAX_CLIENT_MESSAGE: usize = 64 << 10;
/// No message of a server is longer, bytes: Welcome carries the manifest.
pub const MAX_SERVER_MESSAGE: usize = MAX_MANIFEST_BYTES + (64 << 10);
/// A frame of [`ServerMessage::Pages`] is filled up to this, bytes.
pub const PAGES_FRAME: usize = 16 << 10;
/// Longest name of a dataset, token, and text of an error, bytes of UTF-8.
pub const MAX_TEXT: usize = 1024;
/// No list in a client's message has more entries.
pub const MAX_LIST: usize = 2048;

// The byte limit counts a list's entries as they lie in memory: a full list must pass it.
const _: () = assert!(MAX_LIST * size_of::<Want>() + 16 <= MAX_CLIENT_MESSAGE);
const _: () = assert!(MAX_LIST * size_of::<Have>() + 16 <= MAX_CLIENT_MESSAGE);

/// The field of the query of a session's address that carries its first messages, so that they
/// need not wait for the handshake.
pub const EARLY_FIELD: &str = "early";
/// The header of the handshake's answer that says how many of them were taken.
pub const EARLY_HEADER: &str = "escarp-early";
/// They take no more, each with 2 bytes for its length: addresses and headers are limited.
pub const EARLY_BYTES: usize = 6 << 10;

/// First messages as one value, to be written as base64url without padding: each after its length,
/// 2 bytes, little-endian. `None` if they are too long.
pub fn early_value(messages: &[Vec<u8>]) -> Option<Vec<u8>> {
    let mut value = Vec::new();
    for message in messages {
        value.extend(u16::try_from(message.len()).ok()?.to_le_bytes());
        value.extend(message);
    }
    (value.len() <= EARLY_BYTES).then_some(value)
}

/// Optional abilities, as bits of Hello and Welcome. Of both sides' bits, those count that both set.
pub mod capability {
    /// The server sends what a View needs unasked.
    pub const PUSH: u64 = 1;
    /// All that this version defines.
    pub const KNOWN: u64 = PUSH;
}

/// What a client says. As bytes, by [`encode`](Self::encode) and [`decode`](Self::decode) only.
#[derive(Debug, Clone, PartialEq, Encode, Decode)]
pub enum ClientMessage {
    /// The first message, once.
    Hello(Hello),
    /// What is looked at now. A newer one replaces it.
    View {
        /// Grows from 1 on, so that Idle can name the view that it answers.
        sequence: u32,
        /// The view.
        view: View,
        /// What of the terrain is of use.
        scope: Scope,
    },
    /// Parts of pages that Update() reached. A page wanted again replaces the older wish.
    Want(Vec<Want>),
    /// Pages that are no longer wanted, by key.
    Cancel(Vec<u64>),
    /// Bytes of Pages payload that the server may have sent in all, counted from the start.
    Credit {
        /// The count; it never falls.
        total_bytes: u64,
    },
    /// Pages that the client has, with the parts it has of each.
    Have(Vec<Have>),
    /// Pages that the client no longer has, by key.
    Evict(Vec<u64>),
    /// Answered by Pong with the same number.
    Ping(u64),
    /// Why the client leaves.
    Error(PeerError),
}

/// What a server says. As bytes, by [`encode`](Self::encode) and [`decode`](Self::decode) only.
#[derive(Debug, Clone, PartialEq, Encode, Decode)]
pub enum ServerMessage {
    /// Answers Hello.
    Welcome(Welcome),
    /// Parts of pages, as they lie on disk.
    Pages(Vec<Chunk>),
    /// A page that was wanted and does not come.
    Miss(Miss),
    /// The data has a new generation. All that follows is of it, and the server has forgotten what
    /// the client has, wants and looks at.
    GenChange {
        /// The new generation.
        generation: u64,
        /// Its manifest, JSON.
        manifest: Vec<u8>,
    },
    /// Nothing is queued or in flight.
    Idle {
        /// The newest View looked at when the queue ran empty; 0 if none.
        view_sequence: u32,
    },
    /// Answers Ping.
    Pong(u64),
    /// Why the server ends the session.
    Error(PeerError),
    /// Answers Have: those of its pages, by key, that are not of that revision any more.
    Stale(Vec<u64>),
}

/// What of the terrain a client can use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Encode, Decode)]
pub enum Scope {
    /// All around the eye: its mesh keeps the tolerance out of view, too.
    #[default]
    All,
    /// What may be in view.
    InView,
}

/// Opens a session.
#[derive(Debug, Clone, PartialEq, Eq, Encode, Decode)]
pub struct Hello {
    /// Lowest protocol version understood.
    pub oldest: u16,
    /// Highest protocol version understood.
    pub newest: u16,
    /// Bits of [`capability`]; unknown ones are ignored.
    pub capabilities: u64,
    /// Bit `n` is set if codec `n` is understood.
    pub codecs: u32,
    /// Name of the dataset.
    pub dataset: String,
    /// First credit, as in [`ClientMessage::Credit`].
    pub credit_bytes: u64,
    /// Proof of access, if the server asks for one.
    pub token: Option<String>,
}

/// Accepts a session.
#[derive(Debug, Clone, PartialEq, Encode, Decode)]
pub struct Welcome {
    /// The version spoken from here on.
    pub version: u16,
    /// Bits of [`capability`] that both sides have.
    pub capabilities: u64,
    /// The manifest, JSON.
    pub manifest: Vec<u8>,
    /// What the server allows.
    pub limits: SessionLimits,
}

/// What a server allows in one session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Encode, Decode)]
pub struct SessionLimits {
    /// Pages that may be wanted at a time. More are answered by Miss.
    pub wanted_pages: u32,
    /// Views a second. More are dropped, newest kept.
    pub views_per_second: u32,
    /// Pages of the client's that the server remembers. It pushes no more than it can remember.
    pub held_pages: u32,
}

/// How urgent a page is. Classes go in this order, whatever the priority.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Encode, Decode)]
pub enum Class {
    /// Something in view that is resident waits for it.
    Blocker,
    /// In view.
    InView,
    /// Will be in view, by the velocity.
    Predicted,
    /// Around, but not in view.
    Ring,
}

/// Parts of a page that are wanted.
#[derive(Debug, Clone, Copy, PartialEq, Encode, Decode)]
pub struct Want {
    /// [`PageId::key`].
    pub page: u64,
    /// First part: 0 if the client has none of the page, else one more than it has.
    pub first_part: u8,
    /// Last part.
    pub last_part: u8,
    /// Its class.
    pub class: Class,
    /// Largest screen error that it would mend, in units of the tolerance; larger goes first.
    pub priority: f32,
}

/// A page that the client has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Have {
    /// [`PageId::key`].
    pub page: u64,
    /// Its revision.
    pub revision: u32,
    /// Parts it has, from the first.
    pub parts: u8,
}

/// Parts of one page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Chunk {
    /// [`PageId::key`].
    pub page: u64,
    /// Changes when the page's record does; parts of different revisions MUST NOT be joined.
    pub revision: u32,
    /// First part; 0 is the header. Above 15, which no part is, goes as 15.
    pub first_part: u8,
    /// Last part, likewise.
    pub last_part: u8,
    /// The parts, one after the other.
    pub bytes: Vec<u8>,
}

/// A wish that is not granted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Encode, Decode)]
pub struct Miss {
    /// [`PageId::key`].
    pub page: u64,
    /// Why.
    pub reason: MissReason,
}

/// Why a wish is not granted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Encode, Decode)]
pub enum MissReason {
    /// The dataset has no such page, or not these parts.
    NotFound,
    /// Its record is damaged on the server.
    Damaged,
    /// Too many pages are wanted; ask again later.
    Busy,
}

/// Why a peer ends the session.
#[derive(Debug, Clone, PartialEq, Eq, Encode, Decode)]
pub struct PeerError {
    /// For programs.
    pub code: ErrorCode,
    /// For people.
    pub text: String,
}

/// Why a peer ends the session, for programs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Encode, Decode)]
pub enum ErrorCode {
    /// No protocol version, or no codec, in common.
    Version,
    /// There is no dataset of this name.
    NoDataset,
    /// The message could not be decoded, or came out of order.
    Protocol,
    /// A limit was exceeded.
    Limit,
    /// Token missing or wrong.
    Denied,
    /// The server is going down; try again.
    ShuttingDown,
    /// Something failed on the peer's side.
    Internal,
}

/// Why a message was refused.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum WireError {
    /// It is longer than allowed.
    #[error("message of {found} bytes, allowed are {allowed}")]
    TooLong {
        /// Its length.
        found: usize,
        /// The limit.
        allowed: usize,
    },
    /// It could not be decoded.
    #[error("message of {bytes} bytes does not decode: {why}")]
    Malformed {
        /// Its length.
        bytes: usize,
        /// bincode's reason.
        why: String,
    },
    /// A list or text in it is longer than allowed.
    #[error("{field} of length {found}, allowed is {allowed}")]
    TooMany {
        /// What it is.
        field: &'static str,
        /// Entries, or bytes.
        found: usize,
        /// The limit.
        allowed: usize,
    },
    /// Bytes follow it.
    #[error("{left} bytes left over after a message of {read}")]
    Trailing {
        /// Bytes that belong to it.
        read: usize,
        /// Bytes that follow.
        left: usize,
    },
}

impl WireError {
    /// The code to answer with: [`ErrorCode::Limit`] for what is too long, else
    /// [`ErrorCode::Protocol`].
    pub const fn code(&self) -> ErrorCode {
        match self {
            WireError::TooLong { .. } | WireError::TooMany { .. } => ErrorCode::Limit,
            WireError::Malformed { .. } | WireError::Trailing { .. } => ErrorCode::Protocol,
        }
    }
}

impl PeerError {
    /// An error whose text is cut to [`MAX_TEXT`] bytes.
    pub fn new(code: ErrorCode, text: impl Into<String>) -> PeerError {
        let mut text = text.into();
        text.truncate(text.floor_char_boundary(MAX_TEXT));
        PeerError { code, text }
    }
}

impl ClientMessage {
    /// The message as bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut message = self.clone();
        match &mut message {
            ClientMessage::Want(list) => to_differences(list),
            ClientMessage::Have(list) => to_differences(list),
            ClientMessage::Cancel(list) | ClientMessage::Evict(list) => to_differences(list),
            _ => {}
        }
        encode(&message)
    }

    /// Safe on untrusted input.
    ///
    /// # Errors
    /// [`WireError`] if the bytes are not exactly one message within the limits of this module.
    pub fn decode(bytes: &[u8]) -> Result<Self, WireError> {
        let mut message = decode::<Self, MAX_CLIENT_MESSAGE>(bytes)?;
        match &mut message {
            ClientMessage::Hello(hello) => {
                at_most("dataset name", hello.dataset.len(), MAX_TEXT)?;
                at_most(
                    "token",
                    hello.token.as_ref().map_or(0, String::len),
                    MAX_TEXT,
                )?;
            }
            ClientMessage::Want(list) => pages("Want list", list)?,
            ClientMessage::Have(list) => pages("Have list", list)?,
            ClientMessage::Cancel(list) => pages("Cancel list", list)?,
            ClientMessage::Evict(list) => pages("Evict list", list)?,
            ClientMessage::Error(error) => at_most("error text", error.text.len(), MAX_TEXT)?,
            ClientMessage::View { .. } | ClientMessage::Credit { .. } | ClientMessage::Ping(_) => {}
        }
        Ok(message)
    }
}

impl ServerMessage {
    /// The message as bytes.
    pub fn encode(&self) -> Vec<u8> {
        self.clone().into_bytes()
    }

    /// As [`encode`](Self::encode), without a copy of what is in it.
    pub fn into_bytes(mut self) -> Vec<u8> {
        match &mut self {
            ServerMessage::Pages(list) => to_differences(list),
            ServerMessage::Stale(list) => to_differences(list),
            _ => {}
        }
        encode(&self)
    }

    /// Safe on untrusted input.
    ///
    /// # Errors
    /// [`WireError`] if the bytes are not exactly one message within the limits of this module.
    pub fn decode(bytes: &[u8]) -> Result<Self, WireError> {
        let mut message = decode::<Self, MAX_SERVER_MESSAGE>(bytes)?;
        match &mut message {
            ServerMessage::Welcome(Welcome { manifest, .. })
            | ServerMessage::GenChange { manifest, .. } => {
                at_most("manifest", manifest.len(), MAX_MANIFEST_BYTES)?;
            }
            ServerMessage::Stale(list) => pages("Stale list", list)?,
            ServerMessage::Pages(chunks) => {
                let longest = chunks.iter().map(|chunk| chunk.bytes.len()).max();
                at_most("chunk", longest.unwrap_or(0), MAX_RECORD_BYTES)?;
                to_keys(chunks);
            }
            ServerMessage::Error(error) => at_most("error text", error.text.len(), MAX_TEXT)?,
            _ => {}
        }
        Ok(message)
    }
}

/// Takes a list that was decoded for what it stands for, unless it is too long.
fn pages(field: &'static str, list: &mut [impl lists::Entry]) -> Result<(), WireError> {
    at_most(field, list.len(), MAX_LIST)?;
    to_keys(list);
    Ok(())
}

fn at_most(field: &'static str, found: usize, allowed: usize) -> Result<(), WireError> {
    if found <= allowed {
        return Ok(());
    }
    Err(WireError::TooMany {
        field,
        found,
        allowed,
    })
}

impl Want {
    /// The page, if the key names one.
    pub fn page_id(&self) -> Option<PageId> {
        PageId::from_key(self.page)
    }
}

fn encode(message: &impl Encode) -> Vec<u8> {
    // Encoding into a Vec fails only for types that refuse to be encoded; ours do not.
    bincode::encode_to_vec(message, bincode::config::standard()).unwrap_or_default()
}

fn decode<M: Decode<()>, const LIMIT: usize>(bytes: &[u8]) -> Result<M, WireError> {
    if bytes.len() > LIMIT {
        return Err(WireError::TooLong {
            found: bytes.len(),
            allowed: LIMIT,
        });
    }
    let config = bincode::config::standard().with_limit::<LIMIT>();
    let (message, read) =
        bincode::decode_from_slice(bytes, config).map_err(|error| WireError::Malformed {
            bytes: bytes.len(),
            why: error.to_string(),
        })?;
    match bytes.len() - read {
        0 => Ok(message),
        left => Err(WireError::Trailing { read, left }),
    }
}

#[cfg(test)]
mod tests;
