//! The answers, as JSON and PNG.

use crate::heights::{
    self, Accuracy, CoordinateKind, Frame, Height, HeightError, Seen, SightEnds, Verdict, Viewshed,
};
use crate::native::native_corners;
use axum::http::{HeaderMap, HeaderName, HeaderValue};
use escarp_proto::manifest::Manifest;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use serde::Serialize;

/// What every answer says of where its heights come from.
#[derive(Debug, Serialize)]
pub(super) struct About {
    dataset: String,
    generation: u64,
    /// What heights are above; null where that is not known.
    vertical: Option<String>,
    /// The dataset's CRS; null if it has none.
    crs: Option<String>,
    /// `native` or `lonlat`.
    coordinates: &'static str,
    /// Always `triangles`.
    interpolation: &'static str,
    /// What every height may be off by.
    accuracy: Accuracy,
}

impl About {
    pub(super) fn of(name: &str, manifest: &Manifest, kind: CoordinateKind) -> About {
        About {
            dataset: name.into(),
            generation: manifest.generation,
            vertical: manifest.vertical.clone(),
            crs: native_corners(manifest).crs,
            coordinates: match kind {
                CoordinateKind::Native => "native",
                CoordinateKind::LonLat => "lonlat",
            },
            interpolation: "triangles",
            accuracy: Accuracy::of(manifest),
        }
    }
}

/// One height.
#[derive(Debug, Serialize)]
pub(super) struct Point {
    #[serde(flatten)]
    about: About,
    point: [f64; 2],
    /// Null outside of the data.
    height_m: Option<f64>,
    error_m: Option<f64>,
    /// Distance of the samples that it was taken from, east and north.
    spacing_m: Option<[f64; 2]>,
}

impl Point {
    pub(super) fn of(
        about: About,
        point: [f64; 2],
        found: Option<Height>,
        manifest: &Manifest,
    ) -> Point {
        let spacing_m = manifest.georef.sample_spacing_m;
        Point {
            about,
            point,
            height_m: found.map(|found| found.height_m),
            error_m: found.map(|found| found.error_m),
            spacing_m: found.map(|found| spacing_m.map(|step| step * f64::from(found.stride))),
        }
    }
}

/// Many heights.
#[derive(Debug, Serialize)]
pub(super) struct Batch {
    #[serde(flatten)]
    about: About,
    heights_m: Vec<Option<f64>>,
    errors_m: Vec<Option<f64>>,
}

impl Batch {
    pub(super) fn of(about: About, found: &[Option<Height>]) -> Batch {
        Batch {
            about,
            heights_m: heights_m(found),
            errors_m: errors_m(found),
        }
    }
}

fn heights_m(found: &[Option<Height>]) -> Vec<Option<f64>> {
    let height = |found: &Option<Height>| found.map(|found| found.height_m);
    found.iter().map(height).collect()
}

fn errors_m(found: &[Option<Height>]) -> Vec<Option<f64>> {
    let error = |found: &Option<Height>| found.map(|found| found.error_m);
    found.iter().map(error).collect()
}

/// Heights along a polyline.
#[derive(Debug, Serialize)]
pub(super) struct Profile {
    #[serde(flatten)]
    about: About,
    length_m: f64,
    distances_m: Vec<f64>,
    /// Null where the coordinates have no place.
    points: Vec<Option<[f64; 2]>>,
    heights_m: Vec<Option<f64>>,
    errors_m: Vec<Option<f64>>,
}

impl Profile {
    pub(super) fn of(
        about: About,
        frame: &Frame,
        along: &heights::Profile,
        found: &[Option<Height>],
    ) -> Profile {
        let points = along.grid.iter().map(|grid| frame.coordinates(*grid));
        Profile {
            about,
            length_m: along.length_m,
            distances_m: along.distances_m.clone(),
            points: points.collect(),
            heights_m: heights_m(found),
            errors_m: errors_m(found),
        }
    }
}

/// A line of sight.
#[derive(Debug, Serialize)]
pub(super) struct SightAnswer {
    #[serde(flatten)]
    about: About,
    /// On the stored surface; null where data is missing under a line that is clear elsewhere.
    visible: Option<bool>,
    /// Whether it is so whatever the heights are within their bounds.
    certain: bool,
    length_m: f64,
    observer: End,
    target: End,
    /// The least height of the line above the surface; null if it crosses no side of a triangle.
    margin_m: Option<f64>,
    margin_error_m: f64,
    margin_at: Option<Place>,
    blocked_at: Option<Place>,
    over_no_data: bool,
}

/// An end of a line of sight.
#[derive(Debug, Serialize)]
struct End {
    ground_m: f64,
    above_ground_m: f64,
}

/// A place on a line of sight.
#[derive(Debug, Serialize)]
struct Place {
    point: Option<[f64; 2]>,
    /// From the observer.
    distance_m: f64,
}

impl SightAnswer {
    pub(super) fn of(
        about: About,
        frame: &Frame,
        ends: &SightEnds,
        found: &heights::Sight,
    ) -> SightAnswer {
        let [a, b] = [ends.observer.grid(), ends.target.grid()];
        let place = |t: f64| Place {
            point: frame.coordinates([0, 1].map(|i: usize| a[i] + (b[i] - a[i]) * t)),
            distance_m: found.length_m * t,
        };
        let end = |i: usize| End {
            ground_m: found.ground_m[i],
            above_ground_m: ends.above_ground_m[i],
        };
        SightAnswer {
            about,
            visible: found.visible,
            certain: found.verdict != Verdict::Undecided,
            length_m: found.length_m,
            observer: end(0),
            target: end(1),
            margin_m: found.margin_m,
            margin_error_m: found.margin_error_m,
            margin_at: found.margin_m.map(|_| place(found.margin_at)),
            blocked_at: found.blocked_at.map(place),
            over_no_data: found.over_hole,
        }
    }
}

/// A viewshed as a PNG of grey and alpha, and what is to know of it as headers.
pub(super) fn picture(
    view: &Viewshed,
    side_px: u32,
    manifest: &Manifest,
    frame: &Frame,
) -> Result<(HeaderMap, Vec<u8>), HeightError> {
    let greys = view.pixels.iter().flat_map(|seen| match seen {
        Seen::Nothing => [0, 0],
        Seen::Hidden => [0, 255],
        Seen::Undecided => [128, 255],
        Seen::Visible => [255, 255],
    });
    let greys: Vec<u8> = greys.collect();
    let png = png(&greys, [side_px; 2], ExtendedColorType::La8)?;
    let spacing_m = manifest.georef.sample_spacing_m;
    let spacing_m = spacing_m.map(|step| step * f64::from(view.stride));
    let mut headers = HeaderMap::new();
    let mut add = |name: &'static str, value: String| {
        // Only what a header can hold is said there; the manifest says it all.
        if let Ok(value) = HeaderValue::try_from(value) {
            headers.insert(HeaderName::from_static(name), value);
        }
    };
    add("escarp-generation", manifest.generation.to_string());
    add("escarp-error-m", view.error_m.to_string());
    add("escarp-ground-m", view.ground_m.to_string());
    add(
        "escarp-spacing-m",
        format!("{},{}", spacing_m[0], spacing_m[1]),
    );
    if let Some(vertical) = &manifest.vertical {
        add("escarp-vertical", vertical.clone());
    }
    let [[west, east], [south, north]] = view.grid;
    let corners = [[west, south], [east, north]].map(|corner| frame.coordinates(corner));
    if let [Some([west, south]), Some([east, north])] = corners {
        add("escarp-corners", format!("{west},{south},{east},{north}"));
    }
    Ok((headers, png))
}

/// Pixels as a PNG.
pub(crate) fn png(
    pixels: &[u8],
    [width, height]: [u32; 2],
    colour: ExtendedColorType,
) -> Result<Vec<u8>, HeightError> {
    let mut png = Vec::new();
    let encoder =
        PngEncoder::new_with_quality(&mut png, CompressionType::Default, FilterType::Adaptive);
    let written = encoder.write_image(pixels, width, height, colour);
    written.map_err(|error| HeightError::usage(error.to_string(), "a smaller picture"))?;
    Ok(png)
}
