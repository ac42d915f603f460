//! What the server counts, and how it is told to Prometheus (OpenMetrics 1.0 text, which
//! Prometheus reads; `docs/operations.md` has the list).
//!
//! [`Metrics`] is made once, shared, and updated without locks on the way of a frame. The values
//! of every label are either in an enum here, or an address of the router, or the name of a
//! dataset that is hosted: nothing that a peer sends becomes one.

mod labels;
mod process;

#[cfg(test)]
mod tests;

pub use labels::{Ended, Limited, Refusal, TlsFailure};

use crate::session::CloseReason;
use escarp_proto::wire::ErrorCode;
use prometheus_client::encoding::text::{encode_eof, encode_registry};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Metric, Registry};
use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, SystemTime};

/// The content type of [`Metrics::render`].
pub const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Declares the metrics once: the docstring of each is its help text, too.
macro_rules! metrics {
    ($($(#[doc = $doc:literal])+ $name:ident: $kind:ty = $make:expr;)*) => {
        /// Counters, gauges and histograms of one server. Fields are updated by whoever knows.
        #[derive(Debug)]
        pub struct Metrics {
            $($(#[doc = $doc])+ pub $name: $kind,)*
            routes: RwLock<BTreeMap<Box<str>, Arc<Counted>>>,
            started: SystemTime,
            registry: Registry,
        }

        impl Metrics {
            /// All at zero.
            pub fn new() -> Metrics {
                let mut all = Registrar(Registry::with_prefix("escarp"));
                let version = [("version", env!("CARGO_PKG_VERSION"))];
                all.0.register("build", "The program", Info::new(version));
                Metrics {
                    $($name: all.add(stringify!($name), concat!($($doc),+), $make),)*
                    routes: RwLock::default(),
                    started: SystemTime::now(),
                    registry: all.0,
                }
            }
        }
    };
}

metrics! {
    /// Sessions that are open now.
    sessions_open: Gauge = Gauge::default();
    /// Sessions that were opened.
    sessions: Counter = Counter::default();
    /// Sessions that were refused, by reason.
    sessions_refused: ByReason = ByReason::default();
    /// Sessions that have ended, by reason.
    sessions_ended: ByReason = ByReason::default();
    /// Pages that wait to be sent, in all sessions; each has its share.
    queue_pages: Gauge = Gauge::default();
    /// From a page's being wanted, by the client or by the selection, to its being sent.
    queue_age_seconds: Histogram = waits();
    /// Bytes of parts of pages that were sent.
    sent_bytes: Counter = Counter::default();
    /// Of the bytes sent: parts that the newest view needed when they were sent.
    useful_bytes: Counter = Counter::default();
    /// Of the bytes sent: parts that the server selected for a View.
    pushed_bytes: Counter = Counter::default();
    /// Of the bytes sent: parts that the client asked for by Want.
    pulled_bytes: Counter = Counter::default();
    /// Of the bytes sent: parts for a view that was predicted.
    predicted_bytes: Counter = Counter::default();
    /// Of the bytes sent: parts that the same session had been sent before, of the same revision.
    repeated_bytes: Counter = Counter::default();
    /// Bytes of parts that were queued, and not sent because of a newer view: by the mean length.
    cancelled_bytes: Counter = Counter::default();
    /// How often a session had pages to send and no credit.
    credit_stalls: Counter = Counter::default();
    /// Time that a session had pages to send and no credit, of each such stall.
    credit_stall_seconds: Histogram = waits();
    /// Reads of records that took so long that the disk must have been asked.
    cold_reads: Counter = Counter::default();
    /// Reads of records.
    reads: Counter = Counter::default();
    /// From a View to the Idle that answers it: all that its tolerance needs has been sent.
    target_error_seconds: Histogram = waits();
    /// Time that it takes to select pages for one View.
    selection_seconds: Histogram = moments();
    /// Changes of a dataset's generation that sessions were told.
    generation_changes: Counter = Counter::default();
    /// Connections that are open now; one that opened a session is none any more.
    connections_open: Gauge = Gauge::default();
    /// Connections that were accepted.
    connections: Counter = Counter::default();
    /// Accepts that failed for want of resources, such as file descriptors.
    accept_failures: Counter = Counter::default();
    /// What a limit for one address refused.
    limited: ByReason = ByReason::default();
    /// TLS handshakes that failed, by reason.
    tls_failures: ByReason = ByReason::default();
    /// TLS handshakes that succeeded.
    tls_handshakes: Counter = Counter::default();
    /// HTTP requests that were answered, by route and status.
    http_requests: Requests = Requests::default();
    /// Bytes of bodies of HTTP answers, where their length was known.
    http_response_bytes: Family<Route, Counter> = Family::default();
    /// From an HTTP request's header to that of its answer.
    http_request_seconds: Times = Times::new_with_constructor(moments);
}

/// A counter for each reason.
pub type ByReason = Family<[(&'static str, &'static str); 1], Counter>;
/// What is counted for one route, at hand: most answers have status 200.
#[derive(Debug)]
pub(crate) struct Counted {
    route: Route,
    requests: Requests,
    ok: Counter,
    bytes: Counter,
    seconds: Histogram,
}

impl Counted {
    /// A request was answered; see [`Metrics::request_answered`].
    pub(crate) fn answered(&self, status: u16, bytes: u64, took: Duration) {
        match status {
            200 => _ = self.ok.inc(),
            _ => _ = requests(&self.requests, &self.route, status).inc(),
        }
        self.bytes.inc_by(bytes);
        self.seconds.observe(took.as_secs_f64());
    }
}

fn requests(all: &Requests, route: &Route, status: u16) -> Counter {
    let labels = (route.clone(), [("status", status)]);
    all.get_or_create_owned(&labels)
}

/// The label with a route.
type Route = [(&'static str, Arc<str>); 1];
/// The label with a status.
type Status = [(&'static str, u16); 1];
/// A counter for each route and status.
type Requests = Family<(Route, Status), Counter>;
/// A histogram for each route.
type Times = Family<Route, Histogram, fn() -> Histogram>;

impl Default for Metrics {
    fn default() -> Metrics {
        Metrics::new()
    }
}

impl Metrics {
    /// A session was refused before it was open, or at its Hello.
    pub fn session_refused(&self, reason: Refusal) {
        self.sessions_refused.get_or_create(&reason.label()).inc();
    }

    /// A session that was open has ended.
    pub fn session_ended(&self, reason: Ended) {
        self.sessions_ended.get_or_create(&reason.label()).inc();
    }

    /// A session is over: what was refused at its Hello was refused, anything else has ended.
    /// `None`: its connection was lost.
    pub fn session_over(&self, reason: Option<&CloseReason>) {
        let Some(reason) = reason else {
            return self.session_ended(Ended::Lost);
        };
        match reason {
            CloseReason::Client(_) => self.session_ended(Ended::Client),
            CloseReason::Server(error) => match error.code {
                ErrorCode::Denied => self.session_refused(Refusal::Denied),
                ErrorCode::NoDataset => self.session_refused(Refusal::NoDataset),
                ErrorCode::Version => self.session_refused(Refusal::Version),
                ErrorCode::Protocol => self.session_ended(Ended::Protocol),
                ErrorCode::Limit => self.session_ended(Ended::Limit),
                ErrorCode::ShuttingDown => self.session_ended(Ended::Shutdown),
                ErrorCode::Internal => self.session_ended(Ended::Internal),
            },
        }
    }

    /// A limit for one address refused something.
    pub fn limited(&self, what: Limited) {
        self.limited.get_or_create(&what.label()).inc();
    }

    /// A TLS handshake failed.
    pub fn tls_failed(&self, reason: TlsFailure) {
        self.tls_failures.get_or_create(&reason.label()).inc();
    }

    /// A request was answered: by the route as the router knows it, such as `/{name}/manifest`,
    /// or `None` if no route was found. `bytes` is the body's length, where it is known.
    pub fn request_answered(&self, route: Option<&str>, status: u16, bytes: u64, took: Duration) {
        self.counted(route.unwrap_or("none"))
            .answered(status, bytes, took);
    }

    /// The counters of a route. Routes are few, and come again and again.
    pub(crate) fn counted(&self, route: &str) -> Arc<Counted> {
        let routes = self.routes.read().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = routes.get(route) {
            return known.clone();
        }
        drop(routes);
        let label: Route = [("route", route.into())];
        let counted = Arc::new(Counted {
            ok: requests(&self.http_requests, &label, 200),
            requests: self.http_requests.clone(),
            bytes: self.http_response_bytes.get_or_create_owned(&label),
            seconds: self.http_request_seconds.get_or_create_owned(&label),
            route: label,
        });
        let mut routes = self.routes.write().unwrap_or_else(PoisonError::into_inner);
        routes.entry(route.into()).or_insert(counted).clone()
    }

    /// All of it as text, with the generations of the datasets and the state of the process.
    ///
    /// # Errors
    /// Never: text has room.
    pub fn render(&self, stands: &[Stand]) -> Result<String, fmt::Error> {
        let mut text = String::new();
        encode_registry(&mut text, &self.registry)?;
        encode_registry(&mut text, &datasets(stands))?;
        encode_registry(&mut text, &process::registry(self.started))?;
        encode_eof(&mut text)?;
        Ok(text)
    }
}

/// What a dataset is at.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stand {
    /// Its name.
    pub dataset: String,
    /// The generation that is served.
    pub generation: u64,
    /// Pages stored.
    pub pages: u64,
}

fn datasets(stands: &[Stand]) -> Registry {
    let mut all = Registrar(Registry::with_prefix("escarp"));
    let family = Family::<_, Gauge>::default;
    let generation = all.add("dataset_generation", "The generation served", family());
    let pages = all.add("dataset_pages", "Pages stored", family());
    for stand in stands {
        let label = [("dataset", stand.dataset.clone())];
        for (family, value) in [(&generation, stand.generation), (&pages, stand.pages)] {
            let value = i64::try_from(value).unwrap_or(i64::MAX);
            family.get_or_create(&label).set(value);
        }
    }
    all.0
}

/// Registers, and hands back.
struct Registrar(Registry);

impl Registrar {
    fn add<M: Metric + Clone>(&mut self, name: &str, help: &str, metric: M) -> M {
        // The library ends the text with a full stop.
        let help = help.trim().trim_end_matches('.');
        self.0.register(name, help, metric.clone());
        metric
    }
}

/// 1 ms to 32 s: what a person waits for.
fn waits() -> Histogram {
    Histogram::new(exponential_buckets(0.001, 2.0, 16))
}

/// 8 us to 2 s: what a machine takes.
fn moments() -> Histogram {
    Histogram::new(exponential_buckets(8e-6, 4.0, 10))
}

/// One contributor's part of a gauge that sums over all, such as one session's queue. Dropping it
/// takes the part away.
#[derive(Debug)]
pub struct Share {
    gauge: Gauge,
    value: i64,
}

impl Share {
    /// A part of 0.
    pub fn of(gauge: &Gauge) -> Share {
        Share {
            gauge: gauge.clone(),
            value: 0,
        }
    }

    /// A part of 1, for what is counted by being there.
    pub fn one(gauge: &Gauge) -> Share {
        let mut share = Share::of(gauge);
        share.set(1);
        share
    }

    /// Changes the part.
    pub fn set(&mut self, value: usize) {
        let value = i64::try_from(value).unwrap_or(i64::MAX);
        if value != self.value {
            self.gauge.inc_by(value - self.value);
            self.value = value;
        }
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        self.gauge.dec_by(self.value);
    }
}
