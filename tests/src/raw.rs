//! A WebSocket by hand: frames that no library would send, and reading that no library would do.

use crate::host::PATIENCE;
use escarp_proto::page::Codec;
use escarp_proto::wire::{ClientMessage, Hello, PROTOCOL, ServerMessage};
use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};

/// Opcodes of RFC 6455, section 5.2.
pub mod opcode {
    /// Goes on with a message.
    pub const CONTINUATION: u8 = 0;
    /// Begins a text.
    pub const TEXT: u8 = 1;
    /// Begins a binary message.
    pub const BINARY: u8 = 2;
    /// Ends the connection.
    pub const CLOSE: u8 = 8;
    /// Asks for a pong.
    pub const PING: u8 = 9;
}

/// Bit of the first byte: the message ends with this frame.
pub const FINAL: u8 = 0x80;
/// Bit of the first byte that an extension for compression would use.
pub const COMPRESSED: u8 = 0x40;

/// A connection on which a WebSocket was agreed.
#[derive(Debug)]
pub struct RawSocket(pub TcpStream);

/// A Hello for the dataset `moon`, with this first credit.
pub fn hello(credit_bytes: u64) -> ClientMessage {
    ClientMessage::Hello(Hello {
        oldest: PROTOCOL,
        newest: PROTOCOL,
        capabilities: 0,
        codecs: Codec::KNOWN,
        dataset: "moon".into(),
        credit_bytes,
        token: None,
    })
}

/// A masked frame: its first byte, and the payload.
pub fn frame(first: u8, payload: &[u8]) -> Vec<u8> {
    let mut bytes = head(first, 0x80, payload.len() as u64);
    let mask = [7, 77, 177, 27];
    bytes.extend(mask);
    bytes.extend(payload.iter().zip(mask.iter().cycle()).map(|(a, b)| a ^ b));
    bytes
}

/// The head of a frame, up to its length; `masked` is 0x80 or 0.
pub fn head(first: u8, masked: u8, length: u64) -> Vec<u8> {
    let mut bytes = vec![first];
    match length {
        0..126 => bytes.push(masked | length as u8),
        126..0x1_0000 => {
            bytes.push(masked | 126);
            bytes.extend((length as u16).to_be_bytes());
        }
        _ => {
            bytes.push(masked | 127);
            bytes.extend(length.to_be_bytes());
        }
    }
    bytes
}

/// A message in one frame.
pub fn message(message: &ClientMessage) -> Vec<u8> {
    frame(FINAL | opcode::BINARY, &message.encode())
}

impl RawSocket {
    /// Connects, and agrees on a WebSocket.
    ///
    /// # Errors
    /// If that fails; what was answered other than 101 is an error of kind `Other`.
    pub fn open(address: SocketAddr) -> io::Result<RawSocket> {
        let stream = TcpStream::connect(address)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        stream.set_write_timeout(Some(PATIENCE))?;
        stream.set_nodelay(true)?;
        let mut socket = RawSocket(stream);
        let request = format!(
            "GET /session HTTP/1.1\r\nHost: {address}\r\nConnection: Upgrade\r\n\
             Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
             Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        );
        socket.0.write_all(request.as_bytes())?;
        let mut answer = Vec::new();
        while !answer.ends_with(b"\r\n\r\n") {
            let mut byte = [0];
            socket.0.read_exact(&mut byte)?;
            answer.extend(byte);
        }
        match answer.starts_with(b"HTTP/1.1 101") {
            true => Ok(socket),
            false => Err(io::Error::other(
                String::from_utf8_lossy(&answer).into_owned(),
            )),
        }
    }

    /// Sends bytes as they are.
    ///
    /// # Errors
    /// If the server no longer takes them.
    pub fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.write_all(bytes)
    }

    /// The next frame of the server: its first byte and its payload; `None` if the connection
    /// has ended.
    ///
    /// # Panics
    /// If nothing comes for too long.
    pub fn receive(&mut self) -> Option<(u8, Vec<u8>)> {
        let mut start = [0; 2];
        self.read(&mut start)?;
        let length = match start[1] {
            126 => {
                let mut length = [0; 2];
                self.read(&mut length)?;
                u64::from(u16::from_be_bytes(length))
            }
            127 => {
                let mut length = [0; 8];
                self.read(&mut length)?;
                u64::from_be_bytes(length)
            }
            length => u64::from(length),
        };
        assert!(length < 4 << 20, "a frame of {length} bytes");
        let mut payload = vec![0; length as usize];
        self.read(&mut payload)?;
        Some((start[0], payload))
    }

    fn read(&mut self, bytes: &mut [u8]) -> Option<()> {
        match self.0.read_exact(bytes) {
            Ok(()) => Some(()),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                panic!("the server says nothing, and does not end the connection")
            }
            Err(_) => None,
        }
    }

    /// The next message of the protocol; `None` if the connection has ended, or ends.
    ///
    /// # Panics
    /// If it does not decode.
    pub fn message(&mut self) -> Option<ServerMessage> {
        loop {
            let (first, payload) = self.receive()?;
            match first & 0xf {
                opcode::BINARY => {
                    return Some(ServerMessage::decode(&payload).expect("a message"));
                }
                opcode::CLOSE => return None,
                _ => {}
            }
        }
    }

    /// Reads to the end of the connection: the status of its close frame, if there was one.
    pub fn end(&mut self) -> Option<u16> {
        let mut status = None;
        while let Some((first, payload)) = self.receive() {
            if first & 0xf == opcode::CLOSE
                && let Some(bytes) = payload.first_chunk()
            {
                status = Some(u16::from_be_bytes(*bytes));
            }
        }
        status
    }
}
