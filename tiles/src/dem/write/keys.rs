//! GeoKeys of a source: what `geokeys` reads, and GDAL too.

use super::super::{Crs, DemInfo, Registration};
use crate::crs::{self, Conversion, Role};

const USER_DEFINED: u16 = 32767;
const DOUBLES_TAG: u16 = 34736;
const ASCII_TAG: u16 = 34737;

/// The three GeoKey tags while they grow.
#[derive(Debug, Default)]
pub(super) struct Keys {
    entries: Vec<[u16; 4]>,
    /// `GeoDoubleParams`.
    pub doubles: Vec<f64>,
    /// `GeoAsciiParams`.
    pub ascii: String,
}

impl Keys {
    /// All that is known of a source's coordinates and heights; heights are in metres.
    pub fn of(info: &DemInfo) -> Keys {
        let mut keys = Keys::default();
        let grid = info.registration == Registration::Grid;
        keys.code(1025, if grid { 2 } else { 1 });
        match &info.crs {
            Crs::Projected {
                name,
                metres_per_unit,
            } => keys.projected(name, *metres_per_unit),
            Crs::Geographic { name, radius_m } => keys.geographic(name, *radius_m),
            Crs::Local => {}
        }
        if let Some(vertical) = &info.vertical {
            keys.vertical(vertical);
        }
        keys
    }

    /// `GeoKeyDirectory`, sorted by key as the standard demands.
    pub fn directory(&self) -> Vec<u16> {
        let mut entries = self.entries.clone();
        entries.sort_unstable();
        let mut directory = vec![1, 1, 0, entries.len() as u16];
        directory.extend(entries.iter().flatten());
        directory
    }

    fn projected(&mut self, name: &str, metres_per_unit: f64) {
        self.code(1024, 1);
        self.text(1026, crs::title(name));
        match linear_code(metres_per_unit) {
            Some(code) => self.code(3076, code),
            None => {
                self.code(3076, USER_DEFINED);
                self.numbers(3077, &[metres_per_unit]);
            }
        }
        if let Some(code) = crs::epsg_code(name) {
            self.code(3072, code);
            return;
        }
        self.code(3072, USER_DEFINED);
        self.text(3073, crs::title(name));
        if let Some(conversion) = Conversion::of_proj(name) {
            self.conversion(&conversion, metres_per_unit);
            self.body(name, "unnamed");
        }
    }

    fn conversion(&mut self, conversion: &Conversion, metres_per_unit: f64) {
        self.code(3074, USER_DEFINED);
        self.code(3075, conversion.method.geotiff);
        for (key, value) in conversion.geokeys() {
            let length = Role::of_geokey(key).is_some_and(Role::is_length);
            let unit = if length { metres_per_unit } else { 1.0 };
            self.numbers(key, &[value / unit]);
        }
    }

    fn geographic(&mut self, name: &str, radius_m: f64) {
        self.code(1024, 2);
        if let Some(code) = crs::epsg_code(name) {
            self.code(2048, code);
            self.code(2054, 9102);
            self.text(2049, name);
            self.numbers(2057, &[radius_m]);
            return;
        }
        let title = crs::title(name);
        self.text(1026, title);
        match name.starts_with("+proj=") {
            true => self.body(name, &title.replace('_', " ")),
            false => self.body(&format!("+R={radius_m}"), title),
        }
    }

    /// Ellipsoid, datum and prime meridian of a PROJ string.
    fn body(&mut self, definition: &str, title: &str) {
        self.code(2054, 9102);
        let datum = crs::parameter(definition, "datum");
        let known = [("WGS84", 4326), ("NAD83", 4269), ("NAD27", 4267)];
        if let Some((_, code)) = known.iter().find(|(name, _)| Some(*name) == datum) {
            self.code(2048, *code);
            return;
        }
        for id in [2048, 2050, 2056] {
            self.code(id, USER_DEFINED);
        }
        self.text(2049, title);
        if let Some([a, b]) = crs::axes_m(definition) {
            self.numbers(2057, &[a]);
            self.numbers(2058, &[b]);
        }
        let shift = crs::parameter(definition, "towgs84").unwrap_or_default();
        let shift: Vec<f64> = shift.split(',').filter_map(|v| v.parse().ok()).collect();
        if !shift.is_empty() {
            self.numbers(2062, &shift);
        }
        let meridian = crs::parameter(definition, "pm").and_then(|v| v.parse().ok());
        if let Some(degrees) = meridian {
            self.code(2051, USER_DEFINED);
            self.numbers(2061, &[degrees]);
        }
    }

    /// A code only where its unit is the metre, which heights are written in.
    fn vertical(&mut self, vertical: &str) {
        let code = vertical
            .rsplit_once("(EPSG:")
            .and_then(|(_, code)| code.strip_suffix(')'));
        let code = code.and_then(|code| code.parse().ok());
        let code = code.filter(|_| !vertical.contains("(ft"));
        self.code(4096, code.unwrap_or(USER_DEFINED));
        self.text(4097, vertical);
        self.code(4099, 9001);
    }

    fn code(&mut self, id: u16, code: u16) {
        self.entries.push([id, 0, 1, code]);
    }

    fn numbers(&mut self, id: u16, numbers: &[f64]) {
        let (count, at) = (numbers.len() as u16, self.doubles.len() as u16);
        self.entries.push([id, DOUBLES_TAG, count, at]);
        self.doubles.extend(numbers);
    }

    fn text(&mut self, id: u16, text: &str) {
        let kept: String = text
            .chars()
            .take(200)
            .map(|c| if c.is_ascii() && c != '|' { c } else { '?' })
            .collect();
        let (count, at) = (kept.len() as u16 + 1, self.ascii.len() as u16);
        self.entries.push([id, ASCII_TAG, count, at]);
        self.ascii += &kept;
        self.ascii.push('|');
    }
}

fn linear_code(metres: f64) -> Option<u16> {
    let known = [9001, 9002, 9003, 9005, 9036];
    let same = |code: &u16| crs::linear_unit(*code).is_some_and(|m| (m - metres).abs() < 1e-12);
    known.into_iter().find(same)
}
