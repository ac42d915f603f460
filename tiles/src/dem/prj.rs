//! What a `.prj` says: well-known text (OGC and ESRI WKT 1, WKT 2), or the older lines of
//! ARC/INFO.

use super::Crs;

/// Bodies of brackets within brackets, and nodes: more than any coordinate system has.
const MOST_NESTED: usize = 16;
const MOST_NODES: usize = 4096;

const WGS84_RADIUS_M: f64 = 6_378_137.0;
const DEGREE: f64 = 0.017_453_292_519_943_295;

/// A coordinate system, and the unit of heights where the text has one.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Projection {
    pub crs: Crs,
    /// Metres of a unit of height.
    pub height_unit_m: Option<f64>,
}

impl Projection {
    /// One that says nothing of heights.
    pub fn of(crs: Crs) -> Self {
        Self {
            crs,
            height_unit_m: None,
        }
    }
}

/// Reads a `.prj`.
///
/// # Errors
/// What is not understood, for people.
pub(super) fn parse(text: &str) -> Result<Projection, String> {
    let text = text.trim().trim_start_matches('\u{feff}');
    if text.contains('[') {
        return crs_of_wkt(text).map(Projection::of);
    }
    arc_info(text)
}

/// The coordinate system that a well-known text describes: its EPSG code where it has one, or
/// a name that is known; its own name otherwise.
///
/// # Errors
/// What is not understood, for people.
pub fn crs_of_wkt(text: &str) -> Result<Crs, String> {
    let root = parse_node(&mut Cursor::new(text), 0)?;
    let system = root
        .find(&|n| is_projected(n) || is_geographic(n))
        .ok_or_else(|| format!("{} names no projected or geographic system", root.keyword))?;
    let name = system.text().unwrap_or("unnamed");
    let epsg = system
        .child(&["AUTHORITY", "ID"])
        .filter(|id| id.text() == Some("EPSG"))
        .and_then(|id| id.arguments.get(1)?.trim_matches('"').parse::<u32>().ok());
    if is_projected(system) {
        let metres_per_unit = linear_unit(system)?;
        let name = match epsg.or_else(|| projected_code(name)) {
            Some(code) => format!("EPSG:{code}"),
            None => name.into(),
        };
        return Ok(Crs::Projected {
            name,
            metres_per_unit,
        });
    }
    geographic(system, name, epsg)
}

/// The coordinate system of an EPSG code: those that DEMs mostly come in.
///
/// # Errors
/// That the code is not among them, and what to do.
pub fn crs_of_epsg(code: u32) -> Result<Crs, String> {
    let name = format!("EPSG:{code}");
    let utm = |zone: u32| (1..=60).contains(&zone);
    match code {
        4258 | 4269 | 4283 | 4326 | 4979 => Ok(Crs::Geographic {
            name,
            radius_m: WGS84_RADIUS_M,
        }),
        4267 => Ok(Crs::Geographic {
            name,
            radius_m: 6_378_206.4,
        }),
        3857 | 3395 | 3035 | 3031 | 3413 | 2154 | 27700 | 2056 | 5070 => Ok(Crs::Projected {
            name,
            metres_per_unit: 1.0,
        }),
        32_601..=32_660 | 32_701..=32_760 | 32_201..=32_260 => Ok(Crs::Projected {
            name,
            metres_per_unit: 1.0,
        }),
        26_901..=26_923 | 26_701..=26_722 | 25_828..=25_838 if utm(code % 100) => {
            Ok(Crs::Projected {
                name,
                metres_per_unit: 1.0,
            })
        }
        _ => Err(format!(
            "EPSG:{code} is not known by number; give its text: gdalsrsinfo -o wkt1 EPSG:{code} > \
             FILE.prj beside the file"
        )),
    }
}

fn is_projected(node: &Node) -> bool {
    ["PROJCS", "PROJCRS", "PROJECTEDCRS"].contains(&&*node.keyword)
}

fn is_geographic(node: &Node) -> bool {
    let keywords = [
        "GEOGCS",
        "GEOGCRS",
        "GEODCRS",
        "GEODETICCRS",
        "GEOGRAPHICCRS",
    ];
    keywords.contains(&&*node.keyword)
}

fn linear_unit(system: &Node) -> Result<f64, String> {
    let units = ["UNIT", "LENGTHUNIT"];
    let axis = || system.child(&["AXIS"])?.child(&units);
    let metres = match system.child(&units).or_else(axis) {
        None => Some(1.0),
        Some(unit) => unit.number(1),
    };
    metres
        .filter(|m| m.is_finite() && *m > 0.0)
        .ok_or_else(|| "its linear unit is no length".into())
}

fn geographic(system: &Node, name: &str, epsg: Option<u32>) -> Result<Crs, String> {
    let unit = system
        .child(&["UNIT", "ANGLEUNIT"])
        .and_then(|u| u.number(1));
    if unit.is_some_and(|unit| (unit - DEGREE).abs() > 1e-9) {
        return Err("its angles are not in degrees".into());
    }
    let radius_m = system
        .find(&|n| ["SPHEROID", "ELLIPSOID"].contains(&&*n.keyword))
        .and_then(|body| body.number(1))
        .filter(|radius| radius.is_finite() && *radius > 0.0)
        .ok_or("it has no spheroid")?;
    let known = match key_of(name).as_str() {
        "gcswgs1984" | "wgs84" => Some(4326),
        "gcsnorthamerican1983" | "nad83" => Some(4269),
        "gcsnorthamerican1927" | "nad27" => Some(4267),
        "gcsetrs1989" | "etrs89" => Some(4258),
        _ => None,
    };
    let name = epsg
        .or(known)
        .map_or(name.into(), |code| format!("EPSG:{code}"));
    Ok(Crs::Geographic { name, radius_m })
}

/// Letters and digits, in lower case.
fn key_of(name: &str) -> String {
    let kept = name.chars().filter(char::is_ascii_alphanumeric);
    kept.map(|c| c.to_ascii_lowercase()).collect()
}

/// Codes of systems that ESRI's texts only name, such as `WGS_1984_UTM_Zone_11N`.
fn projected_code(name: &str) -> Option<u32> {
    let key = key_of(name);
    if key.contains("webmercator") || key == "popularvisualisationcrsmercator" {
        return Some(3857);
    }
    let (datum, rest) = key.split_once("utmzone")?;
    let digits = rest.trim_end_matches(|c: char| !c.is_ascii_digit());
    let (zone, side) = (digits.parse().ok()?, &rest[digits.len()..]);
    utm_code(datum, zone, side == "s")
}

/// EPSG code of a UTM zone on a datum.
pub(super) fn utm_code(datum: &str, zone: u32, south: bool) -> Option<u32> {
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
    crs.map(|crs| Projection { crs, height_unit_m })
}

fn arc_info_utm(datum: &str, zone: &str, y_shift: &str, units: &str) -> Result<Crs, String> {
    if !["", "METERS", "METRES", "METER"].contains(&units) {
        return Err(format!("its units are {units}, and UTM is in metres"));
    }
    let number: i32 = zone.parse().map_err(|_| format!("UTM zone {zone:?}"))?;
    // A negative zone, or a false northing, is the south: so GDAL has it.
    let shifted = y_shift.parse::<f64>().is_ok_and(|shift| shift != 0.0);
    let code = utm_code(datum, number.unsigned_abs(), number < 0 || shifted);
    let code = code.ok_or_else(|| format!("UTM zone {zone} on datum {datum:?} is not known"))?;
    Ok(Crs::Projected {
        name: format!("EPSG:{code}"),
        metres_per_unit: 1.0,
    })
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
    crs_of_epsg(code)
}

/// `KEYWORD[argument, ..., NODE[...], ...]`.
#[derive(Debug, Default)]
struct Node {
    keyword: String,
    /// Quoted texts and numbers as written.
    arguments: Vec<String>,
    children: Vec<Node>,
}

impl Node {
    /// Its first argument, without quotes.
    fn text(&self) -> Option<&str> {
        self.arguments.first().map(|a| a.trim_matches('"'))
    }

    fn number(&self, at: usize) -> Option<f64> {
        self.arguments.get(at)?.parse().ok()
    }

    fn child(&self, keywords: &[&str]) -> Option<&Node> {
        self.children
            .iter()
            .find(|c| keywords.contains(&&*c.keyword))
    }

    /// This node or the first below it that meets a condition.
    fn find(&self, meets: &dyn Fn(&Node) -> bool) -> Option<&Node> {
        match meets(self) {
            true => Some(self),
            false => self.children.iter().find_map(|c| c.find(meets)),
        }
    }
}

struct Cursor<'a> {
    rest: &'a str,
    nodes: usize,
}

impl<'a> Cursor<'a> {
    fn new(text: &'a str) -> Self {
        Self {
            rest: text,
            nodes: 0,
        }
    }

    /// The next quoted text (a doubled quote stands for one), or run of other signs.
    fn token(&mut self) -> Result<&'a str, String> {
        self.rest = self.rest.trim_start();
        let end = match self.rest.strip_prefix('"') {
            Some(quoted) => 2 + quoted.find('"').ok_or("a quote is not closed")?,
            None => self
                .rest
                .find(['[', ']', '(', ')', ',', '"'])
                .unwrap_or(self.rest.len()),
        };
        let (token, rest) = self.rest.split_at(end);
        self.rest = rest.trim_start();
        Ok(token.trim())
    }

    fn eat(&mut self, signs: &[char]) -> bool {
        let rest = self.rest.strip_prefix(signs);
        self.rest = rest.unwrap_or(self.rest);
        rest.is_some()
    }
}

fn parse_node(cursor: &mut Cursor<'_>, depth: usize) -> Result<Node, String> {
    cursor.nodes += 1;
    if depth > MOST_NESTED || cursor.nodes > MOST_NODES {
        return Err("its WKT is nested too deeply, or too long".into());
    }
    let mut node = Node {
        keyword: cursor.token()?.to_ascii_uppercase(),
        ..Node::default()
    };
    if !cursor.eat(&['[', '(']) {
        return Err(format!(
            "WKT: after {:?} a bracket is missing",
            node.keyword
        ));
    }
    loop {
        let ahead = cursor.rest;
        let token = cursor.token()?;
        if cursor.rest.starts_with(['[', '(']) {
            cursor.rest = ahead;
            node.children.push(parse_node(cursor, depth + 1)?);
        } else {
            node.arguments.push(token.into());
        }
        if cursor.eat(&[']', ')']) {
            return Ok(node);
        }
        if !cursor.eat(&[',']) {
            return Err(format!("WKT: {} is not closed", node.keyword));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ESRI_UTM: &str = r#"PROJCS["WGS_1984_UTM_Zone_11N",GEOGCS["GCS_WGS_1984",
        DATUM["D_WGS_1984",SPHEROID["WGS_1984",6378137.0,298.257223563]],
        PRIMEM["Greenwich",0.0],UNIT["Degree",0.0174532925199433]],
        PROJECTION["Transverse_Mercator"],UNIT["Meter",1.0]]"#;

    fn name_and_number(crs: Crs) -> (String, f64) {
        match crs {
            Crs::Projected {
                name,
                metres_per_unit,
            } => (name, metres_per_unit),
            Crs::Geographic { name, radius_m } => (name, radius_m),
            other => panic!("{other}"),
        }
    }

    #[test]
    fn esri_and_ogc_texts_give_codes_units_and_radii() {
        let feet = r#"PROJCS["x",GEOGCS["y",DATUM["d",SPHEROID["s",6378137,298]]],
            UNIT["US survey foot",0.3048006096012192],AUTHORITY["EPSG","2225"]]"#;
        let moon = r#"GEOGCS["Moon 2000",DATUM["D",SPHEROID["Moon",1737400,0]],
            PRIMEM["R",0],UNIT["degree",0.0174532925199433]]"#;
        let wkt2 = r#"GEOGCRS["WGS 84",DATUM["W",ELLIPSOID["WGS 84",6378137,298.257223563,
            LENGTHUNIT["metre",1]]],CS[ellipsoidal,2],AXIS["lat",north],
            ANGLEUNIT["degree",0.0174532925199433],ID["EPSG",4326]]"#;
        let cases = [
            (ESRI_UTM, "EPSG:32611", 1.0),
            (feet, "EPSG:2225", 0.304_800_609_601_219_2),
            (moon, "Moon 2000", 1_737_400.0),
            (wkt2, "EPSG:4326", WGS84_RADIUS_M),
        ];
        for (text, name, number) in cases {
            let found = name_and_number(crs_of_wkt(text).unwrap());
            assert_eq!(found, (name.to_string(), number));
        }
    }

    #[test]
    fn the_lines_of_arc_info_give_zone_hemisphere_and_unit_of_height() {
        let text = "Projection    UTM\nZone          56\nDatum         WGS84\nZunits        NO\n\
                    Units         METERS\nSpheroid      WGS84\nXshift        500000\n\
                    Yshift        10000000\nParameters\n\n";
        let found = parse(text).unwrap();
        assert_eq!(name_and_number(found.crs), ("EPSG:32756".into(), 1.0));
        assert_eq!(found.height_unit_m, None);
        let feet = "projection geographic\ndatum NAD83\nzunits feet\nunits dd\n";
        let found = parse(feet).unwrap();
        assert_eq!(found.height_unit_m, Some(0.3048));
        assert_eq!(name_and_number(found.crs).0, "EPSG:4269");
    }

    #[test]
    fn every_short_prefix_of_a_text_is_an_error_and_no_panic() {
        for length in 0..ESRI_UTM.len() {
            assert!(parse(&ESRI_UTM[..length]).is_err(), "{length}");
        }
    }

    #[test]
    fn texts_nested_without_end_are_refused() {
        let deep = "GEOGCS[".repeat(100_000);
        assert!(crs_of_wkt(&deep).unwrap_err().contains("nested"));
        let long = format!("GEOGCS[\"a\"{}]", ",UNIT[\"u\",1]".repeat(10_000));
        assert!(crs_of_wkt(&long).is_err());
    }

    #[test]
    fn grads_are_refused() {
        let text = r#"GEOGCS["x",DATUM["d",SPHEROID["s",6378137,298]],UNIT["grad",0.0157]]"#;
        assert!(crs_of_wkt(text).unwrap_err().contains("degrees"));
    }
}
