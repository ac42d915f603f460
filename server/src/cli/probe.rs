//! Asks a server how it is, for containers and scripts without curl.

use anyhow::{Context, Result, anyhow, bail, ensure};
use std::io::{Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

/// Longest answer that is read, bytes.
const MAX_ANSWER: u64 = 64 << 10;

/// The body of the answer, if its status is one of success.
pub(super) fn ask(url: &str, within: Duration) -> Result<String> {
    ensure!(!within.is_zero(), "--timeout-s 0: give a longer time");
    let Some(rest) = url.strip_prefix("http://") else {
        bail!(
            "`{url}` does not start with http://; for a server of TLS, ask its --metrics-listen address"
        );
    };
    let (host, path) = rest.split_once('/').unwrap_or((rest, "readyz"));
    let answer = exchange(host, path, within).with_context(|| format!("asking {url}"))?;
    let (head, body) = answer
        .split_once("\r\n\r\n")
        .ok_or_else(|| anyhow!("{url} did not answer in HTTP"))?;
    let status = head.split(' ').nth(1).unwrap_or("");
    ensure!(
        status.starts_with('2'),
        "{url} answered {}",
        head.lines().next().unwrap_or("").escape_debug()
    );
    Ok(body
        .trim_end()
        .escape_debug()
        .to_string()
        .replace("\\\"", "\""))
}

fn exchange(host: &str, path: &str, within: Duration) -> Result<String> {
    let with_port = if host.rsplit(']').next().is_some_and(|end| end.contains(':')) {
        host.to_owned()
    } else {
        format!("{host}:80")
    };
    let address = with_port
        .to_socket_addrs()?
        .next()
        .context("the host has no address")?;
    let mut stream = TcpStream::connect_timeout(&address, within)?;
    stream.set_read_timeout(Some(within))?;
    stream.set_write_timeout(Some(within))?;
    write!(
        stream,
        "GET /{path} HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\n\r\n"
    )?;
    let mut answer = Vec::new();
    stream.take(MAX_ANSWER).read_to_end(&mut answer)?;
    Ok(String::from_utf8_lossy(&answer).into_owned())
}
