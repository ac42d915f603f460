//! The GeoKey directory of a GeoTIFF: what its coordinates mean.
//!
//! After OGC 19-008r4, "OGC GeoTIFF Standard", version 1.1 (2019), section 7.

use std::collections::BTreeMap;
use std::path::Path;

use super::error::in_and_out;
use super::{Crs, DemError, Registration};

/// Key numbers of the standard, annex B.
mod key {
    pub const MODEL_TYPE: u16 = 1024;
    pub const RASTER_TYPE: u16 = 1025;
    pub const CITATION: u16 = 1026;
    pub const GEODETIC_CRS: u16 = 2048;
    pub const GEODETIC_CITATION: u16 = 2049;
    pub const GEODETIC_DATUM: u16 = 2050;
    pub const ANGULAR_UNITS: u16 = 2054;
    pub const ELLIPSOID: u16 = 2056;
    pub const SEMI_MAJOR_AXIS: u16 = 2057;
    pub const PROJECTED_CRS: u16 = 3072;
    pub const PROJECTED_CITATION: u16 = 3073;
    pub const LINEAR_UNITS: u16 = 3076;
    pub const LINEAR_UNIT_SIZE: u16 = 3077;
    pub const VERTICAL_UNITS: u16 = 4099;
}

/// Tags that hold the values which are not in the directory itself.
const DOUBLES_TAG: u16 = 34736;
const ASCII_TAG: u16 = 34737;

/// Code that stands for "see the other keys".
const USER_DEFINED: u16 = 32767;

const WGS84_RADIUS_M: f64 = 6_378_137.0;

/// Semi-major axes in metres, by EPSG ellipsoid code.
const ELLIPSOIDS: [(u16, f64); 10] = [
    (7001, 6_377_563.396), // Airy 1830
    (7004, 6_377_397.155), // Bessel 1841
    (7008, 6_378_206.4),   // Clarke 1866
    (7012, 6_378_249.145), // Clarke 1880 (RGS)
    (7015, 6_377_276.345), // Everest 1830
    (7019, WGS84_RADIUS_M),
    (7022, 6_378_388.0), // International 1924
    (7024, 6_378_245.0), // Krassowsky 1940
    (7030, WGS84_RADIUS_M),
    (7043, 6_378_135.0), // WGS 72
];

/// Equatorial radii in metres by name in a citation (IAU Working Group, 2015), for files that
/// give no axis.
const BODIES: [(&str, f64); 5] = [
    ("moon", 1_737_400.0),
    ("mars", 3_396_190.0),
    ("mercury", 2_440_530.0),
    ("venus", 6_051_800.0),
    ("wgs", WGS84_RADIUS_M),
];

#[derive(Debug, Clone, PartialEq)]
enum Value {
    Code(u16),
    Number(f64),
    Text(String),
}

/// The keys of one file.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct GeoKeys(BTreeMap<u16, Value>);

impl GeoKeys {
    /// Reads the three GeoKey tags; all empty gives no keys.
    ///
    /// # Errors
    /// [`DemError::Damaged`] where the directory points outside its tags.
    pub fn parse(
        directory: &[u16],
        doubles: &[f64],
        ascii: &str,
        path: &Path,
    ) -> Result<Self, DemError> {
        let mut keys = BTreeMap::new();
        let [_, _, _, count, entries @ ..] = directory else {
            return Ok(Self(keys));
        };
        let (entries, _) = entries.as_chunks::<4>();
        if entries.len() < usize::from(*count) {
            let found = format!("{} of {count} keys", entries.len());
            return Err(DemError::damaged(
                path,
                "GeoKeyDirectory",
                found,
                "all of them",
            ));
        }
        for &[id, location, length, value] in &entries[..usize::from(*count)] {
            let (from, to) = (usize::from(value), usize::from(value) + usize::from(length));
            let found = match location {
                0 => Some(Value::Code(value)),
                DOUBLES_TAG => doubles.get(from).map(|number| Value::Number(*number)),
                ASCII_TAG => ascii_range(ascii, from, to).map(Value::Text),
                _ => continue,
            };
            let outside = || {
                let found = format!("values {from}..{to} of tag {location}");
                DemError::damaged(path, format!("GeoKey {id}"), found, "values inside the tag")
            };
            keys.insert(id, found.ok_or_else(outside)?);
        }
        Ok(Self(keys))
    }

    /// Cell where the file does not say, as GDAL has it.
    pub fn registration(&self) -> Registration {
        if self.code(key::RASTER_TYPE) == Some(2) {
            Registration::Grid
        } else {
            Registration::Cell
        }
    }

    /// What the coordinates mean; `None` where no key says so.
    ///
    /// # Errors
    /// [`DemError::Unsupported`] for geocentric coordinates, angles other than degrees, units or
    /// bodies that are not known.
    pub fn crs(&self, path: &Path) -> Result<Option<Crs>, DemError> {
        let model = self
            .code(key::MODEL_TYPE)
            .filter(|code| *code != USER_DEFINED);
        match model {
            Some(1) => self.projected(path).map(Some),
            Some(2) => self.geographic(path).map(Some),
            Some(3) => Err(self.reproject(path, "a geocentric CRS")),
            _ if self.0.contains_key(&key::PROJECTED_CRS) => self.projected(path).map(Some),
            _ if self.0.contains_key(&key::GEODETIC_CRS) => self.geographic(path).map(Some),
            _ => Ok(None),
        }
    }

    /// Metres of the vertical unit; `None` where the file does not say.
    ///
    /// # Errors
    /// [`DemError::Unsupported`] for a unit that is not a known length.
    pub fn vertical_metres(&self, path: &Path) -> Result<Option<f64>, DemError> {
        let Some(code) = self
            .code(key::VERTICAL_UNITS)
            .filter(|code| ![0, USER_DEFINED].contains(code))
        else {
            return Ok(None);
        };
        let unknown = || {
            let hint = "give the metres of one unit as --height-step";
            DemError::unsupported(path, format!("vertical unit EPSG:{code}"), hint)
        };
        linear_unit(code).map(Some).ok_or_else(unknown)
    }

    fn projected(&self, path: &Path) -> Result<Crs, DemError> {
        let name = self
            .epsg(key::PROJECTED_CRS)
            .or_else(|| self.text(key::PROJECTED_CITATION))
            .or_else(|| self.text(key::CITATION))
            .unwrap_or_else(|| "unnamed projection".into());
        let metres_per_unit = match self.code(key::LINEAR_UNITS) {
            None | Some(0) => Some(1.0),
            Some(USER_DEFINED) => self.number(key::LINEAR_UNIT_SIZE),
            Some(code) => linear_unit(code),
        };
        match metres_per_unit {
            Some(metres_per_unit) if metres_per_unit.is_finite() && metres_per_unit > 0.0 => {
                Ok(Crs::Projected {
                    name,
                    metres_per_unit,
                })
            }
            _ => Err(self.reproject(path, "its linear unit")),
        }
    }

    fn geographic(&self, path: &Path) -> Result<Crs, DemError> {
        // 9122 is the degree as EPSG's own definitions name it.
        if !matches!(self.code(key::ANGULAR_UNITS), None | Some(9102 | 9122)) {
            return Err(self.reproject(path, "an angular unit other than the degree"));
        }
        let name = self
            .epsg(key::GEODETIC_CRS)
            .or_else(|| self.text(key::GEODETIC_CITATION))
            .or_else(|| self.text(key::CITATION))
            .unwrap_or_else(|| "unnamed geographic CRS".into());
        match self.radius_m(&name) {
            Some(radius_m) if radius_m.is_finite() && radius_m > 0.0 => {
                Ok(Crs::Geographic { name, radius_m })
            }
            _ => Err(self.reproject(path, "a geographic CRS without the radius of its body")),
        }
    }

    /// The file's own axis first, then its ellipsoid, then an Earth code, then a body's name.
    fn radius_m(&self, name: &str) -> Option<f64> {
        let ellipsoid = self.code(key::ELLIPSOID);
        let listed = || ELLIPSOIDS.iter().find(|(code, _)| Some(*code) == ellipsoid);
        let lower = name.to_ascii_lowercase();
        let earth = [key::GEODETIC_CRS, key::GEODETIC_DATUM]
            .iter()
            .any(|id| matches!(self.code(*id), Some(1024..USER_DEFINED)));
        self.number(key::SEMI_MAJOR_AXIS)
            .or_else(|| listed().map(|(_, radius_m)| *radius_m))
            .or_else(|| earth.then_some(WGS84_RADIUS_M))
            .or_else(|| Some(BODIES.iter().find(|(body, _)| lower.contains(body))?.1))
    }

    fn reproject(&self, path: &Path, what: &str) -> DemError {
        let hint = format!("convert it: gdalwarp -t_srs EPSG:4326 {}", in_and_out(path));
        DemError::unsupported(path, what, hint)
    }

    fn code(&self, id: u16) -> Option<u16> {
        match self.0.get(&id) {
            Some(Value::Code(code)) => Some(*code),
            _ => None,
        }
    }

    fn number(&self, id: u16) -> Option<f64> {
        match self.0.get(&id) {
            Some(Value::Number(number)) => Some(*number),
            Some(Value::Code(code)) => Some(f64::from(*code)),
            _ => None,
        }
    }

    fn epsg(&self, id: u16) -> Option<String> {
        let code = self
            .code(id)
            .filter(|code| ![0, USER_DEFINED].contains(code))?;
        Some(format!("EPSG:{code}"))
    }

    /// A citation; of GDAL's `GCS Name = Moon 2000|Datum = ...` only the name.
    fn text(&self, id: u16) -> Option<String> {
        let Some(Value::Text(text)) = self.0.get(&id) else {
            return None;
        };
        let first = text.split('|').next().unwrap_or_default();
        let name = first
            .rsplit_once(" = ")
            .map_or(first, |(_, name)| name)
            .trim();
        (!name.is_empty()).then(|| name.to_string())
    }
}

/// Metres of an EPSG length unit.
fn linear_unit(code: u16) -> Option<f64> {
    match code {
        9001 => Some(1.0),
        9002 => Some(0.3048),
        9003 => Some(1200.0 / 3937.0),
        9005 => Some(0.304_797_265_4), // Clarke's foot
        9036 => Some(1000.0),
        _ => None,
    }
}

fn ascii_range(ascii: &str, from: usize, to: usize) -> Option<String> {
    // Writers disagree on whether the closing NUL counts, so the end may be one beyond.
    let bytes = ascii.as_bytes();
    let to = to.min(bytes.len());
    Some(String::from_utf8_lossy(bytes.get(from..to)?).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys(entries: &[[u16; 4]], doubles: &[f64], ascii: &str) -> GeoKeys {
        let mut directory = vec![1, 1, 0, entries.len() as u16];
        directory.extend(entries.iter().flatten());
        GeoKeys::parse(&directory, doubles, ascii, Path::new("f.tif")).unwrap()
    }

    #[test]
    fn the_moon_brings_its_own_radius_and_name() {
        let entries = [
            [1024, 0, 1, 2],
            [2048, 0, 1, 32767],
            [2049, ASCII_TAG, 33, 0],
            [2057, DOUBLES_TAG, 1, 0],
        ];
        let moon = keys(
            &entries,
            &[1_737_400.0],
            "GCS Name = Moon 2000|Datum = Moon|",
        );
        let expected = Crs::Geographic {
            name: "Moon 2000".into(),
            radius_m: 1_737_400.0,
        };
        assert_eq!(moon.crs(Path::new("f")).unwrap(), Some(expected));
    }

    #[test]
    fn us_survey_feet_become_metres_across_and_up() {
        let entries = [
            [1024, 0, 1, 1],
            [3072, 0, 1, 2225],
            [3076, 0, 1, 9003],
            [4099, 0, 1, 9002],
        ];
        let feet = keys(&entries, &[], "");
        let metres_per_unit = 1200.0 / 3937.0;
        let expected = Crs::Projected {
            name: "EPSG:2225".into(),
            metres_per_unit,
        };
        assert_eq!(feet.crs(Path::new("f")).unwrap(), Some(expected));
        assert_eq!(feet.vertical_metres(Path::new("f")).unwrap(), Some(0.3048));
    }

    #[test]
    fn angles_in_grads_are_refused_with_the_command_that_converts() {
        let grads = keys(
            &[[1024, 0, 1, 2], [2048, 0, 1, 4807], [2054, 0, 1, 9105]],
            &[],
            "",
        );
        let error = grads.crs(Path::new("f.tif")).unwrap_err().to_string();
        assert!(error.contains("gdalwarp"), "{error}");
    }

    #[test]
    fn a_key_that_points_outside_its_tag_is_damage() {
        let directory = [1, 1, 0, 1, 2057, DOUBLES_TAG, 1, 9];
        let result = GeoKeys::parse(&directory, &[1.0], "", Path::new("f"));
        assert!(matches!(result, Err(DemError::Damaged { .. })));
    }

    #[test]
    fn a_directory_shorter_than_its_count_is_damage() {
        let result = GeoKeys::parse(&[1, 1, 0, 5, 1024, 0, 1, 1], &[], "", Path::new("f"));
        assert!(matches!(result, Err(DemError::Damaged { .. })));
    }
}
