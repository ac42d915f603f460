//! The first messages of a session, in the address that opens it.
//!
//! A WebSocket may not carry anything before its handshake is answered (RFC 6455, section 4.1):
//! that is a round trip in which a client that knows what to say can only wait.

use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use escarp_proto::wire::{EARLY_BYTES, EARLY_FIELD};
use std::collections::VecDeque;

/// Messages that came before the connection stood.
pub(super) type Early = VecDeque<Vec<u8>>;

/// The messages in an address's query; none if it has no such field.
///
/// # Errors
/// What is wrong with them, and what is allowed.
pub(super) fn messages(query: Option<&str>) -> Result<Early, String> {
    let fields = query.unwrap_or_default().split('&');
    let mut values = fields.filter_map(|field| field.strip_prefix(EARLY_FIELD)?.strip_prefix('='));
    let Some(value) = values.next() else {
        return Ok(Early::new());
    };
    if value.len() > EARLY_BYTES * 4 / 3 + 3 {
        let found = value.len();
        return Err(format!(
            "`{EARLY_FIELD}` has {found} characters, allowed are messages of {EARLY_BYTES} bytes"
        ));
    }
    let bytes = URL_SAFE_NO_PAD
        .decode(value)
        .map_err(|error| format!("`{EARLY_FIELD}` is no base64url without padding: {error}"))?;
    split(&bytes).ok_or_else(|| format!("`{EARLY_FIELD}` ends within a message"))
}

/// Each message is preceded by its length, 2 bytes, little-endian.
fn split(mut bytes: &[u8]) -> Option<Early> {
    let mut messages = Early::new();
    while !bytes.is_empty() {
        let (length, rest) = bytes.split_first_chunk()?;
        let length = usize::from(u16::from_le_bytes(*length));
        let (message, rest) = rest.split_at_checked(length)?;
        messages.push_back(message.to_vec());
        bytes = rest;
    }
    Some(messages)
}

#[cfg(test)]
mod tests {
    use super::*;
    use escarp_proto::wire::early_value;

    #[test]
    fn messages_come_back_as_they_were_written() {
        let sent = vec![vec![1, 2, 3], Vec::new(), vec![0xff; 300]];
        let bytes = early_value(&sent).unwrap();
        let query = format!("a=b&{EARLY_FIELD}={}", URL_SAFE_NO_PAD.encode(bytes));
        assert_eq!(messages(Some(&query)).unwrap(), sent);
        assert_eq!(messages(Some("a=b")), Ok(Early::new()));
        assert_eq!(messages(None), Ok(Early::new()));
    }

    #[test]
    fn what_is_no_list_of_messages_is_refused_with_what_is_allowed() {
        let of = |bytes: &[u8]| format!("{EARLY_FIELD}={}", URL_SAFE_NO_PAD.encode(bytes));
        for (query, part) in [
            (format!("{EARLY_FIELD}=a+/="), "base64url"),
            (of(&[5]), "ends within"),
            (of(&[2, 0, 1]), "ends within"),
            (of(&vec![0; EARLY_BYTES + 300]), "allowed"),
        ] {
            let error = messages(Some(&query)).unwrap_err();
            assert!(error.contains(part), "{error}");
        }
    }
}
