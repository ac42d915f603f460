//! What browsers ask before a page of another site may read an answer (the Fetch Standard,
//! section 3.2). Everything here is read-only, so every page may, unless the configuration says
//! otherwise: whoever restricts origins replaces `Access-Control-Allow-Origin` of the answer.

use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// What can be done to an address.
pub(super) const METHODS: &str = "GET, HEAD, OPTIONS";
/// Headers that a request may have, beyond those that need no question.
const REQUEST_HEADERS: &str =
    "Authorization, Content-Type, If-Match, If-None-Match, If-Range, Range";
/// Headers of an answer that a page may see, beyond those that it always may.
const ANSWER_HEADERS: &str = "Accept-Ranges, Content-Range, ETag, Retry-After, Escarp-Corners, \
     Escarp-Error-M, Escarp-Generation, Escarp-Ground-M, Escarp-Spacing-M, Escarp-Vertical";
/// For how long the answer to the question holds, seconds.
const PREFLIGHT_S: &str = "86400";

/// Lets pages of all sites read an answer.
pub(super) fn label(headers: &mut HeaderMap) {
    let any = HeaderValue::from_static("*");
    headers.insert(header::ACCESS_CONTROL_ALLOW_ORIGIN, any);
    let seen = HeaderValue::from_static(ANSWER_HEADERS);
    headers.insert(header::ACCESS_CONTROL_EXPOSE_HEADERS, seen);
}

/// The same, of a whole answer.
pub(super) async fn labelled(mut response: Response) -> Response {
    label(response.headers_mut());
    response
}

/// The answer to OPTIONS, a browser's question before the request or not.
pub(super) fn options() -> Response {
    let headers = [
        (header::ALLOW, METHODS),
        (header::ACCESS_CONTROL_ALLOW_METHODS, METHODS),
        (header::ACCESS_CONTROL_ALLOW_HEADERS, REQUEST_HEADERS),
        (header::ACCESS_CONTROL_MAX_AGE, PREFLIGHT_S),
    ];
    (StatusCode::NO_CONTENT, headers).into_response()
}
