//! TLS: the certificate and key of the server, read again when they change.

use rustls::ServerConfig;
use rustls::pki_types::pem::{PemObject, SectionKind};
use rustls::pki_types::{CertificateDer, PrivateKeyDer, PrivateSec1KeyDer};
use rustls::pki_types::{PrivatePkcs1KeyDer, PrivatePkcs8KeyDer};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::SystemTime;
use thiserror::Error;
use tokio_rustls::{TlsAcceptor, rustls};

/// Larger files are none of certificates or keys, bytes.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// What a server shows to its clients, and where it comes from.
pub struct Tls {
    cert: PathBuf,
    key: PathBuf,
    config: RwLock<Arc<ServerConfig>>,
    /// When the files were last changed, as of the last reading.
    stamps: Mutex<[Option<SystemTime>; 2]>,
}

/// Why certificate and key cannot be used.
#[derive(Debug, Error)]
pub enum TlsError {
    /// A file cannot be read.
    #[error("{file}: {error}", file = .0.display(), error = .1)]
    Read(PathBuf, io::Error),
    /// A file has something else in it.
    #[error("{file}: {what}", file = .0.display(), what = .1)]
    Content(PathBuf, String),
    /// The library refuses them.
    #[error("{cert} with {key}: {error}", cert = .0.display(), key = .1.display(), error = .2)]
    Refused(PathBuf, PathBuf, rustls::Error),
}

impl Tls {
    /// Reads a chain of certificates, the server's own first, and its private key, both as PEM.
    ///
    /// # Errors
    /// [`TlsError`] with the file, and what was found in it.
    pub fn load(cert: &Path, key: &Path) -> Result<Tls, TlsError> {
        let stamps = Mutex::new([cert, key].map(changed));
        Ok(Tls {
            config: RwLock::new(Arc::new(config(cert, key)?)),
            cert: cert.into(),
            key: key.into(),
            stamps,
        })
    }

    /// Reads the files again. New connections have what is in them; if they cannot be used, what
    /// was read before stays.
    ///
    /// # Errors
    /// [`TlsError`] as of [`load`](Self::load).
    pub fn reload(&self) -> Result<(), TlsError> {
        *self.stamps.lock().unwrap_or_else(PoisonError::into_inner) = self.changed();
        let config = Arc::new(config(&self.cert, &self.key)?);
        *self.config.write().unwrap_or_else(PoisonError::into_inner) = config;
        Ok(())
    }

    /// As [`reload`](Self::reload), if a file has changed since it was last read. Says whether.
    ///
    /// # Errors
    /// [`TlsError`] as of [`load`](Self::load), once a change.
    pub fn reload_if_changed(&self) -> Result<bool, TlsError> {
        let stamps = *self.stamps.lock().unwrap_or_else(PoisonError::into_inner);
        let now = self.changed();
        // A file that is away is about to be replaced.
        if now == stamps || now.contains(&None) {
            return Ok(false);
        }
        self.reload().map(|()| true)
    }

    fn changed(&self) -> [Option<SystemTime>; 2] {
        [&self.cert, &self.key].map(|file| changed(file))
    }

    /// For one connection.
    pub(crate) fn acceptor(&self) -> TlsAcceptor {
        let config = self.config.read().unwrap_or_else(PoisonError::into_inner);
        TlsAcceptor::from(config.clone())
    }
}

fn changed(file: &Path) -> Option<SystemTime> {
    std::fs::metadata(file)
        .and_then(|found| found.modified())
        .ok()
}

/// TLS 1.2 and 1.3, HTTP/1.1.
fn config(cert: &Path, key: &Path) -> Result<ServerConfig, TlsError> {
    let chain = certificates(cert)?;
    let private = private_key(key)?;
    let refused = |error| TlsError::Refused(cert.into(), key.into(), error);
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let mut config = ServerConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(refused)?
        .with_no_client_auth()
        .with_single_cert(chain, private)
        .map_err(refused)?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(config)
}

fn certificates(file: &Path) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    let sections = sections(file)?;
    let kinds = kinds(&sections);
    let is_certificate = |(kind, _): &(SectionKind, Vec<u8>)| *kind == SectionKind::Certificate;
    let chain = sections.into_iter().filter(is_certificate);
    let chain: Vec<_> = chain.map(|(_, der)| CertificateDer::from(der)).collect();
    if chain.is_empty() {
        let what = format!("no CERTIFICATE in it, but {kinds}; a PEM chain is needed");
        return Err(TlsError::Content(file.into(), what));
    }
    Ok(chain)
}

fn private_key(file: &Path) -> Result<PrivateKeyDer<'static>, TlsError> {
    let sections = sections(file)?;
    let kinds = kinds(&sections);
    let mut keys = sections.into_iter().filter_map(|(kind, der)| match kind {
        SectionKind::PrivateKey => Some(PrivatePkcs8KeyDer::from(der).into()),
        SectionKind::RsaPrivateKey => Some(PrivatePkcs1KeyDer::from(der).into()),
        SectionKind::EcPrivateKey => Some(PrivateSec1KeyDer::from(der).into()),
        _ => None,
    });
    match (keys.next(), keys.next()) {
        (Some(key), None) => Ok(key),
        _ => {
            let what = format!(
                "{kinds} in it; exactly one PRIVATE KEY without a passphrase is needed \
                 (`openssl pkey -in FILE` takes a passphrase off)"
            );
            Err(TlsError::Content(file.into(), what))
        }
    }
}

/// The PEM sections of a file (RFC 7468) that have to do with TLS.
fn sections(file: &Path) -> Result<Vec<(SectionKind, Vec<u8>)>, TlsError> {
    let read = || -> io::Result<Vec<u8>> {
        let found = std::fs::metadata(file)?;
        if !found.is_file() {
            // Reading a pipe or a device may never end.
            return Err(io::Error::other("not a regular file"));
        }
        let bytes = found.len();
        if bytes > MAX_FILE_BYTES {
            let error = format!("{bytes} bytes; at most {MAX_FILE_BYTES} are read");
            return Err(io::Error::other(error));
        }
        std::fs::read(file)
    };
    let bytes = read().map_err(|error| TlsError::Read(file.into(), error))?;
    let sections = <(SectionKind, Vec<u8>)>::pem_slice_iter(&bytes);
    let broken = |error| TlsError::Content(file.into(), format!("broken PEM: {error:?}"));
    sections.map(|section| section.map_err(broken)).collect()
}

/// What was found, for people.
fn kinds(sections: &[(SectionKind, Vec<u8>)]) -> String {
    let names = sections.iter().map(|(kind, _)| match kind {
        SectionKind::Certificate => "CERTIFICATE",
        SectionKind::PrivateKey => "PRIVATE KEY",
        SectionKind::RsaPrivateKey => "RSA PRIVATE KEY",
        SectionKind::EcPrivateKey => "EC PRIVATE KEY",
        SectionKind::PublicKey => "PUBLIC KEY",
        SectionKind::Csr => "CERTIFICATE REQUEST",
        _ => "something else",
    });
    match names.collect::<Vec<_>>() {
        names if names.is_empty() => "nothing that is known".into(),
        names => names.join(", "),
    }
}
