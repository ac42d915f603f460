//! One keep-alive connection that asks for one address after the other, and counts every byte.

use anyhow::{Context, Result, bail, ensure};
use escarp_client::net::Url;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;

/// No body of this server is longer, bytes.
const MOST_BODY: u64 = 2 << 20;
/// Nor a line of its heads.
const MOST_LINE: u64 = 16 << 10;

/// What came back.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// The status.
    pub status: u16,
    /// The entity tag, without quotes; empty if there is none.
    pub tag: String,
    /// The body.
    pub body: Vec<u8>,
    /// Head and body, bytes.
    pub bytes: u64,
}

/// A connection, made when it is first needed.
#[derive(Debug)]
pub struct KeptAlive {
    host: String,
    port: u16,
    stream: Option<BufReader<TcpStream>>,
}

impl KeptAlive {
    /// To the server of an address.
    pub fn new(url: &Url) -> KeptAlive {
        KeptAlive {
            host: url.host().to_owned(),
            port: url.port(),
            stream: None,
        }
    }

    /// Asks for a path.
    ///
    /// # Errors
    /// If there is no connection, or no answer in HTTP/1.1 with a length.
    pub fn get(&mut self, path: &str) -> Result<Answer> {
        let mut stream = match self.stream.take() {
            Some(stream) => stream,
            None => {
                let stream = TcpStream::connect((self.host.as_str(), self.port))
                    .with_context(|| format!("connecting to {}:{}", self.host, self.port))?;
                stream.set_nodelay(true)?;
                BufReader::new(stream)
            }
        };
        let request = format!(
            "GET {path} HTTP/1.1\r\nHost: {}:{}\r\n\r\n",
            self.host, self.port
        );
        stream.get_mut().write_all(request.as_bytes())?;
        let answer = read_answer(&mut stream).with_context(|| format!("GET {path}"))?;
        self.stream = Some(stream);
        Ok(answer)
    }
}

fn read_answer(stream: &mut impl BufRead) -> Result<Answer> {
    let mut answer = Answer {
        status: 0,
        tag: String::new(),
        body: Vec::new(),
        bytes: 0,
    };
    let mut length = None;
    loop {
        let mut line = String::new();
        let bytes = stream.by_ref().take(MOST_LINE).read_line(&mut line)?;
        ensure!(
            bytes > 0 && line.ends_with('\n'),
            "the connection ended in a head"
        );
        answer.bytes += bytes as u64;
        let line = line.trim_end();
        if answer.status == 0 {
            let status = line
                .strip_prefix("HTTP/1.1 ")
                .and_then(|rest| rest.get(..3));
            answer.status = status
                .and_then(|digits| digits.parse().ok())
                .with_context(|| format!("no HTTP/1.1 status: {line:?}"))?;
        } else if line.is_empty() {
            break;
        } else if let Some((name, value)) = line.split_once(':') {
            let value = value.trim();
            match name.to_ascii_lowercase().as_str() {
                "content-length" => length = value.parse().ok(),
                "etag" => answer.tag = value.trim_matches('"').to_owned(),
                _ => {}
            }
        }
    }
    let length: u64 = length.context("an answer without a length")?;
    if length > MOST_BODY {
        bail!("a body of {length} bytes, allowed are {MOST_BODY}");
    }
    answer.body.resize(length as usize, 0);
    stream.read_exact(&mut answer.body)?;
    answer.bytes += length;
    Ok(answer)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_are_read_one_after_the_other_and_every_byte_is_counted() {
        let first = "HTTP/1.1 200 OK\r\nETag: \"0a\"\r\nContent-Length: 5\r\n\r\nhello";
        let second = "HTTP/1.1 404 Not Found\r\ncontent-length: 0\r\n\r\n";
        let bytes = format!("{first}{second}");
        let mut stream = bytes.as_bytes();
        let answer = read_answer(&mut stream).expect("an answer");
        assert_eq!((answer.status, answer.tag.as_str()), (200, "0a"));
        assert_eq!(
            (answer.body.as_slice(), answer.bytes),
            (&b"hello"[..], first.len() as u64)
        );
        let answer = read_answer(&mut stream).expect("another");
        assert_eq!((answer.status, answer.bytes), (404, second.len() as u64));
        for bad in [
            "",
            "HTTP/1.1 200 OK\r\n\r\n",
            "HTTP/1.1 200 OK\r\ncontent-length: 9\r\n\r\nx",
        ] {
            assert!(read_answer(&mut bad.as_bytes()).is_err(), "{bad:?}");
        }
    }
}
