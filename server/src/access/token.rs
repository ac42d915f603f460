//! Bearer tokens, kept and compared as hashes, in time that does not depend on them.

use ring::digest::{SHA256, SHA256_OUTPUT_LEN, digest};
use std::fmt;
use subtle::ConstantTimeEq;
use thiserror::Error;

/// Fewer characters can be guessed.
const MIN_CHARACTERS: usize = 16;
/// Longest token, as the protocol has it.
const MAX_BYTES: usize = escarp_proto::wire::MAX_TEXT;
/// Before the hash of a token, where the token itself shall not be written down.
const HASHED: &str = "sha256:";

/// The SHA-256 of a token. The token itself is not kept.
#[derive(Clone, PartialEq, Eq)]
pub struct Token([u8; SHA256_OUTPUT_LEN]);

/// Why a text cannot be a token. It does not say which text.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum TokenError {
    /// Too short or too long.
    #[error("a token of {0} bytes; allowed are {MIN_CHARACTERS} to {MAX_BYTES}")]
    Length(usize),
    /// Blanks, control characters, or beyond ASCII.
    #[error("a token with {0:?}; allowed are visible ASCII characters")]
    Character(char),
    /// After `sha256:`.
    #[error(
        "`{HASHED}` must be followed by 64 hexadecimal digits; as `printf %s TOKEN | sha256sum` prints them"
    )]
    Hash,
}

impl Token {
    /// The hash of what a client gave.
    pub fn of(given: &str) -> Token {
        let hash = digest(&SHA256, given.as_bytes());
        let mut bytes = [0; SHA256_OUTPUT_LEN];
        bytes.copy_from_slice(hash.as_ref());
        Token(bytes)
    }

    /// From a configuration: the token itself, or `sha256:` and the hash of it in hexadecimal.
    ///
    /// # Errors
    /// [`TokenError`] if it is neither.
    pub fn configured(text: &str) -> Result<Token, TokenError> {
        if let Some(hash) = text.strip_prefix(HASHED) {
            return from_hex(hash).map(Token).ok_or(TokenError::Hash);
        }
        match text.chars().find(|c| !c.is_ascii_graphic()) {
            Some(c) => Err(TokenError::Character(c)),
            None if !(MIN_CHARACTERS..=MAX_BYTES).contains(&text.len()) => {
                Err(TokenError::Length(text.len()))
            }
            None => Ok(Token::of(text)),
        }
    }

    /// From a file: one a line, as [`configured`](Self::configured); empty lines, and those that
    /// start with `#`, do not count.
    ///
    /// # Errors
    /// The number of the wrong line, from 1, and what is wrong.
    pub fn listed(text: &str) -> Result<Vec<Token>, (usize, TokenError)> {
        let lines = text.lines().map(str::trim).enumerate();
        lines
            .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
            .map(|(at, line)| Token::configured(line).map_err(|error| (at + 1, error)))
            .collect()
    }
}

/// Nothing of it can end in a log.
impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token")
    }
}

/// Whether a token is one of others. Takes the same time wherever it is, or is not.
pub(super) fn is_among<'a>(given: &Token, known: impl Iterator<Item = &'a Token>) -> bool {
    let found = known.fold(subtle::Choice::from(0), |found, token| {
        found | token.0.ct_eq(&given.0)
    });
    found.into()
}

fn from_hex(text: &str) -> Option<[u8; SHA256_OUTPUT_LEN]> {
    let digits: Vec<u32> = text
        .chars()
        .map(|c| c.to_digit(16))
        .collect::<Option<_>>()?;
    let bytes: Vec<u8> = digits
        .chunks(2)
        .map(|pair| pair.iter().fold(0, |byte, digit| byte << 4 | *digit as u8))
        .collect();
    (digits.len() == 2 * SHA256_OUTPUT_LEN).then(|| bytes.try_into().ok())?
}
