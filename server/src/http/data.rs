//! A dataset's bytes: manifests, pages and packs, each at an address that never changes its
//! content, and at one that always has the newest.
//!
//! Whatever is in the system's memory is answered at once, on the thread that read the request.

use super::address::{Address, Place, What};
use super::give::give;
use super::kept::{Content, Thing};
use super::{App, Problem, cors};
use crate::catalog::{Hosted, percent_encoded};
use crate::published::Published;
use crate::source::{AtOnce, GenerationId, SourceError};
use axum::body::Bytes;
use axum::extract::{Path, Request, State};
use axum::http::{HeaderMap, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use escarp_proto::geometry::{GridLevels, PAGE_LEVELS};
use serde_json::json;
use std::sync::Arc;

/// Of what a generation has: it is so for ever.
const IMMUTABLE: &str = "public, max-age=31536000, immutable";
/// Of what has another content in the next generation: caches may keep it, but have to ask.
const REVALIDATED: &str = "no-cache";
/// Of what says which generation is current: caches keep it for a moment.
const BRIEF: &str = "public, max-age=5, must-revalidate";

const BYTES: &str = "application/octet-stream";
const JSON: &str = "application/json";

/// What is asked for, of a generation that is hosted.
struct Asked {
    published: Arc<Published>,
    what: Thing,
    /// Whether the address names the generation.
    immutable: bool,
}

/// Answers a request for a dataset's bytes.
pub(super) async fn data(State(app): State<App>, request: Request) -> Response {
    let asked = match asked(&app, request.uri().path()) {
        Ok(Some(asked)) => asked,
        Ok(None) => return Problem::unknown(&app, request.uri().path()).into_response(),
        Err(problem) => return problem.into_response(),
    };
    let content = match asked.at_once(&app) {
        Some(content) => content,
        None => asked.kept(&app, asked.wait().await),
    };
    asked.answer(request.method(), request.headers(), content)
}

/// As [`data`], if the answer is at hand, and nothing is wrong.
pub(super) fn at_once<B>(app: &App, request: &axum::http::Request<B>) -> Option<Response> {
    let method = request.method();
    if method != Method::GET && method != Method::HEAD {
        return None;
    }
    let asked = asked(app, request.uri().path()).ok()??;
    let content = asked.at_once(app)?.ok()??;
    let mut response = asked.answer(method, request.headers(), Ok(Some(content)));
    cors::label(response.headers_mut());
    Some(response)
}

/// `/{name}/current`: which generation is current, and where its bytes are.
pub(super) async fn current(
    State(app): State<App>,
    Path(name): Path<String>,
    request: Request,
) -> Result<Response, Problem> {
    let hosted = app.hosted(&name)?;
    let id = hosted.source().generation_id();
    let body = serde_json::to_vec(&addresses(&hosted, id)).unwrap_or_default();
    let content = Content::named(&id.to_string(), body.into());
    let (method, headers) = (request.method(), request.headers());
    Ok(give(method, headers, content, (JSON, BRIEF)))
}

/// Paths, so that they are the same for every client, whatever proxies stand between.
fn addresses(hosted: &Hosted, id: GenerationId) -> serde_json::Value {
    let base = format!("/{}/{id}", percent_encoded(hosted.name()));
    json!({
        "name": hosted.name(),
        "generation": id.generation,
        "id": id.to_string(),
        "manifest": format!("{base}/manifest"),
        "page": format!("{base}/page/{{level}}/{{x}}/{{y}}"),
        "pack": format!("{base}/pack/{{level}}/{{x}}/{{y}}"),
    })
}

/// What a path asks for; `None` if it is no address of a dataset's bytes.
fn asked(app: &App, path: &str) -> Result<Option<Asked>, Problem> {
    let Some(address) = Address::parse(path) else {
        return Ok(None);
    };
    let hosted = app.hosted(&address.name)?;
    let published = hosted.published();
    let source = published.source();
    if let Some(id) = address.generation
        && id != published.id()
    {
        return Err(not_current(&hosted, id, source.generation_id()));
    }
    let levels = source.manifest().grid_levels;
    let page = |place: Place<'_>| {
        let page = place.page().filter(|&page| levels.holds(page));
        page.ok_or_else(|| no_page(&place.0.join("/"), levels))
    };
    let what = match address.what {
        What::Manifest => Thing::Manifest,
        What::Page(place) => Thing::Page(page(place)?),
        What::Pack(place) => Thing::Pack(page(place)?),
    };
    Ok(Some(Asked {
        what,
        published,
        immutable: address.generation.is_some(),
    }))
}

impl Asked {
    /// What is asked for, if that is in memory.
    fn at_once(&self, app: &App) -> Option<Result<Option<Content>, SourceError>> {
        let known = app.kept.get(self.published.number(), self.what);
        if known.is_some() {
            return Some(Ok(known));
        }
        let source = self.published.source().as_ref();
        let found = match self.what {
            Thing::Manifest => {
                let json = Bytes::copy_from_slice(source.manifest_json());
                Some(Ok(Some(Content::of(source.generation_id().checksum, json))))
            }
            Thing::Page(page) => content(source.record_at_once(page), |r| (r.revision, r.bytes)),
            Thing::Pack(page) => content(source.pack_at_once(page), |p| (p.checksum, p.bytes)),
        };
        found.map(|found| self.kept(app, found))
    }

    /// The same; it is kept for those who ask for it next.
    fn kept(
        &self,
        app: &App,
        found: Result<Option<Content>, SourceError>,
    ) -> Result<Option<Content>, SourceError> {
        if let Ok(Some(content)) = &found {
            app.kept.keep(self.published.number(), self.what, content);
        }
        found
    }

    /// What is asked for, read off the async threads.
    async fn wait(&self) -> Result<Option<Content>, SourceError> {
        let (source, what) = (self.published.source().clone(), self.what);
        let read = move || match what {
            Thing::Page(page) => Ok(source
                .record(page)?
                .map(|r| Content::of(r.revision, r.bytes))),
            Thing::Pack(page) => Ok(source.pack(page)?.map(|p| Content::of(p.checksum, p.bytes))),
            // It is always at hand.
            Thing::Manifest => Ok(None),
        };
        let read = tokio::task::spawn_blocking(read).await;
        read.unwrap_or_else(|error| {
            Err(SourceError::Read {
                file: "the dataset".into(),
                why: error.to_string(),
            })
        })
    }

    fn answer(
        &self,
        method: &Method,
        headers: &HeaderMap,
        content: Result<Option<Content>, SourceError>,
    ) -> Response {
        let kind = match self.what {
            Thing::Manifest => JSON,
            Thing::Page(_) | Thing::Pack(_) => BYTES,
        };
        let caching = if self.immutable {
            IMMUTABLE
        } else {
            REVALIDATED
        };
        match content {
            Ok(Some(content)) => give(method, headers, content, (kind, caching)),
            Ok(None) => {
                let subject = self.subject();
                let text =
                    format!("no record is stored for {subject}: it is flat, empty, or no data");
                let problem = Problem::plain(StatusCode::NOT_FOUND, text);
                // That, too, is so for ever.
                ([(header::CACHE_CONTROL, caching)], problem).into_response()
            }
            Err(error) => {
                let subject = self.subject();
                tracing::debug!(subject, %error, "not sent");
                let text = format!("{subject}: {}", for_clients(&error));
                let status = StatusCode::INTERNAL_SERVER_ERROR;
                Problem::plain(status, text).into_response()
            }
        }
    }

    /// What is asked for, in words.
    fn subject(&self) -> String {
        match self.what {
            Thing::Manifest => "the manifest".into(),
            Thing::Page(page) => format!("page {page}"),
            Thing::Pack(page) => format!("the children of page {page}"),
        }
    }
}

fn content<T>(
    found: AtOnce<T>,
    of: impl Fn(T) -> (u32, Bytes),
) -> Option<Result<Option<Content>, SourceError>> {
    let content = |found| {
        let (checksum, bytes) = of(found);
        Content::of(checksum, bytes)
    };
    Some(found?.map(|found| found.map(content)))
}

/// Where files lie is the host's business.
fn for_clients(error: &SourceError) -> &'static str {
    match error {
        SourceError::Damaged { .. } => "damaged on the server",
        SourceError::Read { .. } => "cannot be read on the server",
    }
}

/// Status 410 for a generation that was, 404 for one that is not known; with the current one.
fn not_current(hosted: &Hosted, given: &str, current: GenerationId) -> Problem {
    let past = given
        .parse()
        .is_ok_and(|id: GenerationId| id.generation <= current.generation);
    let (status, is) = match past {
        true => (StatusCode::GONE, "is not hosted any more"),
        false => (StatusCode::NOT_FOUND, "is not known here"),
    };
    Problem {
        current: Some(addresses(hosted, current)),
        ..Problem::plain(status, format!("generation `{given}` {is}"))
    }
}

fn no_page(address: &str, levels: GridLevels) -> Problem {
    let finest = levels.finest_page_level();
    let starts = (0..=finest)
        .step_by(PAGE_LEVELS.into())
        .map(|level| level.to_string());
    Problem {
        allowed: vec![
            format!("level: {}", starts.collect::<Vec<_>>().join(", ")),
            "x, y: from 0 to 2^level - 1, from the south-west".into(),
        ],
        ..Problem::plain(
            StatusCode::NOT_FOUND,
            format!("`{address}` is no page's level/x/y"),
        )
    }
}
