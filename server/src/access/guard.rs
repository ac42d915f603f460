//! What happens to every HTTP request before and after its handler: it gets a name for the logs,
//! is counted, held against the limits of its address and the rules of its dataset, and its
//! answer says who may read it.

use super::{Access, Address, Caller, Denied, Place, Proxies, Rates};
use crate::catalog::{RESERVED, percent_decoded};
use crate::http::Problem;
use crate::limits::Limits;
use crate::metrics::{Limited, Metrics};
use axum::body::HttpBody;
use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::net::IpAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, Instant};
use tracing::Instrument;

/// The name of a request in all logs it passes.
const REQUEST_ID: &str = "x-request-id";
/// The header in which proxies note how they were asked.
const FORWARDED_PROTO: &str = "x-forwarded-proto";
/// Longest name that is taken from a client.
const MAX_ID: usize = 64;

/// The other end of a connection. Stands in the extensions of its requests.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Peer {
    pub ip: IpAddr,
    /// Whether it came by TLS.
    pub secure: bool,
}

/// The rules, limits and counters that all requests pass.
#[derive(Debug)]
pub(crate) struct Gate {
    access: RwLock<Arc<Access>>,
    proxies: Proxies,
    /// Whether the limits for one address hold for this machine, too.
    limit_loopback: bool,
    rates: Arc<Rates>,
    pub(crate) metrics: Arc<Metrics>,
    started: Instant,
    /// Names for requests that have none: that of this run, and a number.
    run: String,
    requests: AtomicU64,
}

impl Gate {
    pub(crate) fn new(limits: &Limits, metrics: Arc<Metrics>) -> Gate {
        let since_1970 = std::time::SystemTime::UNIX_EPOCH.elapsed();
        Gate {
            access: RwLock::default(),
            proxies: Proxies::default(),
            limit_loopback: false,
            rates: Arc::new(Rates::new(limits)),
            metrics,
            started: Instant::now(),
            // Another run has another one, or at least another process.
            run: format!(
                "{:x}-{:x}",
                since_1970.map_or(0, |since| since.as_millis()),
                std::process::id()
            ),
            requests: AtomicU64::new(0),
        }
    }

    pub(crate) fn with_proxies(mut self, proxies: Proxies) -> Gate {
        self.proxies = proxies;
        self
    }

    pub(crate) fn limiting_loopback(mut self, limit: bool) -> Gate {
        self.limit_loopback = limit;
        self
    }

    /// The rules as they are now.
    pub(crate) fn access(&self) -> Arc<Access> {
        let access = self.access.read().unwrap_or_else(PoisonError::into_inner);
        access.clone()
    }

    /// Other rules from now on. Sessions that are open stay so.
    pub(crate) fn set_access(&self, access: Access) {
        *self.access.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(access);
    }

    /// A place for a connection: `Err` if its address has too many.
    pub(crate) fn connection(&self, ip: IpAddr) -> Result<Option<Place>, ()> {
        if self.is_exempt(ip) || self.proxies.trust(ip) {
            return Ok(None);
        }
        let place = self.rates.connection(Address::of(ip), self.now());
        self.counted(place, Limited::Connection)
    }

    /// A place for a session: `Err` if its address has too many.
    pub(crate) fn session(&self, caller: &Caller) -> Result<Option<Place>, ()> {
        let Some(ip) = caller.address.filter(|ip| !self.is_exempt(*ip)) else {
            return Ok(None);
        };
        let place = self.rates.session(Address::of(ip), self.now());
        self.counted(place, Limited::Session)
    }

    fn counted(&self, place: Option<Place>, what: Limited) -> Result<Option<Place>, ()> {
        if place.is_none() {
            self.metrics.limited(what);
        }
        place.map(Some).ok_or(())
    }

    fn request(&self, ip: IpAddr) -> Result<(), Duration> {
        if self.is_exempt(ip) {
            return Ok(());
        }
        let counted = self.rates.request(Address::of(ip), self.now());
        counted.inspect_err(|_| self.metrics.limited(Limited::Request))
    }

    fn is_exempt(&self, ip: IpAddr) -> bool {
        ip.to_canonical().is_loopback() && !self.limit_loopback
    }

    fn now(&self) -> Duration {
        self.started.elapsed()
    }

    /// Who asks.
    fn caller(&self, request: &Request) -> Caller {
        let mut caller = Caller::of(self.access(), request.headers());
        if let Some(peer) = request.extensions().get::<Peer>() {
            caller.address = Some(self.proxies.client(peer.ip, request.headers()));
            let told = request.headers().get(FORWARDED_PROTO);
            let proxied = self.proxies.trust(peer.ip) && told.is_some_and(|told| told == "https");
            caller.secure = peer.secure || proxied;
        }
        caller
    }

    /// Whether a request may be answered past the middleware, as that would change nothing: all
    /// is open to everyone, from every web page, and the request has no name.
    pub(crate) fn lets_pass<B>(&self, request: &axum::http::Request<B>) -> bool {
        let (headers, access) = (request.headers(), self.access());
        !headers.contains_key(REQUEST_ID) && access.is_open() && access.hosts.allow(headers)
    }

    /// Counts a request that is answered past the middleware. False if its address has had too
    /// many; the middleware then says so.
    pub(crate) fn counts<B>(&self, request: &axum::http::Request<B>) -> bool {
        let Some(peer) = request.extensions().get::<Peer>() else {
            return false;
        };
        let client = self.proxies.client(peer.ip, request.headers());
        let within = || self.rates.request(Address::of(client), self.now());
        self.is_exempt(client) || within().is_ok()
    }

    /// The request's own name, if it is one that can stand in a log; else a new one.
    fn id(&self, headers: &HeaderMap) -> HeaderValue {
        let plain = |byte: &u8| byte.is_ascii_alphanumeric() || b"-_.".contains(byte);
        let sane =
            |id: &&HeaderValue| (1..=MAX_ID).contains(&id.len()) && id.as_bytes().iter().all(plain);
        headers
            .get(REQUEST_ID)
            .filter(sane)
            .cloned()
            .unwrap_or_else(|| {
                let number = self.requests.fetch_add(1, Ordering::Relaxed);
                let id = format!("{}-{number:x}", self.run);
                id.parse().unwrap_or(HeaderValue::from_static("unnamed"))
            })
    }
}

/// The middleware.
pub(crate) async fn guard(
    State(gate): State<Arc<Gate>>,
    mut request: Request,
    next: Next,
) -> Response {
    let began = Instant::now();
    let id = gate.id(request.headers());
    let caller = gate.caller(&request);
    let dataset = dataset_of(request.uri().path());
    let route = request.extensions().get::<MatchedPath>().cloned();
    let span = tracing::info_span!(
        "request",
        id = id.to_str().unwrap_or(""),
        method = %request.method(),
        path = request.uri().path(),
    );
    let mut response = match refusal(&gate, &caller, dataset.as_deref(), &request) {
        Some(refused) => refused,
        None => {
            request.extensions_mut().insert(caller.clone());
            next.run(request).instrument(span.clone()).await
        }
    };
    label(&mut response, &caller, dataset.as_deref());
    response.headers_mut().insert(REQUEST_ID, id);
    let (status, took) = (response.status().as_u16(), began.elapsed());
    let bytes = response.body().size_hint().exact().unwrap_or(0);
    let route = route.as_ref().map(MatchedPath::as_str);
    gate.metrics.request_answered(route, status, bytes, took);
    span.in_scope(|| tracing::debug!(status, bytes, ?took, client = ?caller.address, "answered"));
    response
}

/// The name of the dataset that an address is about, if it is about one.
fn dataset_of(path: &str) -> Option<String> {
    let name = path.strip_prefix('/')?.split('/').next()?;
    // What is not UTF-8 is no dataset's name.
    let name = percent_decoded(name)?;
    (!name.is_empty() && !RESERVED.contains(&&*name)).then(|| name.into_owned())
}

/// The answer to a request that does not reach its handler.
fn refusal(
    gate: &Gate,
    caller: &Caller,
    dataset: Option<&str>,
    request: &Request,
) -> Option<Response> {
    let path = request.uri().path();
    if !gate.access().hosts.allow(request.headers()) {
        return Some(misdirected());
    }
    if percent_decoded(path).is_none() {
        // Nothing here has such a name.
        let error = format!("there is no {path} here: it is no UTF-8");
        return Some(Problem::plain(StatusCode::NOT_FOUND, error).into_response());
    }
    let probe = ["/healthz", "/readyz"].contains(&path);
    if let Some(ip) = caller.address.filter(|_| !probe)
        && let Err(wait) = gate.request(ip)
    {
        return Some(too_many(wait));
    }
    // What is allowed is asked without a token; the answer has no data.
    let dataset = dataset.filter(|_| request.method() != Method::OPTIONS)?;
    caller.opens(dataset).err().map(|why| denied(dataset, why))
}

/// Status 421 (RFC 9110, section 15.5.20).
fn misdirected() -> Response {
    let problem = Problem {
        allowed: [
            "localhost",
            "an IP address",
            "what `hosts` in the settings names",
        ]
        .map(Into::into)
        .into(),
        ..Problem::plain(
            StatusCode::MISDIRECTED_REQUEST,
            "this server is not addressed by the name in Host",
        )
    };
    problem.into_response()
}

/// Status 429.
pub(crate) fn too_many(wait: Duration) -> Response {
    let seconds = wait.as_secs() + 1;
    let error = format!("too much from your address; try again in {seconds} s");
    let problem = Problem::plain(StatusCode::TOO_MANY_REQUESTS, error);
    ([(header::RETRY_AFTER, seconds.to_string())], problem).into_response()
}

/// Status 401 without a token (RFC 6750, section 3), 403 with a wrong one; whether there is such
/// a dataset is not said.
fn denied(dataset: &str, why: Denied) -> Response {
    match why {
        Denied::NoToken => {
            let error = format!("`{dataset}` needs a token: Authorization: Bearer TOKEN");
            let problem = Problem::plain(StatusCode::UNAUTHORIZED, error);
            let ask = [(header::WWW_AUTHENTICATE, "Bearer realm=\"escarp\"")];
            (ask, problem).into_response()
        }
        Denied::WrongToken | Denied::Origin => {
            let error = format!("this token does not open `{dataset}`");
            Problem::plain(StatusCode::FORBIDDEN, error).into_response()
        }
    }
}

/// Says which web pages may read an answer, and which caches may keep it.
fn label(response: &mut Response, caller: &Caller, dataset: Option<&str>) {
    let headers = response.headers_mut();
    let (origin, depends) = caller.allowed_origin(dataset);
    match origin {
        Some(origin) => headers.insert(header::ACCESS_CONTROL_ALLOW_ORIGIN, origin),
        None => headers.remove(header::ACCESS_CONTROL_ALLOW_ORIGIN),
    };
    if depends {
        headers.append(header::VARY, HeaderValue::from_static("Origin"));
    }
    if dataset.is_some_and(|dataset| caller.needs_token(dataset)) {
        // Shared caches do not tell tokens apart.
        let kept = headers
            .get(header::CACHE_CONTROL)
            .and_then(|value| value.to_str().ok());
        let rules = kept.unwrap_or("no-cache").split(',').map(str::trim);
        let own = rules.filter(|rule| *rule != "public" && !rule.starts_with("s-maxage"));
        let private = ["private"]
            .into_iter()
            .chain(own)
            .collect::<Vec<_>>()
            .join(", ");
        if let Ok(private) = private.parse() {
            headers.insert(header::CACHE_CONTROL, private);
        }
        headers.append(header::VARY, HeaderValue::from_static("Authorization"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_dataset_of_an_address_is_its_first_part_decoded() {
        let is = |path, name: Option<&str>| assert_eq!(dataset_of(path).as_deref(), name, "{path}");
        is("/moon", Some("moon"));
        is("/moon/page/0/0/0", Some("moon"));
        is("/Gr%C3%BC%c3%9fe%201/manifest", Some("Grüße 1"));
        is("/a%2Fb%/x", Some("a/b%"));
        is("/datasets", None);
        is("/", None);
        is("*", None);
    }

    #[test]
    fn a_request_keeps_its_name_if_that_can_stand_in_a_log() {
        let gate = Gate::new(&Limits::default(), Arc::default());
        let id = |given: &'static str| {
            let headers = HeaderMap::from_iter([(
                REQUEST_ID.parse().unwrap(),
                HeaderValue::from_static(given),
            )]);
            gate.id(&headers)
        };
        assert_eq!(id("a-B_3.x"), "a-B_3.x");
        let long = "x".repeat(MAX_ID + 1);
        let made: Vec<_> = ["", "a b", "a\"b", "a\tb", long.leak()].map(id).into();
        let distinct: std::collections::HashSet<_> = made.iter().collect();
        assert_eq!(distinct.len(), made.len());
        assert!(
            made.iter()
                .all(|id| id.to_str().unwrap().starts_with(&gate.run))
        );
    }
}
