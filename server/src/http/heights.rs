//! Heights for programs: `/{name}/heights`, `/{name}/profile`, `/{name}/sight` and
//! `/{name}/viewshed.png`. What is computed is in [`crate::heights`]; here are its addresses.

mod answer;
mod gate;
mod points;
mod query;

use super::{App, Problem, overview};
use crate::heights::{
    self, CoordinateKind, Detail, Frame, GridPlace, HeightLimits, Pages, Spread, Work,
};
pub(super) use answer::png;
use answer::{About, Batch, Point, Profile, SightAnswer};
use axum::Router;
use axum::body::Body;
use axum::extract::{Extension, Path, RawQuery, State};
use axum::http::{HeaderMap, HeaderValue, Method, header};
use axum::response::{IntoResponse, Json, Response};
use axum::routing::get;
pub(super) use gate::{Gates, Refused};
pub(super) use query::Query;
use std::sync::Arc;

/// What can be done to the addresses that take lists of points.
const METHODS: &str = "GET, HEAD, POST, OPTIONS";
/// What every request about sight may say.
const SIGHTING: [&str; 6] = [
    "observer",
    "observer_height",
    "target_height",
    "crs",
    "curvature",
    "refraction",
];
/// Samples of a profile unless told otherwise.
const PROFILE_SAMPLES: usize = 100;
/// Pixels on a side of a viewshed unless told otherwise.
const VIEWSHED_SIDE_PX: u32 = 512;

/// The addresses, with the places of those who compute.
pub(crate) fn routes(limits: &HeightLimits) -> Router<App> {
    Router::new()
        .route(
            "/{name}/heights",
            get(point).post(batch).fallback(wrong_method),
        )
        .route(
            "/{name}/profile",
            get(profile).post(profile).fallback(wrong_method),
        )
        .route("/{name}/sight", get(sight))
        .route("/{name}/viewshed.png", get(viewshed))
        .route("/{name}/overview.png", get(overview::overview))
        .layer(Extension(Arc::new(overview::Cache::default())))
        .layer(Extension(Arc::new(Gates::new(limits))))
}

async fn wrong_method(method: Method) -> Response {
    if method != Method::OPTIONS {
        return super::not_allowed(&method, METHODS);
    }
    let mut response = super::cors::options();
    let methods = HeaderValue::from_static(METHODS);
    for name in [header::ALLOW, header::ACCESS_CONTROL_ALLOW_METHODS] {
        response.headers_mut().insert(name, methods.clone());
    }
    response
}

type Gate = Extension<Arc<Gates>>;

/// `GET /{name}/heights`: one point.
async fn point(
    State(app): State<App>,
    Extension(gates): Gate,
    Path(name): Path<String>,
    RawQuery(query): RawQuery,
) -> Result<Response, Refused> {
    let source = app.hosted(&name)?.source();
    let query = Query::parse(query, &["x", "y", "lon", "lat", "error", "resolution"])?;
    let (kind, point) = query.point()?;
    let detail = query.detail()?;
    let most = app.limits.heights.pages;
    let found = gates.request(move |cancelled| {
        let frame = Frame::of(source.manifest(), kind)?;
        let mut pages = Pages::new(&*source, Work::new(most, 0, cancelled));
        let place = frame.grid(point).and_then(|grid| frame.within(grid));
        let found = match place {
            Some(place) => heights::height_at(&mut pages, place, detail)?,
            None => None,
        };
        let about = About::of(&name, source.manifest(), kind);
        Ok(Point::of(about, point, found, source.manifest()))
    });
    Ok(Json(found.await?).into_response())
}

/// `POST /{name}/heights`: many points, as JSON or CSV; answered likewise.
async fn batch(
    State(app): State<App>,
    Extension(gates): Gate,
    Path(name): Path<String>,
    RawQuery(query): RawQuery,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Refused> {
    let source = app.hosted(&name)?.source();
    let query = Query::parse(query, &["crs", "error", "resolution"])?;
    let (kind, detail) = (query.kind()?, query.detail()?);
    let limits = &app.limits;
    let body = points::body(body, limits.heights.batch_points, limits.hello_timeout).await?;
    let most = limits.heights.clone();
    let is_csv = points::is_csv(&headers);
    let found = gates.request(move |cancelled| {
        let points = match is_csv {
            true => points::from_csv(&body, most.batch_points)?,
            false => points::from_json(&body, most.batch_points)?,
        };
        let frame = Frame::of(source.manifest(), kind)?;
        let place = |point: &[f64; 2]| frame.grid(*point).and_then(|grid| frame.within(grid));
        let places: Vec<Option<GridPlace>> = points.iter().map(place).collect();
        let mut pages = Pages::new(&*source, Work::new(most.pages, 0, cancelled));
        let found = heights::heights_at(&mut pages, &places, detail)?;
        let about = About::of(&name, source.manifest(), kind);
        Ok(match is_csv {
            true => points::to_csv(&points, &found).into_response(),
            false => Json(Batch::of(about, &found)).into_response(),
        })
    });
    found.await
}

/// `GET` and `POST /{name}/profile`: heights along a polyline.
async fn profile(
    State(app): State<App>,
    Extension(gates): Gate,
    Path(name): Path<String>,
    RawQuery(query): RawQuery,
    method: Method,
    body: Body,
) -> Result<Response, Refused> {
    let source = app.hosted(&name)?.source();
    let known = ["points", "crs", "samples", "spacing", "error", "resolution"];
    let is_post = method == Method::POST;
    let query = Query::parse(query, &known[usize::from(is_post)..])?;
    let (kind, detail) = (query.kind()?, query.detail()?);
    let spread = query.spread(PROFILE_SAMPLES)?;
    let limits = &app.limits;
    let vertices = match is_post {
        true => {
            let body = points::body(body, heights::MAX_VERTICES, limits.hello_timeout).await?;
            points::from_json(&body, heights::MAX_VERTICES)?
        }
        false => query.polyline()?,
    };
    let most = limits.heights.clone();
    let found = gates.request(move |cancelled| {
        let mut pages = Pages::new(&*source, Work::new(most.pages, 0, cancelled));
        let most = most.profile_samples;
        heights_along(&mut pages, &name, kind, &vertices, (spread, detail, most))
    });
    Ok(Json(found.await?).into_response())
}

fn heights_along(
    pages: &mut Pages<'_>,
    name: &str,
    kind: CoordinateKind,
    vertices: &[[f64; 2]],
    (spread, detail, most): (Spread, Detail, usize),
) -> Result<Profile, heights::HeightError> {
    let manifest = pages.manifest();
    let frame = Frame::of(manifest, kind)?;
    let grid = query::all_on_the_plane(&frame, vertices)?;
    let along = heights::along(&frame, &grid, spread, most)?;
    let mut found = Vec::with_capacity(along.grid.len());
    for grid in &along.grid {
        found.push(match frame.within(*grid) {
            Some(place) => heights::height_at(pages, place, detail)?,
            None => None,
        });
    }
    let about = About::of(name, manifest, kind);
    Ok(Profile::of(about, &frame, &along, &found))
}

/// `GET /{name}/sight`: a line of sight.
async fn sight(
    State(app): State<App>,
    Extension(gates): Gate,
    Path(name): Path<String>,
    RawQuery(query): RawQuery,
) -> Result<Response, Refused> {
    let source = app.hosted(&name)?.source();
    let query = Query::parse(query, &[&SIGHTING[..], &["target"]].concat())?;
    let kind = query.kind()?;
    let points = [query.pair("observer")?, query.pair("target")?];
    let (above_ground_m, curvature) = query.sighting()?;
    let most = app.limits.heights.clone();
    let found = gates.request(move |cancelled| {
        let frame = Frame::of(source.manifest(), kind)?;
        let work = Work::new(most.pages, most.sight_steps, cancelled);
        let mut pages = Pages::new(&*source, work);
        let [observer, target] = [0, 1].map(|i: usize| query::inside(&frame, points[i]));
        let ends = heights::SightEnds {
            observer: observer?,
            target: target?,
            above_ground_m,
            curvature,
        };
        let found = heights::sight(&mut pages, &frame, &ends)?;
        let found = found.ok_or_else(|| query::no_ground("observer or target", &points))?;
        let about = About::of(&name, source.manifest(), kind);
        Ok(SightAnswer::of(about, &frame, &ends, &found))
    });
    Ok(Json(found.await?).into_response())
}

/// `GET /{name}/viewshed.png`: what is seen from a place.
async fn viewshed(
    State(app): State<App>,
    Extension(gates): Gate,
    Path(name): Path<String>,
    RawQuery(query): RawQuery,
) -> Result<Response, Refused> {
    let source = app.hosted(&name)?.source();
    let known = [&SIGHTING[..], &["radius", "size", "resolution"]].concat();
    let query = Query::parse(query, &known)?;
    let kind = query.kind()?;
    let observer = query.pair("observer")?;
    let side_px = query.whole("size")?.unwrap_or(VIEWSHED_SIDE_PX);
    let radius_m = query.needed("radius")?;
    let resolution_m = query.number("resolution")?;
    let (above_ground_m, curvature) = query.sighting()?;
    let most = app.limits.heights.clone();
    let found = gates.image(move |cancelled| {
        let manifest = source.manifest();
        let frame = Frame::of(manifest, kind)?;
        let request = heights::ViewshedRequest {
            observer: query::inside(&frame, observer)?,
            radius_m,
            above_ground_m,
            side_px,
            curvature,
            resolution_m,
        };
        let work = Work::new(most.pages, most.viewshed_steps, cancelled);
        let mut pages = Pages::new(&*source, work);
        let view = heights::viewshed(&mut pages, &frame, &request, &most)?;
        let view = view.ok_or_else(|| query::no_ground("observer", &[observer]))?;
        answer::picture(&view, side_px, manifest, &frame)
    });
    let (headers, png) = found.await?;
    let kind = [
        (header::CONTENT_TYPE, "image/png"),
        (header::CACHE_CONTROL, "no-cache"),
    ];
    Ok((kind, headers, png).into_response())
}
