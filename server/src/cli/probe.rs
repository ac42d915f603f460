//! Asks a server how it is, for containers and scripts without curl.

use anyhow::{Context, Result, anyhow, bail, ensure};
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName};
use tokio_rustls::rustls::{self, ClientConfig, ClientConnection, RootCertStore, StreamOwned};

/// Longest answer that is read, bytes.
const MAX_ANSWER: u64 = 64 << 10;

/// The body of the answer, if its status is one of success. Over TLS the certificates in `ca` are
/// believed, or those of the system.
pub(super) fn ask(url: &str, ca: Option<&Path>, within: Duration) -> Result<String> {
    ensure!(!within.is_zero(), "--timeout-s 0: give a longer time");
    let (secure, rest) = match url.split_once("://") {
        Some(("http", rest)) => (false, rest),
        Some(("https", rest)) => (true, rest),
        _ => bail!("`{url}` starts with neither http:// nor https://"),
    };
    let (host, path) = rest.split_once('/').unwrap_or((rest, "readyz"));
    let ca = secure.then(|| believed(ca)).transpose()?;
    let answer = exchange(host, path, ca, within).with_context(|| format!("asking {url}"))?;
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

fn exchange(host: &str, path: &str, ca: Option<RootCertStore>, within: Duration) -> Result<String> {
    let (name, port) = match host.rsplit_once(':') {
        Some((name, port)) if !port.ends_with(']') => (name, Some(port)),
        _ => (host, None),
    };
    let default = if ca.is_some() { "443" } else { "80" };
    let address = format!("{name}:{}", port.unwrap_or(default))
        .to_socket_addrs()?
        .next()
        .context("the host has no address")?;
    let stream = TcpStream::connect_timeout(&address, within)?;
    stream.set_read_timeout(Some(within))?;
    stream.set_write_timeout(Some(within))?;
    let request = format!("GET /{path} HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\n\r\n");
    match ca {
        None => answer(stream, &request),
        Some(ca) => answer(secured(stream, name, ca)?, &request),
    }
}

fn answer(mut stream: impl Read + Write, request: &str) -> Result<String> {
    stream.write_all(request.as_bytes())?;
    stream.flush()?;
    let mut answer = Vec::new();
    match stream.take(MAX_ANSWER).read_to_end(&mut answer) {
        // The end of TLS may be left out; the answer's own length says what came.
        Err(error) if error.kind() != ErrorKind::UnexpectedEof => return Err(error.into()),
        _ => {}
    }
    Ok(String::from_utf8_lossy(&answer).into_owned())
}

fn secured(
    stream: TcpStream,
    name: &str,
    ca: RootCertStore,
) -> Result<StreamOwned<ClientConnection, TcpStream>> {
    let name = name.trim_matches(['[', ']']).to_owned();
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()?
        .with_root_certificates(ca)
        .with_no_client_auth();
    let connection = ClientConnection::new(Arc::new(config), ServerName::try_from(name)?)?;
    Ok(StreamOwned::new(connection, stream))
}

/// The certificates in a file, or those of the system.
fn believed(ca: Option<&Path>) -> Result<RootCertStore> {
    let mut store = RootCertStore::empty();
    let Some(path) = ca else {
        let found = rustls_native_certs::load_native_certs();
        store.add_parsable_certificates(found.certs);
        ensure!(
            !store.is_empty(),
            "the system believes no certificate; give some with --ca"
        );
        return Ok(store);
    };
    let told = || format!("{}: no certificates in PEM", path.display());
    for certificate in CertificateDer::pem_file_iter(path).with_context(told)? {
        store
            .add(certificate.with_context(told)?)
            .with_context(told)?;
    }
    ensure!(!store.is_empty(), told());
    Ok(store)
}
