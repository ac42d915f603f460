//! Answers to requests that cannot be granted: what was wrong, and what is allowed.

use super::App;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Json, Response};
use serde::Serialize;

/// The addresses of the server, for those who took a wrong one.
const ADDRESSES: [&str; 19] = [
    "/",
    "/healthz",
    "/readyz",
    "/metrics",
    "/datasets",
    "/openapi.json",
    "/{name}",
    "/{name}/current",
    "/{name}/{generation}/manifest",
    "/{name}/{generation}/page/{level}/{x}/{y}",
    "/{name}/{generation}/pack/{level}/{x}/{y}",
    "/{name}/manifest",
    "/{name}/page/{level}/{x}/{y}",
    "/{name}/heights",
    "/{name}/profile",
    "/{name}/sight",
    "/{name}/viewshed.png",
    "/{name}/overview.png",
    "/session (WebSocket)",
];

/// A JSON body for an error status.
#[derive(Debug, Serialize)]
pub(crate) struct Problem {
    #[serde(skip)]
    pub status: StatusCode,
    /// What is wrong, a sentence for people.
    pub error: String,
    /// What is allowed in its place.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub allowed: Vec<String>,
    /// The names of the datasets, where the name was wrong.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub datasets: Vec<String>,
    /// The current generation, where another one was named.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub current: Option<serde_json::Value>,
}

impl Problem {
    /// Status 404: there is no such address.
    pub(super) fn unknown(app: &App, path: &str) -> Problem {
        // Those that need a token are not told to those who might have none.
        let access = app.gate.access();
        let names = app.catalog.names().into_iter();
        let open = names.filter(|name| !access.needs_token(name));
        Problem {
            status: StatusCode::NOT_FOUND,
            error: format!("there is no {path} here"),
            allowed: ADDRESSES.map(Into::into).into(),
            datasets: open.collect(),
            current: None,
        }
    }

    /// Status 404: there is no such dataset.
    pub(super) fn no_dataset(app: &App, name: &str) -> Problem {
        Problem {
            error: format!("there is no dataset `{name}` here"),
            ..Problem::unknown(app, name)
        }
    }

    /// An error status with nothing to choose from.
    pub(crate) fn plain(status: StatusCode, error: impl Into<String>) -> Problem {
        Problem {
            status,
            error: error.into(),
            allowed: Vec::new(),
            datasets: Vec::new(),
            current: None,
        }
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        // What is wrong now may be right in a moment.
        let caching = [(header::CACHE_CONTROL, "no-store")];
        (self.status, caching, Json(self)).into_response()
    }
}
