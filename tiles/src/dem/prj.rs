//! What a `.prj` says: well-known text ([`crate::crs`] reads it), or the older lines of ARC/INFO.

use super::Crs;
use crate::crs::{self, vertical, wkt};

/// A coordinate system, and what the text says of heights.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Projection {
    pub crs: Crs,
    /// Metres of a unit of height.
    pub height_unit_m: Option<f64>,
    /// What heights are above.
    pub vertical: Option<String>,
}

impl Projection {
    /// One that says nothing of heights.
    pub fn of(crs: Crs) -> Self {
        Self {
            crs,
            height_unit_m: None,
            vertical: None,
        }
    }
}

/// Reads a `.prj`.
///
/// # Errors
/// What is not understood, for people.
pub(super) fn parse(text: &str) -> Result<Projection, String> {
    if !text.contains(['[', '(']) {
        return arc_info(text);
    }
    Ok(Projection {
        crs: wkt::from_wkt(text)?,
        height_unit_m: vertical::metres_of_wkt(text),
        vertical: vertical::from_wkt(text),
    })
}

/// Letters and digits, in lower case.
fn key_of(name: &str) -> String {
    let kept = name.chars().filter(char::is_ascii_alphanumeric);
    kept.map(|c| c.to_ascii_lowercase()).collect()
}

/// EPSG code of a UTM zone on a datum.
pub(super) fn utm_code(datum: &str, zone: u16, south: bool) -> Option<u16> {
    if !(1..=60).contains(&zone) {
        return None;
    }
    match (key_of(datum).as_str(), south) {
        ("wgs1984" | "wgs84" | "wge", false) => Some(32_600 + zone),
        ("wgs1984" | "wgs84" | "wge", true) => Some(32_700 + zone),
        ("wgs1972" | "wgs72" | "wgc", false) => Some(32_200 + zone),
        ("wgs1972" | "wgs72" | "wgc", true) => Some(32_300 + zone),
        ("nad1983" | "nad83" | "nar", false) if zone <= 23 => Some(26_900 + zone),
        ("nad1927" | "nad27" | "nas", false) if zone <= 22 => Some(26_700 + zone),
        ("etrs1989" | "etrs89", false) if (28..=38).contains(&zone) => Some(25_800 + zone),
        _ => None,
    }
}

/// `Projection UTM`, `Zone 56`, `Datum WGS84`, `Yshift 10000000`: one word and its value a line.
fn arc_info(text: &str) -> Result<Projection, String> {
    let value = |key: &str| {
        let mut lines = text.lines().filter_map(|line| {
            let line = line.trim();
            let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
            word.eq_ignore_ascii_case(key)
                .then(|| rest.trim().to_ascii_uppercase())
        });
        lines.next().unwrap_or_default()
    };
    let datum = match value("Datum").as_str() {
        "" => value("Spheroid"),
        datum => datum.to_string(),
    };
    let height_unit_m = match value("Zunits").as_str() {
        "FEET" | "FOOT" => Some(0.3048),
        "METERS" | "METRES" => Some(1.0),
        _ => None,
    };
    let crs = match value("Projection").as_str() {
        "UTM" => arc_info_utm(&datum, &value("Zone"), &value("Yshift"), &value("Units")),
        "GEOGRAPHIC" => arc_info_degrees(&datum, &value("Units")),
        "" => Err("it has neither WKT nor a line 'Projection'".into()),
        other => Err(format!(
            "projection {other} of an ARC/INFO .prj is not read"
        )),
    };
    crs.map(|crs| Projection {
        height_unit_m,
        ..Projection::of(crs)
    })
}

fn arc_info_utm(datum: &str, zone: &str, y_shift: &str, units: &str) -> Result<Crs, String> {
    if !["", "METERS", "METRES", "METER"].contains(&units) {
        return Err(format!("its units are {units}, and UTM is in metres"));
    }
    let number: i16 = zone.parse().map_err(|_| format!("UTM zone {zone:?}"))?;
    // A negative zone, or a false northing, is the south: so GDAL has it.
    let shifted = y_shift.parse::<f64>().is_ok_and(|shift| shift != 0.0);
    let code = utm_code(datum, number.unsigned_abs(), number < 0 || shifted);
    let code = code.ok_or_else(|| format!("UTM zone {zone} on datum {datum:?} is not known"))?;
    crs::from_epsg(code)
}

fn arc_info_degrees(datum: &str, units: &str) -> Result<Crs, String> {
    if !["", "DD", "DEGREES"].contains(&units) {
        return Err(format!("its units are {units}, and DD (degrees) are read"));
    }
    let code = match datum {
        "WGS84" | "WGE" => 4326,
        "NAD83" | "NAR" => 4269,
        "NAD27" | "NAS" => 4267,
        other => return Err(format!("datum {other:?} is not known")),
    };
    crs::from_epsg(code)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(crs: &Crs) -> &str {
        match crs {
            Crs::Projected { name, .. } | Crs::Geographic { name, .. } => name,
            Crs::Local => "none",
        }
    }

    #[test]
    fn well_known_text_is_read_with_what_it_says_of_heights() {
        let text = r#"COMPD_CS["x",GEOGCS["WGS 84",DATUM["WGS_1984",
            SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],
            UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4326"]],
            VERT_CS["feet over the geoid",VERT_DATUM["EGM96",2005],UNIT["foot",0.3048]]]"#;
        let found = parse(text).unwrap();
        assert_eq!(name(&found.crs), "EPSG:4326");
        assert_eq!(found.height_unit_m, Some(0.3048));
        assert_eq!(found.vertical.as_deref(), Some("feet over the geoid"));
        for length in 0..text.len() {
            assert!(parse(&text[..length]).is_err(), "{length}");
        }
    }

    #[test]
    fn the_lines_of_arc_info_give_zone_hemisphere_and_unit_of_height() {
        let text = "Projection    UTM\nZone          56\nDatum         WGS84\nZunits        NO\n\
                    Units         METERS\nSpheroid      WGS84\nXshift        500000\n\
                    Yshift        10000000\nParameters\n\n";
        let found = parse(text).unwrap();
        assert_eq!(
            (name(&found.crs), found.height_unit_m),
            ("EPSG:32756", None)
        );
        let feet = "projection geographic\ndatum NAD83\nzunits feet\nunits dd\n";
        let found = parse(feet).unwrap();
        assert_eq!(
            (name(&found.crs), found.height_unit_m),
            ("EPSG:4269", Some(0.3048))
        );
    }

    #[test]
    fn lines_that_are_not_understood_are_named() {
        for (text, expected) in [
            ("", "neither"),
            ("Projection ALBERS", "ALBERS"),
            ("Projection UTM\nZone 77\nDatum WGS84", "zone 77"),
            ("Projection UTM\nZone x", "zone \"X\""),
            ("Projection UTM\nZone 10\nDatum WGS84\nUnits FEET", "FEET"),
            ("Projection GEOGRAPHIC\nDatum TOKYO", "TOKYO"),
        ] {
            let why = parse(text).unwrap_err();
            assert!(why.contains(expected), "{text}: {why}");
        }
    }
}
