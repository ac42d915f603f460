//! The HTTP addresses: datasets, manifests, pages, and the way into a session.

mod describe;
mod heights;
mod index;
mod overview;
mod page;
mod problem;

use crate::catalog::{Catalog, Hosted};
use crate::limits::Limits;
use crate::socket::{self, Sessions};
use axum::Router;
use axum::extract::{Path, Request, State};
use axum::http::{HeaderMap, Method, StatusCode, header};
use axum::response::{IntoResponse, Json, Response};
use axum::routing::get;
use describe::{Dataset, Datasets};
pub(crate) use problem::Problem;
use std::sync::Arc;

/// What every handler needs.
#[derive(Clone)]
pub(crate) struct App {
    pub catalog: Arc<Catalog>,
    pub sessions: Sessions,
    pub limits: Arc<Limits>,
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
    Router::new()
        .route("/", get(index::index))
        .route("/healthz", get(async || "ok\n"))
        .route("/datasets", get(datasets))
        .route("/session", get(socket::upgrade))
        .route("/{name}", get(dataset))
        .route("/{name}/manifest", get(manifest))
        .route("/{name}/page/{level}/{x}/{y}", get(page::page))
        .merge(heights::routes(&app.limits.heights))
        .fallback(unknown)
        .method_not_allowed_fallback(wrong_method)
        .with_state(app)
}

async fn datasets(State(app): State<App>, headers: HeaderMap) -> Json<Datasets> {
    let host = host(&headers);
    let describe = |hosted: &Arc<Hosted>| Dataset::of(hosted, host);
    Json(Datasets {
        datasets: app.catalog.all().iter().map(describe).collect(),
    })
}

async fn dataset(
    State(app): State<App>,
    Path(name): Path<String>,
    headers: HeaderMap,
) -> Result<Json<Dataset>, Problem> {
    let hosted = app.hosted(&name)?;
    Ok(Json(Dataset::of(&hosted, host(&headers))))
}

async fn manifest(
    State(app): State<App>,
    Path(name): Path<String>,
) -> Result<impl IntoResponse, Problem> {
    let source = app.hosted(&name)?.source();
    let headers = [
        (header::CONTENT_TYPE, "application/json"),
        (header::CACHE_CONTROL, "no-cache"),
    ];
    Ok((headers, source.manifest_json().to_vec()))
}

async fn unknown(State(app): State<App>, request: Request) -> Response {
    Problem::unknown(&app, request.uri().path()).into_response()
}

async fn wrong_method(method: Method) -> Response {
    not_allowed(&method, &["GET", "HEAD"])
}

/// Status 405, with the methods that there are.
fn not_allowed(method: &Method, allowed: &[&str]) -> Response {
    let problem = Problem {
        status: StatusCode::METHOD_NOT_ALLOWED,
        error: format!("this address does not {method}"),
        allowed: allowed.iter().map(|&method| method.into()).collect(),
        datasets: Vec::new(),
    };
    ([(header::ALLOW, allowed.join(", "))], problem).into_response()
}

/// The server's host and port as the client addressed it.
fn host(headers: &HeaderMap) -> &str {
    let host = headers
        .get(header::HOST)
        .and_then(|host| host.to_str().ok());
    host.unwrap_or("localhost")
}
