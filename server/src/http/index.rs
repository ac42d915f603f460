//! `/`: what is hosted, for people: a page for browsers, a text for terminals.

mod page;

use super::{App, host};
use crate::access::Caller;
use crate::catalog::{Hosted, percent_encoded};
use axum::extract::{Extension, State};
use axum::http::{HeaderMap, header};
use axum::response::{Html, IntoResponse, Response};
use std::sync::Arc;

pub(super) async fn index(
    State(app): State<App>,
    Extension(caller): Extension<Caller>,
    headers: HeaderMap,
) -> Response {
    let host = host(&headers);
    let mut hosted = app.catalog.all();
    hosted.retain(|hosted| caller.sees(hosted.name()));
    let schemes = match caller.secure {
        true => ["https", "wss"],
        false => ["http", "ws"],
    };
    let vary = [
        (header::VARY, "accept"),
        (header::CACHE_CONTROL, "no-cache"),
    ];
    if prefers_html(&headers) {
        let policy = [(header::CONTENT_SECURITY_POLICY, page::policy())];
        let page = page::page(&hosted, host, schemes);
        return (vary, policy, Html(page)).into_response();
    }
    (vary, text(&hosted, host, schemes)).into_response()
}

fn text(hosted: &[Arc<Hosted>], host: &str, [http, ws]: [&str; 2]) -> String {
    let mut text = format!(
        "This is an Escarp terrain server.\n\n\
         Look at a dataset:    escarp-client view {http}://{host}/NAME\n\
         List the datasets:    {http}://{host}/datasets\n\
         Heights for programs: {http}://{host}/NAME/heights?lon=..&lat=.. and more, described in\n\
         \x20                     {http}://{host}/openapi.json\n\
         Stream in a program:  {ws}://{host}/session (proto/PROTOCOL.md in Escarp's source)\n\n\
         Datasets:\n"
    );
    for hosted in hosted {
        text += &format!("  {http}://{host}/{}\n", percent_encoded(hosted.name()));
    }
    text
}

/// Whether HTML is named, and no less welcome than text (RFC 9110, section 12.5.1).
fn prefers_html(headers: &HeaderMap) -> bool {
    let lists = headers.get_all(header::ACCEPT).iter();
    let lists = lists.filter_map(|list| list.to_str().ok());
    let (mut html, mut text): (f64, f64) = (0.0, 0.0);
    for range in lists.flat_map(|list| list.split(',')) {
        let mut words = range.split(';').map(str::trim);
        let kind = words.next().unwrap_or_default();
        let quality = words.find_map(|word| word.strip_prefix("q=")?.parse().ok());
        let quality: f64 = quality.unwrap_or(1.0);
        match kind.to_ascii_lowercase().as_str() {
            "text/html" | "application/xhtml+xml" => html = html.max(quality),
            "text/plain" => text = text.max(quality),
            _ => {}
        }
    }
    html > 0.0 && html >= text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn browsers_get_html_and_others_text() {
        let prefers = |accept: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::ACCEPT, accept.parse().unwrap());
            prefers_html(&headers)
        };
        assert!(prefers(
            "text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8"
        ));
        assert!(prefers("TEXT/HTML"));
        for accept in [
            "*/*",
            "text/plain",
            "text/html;q=0",
            "text/html;q=0.5, text/plain",
            "",
        ] {
            assert!(!prefers(accept), "{accept}");
        }
        assert!(!prefers_html(&HeaderMap::new()));
    }
}
