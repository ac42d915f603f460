//! Ellipsoids, datums and units, by the names and codes that files give.

use super::methods::plain;

/// Datums by their plain names in WKT, without `d` or `datum` before and after, with the EPSG
/// code of the geographic CRS that has them.
const DATUMS: &[(&str, u16)] = &[
    ("wgs1984", 4326),
    ("worldgeodeticsystem1984", 4326),
    ("worldgeodeticsystem1984ensemble", 4326),
    ("wgs84", 4326),
    ("wgs1972", 4322),
    ("northamerican1983", 4269),
    ("northamericandatum1983", 4269),
    ("northamerican1927", 4267),
    ("northamericandatum1927", 4267),
    ("etrs1989", 4258),
    ("europeanterrestrialreferencesystem1989", 4258),
    ("europeanterrestrialreferencesystem1989ensemble", 4258),
    ("european1950", 4230),
    ("europeandatum1950", 4230),
    ("osgb1936", 4277),
    ("ordnancesurveyofgreatbritain1936", 4277),
    ("deutscheshauptdreiecksnetz", 4314),
    ("pulkovo1942", 4284),
    ("tokyo", 4301),
    ("ch1903", 4149),
    ("militargeographischeinstitut", 4312),
    ("mgi", 4312),
    ("amersfoort", 4289),
    ("nzgd2000", 4167),
    ("newzealandgeodeticdatum2000", 4167),
    ("gda1994", 4283),
    ("geocentricdatumofaustralia1994", 4283),
    ("gda2020", 7844),
    ("geocentricdatumofaustralia2020", 7844),
    ("jgd2000", 4612),
    ("japanesegeodeticdatum2000", 4612),
    ("jgd2011", 6668),
    ("japanesegeodeticdatum2011", 6668),
    ("korean2000", 4737),
    ("geocentricdatumofkorea", 4737),
    ("sirgas2000", 4674),
    ("sistemadereferenciageocentricoparalasamericas2000", 4674),
    ("southamerican1969", 4618),
    ("southamericandatum1969", 4618),
    ("rgf1993", 4171),
    ("reseaugeodesiquefrancais1993", 4171),
];

/// Semi-major axes in metres and inverse flattenings (0: a sphere), by EPSG ellipsoid code.
const ELLIPSOIDS: [(u16, f64, f64); 11] = [
    (7001, 6_377_563.396, 299.324_964_6), // Airy 1830
    (7004, 6_377_397.155, 299.152_812_8), // Bessel 1841
    (7008, 6_378_206.4, 294.978_698_214), // Clarke 1866
    (7012, 6_378_249.145, 293.465),       // Clarke 1880 (RGS)
    (7015, 6_377_276.345, 300.801_7),     // Everest 1830
    (7019, 6_378_137.0, 298.257_222_101), // GRS 1980
    (7022, 6_378_388.0, 297.0),           // International 1924
    (7024, 6_378_245.0, 298.3),           // Krassowsky 1940
    (7030, 6_378_137.0, 298.257_223_563), // WGS 84
    (7035, 6_371_000.0, 0.0),             // sphere
    (7043, 6_378_135.0, 298.26),          // WGS 72
];

/// Equatorial radii in metres by name (IAU Working Group, 2015), for files that give no axis.
const BODIES: [(&str, f64, f64); 5] = [
    ("moon", 1_737_400.0, 0.0),
    ("mars", 3_396_190.0, 169.894_447_22),
    ("mercury", 2_440_530.0, 0.0),
    ("venus", 6_051_800.0, 0.0),
    ("wgs", 6_378_137.0, 298.257_223_563),
];

/// What longitude and latitude are measured on.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Body {
    /// The geographic CRS, as its file calls it.
    pub name: String,
    /// Its EPSG code, stated or known by its datum's name.
    pub code: Option<u16>,
    /// Semi-major axis in metres and inverse flattening, 0 for a sphere.
    pub ellipsoid: Option<(f64, f64)>,
    /// Shift to WGS 84: three or seven numbers.
    pub to_wgs84: Vec<f64>,
    /// Longitude of the prime meridian, degrees from Greenwich.
    pub prime_meridian_deg: f64,
}

impl Body {
    /// The code of a datum by its name.
    pub fn code_of_datum(name: &str) -> Option<u16> {
        let name = plain(name);
        let short = name.strip_prefix('d').unwrap_or(&name);
        let found = DATUMS
            .iter()
            .find(|(known, _)| *known == name || *known == short);
        found.map(|(_, code)| *code)
    }

    /// The ellipsoid of an EPSG code.
    pub fn ellipsoid_of_code(code: u16) -> Option<(f64, f64)> {
        let found = ELLIPSOIDS.iter().find(|(known, ..)| *known == code);
        found.map(|(_, a, rf)| (*a, *rf))
    }

    /// The ellipsoid of a body that a citation names.
    pub fn ellipsoid_of_name(name: &str) -> Option<(f64, f64)> {
        let name = name.to_ascii_lowercase();
        let found = BODIES.iter().find(|(known, ..)| name.contains(known));
        found.map(|(_, a, rf)| (*a, *rf))
    }

    /// `+datum=...`, `+ellps=...` or `+a=... +rf=...`, with shift and prime meridian.
    ///
    /// # Errors
    /// A sentence, where nothing says how large the body is, or its axes are none.
    pub fn proj(&self) -> Result<String, String> {
        if let Some(definition) = self.code.and_then(super::epsg_definition) {
            return Ok(super::without(
                definition,
                &["proj", "no_defs", "type", "units", "to_meter"],
            ));
        }
        let Some((a, rf)) = self.ellipsoid else {
            return Err(format!(
                "nothing says how large the body of {:?} is",
                self.name
            ));
        };
        if !(a.is_finite() && a > 0.0 && rf.is_finite() && (rf == 0.0 || rf > 1.0)) {
            return Err(format!(
                "a semi-major axis of {a} m with an inverse flattening of {rf}"
            ));
        }
        let mut out = match rf {
            0.0 => format!("+R={a}"),
            _ => format!("+a={a} +rf={rf}"),
        };
        if matches!(self.to_wgs84.len(), 3 | 7) {
            let shift: Vec<String> = self.to_wgs84.iter().map(f64::to_string).collect();
            out += &format!(" +towgs84={}", shift.join(","));
        }
        if self.prime_meridian_deg != 0.0 {
            out += &format!(" +pm={}", self.prime_meridian_deg);
        }
        Ok(out)
    }

    /// The name of longitude and latitude on this body, as [`crate::dem::Crs`] has it.
    ///
    /// # Errors
    /// As [`proj`](Self::proj).
    pub fn geographic_name(&self) -> Result<String, String> {
        if let Some(code) = self.code {
            return Ok(format!("EPSG:{code}"));
        }
        let proj = self.proj()?;
        let sphere = self.ellipsoid.is_some_and(|(_, rf)| rf == 0.0);
        if sphere && self.prime_meridian_deg == 0.0 && !self.name.is_empty() {
            return Ok(self.name.clone());
        }
        let title = super::title_parameter(&self.name);
        Ok(format!("+proj=longlat {proj} +no_defs{title}"))
    }

    /// Semi-major axis, metres.
    ///
    /// # Errors
    /// As [`proj`](Self::proj).
    pub fn radius_m(&self) -> Result<f64, String> {
        if let (None, Some((a, _))) = (self.code, self.ellipsoid) {
            return Ok(a);
        }
        let definition = format!("+proj=longlat {}", self.proj()?);
        Ok(super::projection::checked(&definition)?
            .ellipse_parameters()
            .0)
    }
}

/// Metres of an EPSG length unit.
pub(crate) fn linear_unit(code: u16) -> Option<f64> {
    match code {
        9001 => Some(1.0),
        9002 => Some(0.3048),
        9003 => Some(1200.0 / 3937.0),
        9005 => Some(0.304_797_265_4), // Clarke's foot
        9036 => Some(1000.0),
        _ => None,
    }
}
