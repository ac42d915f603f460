//! What went wrong with a connection, in sentences for people.

use super::Url;
use std::io::{Error as IoError, ErrorKind};
use std::time::Duration;
use tokio_tungstenite::tungstenite::error::{CapacityError, ProtocolError};
use tokio_tungstenite::tungstenite::protocol::CloseFrame;
use tokio_tungstenite::tungstenite::{Error, http::StatusCode};

/// A text message; Escarp's are binary.
pub(super) const TEXT: &str = "no Escarp server: it sent a text message";

/// No TCP connection.
pub(super) fn no_connection(url: &Url, error: &IoError) -> String {
    let at = url.authority();
    match error.kind() {
        ErrorKind::ConnectionRefused => {
            format!("no server listens at {at} ({error}): is escarp-server running there?")
        }
        _ if error.raw_os_error().is_none() => {
            format!("the host \"{}\" is not found: {error}", url.host())
        }
        _ => format!("no connection to {at}: {error}"),
    }
}

/// Nothing came in time.
pub(super) fn no_answer(url: &Url, waited: Duration) -> String {
    format!("no answer from {} within {waited:?}", url.authority())
}

/// Connected, but no WebSocket came about.
pub(super) fn no_session(url: &Url, error: &Error) -> String {
    let at = url.authority();
    match error {
        Error::Http(response) if response.status() == StatusCode::NOT_FOUND => {
            format!("no Escarp server at {at}: it has no /session (HTTP 404 Not Found)")
        }
        Error::Http(response) if response.status().is_success() => {
            let status = response.status();
            format!("no Escarp server at {at}: it answers as a plain web server (HTTP {status})")
        }
        Error::Http(response) => {
            format!(
                "the server at {at} refuses the session: HTTP {}",
                response.status()
            )
        }
        Error::Io(error) => format!("{at} closed the connection before a session began: {error}"),
        Error::Protocol(ProtocolError::HandshakeIncomplete) => {
            format!("{at} closed the connection before a session began")
        }
        error => format!("no Escarp server at {at}: it does not speak WebSocket ({error})"),
    }
}

/// The session ended with an error.
pub(super) fn lost(error: &Error) -> String {
    match error {
        Error::ConnectionClosed | Error::AlreadyClosed => closed(None),
        Error::Io(error) => format!("the connection was lost: {error}"),
        Error::Protocol(ProtocolError::ResetWithoutClosingHandshake) => {
            "the connection was lost: the server is gone".into()
        }
        Error::Capacity(CapacityError::MessageTooLong { size, max_size }) => {
            format!("the server sent a message of {size} bytes, allowed are {max_size}")
        }
        error => format!("the connection broke: {error}"),
    }
}

/// The server ended the session.
pub(super) fn closed(frame: Option<CloseFrame>) -> String {
    match frame {
        Some(frame) if !frame.reason.is_empty() => {
            format!("the server closed the connection: {}", frame.reason)
        }
        _ => "the server closed the connection".into(),
    }
}
