//! Well-known text to a [`Crs`]: version 1 as GDAL writes it, Esri's flavour in `.prj` files, and
//! version 2.
//!
//! After OGC 01-009 (2001), OGC 18-010r7 (2019), and Esri's list of projections. Axes are taken
//! as east and north, whatever order is stated, as in every raster format that holds WKT.

pub(crate) mod tree;

use super::{Body, Conversion, Role, epsg_definition, methods, title_parameter};
use crate::dem::Crs;
pub use tree::MAX_BYTES;
use tree::Node;

const GEOGRAPHIC: &[&str] = &[
    "GEOGCS",
    "GEOGCRS",
    "GEOGRAPHICCRS",
    "GEODCRS",
    "GEODETICCRS",
    "BASEGEOGCRS",
    "BASEGEODCRS",
];
const PROJECTED: &[&str] = &["PROJCS", "PROJCRS", "PROJECTEDCRS"];
/// They hold a CRS beside other things.
const WRAPPERS: &[&str] = &["COMPD_CS", "COMPOUNDCRS", "BOUNDCRS", "SOURCECRS"];
const UNITS: &[&str] = &["UNIT", "LENGTHUNIT", "ANGLEUNIT"];

/// The CRS that a WKT defines; of a compound one the horizontal part ([`super::vertical`] reads
/// the other). Safe on untrusted text.
///
/// # Errors
/// A sentence that says where the text breaks, or what in it is not understood.
pub fn from_wkt(wkt: &str) -> Result<Crs, String> {
    let root = Node::parse(wkt.trim_start_matches('\u{feff}').trim())?;
    let mut node = &root;
    while WRAPPERS.contains(&node.keyword.as_str()) {
        let inner = node.nodes().find(|n| {
            [GEOGRAPHIC, PROJECTED, WRAPPERS]
                .iter()
                .any(|k| k.contains(&&*n.keyword))
        });
        node = inner.ok_or_else(|| format!("no horizontal CRS in the WKT's {}", node.keyword))?;
    }
    match node.keyword.as_str() {
        keyword if PROJECTED.contains(&keyword) => projected(node),
        keyword if GEOGRAPHIC.contains(&keyword) => geographic(node),
        other => Err(format!(
            "the WKT is a {other}; allowed are projected and geographic coordinate systems"
        )),
    }
}

fn geographic(node: &Node) -> Result<Crs, String> {
    let degrees = degrees_a_unit(node);
    if (degrees - 1.0).abs() > 1e-6 {
        return Err(format!(
            "angles of {degrees} degrees a unit; allowed are degrees"
        ));
    }
    let body = body(node)?;
    let crs = Crs::Geographic {
        name: body.geographic_name()?,
        radius_m: body.radius_m()?,
    };
    Ok(crs)
}

fn projected(node: &Node) -> Result<Crs, String> {
    let base = node
        .find(GEOGRAPHIC)
        .ok_or("no geographic CRS in the WKT's projected one")?;
    let metres_per_unit = metres_a_unit(node)?;
    let code = node.epsg().filter(|code| epsg_definition(*code).is_some());
    if let Some(code) = code {
        return Ok(Crs::Projected {
            name: format!("EPSG:{code}"),
            metres_per_unit,
        });
    }
    let name = projected_name(node, base, metres_per_unit)?;
    Ok(Crs::Projected {
        name,
        metres_per_unit,
    })
}

/// The code or the PROJ string of a projected CRS without a code.
fn projected_name(node: &Node, base: &Node, metres_per_unit: f64) -> Result<String, String> {
    let holder = node.find(&["CONVERSION"]).unwrap_or(node);
    let method = holder
        .find(&["PROJECTION", "METHOD"])
        .map(Node::name)
        .ok_or("no projection method in the WKT")?;
    let title = title_parameter(node.name());
    if methods::is_web_mercator(method) {
        return Ok("EPSG:3857".into());
    }
    let mut conversion = Conversion::of_wkt(method).ok_or_else(|| {
        format!("projection method {method:?} is not known; gdalwarp can bring it to another CRS")
    })?;
    let degrees = degrees_a_unit(base);
    for parameter in holder.nodes().filter(|n| n.keyword == "PARAMETER") {
        let (Some(role), Some(value)) =
            (Role::of_wkt(parameter.name()), parameter.numbers().next())
        else {
            continue;
        };
        let unit = parameter.find(UNITS).and_then(|unit| unit.numbers().next());
        let scale = match role {
            _ if role.is_length() => unit.unwrap_or(metres_per_unit),
            _ if role.is_angle() => unit.map_or(degrees, f64::to_degrees),
            _ => 1.0,
        };
        // A unit of 0.017453292519943295 or of its usual abbreviation is the degree itself.
        let scale = if (scale - 1.0).abs() < 1e-9 {
            1.0
        } else {
            scale
        };
        conversion.values.push((role, value * scale));
    }
    named(&conversion, &body(base)?, metres_per_unit, &title)
}

/// The name of a projection on a body: the code of a UTM zone, else a PROJ string.
///
/// # Errors
/// Where nothing says how large the body is.
pub(crate) fn named(
    conversion: &Conversion,
    body: &Body,
    metres_per_unit: f64,
    title: &str,
) -> Result<String, String> {
    if metres_per_unit == 1.0
        && let Some(code) = body.code.and_then(|code| utm_code(conversion, code))
    {
        return Ok(format!("EPSG:{code}"));
    }
    let unit = match metres_per_unit {
        1.0 => " +units=m".to_owned(),
        metres => format!(" +to_meter={metres}"),
    };
    let name = format!(
        "{} {}{unit} +no_defs{title}",
        conversion.proj(),
        body.proj()?
    );
    super::projection::checked(&name)?;
    Ok(name)
}

/// EPSG's code of a UTM zone, which Esri's files only name.
fn utm_code(conversion: &Conversion, geographic: u16) -> Option<u16> {
    let zone = ((conversion.get(Role::Longitude)? + 183.0) / 6.0).round();
    if !(1.0..=60.0).contains(&zone) {
        return None;
    }
    let zone = zone as u16;
    let same = |south| {
        let utm = Conversion::utm(zone, south);
        conversion.method == utm.method
            && utm
                .values
                .iter()
                .all(|(role, value)| conversion.get(*role).unwrap_or(0.0) == *value)
    };
    let north = same(false);
    if !north && !same(true) {
        return None;
    }
    let code = match (geographic, north) {
        (4326, true) => 32600 + zone,
        (4326, false) => 32700 + zone,
        (4269, true) if zone <= 23 => 26900 + zone,
        (4258, true) if (28..=38).contains(&zone) => 25800 + zone,
        (4267, true) if zone <= 22 => 26700 + zone,
        _ => return None,
    };
    epsg_definition(code).map(|_| code)
}

/// Ellipsoid, datum and prime meridian of a geographic CRS.
fn body(node: &Node) -> Result<Body, String> {
    let datum = node
        .find(&["DATUM", "TRF", "GEODETICDATUM", "ENSEMBLE"])
        .ok_or("no datum in the WKT")?;
    let ellipsoid = datum
        .find(&["SPHEROID", "ELLIPSOID"])
        .map(ellipsoid)
        .transpose()?;
    let prime_meridian_deg = node
        .find(&["PRIMEM", "PRIMEMERIDIAN"])
        .and_then(|primem| primem.numbers().next())
        .unwrap_or(0.0)
        * degrees_a_unit(node);
    let to_wgs84 = datum
        .find(&["TOWGS84"])
        .map(|node| node.numbers().collect())
        .unwrap_or_default();
    let known = |code: &u16| epsg_definition(*code).is_some();
    // A datum's name stands for its code only with its own ellipsoid and from Greenwich.
    let by_name = || {
        let code = Body::code_of_datum(datum.name()).filter(known)?;
        let definition = format!("+proj=longlat {}", epsg_definition(code)?);
        let radius_m = super::projection::checked(&definition)
            .ok()?
            .ellipse_parameters()
            .0;
        let fits = ellipsoid.is_none_or(|(a, _)| (a - radius_m).abs() < 0.1);
        (fits && prime_meridian_deg == 0.0).then_some(code)
    };
    Ok(Body {
        name: node.name().to_owned(),
        code: node.epsg().filter(known).or_else(by_name),
        ellipsoid,
        to_wgs84,
        prime_meridian_deg,
    })
}

fn ellipsoid(node: &Node) -> Result<(f64, f64), String> {
    let numbers: Vec<f64> = node.numbers().take(2).collect();
    let [a, rf] = numbers[..] else {
        return Err(format!(
            "no two axes in the WKT's ellipsoid {:?}",
            node.name()
        ));
    };
    let unit = node.find(UNITS).and_then(|unit| unit.numbers().next());
    Ok((a * unit.unwrap_or(1.0), rf))
}

/// Degrees of the angular unit of a geographic CRS, or of its axes.
fn degrees_a_unit(node: &Node) -> f64 {
    let unit = node
        .find(UNITS)
        .or_else(|| node.find(&["AXIS"])?.find(UNITS));
    let radians = unit.and_then(|unit| unit.numbers().next());
    radians.map_or(1.0, f64::to_degrees)
}

/// Metres of the linear unit of a projected CRS, or of its axes.
fn metres_a_unit(node: &Node) -> Result<f64, String> {
    let unit = node
        .find(UNITS)
        .or_else(|| node.find(&["AXIS"])?.find(UNITS));
    match unit.and_then(|unit| unit.numbers().next()).unwrap_or(1.0) {
        metres if metres.is_finite() && metres > 0.0 => Ok(metres),
        metres => Err(format!("a unit of {metres} m")),
    }
}
