//! Accepts connections, and ends them when told to.

mod connection;

use crate::access::{Access, Gate, Proxies};
use crate::catalog::Catalog;
use crate::health::{self, Health};
use crate::http::{App, Kept, Service};
use crate::limits::Limits;
use crate::metrics::{Metrics, Share};
use crate::socket::{Phase, Sessions};
use crate::tls::Tls;
use connection::Connection;
use std::io;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::task::JoinSet;
use tracing::Instrument;

/// After an accept that failed for want of resources.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// While accepts go on failing, that is logged this often.
const FAILURE_LOG_INTERVAL: Duration = Duration::from_secs(10);
/// Connections to the address of those who watch.
const WATCHERS: usize = 64;

/// What is served, and how.
pub struct Serving {
    catalog: Arc<Catalog>,
    limits: Limits,
    gate: Gate,
    tls: Option<Arc<Tls>>,
    watchers: Option<TcpListener>,
    drain_delay: Duration,
}

impl Serving {
    /// Plain HTTP, open to all.
    pub fn new(catalog: Arc<Catalog>, limits: Limits) -> Serving {
        Serving {
            catalog,
            gate: Gate::new(&limits, Arc::default()),
            limits,
            tls: None,
            watchers: None,
            drain_delay: Duration::ZERO,
        }
    }

    /// Only to those that the rules allow.
    #[must_use]
    pub fn with_access(self, access: Access) -> Serving {
        self.gate.set_access(access);
        self
    }

    /// Over TLS only.
    #[must_use]
    pub fn with_tls(mut self, tls: Arc<Tls>) -> Serving {
        self.tls = Some(tls);
        self
    }

    /// Takes these proxies' word for the addresses of their clients.
    #[must_use]
    pub fn behind(mut self, proxies: Proxies) -> Serving {
        self.gate = self.gate.with_proxies(proxies);
        self
    }

    /// Whether the limits for one address hold for this machine, too.
    #[must_use]
    pub fn limiting_loopback(mut self, limit: bool) -> Serving {
        self.gate = self.gate.limiting_loopback(limit);
        self
    }

    /// Gives metrics and health on an address of their own, in plain HTTP, and there alone.
    #[must_use]
    pub fn watched_at(mut self, listener: TcpListener) -> Serving {
        self.watchers = Some(listener);
        self
    }

    /// Goes on for so long after it was told to shut down, while `/readyz` says so.
    #[must_use]
    pub fn draining_after(mut self, delay: Duration) -> Serving {
        self.drain_delay = delay;
        self
    }

    /// What is counted.
    pub fn metrics(&self) -> Arc<Metrics> {
        self.gate.metrics.clone()
    }

    /// Serves until `shutdown` is ready; then tells all sessions, waits at most
    /// [`Limits::drain_timeout`] for them, and ends what is left. `rules` brings other rules of
    /// access.
    ///
    /// # Errors
    /// If the listener has no address. What goes wrong with one connection ends that one only.
    pub async fn run(
        self,
        listener: TcpListener,
        rules: watch::Receiver<Option<Access>>,
        shutdown: impl Future<Output = ()>,
    ) -> io::Result<()> {
        tracing::info!(address = %listener.local_addr()?, tls = self.tls.is_some(), "listening");
        let (phase, watched) = watch::channel(Phase::Serving);
        let limits = Arc::new(self.limits);
        let gate = Arc::new(self.gate);
        let sessions = Sessions::new(limits.clone(), watched.clone());
        let app = App {
            catalog: self.catalog,
            sessions: sessions.clone(),
            gate: gate.clone(),
            health: Arc::new(Health::default()),
            counted: self.watchers.is_none(),
            limits: limits.clone(),
            kept: Arc::new(Kept::new(limits.kept_bytes)),
        };
        let open = |service, places, tls| Connections {
            places: Arc::new(Semaphore::new(places)),
            tasks: JoinSet::new(),
            service,
            limits: limits.clone(),
            gate: gate.clone(),
            tls,
            phase: watched.clone(),
            failing: None,
        };
        // Those who watch are answered until the end. Dropping the set ends them.
        let mut watching = JoinSet::new();
        if let Some(watchers) = self.watchers {
            tracing::info!(address = %watchers.local_addr()?, "metrics");
            let mut connections = open(Service::of(health::router(app.clone())), WATCHERS, None);
            watching.spawn(async move { connections.accept(&watchers).await });
        }
        watching.spawn(follow(gate.clone(), rules));
        let mut connections = open(Service::new(app.clone()), limits.connections, self.tls);
        let told = async {
            shutdown.await;
            app.health.drain();
            tokio::time::sleep(self.drain_delay).await;
        };
        tokio::select! {
            () = connections.accept(&listener) => {}
            () = told => {}
        }
        drop(listener);
        phase.send_replace(Phase::Draining);
        connections.drain(&sessions).await;
        phase.send_replace(Phase::Stopped);
        connections.tasks.shutdown().await;
        Ok(())
    }
}

/// Serves the datasets of a catalog in plain HTTP to all, until `shutdown` is ready; see
/// [`Serving::run`].
///
/// # Errors
/// If the listener has no address.
pub async fn serve(
    listener: TcpListener,
    catalog: Arc<Catalog>,
    limits: Limits,
    shutdown: impl Future<Output = ()>,
) -> io::Result<()> {
    // Without a sender, the rules stay.
    let rules = watch::channel(None).1;
    Serving::new(catalog, limits)
        .run(listener, rules, shutdown)
        .await
}

/// Takes on new rules as they come.
async fn follow(gate: Arc<Gate>, mut rules: watch::Receiver<Option<Access>>) {
    while rules.changed().await.is_ok() {
        if let Some(access) = rules.borrow_and_update().clone() {
            gate.set_access(access);
        }
    }
}

/// The open connections that are not sessions.
struct Connections {
    places: Arc<Semaphore>,
    tasks: JoinSet<()>,
    service: Service,
    limits: Arc<Limits>,
    gate: Arc<Gate>,
    tls: Option<Arc<Tls>>,
    phase: watch::Receiver<Phase>,
    /// While accepts fail: when that was last logged, and how many have failed since.
    failing: Option<(Instant, u64)>,
}

impl Connections {
    /// Accepts connections, for ever, while there are places for them.
    async fn accept(&mut self, listener: &TcpListener) {
        // The semaphore is never closed.
        while let Ok(place) = self.places.clone().acquire_owned().await {
            match listener.accept().await {
                Ok((stream, peer)) => {
                    self.failing = None;
                    let span = tracing::info_span!("connection", %peer);
                    if let Ok(held) = self.gate.connection(peer.ip()) {
                        let connection = self.connection(stream, peer, place);
                        let connection = connection.holding(held);
                        self.tasks.spawn(connection.run().instrument(span));
                    }
                }
                Err(error) => {
                    self.note_failure(&error);
                    tokio::time::sleep(ACCEPT_PAUSE).await;
                }
            }
            while self.tasks.try_join_next().is_some() {}
        }
    }

    /// Logs a failure to accept, unless that has just been done.
    fn note_failure(&mut self, error: &io::Error) {
        self.gate.metrics.accept_failures.inc();
        let (last, failures) = self.failing.unwrap_or((Instant::now(), 0));
        let due = failures == 0 || last.elapsed() >= FAILURE_LOG_INTERVAL;
        self.failing = Some((if due { Instant::now() } else { last }, failures + 1));
        if due {
            let failures = failures + 1;
            tracing::warn!(%error, failures, "connections wait: they cannot be accepted");
        }
    }

    fn connection(
        &self,
        stream: TcpStream,
        peer: std::net::SocketAddr,
        place: OwnedSemaphorePermit,
    ) -> Connection {
        let metrics = &self.gate.metrics;
        metrics.connections.inc();
        Connection {
            stream,
            peer: peer.ip(),
            service: self.service.clone(),
            limits: self.limits.clone(),
            tls: self.tls.clone(),
            phase: self.phase.clone(),
            metrics: metrics.clone(),
            _counted: Share::one(&metrics.connections_open),
            _place: place,
            _held: None,
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
