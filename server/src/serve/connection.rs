//! One connection, from its first byte to its last request.

use crate::access::{Peer, Place};
use crate::http::Service;
use crate::limits::{HEADER_BYTES, Limits};
use crate::metrics::{Metrics, Share, TlsFailure};
use crate::socket::Phase;
use crate::stall::StallGuard;
use crate::tls::Tls;
use hyper::server::conn::http1::Builder;
use hyper::service::{Service as _, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use std::io;
use std::net::IpAddr;
use std::sync::Arc;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::sync::{OwnedSemaphorePermit, watch};
use tokio::time::timeout;
use tokio_rustls::server::TlsStream;

/// First byte of a TLS handshake (RFC 8446, section 5.1).
const HANDSHAKE: u8 = 22;
/// To those who speak plain HTTP to an address of TLS.
const PLAIN: &[u8] = b"HTTP/1.1 400 Bad Request\r\ncontent-type: text/plain\r\n\
    connection: close\r\ncontent-length: 47\r\n\r\nThis address takes TLS only: use https or wss.\r\n";
/// Bytes that the kernel takes before it has sent those of before: about a frame, so that a newer
/// view overtakes all but one.
const UNSENT_BYTES: u32 = 16 << 10;
/// Bytes of a request that is not answered are read, so that what it is told arrives.
const IGNORED_BYTES: u64 = 64 << 10;

/// A connection, and what it holds until its end.
pub(super) struct Connection {
    pub stream: TcpStream,
    pub peer: IpAddr,
    pub service: Service,
    pub limits: Arc<Limits>,
    pub tls: Option<Arc<Tls>>,
    pub phase: watch::Receiver<Phase>,
    pub metrics: Arc<Metrics>,
    pub _counted: Share,
    pub _place: OwnedSemaphorePermit,
    pub _held: Option<Place>,
}

impl Connection {
    /// Keeps its address's place.
    pub(super) fn holding(mut self, held: Option<Place>) -> Connection {
        self._held = held;
        self
    }

    /// Answers its requests.
    pub(super) async fn run(mut self) {
        tune(&self.stream);
        let peer = Peer {
            ip: self.peer,
            secure: self.tls.is_some(),
        };
        match self.tls.take() {
            None => answer(self.stream, peer, self.service, &self.limits, self.phase).await,
            Some(tls) => self.secure(peer, &tls).await,
        }
    }

    /// As [`run`](Self::run), over TLS.
    async fn secure(self, peer: Peer, tls: &Tls) {
        let limits = self.limits;
        let shaken = timeout(limits.hello_timeout, handshake(self.stream, tls)).await;
        let (failure, plain) = match shaken {
            Ok(Ok(stream)) => {
                self.metrics.tls_handshakes.inc();
                return answer(stream, peer, self.service, &limits, self.phase).await;
            }
            Ok(Err((failure, plain))) => (failure, plain),
            Err(_) => (TlsFailure::Timeout, None),
        };
        self.metrics.tls_failed(failure);
        if let Some(stream) = plain {
            // If it does not arrive, nothing is lost.
            let _ = timeout(limits.close_timeout, refuse(stream)).await;
        }
    }
}

/// Frames are small, and each is wanted at once; and what the kernel has taken can no longer be
/// cancelled, so it takes little beyond what the line holds. On failure it is only slower.
fn tune(stream: &TcpStream) {
    let _ = stream.set_nodelay(true);
    #[cfg(any(target_os = "linux", target_os = "macos"))]
    let _ = socket2::SockRef::from(stream).set_tcp_notsent_lowat(UNSENT_BYTES);
}

/// A TLS stream; or why there is none, with the connection if the client speaks plain HTTP.
async fn handshake(
    stream: TcpStream,
    tls: &Tls,
) -> Result<TlsStream<TcpStream>, (TlsFailure, Option<TcpStream>)> {
    let mut first = [0];
    match stream.peek(&mut first).await {
        Ok(1) if first[0] == HANDSHAKE => {}
        Ok(1) if first[0].is_ascii_uppercase() => return Err((TlsFailure::NotTls, Some(stream))),
        Ok(1) => return Err((TlsFailure::NotTls, None)),
        _ => return Err((TlsFailure::Closed, None)),
    }
    tls.acceptor().accept(stream).await.map_err(|error| {
        tracing::debug!(%error, "no TLS");
        let failure = match error.kind() {
            io::ErrorKind::InvalidData => TlsFailure::Handshake,
            _ => TlsFailure::Closed,
        };
        (failure, None)
    })
}

/// Tells a client that speaks plain HTTP what is spoken here. A socket that is closed with unread
/// bytes in it is reset, and takes what was sent with it.
async fn refuse(mut stream: TcpStream) -> io::Result<()> {
    stream.write_all(PLAIN).await?;
    stream.shutdown().await?;
    let mut unread = stream.take(IGNORED_BYTES);
    tokio::io::copy(&mut unread, &mut tokio::io::sink()).await?;
    Ok(())
}

/// Answers the requests of a connection until it ends, or the server goes down.
async fn answer<S: AsyncRead + AsyncWrite + Unpin + Send + 'static>(
    stream: S,
    peer: Peer,
    service: Service,
    limits: &Limits,
    mut phase: watch::Receiver<Phase>,
) {
    let stream = TokioIo::new(StallGuard::new(stream, limits.send_timeout));
    let service = service_fn(move |mut request: hyper::Request<hyper::body::Incoming>| {
        request.extensions_mut().insert(peer);
        service.call(request)
    });
    let served = builder(limits)
        .serve_connection(stream, service)
        .with_upgrades();
    tokio::pin!(served);
    let result = tokio::select! {
        result = &mut served => result,
        () = draining(&mut phase) => {
            served.as_mut().graceful_shutdown();
            served.await
        }
    };
    if let Err(error) = result {
        tracing::debug!(%error, "connection ended");
    }
}

/// Ready when the server no longer serves.
async fn draining(phase: &mut watch::Receiver<Phase>) {
    // An error says that the server is gone altogether.
    let _ = phase.wait_for(|phase| *phase != Phase::Serving).await;
}

/// HTTP/1 only: hyper-util's way to tell the versions apart waits for the first bytes without any
/// time limit.
fn builder(limits: &Limits) -> Builder {
    let mut builder = Builder::new();
    builder
        .timer(TokioTimer::new())
        .header_read_timeout(limits.hello_timeout)
        .max_buf_size(HEADER_BYTES);
    builder
}
