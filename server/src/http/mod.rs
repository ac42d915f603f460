//! The HTTP addresses: datasets, manifests, pages, and the way into a session.

mod address;
mod conditions;
mod cors;
mod data;
mod describe;
mod give;
mod heights;
mod index;
mod kept;
mod openapi;
mod overview;
mod problem;
mod service;

use crate::access::{Caller, Gate, guard};
use crate::catalog::{Catalog, Hosted};
use crate::health::{self, Health};
use crate::limits::Limits;
use crate::socket::{self, Sessions};
use axum::extract::{Extension, Path, Request, State};
use axum::http::{HeaderMap, Method, StatusCode, header};
use axum::middleware::map_response;
use axum::response::{IntoResponse, Json, Response};
use axum::routing::get;
use axum::{Router, middleware};
use describe::{Dataset, Datasets};
pub(crate) use kept::Kept;
pub(crate) use problem::Problem;
pub(crate) use service::Service;
use std::sync::Arc;

/// What every handler needs.
#[derive(Clone)]
pub(crate) struct App {
    pub catalog: Arc<Catalog>,
    pub sessions: Sessions,
    pub gate: Arc<Gate>,
    pub health: Arc<Health>,
    /// Whether `/metrics` is here, and not on an address of its own.
    pub counted: bool,
    pub limits: Arc<Limits>,
    pub kept: Arc<Kept>,
}

impl App {
    /// The dataset of a name.
    ///
    /// # Errors
    /// Status 404 if there is none.
    pub(crate) fn hosted(&self, name: &str) -> Result<Arc<Hosted>, Problem> {
        let found = self.catalog.get(name);
        found.ok_or_else(|| Problem::no_dataset(self, name))
    }
}

/// All addresses.
pub(crate) fn router(app: App) -> Router {
    let gate = app.gate.clone();
    Router::new()
        .merge(health::routes(app.counted))
        .route("/", get(index::index))
        .route("/openapi.json", get(openapi::openapi))
        .route("/datasets", get(datasets))
        .route("/session", get(socket::upgrade))
        .route("/{name}", get(dataset))
        .route("/{name}/current", get(data::current))
        .route("/{name}/manifest", get(data::data))
        .route("/{name}/page/{level}/{x}/{y}", get(data::data))
        .route("/{name}/pack/{level}/{x}/{y}", get(data::data))
        .route("/{name}/{generation}/manifest", get(data::data))
        .route("/{name}/{generation}/page/{level}/{x}/{y}", get(data::data))
        .route("/{name}/{generation}/pack/{level}/{x}/{y}", get(data::data))
        .merge(heights::routes(&app.limits.heights))
        .fallback(unknown)
        .method_not_allowed_fallback(wrong_method)
        .layer(map_response(cors::labelled))
        .with_state(app)
        .layer(middleware::from_fn_with_state(gate, guard))
}

async fn datasets(
    State(app): State<App>,
    Extension(caller): Extension<Caller>,
    headers: HeaderMap,
) -> Response {
    let host = host(&headers);
    let describe = |hosted: &Arc<Hosted>| Dataset::of(hosted, &caller, host);
    let all = app.catalog.all();
    let seen = all.iter().filter(|hosted| caller.sees(hosted.name()));
    let datasets = seen.map(describe).collect();
    described(Datasets { datasets })
}

/// What may be otherwise with the next generation, and names the server as this client does.
fn described(what: impl serde::Serialize) -> Response {
    let caching = [(header::CACHE_CONTROL, "no-cache"), (header::VARY, "host")];
    (caching, Json(what)).into_response()
}

async fn dataset(
    State(app): State<App>,
    Extension(caller): Extension<Caller>,
    Path(name): Path<String>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let hosted = app.hosted(&name)?;
    Ok(described(Dataset::of(&hosted, &caller, host(&headers))))
}

async fn unknown(State(app): State<App>, request: Request) -> Response {
    match *request.method() {
        // A browser that may not ask could not read what is wrong.
        Method::OPTIONS => cors::options(),
        _ => Problem::unknown(&app, request.uri().path()).into_response(),
    }
}

async fn wrong_method(method: Method) -> Response {
    if method == Method::OPTIONS {
        return cors::options();
    }
    not_allowed(&method, cors::METHODS)
}

/// Status 405, with the methods that there are.
fn not_allowed(method: &Method, allowed: &'static str) -> Response {
    let problem = Problem {
        allowed: allowed.split(", ").map(Into::into).collect(),
        ..Problem::plain(
            StatusCode::METHOD_NOT_ALLOWED,
            format!("this address does not {method}"),
        )
    };
    ([(header::ALLOW, allowed)], problem).into_response()
}

/// The server's host and port as the client addressed it.
fn host(headers: &HeaderMap) -> &str {
    let host = headers
        .get(header::HOST)
        .and_then(|host| host.to_str().ok());
    host.unwrap_or("localhost")
}
