//! TLS to the server.

use super::Url;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{ClientConfig, RootCertStore};
use std::path::Path;
use std::sync::Arc;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio_rustls::{TlsConnector, client::TlsStream, rustls};

/// A connection, with or without TLS.
pub(super) trait Wire: AsyncRead + AsyncWrite + Send + Unpin {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin> Wire for T {}

/// Begins TLS, and makes sure that the server is who its address says.
pub(super) async fn secured(url: &Url, stream: TcpStream) -> Result<TlsStream<TcpStream>, String> {
    let roots = roots(url.credentials().ca.as_deref())?;
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(|error| format!("no TLS: {error}"))?
        .with_root_certificates(roots)
        .with_no_client_auth();
    let name = ServerName::try_from(url.host().to_owned())
        .map_err(|error| format!("the host \"{}\" cannot be certified: {error}", url.host()))?;
    let connector = TlsConnector::from(Arc::new(config));
    connector.connect(name, stream).await.map_err(|error| {
        format!(
            "no TLS with {}: {error}; a server without TLS has http://, one of a private \
             authority needs --ca FILE",
            url.authority()
        )
    })
}

/// Whom to believe: the certificates in a file, or those that the system believes.
fn roots(file: Option<&Path>) -> Result<RootCertStore, String> {
    let mut roots = RootCertStore::empty();
    let Some(file) = file else {
        let found = rustls_native_certs::load_native_certs();
        let (taken, _) = roots.add_parsable_certificates(found.certs);
        return match taken {
            0 => Err("no TLS: this system has no certificates; give --ca FILE".into()),
            _ => Ok(roots),
        };
    };
    let wrong = |what: String| format!("the certificates in {}: {what}", file.display());
    let certs = CertificateDer::pem_file_iter(file).map_err(|error| wrong(error.to_string()))?;
    for cert in certs {
        let cert = cert.map_err(|error| wrong(error.to_string()))?;
        roots.add(cert).map_err(|error| wrong(error.to_string()))?;
    }
    match roots.is_empty() {
        true => Err(wrong(
            "there is none; a PEM file with CERTIFICATE in it is needed".into(),
        )),
        false => Ok(roots),
    }
}
