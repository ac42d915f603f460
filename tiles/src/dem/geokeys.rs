//! The GeoKey directory of a GeoTIFF: what its coordinates mean.
//!
//! After OGC 19-008r4, "OGC GeoTIFF Standard", version 1.1 (2019), section 7.

use std::collections::BTreeMap;
use std::path::Path;

use super::error::in_and_out;
use super::{Crs, DemError, Registration};
use crate::crs::{self, Body, Conversion, Role, linear_unit};

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
    pub const PRIME_MERIDIAN: u16 = 2051;
    pub const SEMI_MINOR_AXIS: u16 = 2058;
    pub const INVERSE_FLATTENING: u16 = 2059;
    pub const PRIME_MERIDIAN_LONGITUDE: u16 = 2061;
    pub const TO_WGS84: u16 = 2062;
    pub const PROJECTION: u16 = 3074;
    pub const METHOD: u16 = 3075;
    pub const VERTICAL_CRS: u16 = 4096;
    pub const VERTICAL_CITATION: u16 = 4097;
    pub const VERTICAL_UNITS: u16 = 4099;
}

/// Tags that hold the values which are not in the directory itself.
const DOUBLES_TAG: u16 = 34736;
const ASCII_TAG: u16 = 34737;

/// Code that stands for "see the other keys".
const USER_DEFINED: u16 = 32767;

/// EPSG's prime meridian of Greenwich.
const GREENWICH: u16 = 8901;

#[derive(Debug, Clone, PartialEq)]
enum Value {
    Code(u16),
    Numbers(Vec<f64>),
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
                DOUBLES_TAG => doubles
                    .get(from..to)
                    .filter(|v| !v.is_empty())
                    .map(|v| Value::Numbers(v.to_vec())),
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

    /// What heights are above, by its code or its citation; `None` where no key says so.
    pub fn vertical(&self) -> Option<String> {
        let stated = |id| {
            self.code(id)
                .filter(|code| ![0, USER_DEFINED].contains(code))
        };
        if let Some(code) = stated(key::VERTICAL_CRS) {
            return Some(crs::vertical::from_code(code));
        }
        let citation = self.text(key::VERTICAL_CITATION);
        let three_dimensions =
            || (stated(key::GEODETIC_CRS)? == 4979).then(|| crs::vertical::from_code(4979));
        citation
            .and_then(|text| crs::vertical::from_text(&text))
            .or_else(three_dimensions)
    }

    fn projected(&self, path: &Path) -> Result<Crs, DemError> {
        let by_code = self
            .epsg(key::PROJECTED_CRS)
            .and_then(|code| crs::from_user(&code).ok());
        let metres_per_unit = match (self.code(key::LINEAR_UNITS), &by_code) {
            (
                None | Some(0),
                Some(Crs::Projected {
                    metres_per_unit, ..
                }),
            ) => Some(*metres_per_unit),
            (None | Some(0), _) => Some(1.0),
            (Some(USER_DEFINED), _) => self.number(key::LINEAR_UNIT_SIZE),
            (Some(code), _) => linear_unit(code),
        };
        let positive = |metres: &f64| metres.is_finite() && *metres > 0.0;
        let Some(metres_per_unit) = metres_per_unit.filter(positive) else {
            return Err(self.reproject(path, "its linear unit"));
        };
        let name = self
            .epsg(key::PROJECTED_CRS)
            .or_else(|| self.conversion_name(metres_per_unit))
            .unwrap_or_else(|| self.projected_citation());
        Ok(Crs::Projected {
            name,
            metres_per_unit,
        })
    }

    fn projected_citation(&self) -> String {
        self.text(key::PROJECTED_CITATION)
            .or_else(|| self.text(key::CITATION))
            .unwrap_or_else(|| "unnamed projection".into())
    }

    /// The definition of a projection that is given by its parameters; `None` where they do not
    /// suffice, or name a method that is not known.
    fn conversion_name(&self, metres_per_unit: f64) -> Option<String> {
        // EPSG numbers UTM's zones 16001 to 16060, and 16101 to 16160 in the south.
        let mut conversion = match self.code(key::PROJECTION) {
            Some(code @ 16001..=16060) => Conversion::utm(code - 16000, false),
            Some(code @ 16101..=16160) => Conversion::utm(code - 16100, true),
            _ => Conversion::of_geotiff(self.code(key::METHOD)?)?,
        };
        for id in self.0.keys() {
            let (Some(role), Some(value)) = (Role::of_geokey(*id), self.number(*id)) else {
                continue;
            };
            let scale = if role.is_length() {
                metres_per_unit
            } else {
                1.0
            };
            conversion.values.push((role, value * scale));
        }
        if !self.has_degrees() {
            return None;
        }
        let title = crs::title_parameter(&self.projected_citation());
        crs::wkt::named(&conversion, &self.body(), metres_per_unit, &title).ok()
    }

    fn geographic(&self, path: &Path) -> Result<Crs, DemError> {
        if !self.has_degrees() {
            return Err(self.reproject(path, "an angular unit other than the degree"));
        }
        let body = self.body();
        match (body.geographic_name(), body.radius_m()) {
            (Ok(name), Ok(radius_m)) => Ok(Crs::Geographic { name, radius_m }),
            (Err(why), _) | (_, Err(why)) => {
                let what = format!("a geographic CRS without the radius of its body ({why})");
                Err(self.reproject(path, &what))
            }
        }
    }

    /// 9122 is the degree as EPSG's own definitions name it.
    fn has_degrees(&self) -> bool {
        matches!(self.code(key::ANGULAR_UNITS), None | Some(9102 | 9122))
    }

    /// The file's own axes first, then its ellipsoid, then what its name says. An EPSG code that
    /// is not known here is one of Earth.
    fn body(&self) -> Body {
        let name = self
            .text(key::GEODETIC_CITATION)
            .or_else(|| self.text(key::CITATION))
            .unwrap_or_else(|| "unnamed geographic CRS".into());
        let stated = |id| {
            self.code(id)
                .filter(|code| (1024..USER_DEFINED).contains(code))
        };
        let code = stated(key::GEODETIC_CRS);
        // GeoTIFF's datums 6000 to 6999 are those of the CRSs 4000 to 4999.
        let by_datum = stated(key::GEODETIC_DATUM).filter(|code| (6000..7000).contains(code));
        let earth = (code.is_some() || by_datum.is_some()).then_some(7030);
        let listed = self.code(key::ELLIPSOID).or(earth);
        let ellipsoid = self
            .own_ellipsoid()
            .or_else(|| listed.and_then(Body::ellipsoid_of_code))
            .or_else(|| Body::ellipsoid_of_name(&name));
        let greenwich = self
            .code(key::PRIME_MERIDIAN)
            .is_none_or(|code| code == GREENWICH);
        let prime_meridian_deg = match greenwich {
            true => 0.0,
            false => self.number(key::PRIME_MERIDIAN_LONGITUDE).unwrap_or(0.0),
        };
        Body {
            code: code.or(by_datum.map(|code| code - 2000).filter(|_| greenwich)),
            ellipsoid,
            to_wgs84: self.numbers(key::TO_WGS84).to_vec(),
            prime_meridian_deg,
            name,
        }
    }

    /// Semi-major axis and inverse flattening, 0 for a sphere.
    fn own_ellipsoid(&self) -> Option<(f64, f64)> {
        let a = self.number(key::SEMI_MAJOR_AXIS)?;
        let by_minor = |b: f64| if a == b { 0.0 } else { a / (a - b) };
        let flattening = self
            .number(key::INVERSE_FLATTENING)
            .or_else(|| self.number(key::SEMI_MINOR_AXIS).map(by_minor));
        Some((a, flattening.unwrap_or(0.0)))
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
            Some(Value::Numbers(numbers)) => numbers.first().copied(),
            Some(Value::Code(code)) => Some(f64::from(*code)),
            _ => None,
        }
    }

    fn numbers(&self, id: u16) -> &[f64] {
        match self.0.get(&id) {
            Some(Value::Numbers(numbers)) => numbers,
            _ => &[],
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
