//! Coordinate systems: what a file or a user says of them becomes one definition, and that a way
//! to and from longitude and latitude.
//!
//! Suggested reading order: here how a [`Crs`] is named; `methods` (map projections in three
//! spellings), `body` (ellipsoids and datums), `wkt`; `projection` (to longitude and latitude and
//! back), `extent` (of a dataset), `longitude` (which turn of the circle), `vertical` (what heights
//! are above).
//!
//! A [`Crs`] is named by what defines it: `EPSG:32612`; or a PROJ string, whose `+title=` is the
//! file's own name; or, if that is all that a file gives, a citation, which cannot be transformed.
//! The first two are understood by GDAL, too.

mod body;
pub mod extent;
pub mod longitude;
mod methods;
mod projection;
pub mod vertical;
pub mod wkt;

pub(crate) use body::{Body, linear_unit};
pub(crate) use methods::{Conversion, Role};
pub use projection::{Projection, needs_grid};

use crate::dem::Crs;

/// The CRS of an EPSG code.
///
/// # Errors
/// A sentence, for a code that is not known, or is no plane and no longitude and latitude.
pub fn from_epsg(code: u16) -> Result<Crs, String> {
    let definition = epsg_definition(code)
        .ok_or_else(|| format!("EPSG:{code} is not known here; give it as WKT or PROJ string"))?;
    from_definition(definition, format!("EPSG:{code}"))
}

/// The CRS of a PROJ string, such as `+proj=stere +lat_0=90 +R=1737400`.
///
/// # Errors
/// A sentence, for a string that says no projection that is known.
pub fn from_proj(definition: &str) -> Result<Crs, String> {
    if definition.len() > wkt::MAX_BYTES {
        return Err(format!("a PROJ string of {} bytes", definition.len()));
    }
    let words: Vec<&str> = definition.split_whitespace().collect();
    let definition = words.join(" ");
    from_definition(&definition, definition.clone())
}

/// What a user writes: `EPSG:32633`, a PROJ string, or WKT.
///
/// # Errors
/// A sentence that says what is allowed, or what is wrong in the text.
pub fn from_user(text: &str) -> Result<Crs, String> {
    let text = text.trim();
    if text.starts_with('+') {
        return from_proj(text);
    }
    if text.contains(['[', '(']) {
        return wkt::from_wkt(text);
    }
    // What is quoted may be a whole file of something else.
    let shown: String = text.chars().take(60).collect();
    match text.split_once(':') {
        Some((authority, code)) if authority.eq_ignore_ascii_case("EPSG") => match code.parse() {
            Ok(code) => from_epsg(code),
            Err(_) => Err(format!(
                "{shown:?} is no EPSG code: allowed is one number after the colon, up to 65535"
            )),
        },
        _ => Err(format!(
            "{shown:?} is no CRS: allowed are EPSG:code, a PROJ string that starts with +proj=, WKT, \
             or a file with WKT"
        )),
    }
}

/// The PROJ string that defines a CRS, in whatever unit it has.
///
/// # Errors
/// A sentence, for a CRS that its file only names.
pub fn definition(crs: &Crs) -> Result<String, String> {
    let (Crs::Projected { name, .. } | Crs::Geographic { name, .. }) = crs else {
        return Err("there is no georeference".into());
    };
    if let Some(code) = epsg_code(name) {
        let known = epsg_definition(code).map(str::to_owned);
        return known.ok_or_else(|| format!("{name} is not known here"));
    }
    match crs {
        _ if name.starts_with("+proj=") => Ok(name.clone()),
        // Only spheres are left without a definition of their own.
        Crs::Geographic { radius_m, .. } => Ok(format!("+proj=longlat +R={radius_m} +no_defs")),
        _ => Err(format!(
            "the file names its projection ({name}) but does not say what it is"
        )),
    }
}

/// The number of `EPSG:number`.
pub fn epsg_code(name: &str) -> Option<u16> {
    name.strip_prefix("EPSG:")?.parse().ok()
}

/// A CRS's name for people: its code, the title of its definition, or the citation.
pub fn title(name: &str) -> &str {
    if name.starts_with("+proj=") {
        parameter(name, "title").unwrap_or(name)
    } else {
        name
    }
}

/// `+title=` of a name: blanks would end it.
pub(crate) fn title_parameter(name: &str) -> String {
    let kept: String = name
        .chars()
        .take(100)
        .map(|c| match c {
            c if c.is_alphanumeric() || "-.:/".contains(c) => c,
            _ => '_',
        })
        .collect();
    match kept.is_empty() {
        true => String::new(),
        false => format!(" +title={kept}"),
    }
}

/// Semi-major and semi-minor axis of the body of a PROJ string, metres.
pub(crate) fn axes_m(definition: &str) -> Option<[f64; 2]> {
    let body = without(definition, &["proj", "units", "to_meter"]);
    let proj = projection::checked(&format!("+proj=longlat {body}")).ok()?;
    Some(proj.ellipse_parameters().into())
}

fn from_definition(definition: &str, name: String) -> Result<Crs, String> {
    let proj = projection::checked(definition)?;
    let radius_m = proj.ellipse_parameters().0;
    if proj.is_latlong() {
        return Ok(Crs::Geographic { name, radius_m });
    }
    let metres_per_unit = proj.to_meter();
    Ok(Crs::Projected {
        name,
        metres_per_unit,
    })
}

/// Crate `crs-definitions`, from the EPSG registry by way of PROJ.
fn epsg_definition(code: u16) -> Option<&'static str> {
    crs_definitions::from_code(code)
        .map(|def| def.proj4)
        .filter(|text| text.contains("+proj="))
}

/// The value of `+name=value`.
pub(crate) fn parameter<'a>(definition: &'a str, name: &str) -> Option<&'a str> {
    definition
        .split_whitespace()
        .filter_map(|word| word.strip_prefix('+')?.split_once('='))
        .find_map(|(key, value)| (key == name).then_some(value))
}

/// Whether `+name` stands in a definition.
fn has_flag(definition: &str, name: &str) -> bool {
    definition
        .split_whitespace()
        .any(|word| word.strip_prefix('+') == Some(name))
}

/// A definition without some of its parameters.
fn without(definition: &str, names: &[&str]) -> String {
    let kept = definition.split_whitespace().filter(|word| {
        let key = word.trim_start_matches('+').split('=').next();
        !names.contains(&key.unwrap_or_default())
    });
    kept.collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests;
