//! `/{name}/page/{level}/{x}/{y}`: a page's whole record, with its revision as ETag.

use super::{App, Problem};
use crate::source::PageSource;
use axum::body::Bytes;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use escarp_proto::geometry::{GridLevels, PAGE_LEVELS, PageId};
use std::sync::Arc;

type Address = (String, String, String, String);

/// The whole record of a page, read off the async threads.
pub(super) async fn page(
    State(app): State<App>,
    Path((name, level, x, y)): Path<Address>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let source = app.hosted(&name)?.source();
    let levels = source.manifest().grid_levels;
    let page = parse(&level, &x, &y)
        .filter(|&page| levels.holds(page))
        .ok_or_else(|| no_page(&format!("{level}/{x}/{y}"), levels))?;
    let (revision, record) = read(source.clone(), page).await?;
    let tag = format!("\"{revision:08x}\"");
    // The data at this address may be published anew: caches may keep it, but have to ask.
    let caching = [
        (header::ETAG, tag.clone()),
        (header::CACHE_CONTROL, "no-cache".into()),
    ];
    if has(&headers, &tag) {
        return Ok((StatusCode::NOT_MODIFIED, caching).into_response());
    }
    let kind = [(header::CONTENT_TYPE, "application/octet-stream")];
    Ok((caching, kind, record).into_response())
}

fn parse(level: &str, x: &str, y: &str) -> Option<PageId> {
    PageId::new(level.parse().ok()?, x.parse().ok()?, y.parse().ok()?)
}

fn no_page(address: &str, levels: GridLevels) -> Problem {
    let finest = levels.finest_page_level();
    let starts = (0..=finest)
        .step_by(PAGE_LEVELS.into())
        .map(|level| level.to_string());
    Problem {
        status: StatusCode::NOT_FOUND,
        error: format!("`{address}` is no page's level/x/y"),
        allowed: vec![
            format!("level: {}", starts.collect::<Vec<_>>().join(", ")),
            "x, y: from 0 to 2^level - 1, from the south-west".into(),
        ],
        datasets: Vec::new(),
    }
}

async fn read(source: Arc<dyn PageSource>, page: PageId) -> Result<(u32, Bytes), Problem> {
    let read = move || {
        let found = source.record(page)?;
        Ok(found.map(|record| (record.revision, record.bytes)))
    };
    let internal = |text: String| {
        tracing::debug!(%page, text, "record not sent");
        Problem::plain(
            StatusCode::INTERNAL_SERVER_ERROR,
            format!("page {page}: {text}"),
        )
    };
    tokio::task::spawn_blocking(read)
        .await
        .map_err(|error| internal(error.to_string()))?
        .map_err(|error: crate::source::SourceError| internal(error.to_string()))?
        .ok_or_else(|| {
            let text =
                format!("no record is stored for page {page}: it is flat, empty, or no data");
            Problem::plain(StatusCode::NOT_FOUND, text)
        })
}

/// Whether the client has the record with this tag (RFC 9110, section 13.1.2: weak comparison).
fn has(headers: &HeaderMap, tag: &str) -> bool {
    let lists = headers.get_all(header::IF_NONE_MATCH);
    lists
        .iter()
        .filter_map(|list| list.to_str().ok())
        .any(|list| {
            let mut tags = list.split(',').map(|tag| tag.trim());
            tags.any(|given| given == "*" || given.strip_prefix("W/").unwrap_or(given) == tag)
        })
}
