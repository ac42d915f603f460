//! A dataset's bytes: manifests, pages and packs, each at an address that never changes its
//! content, and at one that always has the newest.
//!
//! Whatever is in the system's memory is answered at once, on the thread that read the request.

use super::address::{Address, Place, What};
use super::conditions::{Verdict, verdict};
use super::{App, Problem, cors};
use crate::catalog::{Hosted, percent_encoded};
use crate::source::{AtOnce, GenerationId, PageSource, SourceError};
use axum::body::{Body, Bytes};
use axum::extract::{Path, Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use escarp_proto::geometry::{GridLevels, PAGE_LEVELS, PageId};
use serde_json::json;
use std::sync::Arc;

/// Of what a generation has: it is so for ever.
const IMMUTABLE: &str = "public, max-age=31536000, immutable";
/// Of what has another content in the next generation: caches may keep it, but have to ask.
const REVALIDATED: &str = "no-cache";
/// Of what says which generation is current: caches keep it for a moment.
const BRIEF: &str = "public, max-age=5, must-revalidate";

/// The checksum that names a content, and the content.
type Content = (u32, Bytes);

/// What is asked for, of a generation that is hosted.
struct Asked {
    source: Arc<dyn PageSource>,
    what: Thing,
    /// Whether the address names the generation.
    immutable: bool,
}

#[derive(Clone, Copy)]
enum Thing {
    Manifest,
    Page(PageId),
    Pack(PageId),
}

/// Answers a request for a dataset's bytes.
pub(super) async fn data(State(app): State<App>, request: Request) -> Response {
    let asked = match asked(&app, request.uri().path()) {
        Ok(Some(asked)) => asked,
        Ok(None) => return Problem::unknown(&app, request.uri().path()).into_response(),
        Err(problem) => return problem.into_response(),
    };
    let content = match asked.at_once() {
        Some(content) => content,
        None => asked.wait().await,
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
    let content = asked.at_once()?.ok()??;
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
    let (method, headers) = (request.method(), request.headers());
    let kind = "application/json";
    let tag = format!("\"{id}\"");
    Ok(give(method, headers, (tag, kind, BRIEF), body.into()))
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
    let source = hosted.source();
    if let Some(id) = address.generation
        && !names(id, source.generation_id())
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
        source,
        immutable: address.generation.is_some(),
    }))
}

/// Whether a text is this id.
fn names(text: &str, id: GenerationId) -> bool {
    text.parse() == Ok(id)
}

impl Asked {
    /// What is asked for, if that is in memory.
    fn at_once(&self) -> Option<Result<Option<Content>, SourceError>> {
        let source = self.source.as_ref();
        match self.what {
            Thing::Manifest => {
                let json = Bytes::copy_from_slice(source.manifest_json());
                Some(Ok(Some((source.generation_id().checksum, json))))
            }
            Thing::Page(page) => content(source.record_at_once(page), |r| (r.revision, r.bytes)),
            Thing::Pack(page) => content(source.pack_at_once(page), |p| (p.checksum, p.bytes)),
        }
    }

    /// What is asked for, read off the async threads.
    async fn wait(&self) -> Result<Option<Content>, SourceError> {
        let (source, what) = (self.source.clone(), self.what);
        let read = move || match what {
            Thing::Page(page) => Ok(source.record(page)?.map(|r| (r.revision, r.bytes))),
            Thing::Pack(page) => Ok(source.pack(page)?.map(|p| (p.checksum, p.bytes))),
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
        let (kind, subject) = match self.what {
            Thing::Manifest => ("application/json", "the manifest".to_owned()),
            Thing::Page(page) => (BYTES, format!("page {page}")),
            Thing::Pack(page) => (BYTES, format!("the children of page {page}")),
        };
        let caching = if self.immutable {
            IMMUTABLE
        } else {
            REVALIDATED
        };
        match content {
            Ok(Some((checksum, bytes))) => {
                let tag = format!("\"{checksum:08x}\"");
                give(method, headers, (tag, kind, caching), bytes)
            }
            Ok(None) => {
                let text =
                    format!("no record is stored for {subject}: it is flat, empty, or no data");
                let problem = Problem::plain(StatusCode::NOT_FOUND, text);
                // That, too, is so for ever.
                ([(header::CACHE_CONTROL, caching)], problem).into_response()
            }
            Err(error) => {
                tracing::debug!(subject, %error, "not sent");
                let text = format!("{subject}: {}", for_clients(&error));
                let status = StatusCode::INTERNAL_SERVER_ERROR;
                Problem::plain(status, text).into_response()
            }
        }
    }
}

const BYTES: &str = "application/octet-stream";

fn content<T>(
    found: AtOnce<T>,
    of: impl Fn(T) -> Content,
) -> Option<Result<Option<Content>, SourceError>> {
    Some(found?.map(|found| found.map(of)))
}

/// Where files lie is the host's business.
fn for_clients(error: &SourceError) -> &'static str {
    match error {
        SourceError::Damaged { .. } => "damaged on the server",
        SourceError::Read { .. } => "cannot be read on the server",
    }
}

/// Gives a content, or as much of it as the request's conditions allow.
fn give(
    method: &Method,
    headers: &HeaderMap,
    (tag, kind, caching): (String, &'static str, &'static str),
    bytes: Bytes,
) -> Response {
    let length = bytes.len();
    let verdict = verdict(method, headers, &tag, length);
    let (status, body) = match &verdict {
        Verdict::Whole => (StatusCode::OK, bytes),
        Verdict::Part(range) => (StatusCode::PARTIAL_CONTENT, bytes.slice(range.clone())),
        Verdict::NotModified => (StatusCode::NOT_MODIFIED, Bytes::new()),
        Verdict::PreconditionFailed => return precondition_failed(&tag),
        Verdict::NotSatisfiable => return not_satisfiable(length),
    };
    let mut response = Response::new(Body::from(body));
    *response.status_mut() = status;
    let own = response.headers_mut();
    let tag = HeaderValue::try_from(tag);
    own.extend(tag.map(|tag| (header::ETAG, tag)));
    own.insert(header::CACHE_CONTROL, HeaderValue::from_static(caching));
    if status != StatusCode::NOT_MODIFIED {
        own.insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
        own.insert(header::ACCEPT_RANGES, HeaderValue::from_static("bytes"));
    }
    if let Verdict::Part(range) = verdict {
        let part = format!("bytes {}-{}/{length}", range.start, range.end - 1);
        let part = HeaderValue::try_from(part);
        own.extend(part.map(|part| (header::CONTENT_RANGE, part)));
    }
    response
}

fn precondition_failed(tag: &str) -> Response {
    let text = format!("it is {tag}, not what If-Match names");
    Problem::plain(StatusCode::PRECONDITION_FAILED, text).into_response()
}

fn not_satisfiable(length: usize) -> Response {
    let text = format!("there are {length} bytes, and none in that range");
    let problem = Problem::plain(StatusCode::RANGE_NOT_SATISFIABLE, text);
    let range = [(header::CONTENT_RANGE, format!("bytes */{length}"))];
    (range, problem).into_response()
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
