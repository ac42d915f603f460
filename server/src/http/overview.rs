//! `/{name}/overview.png`: a dataset at a glance. A picture is drawn once and kept.

use super::App;
use super::heights::{Gates, Query, Refused, png};
use crate::heights::{CoordinateKind, Frame, Pages, Work, overview as draw};
use crate::source::GenerationId;
use axum::extract::{Extension, Path, RawQuery, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use image::ExtendedColorType;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

/// Width unless told otherwise.
pub(super) const WIDTH_PX: u32 = 640;
/// Bytes of all pictures that are kept.
const KEPT_BYTES: usize = 32 << 20;

type Key = (String, GenerationId, u32);

/// The pictures drawn last.
#[derive(Default)]
pub(super) struct Cache(Mutex<VecDeque<(Key, Bytes)>>);

impl Cache {
    fn get(&self, key: &Key) -> Option<Bytes> {
        let kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let found = kept.iter().find(|(known, _)| known == key);
        found.map(|(_, png)| png.clone())
    }

    /// Keeps a picture, and as many of those before it as there is room for.
    fn put(&self, key: Key, png: Bytes) {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        kept.retain(|(known, _)| *known != key);
        kept.push_back((key, png));
        let bytes = |kept: &VecDeque<(Key, Bytes)>| kept.iter().map(|(_, png)| png.len()).sum();
        let mut total: usize = bytes(&kept);
        while total > KEPT_BYTES {
            let Some((_, dropped)) = kept.pop_front() else {
                break;
            };
            total -= dropped.len();
        }
    }
}

pub(super) async fn overview(
    State(app): State<App>,
    Extension(gates): Extension<Arc<Gates>>,
    Extension(cache): Extension<Arc<Cache>>,
    Path(name): Path<String>,
    RawQuery(query): RawQuery,
    headers: HeaderMap,
) -> Result<Response, Refused> {
    let source = app.hosted(&name)?.source();
    let query = Query::parse(query, &["width"])?;
    let width_px = query.whole("width")?.unwrap_or(WIDTH_PX);
    let id = source.generation_id();
    let tag = format!("\"{id}-{width_px}\"");
    let caching = [
        (header::ETAG, tag.clone()),
        (header::CACHE_CONTROL, "no-cache".into()),
    ];
    let given = headers.get(header::IF_NONE_MATCH);
    if given.and_then(|given| given.to_str().ok()) == Some(tag.as_str()) {
        return Ok((StatusCode::NOT_MODIFIED, caching).into_response());
    }
    let key = (name, id, width_px);
    let png = match cache.get(&key) {
        Some(png) => png,
        None => {
            let limits = app.limits.heights.clone();
            let drawn = gates.image(move |cancelled| {
                let work = Work::new(limits.pages, 0, cancelled);
                let mut pages = Pages::new(&*source, work);
                let frame = Frame::of(source.manifest(), CoordinateKind::Native)?;
                let drawn = draw(&mut pages, &frame, width_px, &limits)?;
                png(&drawn.rgba, drawn.size_px, ExtendedColorType::Rgba8)
            });
            let png = Bytes::from(drawn.await?);
            cache.put(key, png.clone());
            png
        }
    };
    let kind = [(header::CONTENT_TYPE, "image/png")];
    Ok((caching, kind, png).into_response())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_pictures_make_room() {
        let cache = Cache::default();
        let id = "1-00000000".parse().unwrap();
        let key = |width| ("moon".to_owned(), id, width);
        let third = Bytes::from(vec![0; KEPT_BYTES / 3]);
        for width in 1..=4 {
            cache.put(key(width), third.clone());
        }
        assert_eq!(cache.get(&key(1)), None);
        assert!((2..=4).all(|width| cache.get(&key(width)).is_some()));
    }
}
