//! Answers that have a content: all of it, a part, or only that the client has it.

use super::Problem;
use super::conditions::{Verdict, verdict};
use super::kept::Content;
use axum::body::{Body, Bytes};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// As many as an answer has, so that their table need not grow.
const HEADERS: usize = 8;

/// Gives a content of a media type, or as much of it as the request's conditions allow. `caching`
/// is what caches may do with it.
pub(super) fn give(
    method: &Method,
    headers: &HeaderMap,
    content: Content,
    (kind, caching): (&'static str, &'static str),
) -> Response {
    let Content { tag, bytes } = content;
    let length = bytes.len();
    let text = tag.to_str().unwrap_or_default();
    let verdict = verdict(method, headers, text, length);
    let (status, body) = match &verdict {
        Verdict::Whole => (StatusCode::OK, bytes),
        Verdict::Part(range) => (StatusCode::PARTIAL_CONTENT, bytes.slice(range.clone())),
        Verdict::NotModified => (StatusCode::NOT_MODIFIED, Bytes::new()),
        Verdict::PreconditionFailed => return precondition_failed(text),
        Verdict::NotSatisfiable => return not_satisfiable(length),
    };
    let mut response = Response::new(Body::from(body));
    *response.status_mut() = status;
    let own = response.headers_mut();
    own.reserve(HEADERS);
    own.insert(header::ETAG, tag);
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
