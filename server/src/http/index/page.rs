//! The page at `/`. It needs no script and nothing from elsewhere; the one style that it has is
//! named by its checksum, so that a browser takes no other.

use crate::catalog::{Hosted, percent_encoded};
use crate::heights::Accuracy;
use crate::native::native_corners;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use escarp_proto::manifest::Manifest;
use escarp_tiles::crs::extent;
use std::fmt::Write;
use std::sync::Arc;

const STYLE: &str = include_str!("style.css");

/// The content security policy of the page.
pub(super) fn policy() -> String {
    let digest = ring::digest::digest(&ring::digest::SHA256, STYLE.as_bytes());
    let style = BASE64_STANDARD.encode(digest);
    format!(
        "default-src 'none'; img-src 'self'; style-src 'sha256-{style}'; base-uri 'none'; \
         form-action 'none'; frame-ancestors 'none'"
    )
}

pub(super) fn page(all: &[Arc<Hosted>], host: &str, [http, ws]: [&str; 2]) -> String {
    let host = escaped(host);
    let count = match all.len() {
        1 => "1 dataset".into(),
        count => format!("{count} datasets"),
    };
    let articles: String = all
        .iter()
        .map(|hosted| article(hosted, &format!("{http}://{host}")))
        .collect();
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <title>Escarp terrain server</title><style>{STYLE}</style></head>\n<body>\
         <header><h1>Escarp terrain server</h1><p>{count} at {host}</p></header>\n\
         <main>{articles}</main>\n<footer><p>\
         <a href=\"/datasets\">Datasets as JSON</a> · \
         <a href=\"/openapi.json\">OpenAPI description of all addresses</a> · \
         sessions at <code>{ws}://{host}/session</code></p></footer>\n</body></html>\n"
    )
}

fn article(hosted: &Hosted, server: &str) -> String {
    let source = hosted.source();
    let manifest = source.manifest();
    let (name, address) = (escaped(hosted.name()), percent_encoded(hosted.name()));
    let mut facts = String::new();
    for (what, value) in facts_of(manifest) {
        // Writing to a string does not fail.
        let _ = write!(facts, "<dt>{what}</dt><dd>{}</dd>", escaped(&value));
    }
    let [x, y] = middle(manifest).map(|v| (v * 1e6).round() / 1e6);
    let id = source.generation_id();
    format!(
        "<article id=\"{address}\"><div><img src=\"/{address}/overview.png\" loading=\"lazy\" \
         alt=\"Shaded relief of {name}\"></div><div><h2>{name}</h2>\
         <pre><code>escarp-client view {server}/{address}</code></pre><dl>{facts}</dl>\
         <nav><a href=\"/{address}\">JSON</a><a href=\"/{address}/manifest\">Manifest</a>\
         <a href=\"/{address}/current\">Current</a>\
         <a href=\"/{address}/{id}/manifest\">Generation {id}</a>\
         <a href=\"/{address}/heights?x={x}&amp;y={y}\">Height in the middle</a>\
         </nav></div></article>\n"
    )
}

/// The middle of the data, in its own coordinates.
fn middle(manifest: &Manifest) -> [f64; 2] {
    let [a, _, b, _] = native_corners(manifest).corners;
    [f64::midpoint(a[0], b[0]), f64::midpoint(a[1], b[1])]
}

/// What there is to know of a dataset, and its names.
fn facts_of(manifest: &Manifest) -> Vec<(&'static str, String)> {
    let native = native_corners(manifest);
    let [west_south, _, east_north, _] = native.corners;
    let places = if native.unit == "degree" { 5 } else { 1 };
    let span = |axis: usize| span(west_south[axis], east_north[axis], places);
    let extent = match native.unit.as_str() {
        "degree" => format!("longitude {}, latitude {}", span(0), span(1)),
        unit => format!("x {}, y {} ({unit})", span(0), span(1)),
    };
    let mut facts = vec![("Extent", extent)];
    if native.unit != "degree"
        && let Some(text) = degrees(manifest)
    {
        facts.push(("Degrees", text));
    }
    let [width, height] = manifest.samples;
    let [dx, dy] = manifest.georef.sample_spacing_m;
    let bytes: u64 = manifest.segments.iter().map(|segment| segment.bytes).sum();
    let crs = native.crs.as_deref().map(escarp_tiles::crs::title);
    facts.push(("CRS", crs.unwrap_or("none: a local plane").into()));
    facts.push((
        "Samples",
        format!("{} × {}", grouped(width.into()), grouped(height.into())),
    ));
    facts.push(("Spacing", format!("{} m × {} m", figures(dx), figures(dy))));
    let [_, _, [low, high]] = manifest.extent_m();
    facts.push((
        "Heights",
        format!("{} m to {} m", figures(low), figures(high)),
    ));
    let vertical = manifest.vertical.as_deref();
    facts.push((
        "Above",
        vertical.unwrap_or("not stated by the source").into(),
    ));
    let error_m = Accuracy::of(manifest).finest_m();
    let error = match error_m {
        0.0 => "none: stored as given".into(),
        _ => format!("at most {} m", figures_up(error_m)),
    };
    facts.push(("Error", error));
    let levels = manifest.grid_levels.get();
    facts.push((
        "Tree",
        format!("{levels} levels, {} pages", grouped(manifest.pages)),
    ));
    facts.push(("Size", size(bytes.saturating_add(manifest.index.bytes))));
    facts.push(("Generation", manifest.generation.to_string()));
    facts
}

/// Longitudes and latitudes of the corners.
fn degrees(manifest: &Manifest) -> Option<String> {
    let extent = extent::of(manifest)?;
    let (sw, ne) = (extent.south_west, extent.north_east);
    Some(format!(
        "longitude {}, latitude {}",
        span(sw[0], ne[0], 5),
        span(sw[1], ne[1], 5)
    ))
}

fn span(from: f64, to: f64, places: usize) -> String {
    format!("{from:.places$} to {to:.places$}")
}

/// Four figures, but no fewer than the whole metres.
fn figures(metres: f64) -> String {
    let whole = metres.abs().max(1e-9).log10().floor() as i32;
    let places = (3 - whole).clamp(0, 9) as usize;
    let text = format!("{metres:.places$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').into(),
        false => text,
    }
}

/// A bound above 0, rounded up to three figures, and to a micrometre.
fn figures_up(metres: f64) -> String {
    let metres = metres.max(1e-6);
    let scale = 10f64.powi(2 - metres.log10().floor() as i32);
    figures((metres * scale).ceil() / scale)
}

/// Groups of three digits.
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

fn size(bytes: u64) -> String {
    let exact = bytes as f64;
    let text = match bytes {
        0..1_000_000 => format!("{:.1} kB", exact / 1e3),
        1_000_000..1_000_000_000 => format!("{:.1} MB", exact / 1e6),
        _ => format!("{:.2} GB", exact / 1e9),
    };
    format!("{text} ({} bytes)", grouped(bytes))
}

/// For text and for quoted attributes.
fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            '\'' => safe.push_str("&#39;"),
            c => safe.push(c),
        }
    }
    safe
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Catalog;
    use crate::tests::fake::FakeSource;

    #[test]
    fn names_and_hosts_cannot_become_markup() {
        let catalog = Catalog::default();
        let name = "<script>alert('1')&\"";
        catalog.add(name, FakeSource::shared()).unwrap();
        let page = page(&catalog.all(), "a\"><u>", ["http", "ws"]);
        assert!(!page.contains("<script") && !page.contains("<u"), "{page}");
        assert!(page.contains("&lt;script&gt;alert(&#39;1&#39;)&amp;&quot;"));
        assert!(page.contains("/%3Cscript%3Ealert%28%271%27%29%26%22/overview.png"));
    }

    #[test]
    fn numbers_are_short_and_bounds_rounded_up() {
        assert_eq!(figures(118.450587), "118.5");
        assert_eq!(figures(10.0), "10");
        assert_eq!(figures(-6572.4), "-6572");
        assert_eq!(figures(0.0), "0");
        assert_eq!(figures_up(0.050_001), "0.0501");
        assert_eq!(figures_up(2.4e-10), "0.000001");
        assert_eq!(grouped(1_234_567), "1,234,567");
        assert_eq!(size(71_900_542), "71.9 MB (71,900,542 bytes)");
    }
}
