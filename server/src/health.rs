//! Whether the server is alive, whether it is ready, and what it counts: for machines that watch.

use crate::http::App;
use crate::metrics::{CONTENT_TYPE, Stand};
use axum::Router;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Json, Response};
use axum::routing::get;
use serde::Serialize;
use std::sync::atomic::{AtomicBool, Ordering};

/// What `/readyz` goes by.
#[derive(Debug, Default)]
pub(crate) struct Health {
    draining: AtomicBool,
}

impl Health {
    /// From now on the server is going down.
    pub(crate) fn drain(&self) {
        self.draining.store(true, Ordering::Relaxed);
    }
}

/// The answer of `/readyz`.
#[derive(Debug, Serialize)]
struct Readiness {
    ready: bool,
    /// Why not.
    reasons: Vec<&'static str>,
    datasets: usize,
}

/// Addresses for those who watch. `counted`: with `/metrics`.
pub(crate) fn routes(counted: bool) -> Router<App> {
    let router = Router::new()
        .route("/healthz", get(async || "ok\n"))
        .route("/readyz", get(readyz));
    match counted {
        true => router.route("/metrics", get(metrics)),
        false => router,
    }
}

/// The same on an address of its own, where names that need a token are told, too.
pub(crate) fn router(app: App) -> Router {
    Router::new()
        .route("/metrics", get(all_metrics))
        .merge(routes(false))
        .with_state(app)
}

async fn readyz(State(app): State<App>) -> Response {
    let datasets = app.catalog.names().len();
    let found = [
        (
            app.health.draining.load(Ordering::Relaxed),
            "the server is going down",
        ),
        (datasets == 0, "no dataset is open"),
    ];
    let reasons: Vec<_> = found
        .into_iter()
        .filter(|(is, _)| *is)
        .map(|(_, why)| why)
        .collect();
    let status = match reasons.is_empty() {
        true => StatusCode::OK,
        false => StatusCode::SERVICE_UNAVAILABLE,
    };
    let ready = reasons.is_empty();
    let readiness = Readiness {
        ready,
        reasons,
        datasets,
    };
    (status, Json(readiness)).into_response()
}

async fn metrics(State(app): State<App>) -> Response {
    let access = app.gate.access();
    rendered(&app, |dataset| !access.needs_token(dataset))
}

async fn all_metrics(State(app): State<App>) -> Response {
    rendered(&app, |_| true)
}

fn rendered(app: &App, shown: impl Fn(&str) -> bool) -> Response {
    let hosted = app.catalog.all();
    let shown = hosted.iter().filter(|hosted| shown(hosted.name()));
    let stand = |hosted: &std::sync::Arc<crate::Hosted>| {
        let source = hosted.source();
        Stand {
            dataset: hosted.name().to_owned(),
            generation: source.manifest().generation,
            pages: source.manifest().pages,
        }
    };
    let stands: Vec<_> = shown.map(stand).collect();
    match app.gate.metrics.render(&stands) {
        Ok(text) => ([(header::CONTENT_TYPE, CONTENT_TYPE)], text).into_response(),
        Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
    }
}
