//! Accepts connections, and ends them when told to.

use crate::catalog::Catalog;
use crate::http::{App, Service};
use crate::limits::{HEADER_BYTES, Limits};
use crate::socket::{Phase, Sessions};
use crate::stall::StallGuard;
use hyper::server::conn::http1::Builder;
use hyper_util::rt::{TokioIo, TokioTimer};
use std::io;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::task::JoinSet;
use tracing::Instrument;

/// After an accept that failed for want of resources.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// Serves the datasets of a catalog until `shutdown` is ready; then tells all sessions, waits at
/// most [`Limits::drain_timeout`] for them, and ends what is left.
///
/// # Errors
/// If the listener has no address. What goes wrong with one connection ends that connection only.
pub async fn serve(
    listener: TcpListener,
    catalog: Arc<Catalog>,
    limits: Limits,
    shutdown: impl Future<Output = ()>,
) -> io::Result<()> {
    tracing::info!(address = %listener.local_addr()?, "listening");
    let (phase, watched) = watch::channel(Phase::Serving);
    let limits = Arc::new(limits);
    let sessions = Sessions::new(limits.clone(), watched.clone());
    let service = Service::new(App {
        catalog,
        sessions: sessions.clone(),
        door: None,
    });
    let mut connections = Connections {
        places: Arc::new(Semaphore::new(limits.connections)),
        tasks: JoinSet::new(),
        service,
        limits,
        phase: watched,
    };
    tokio::select! {
        () = connections.accept(&listener) => {}
        () = shutdown => {}
    }
    drop(listener);
    phase.send_replace(Phase::Draining);
    connections.drain(&sessions).await;
    phase.send_replace(Phase::Stopped);
    connections.tasks.shutdown().await;
    Ok(())
}

/// The open connections that are not sessions.
struct Connections {
    places: Arc<Semaphore>,
    tasks: JoinSet<()>,
    service: Service,
    limits: Arc<Limits>,
    phase: watch::Receiver<Phase>,
}

impl Connections {
    /// Accepts connections, for ever, while there are places for them.
    async fn accept(&mut self, listener: &TcpListener) {
        // The semaphore is never closed.
        while let Ok(place) = self.places.clone().acquire_owned().await {
            match listener.accept().await {
                Ok((stream, peer)) => {
                    let span = tracing::info_span!("connection", %peer);
                    self.tasks
                        .spawn(self.connection(stream, place).instrument(span));
                }
                Err(error) => {
                    tracing::warn!(%error, "a connection was not accepted");
                    tokio::time::sleep(ACCEPT_PAUSE).await;
                }
            }
            while self.tasks.try_join_next().is_some() {}
        }
    }

    /// Answers one connection's requests.
    fn connection(
        &self,
        stream: TcpStream,
        place: OwnedSemaphorePermit,
    ) -> impl Future<Output = ()> + use<> {
        let service = self.service.clone();
        let mut phase = self.phase.clone();
        let limits = self.limits.clone();
        async move {
            let _place = place;
            // Frames are small, and each is wanted at once. On failure it is only slower.
            let _ = stream.set_nodelay(true);
            let stream = TokioIo::new(StallGuard::new(stream, limits.send_timeout));
            let served = builder(&limits)
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
    }

    /// Waits for connections and sessions to end by themselves.
    async fn drain(&mut self, sessions: &Sessions) {
        let ended = async {
            sessions.ended().await;
            while self.tasks.join_next().await.is_some() {}
        };
        if tokio::time::timeout(self.limits.drain_timeout, ended)
            .await
            .is_err()
        {
            tracing::warn!(within = ?self.limits.drain_timeout, "connections did not end");
        }
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
