//! USGS ASCII DEM: profiles from south to north, each with its own length and start, so that the
//! border may be ragged; -32767 is a void.
//!
//! After USGS, "Standards for Digital Elevation Models", part 2 (1998): record A is 1024 bytes
//! (864 in old files), then a record B a profile. Numbers stand in fixed columns, but files are
//! about that have line ends between records, so they are read one by one.

use std::path::Path;

use crate::crs::vertical;

use super::error::in_and_out;
use super::heights::{self, HeightRule};
use super::{
    Crs, DemError, DemInfo, DemSource, OpenOptions, Placement, Registration, SampleType, prj,
};

/// The largest file that is read, in bytes: a 7.5' sheet at 3 m has 100 MB.
const MAX_FILE_BYTES: u64 = 256 << 20;
/// The most samples of the box around all profiles.
const MAX_SAMPLES: u64 = 64 << 20;
/// Rows that a corner of the sheet may lie beyond all profiles.
const MOST_ROWS_BEYOND: f64 = 64.0;
/// How far a profile's start may be off the lattice, in cells.
const MAX_OFF_LATTICE: f64 = 0.05;

const VOID: i32 = -32767;
const FOOT_M: f64 = 0.3048;

/// Bytes of record A up to which every file has it.
const SHORT_A_BYTES: usize = 864;
/// Where records B may start: after a long record A with or without line end, an old one, and
/// one that some programs make.
const B_STARTS: [usize; 6] = [1024, 1025, 1026, 864, 893, 896];

/// One open DEM.
pub(super) struct UsgsDem {
    info: DemInfo,
    rule: HeightRule,
    /// Stored values, row by row from the north-west; NaN where no profile has one.
    samples: Vec<f32>,
}

/// A profile's place and stored values, from the south.
struct Profile {
    x: f64,
    y: f64,
    datum: f64,
    values: Vec<i32>,
}

/// What record A says.
struct RecordA {
    system: u32,
    zone: i32,
    /// Metres a unit of height.
    unit_m: f64,
    /// Steps x, y in the system's units, z in units of height.
    steps: [f64; 3],
    profiles: u32,
    /// Of the corners, in the system's units.
    corners_y: [f64; 4],
    vertical: Option<String>,
    horizontal: u32,
}

/// Whether a text is a record A: codes where they must stand.
pub(super) fn looks_like(text: &str) -> bool {
    let code = |at: usize| -> Option<i32> { text.get(at..at + 6)?.trim().parse().ok() };
    text.len() >= SHORT_A_BYTES
        && matches!(code(150), Some(1 | 4))
        && matches!(code(156), Some(0..=3))
        && matches!(code(528), Some(0..=3))
        && matches!(code(534), Some(1 | 2))
        && code(540) == Some(4)
}

/// Numbers one after the other; a minus starts the next one, as full columns touch.
struct Numbers<'a> {
    text: &'a [u8],
    at: usize,
    path: &'a Path,
}

impl<'a> Numbers<'a> {
    fn token(&mut self) -> Option<&'a str> {
        let blank = |b: &u8| b.is_ascii_whitespace() || *b == 0;
        self.at += self.text[self.at..].iter().take_while(|b| blank(b)).count();
        let rest = &self.text[self.at..];
        let exponent = |i: usize| matches!(rest[i - 1], b'D' | b'E' | b'd' | b'e');
        let more = |i: &usize| !blank(&rest[*i]) && (rest[*i] != b'-' || exponent(*i));
        let length = match rest.is_empty() {
            true => return None,
            false => 1 + (1..rest.len()).take_while(more).count(),
        };
        self.at += length;
        std::str::from_utf8(&rest[..length]).ok()
    }

    fn number<T: std::str::FromStr>(&mut self, what: &str) -> Result<T, DemError> {
        let token = self.token();
        let value = token.and_then(|text| text.replace(['D', 'd'], "E").parse().ok());
        value.ok_or_else(|| {
            let found = token.map_or("the end of the file".into(), |text| format!("{text:?}"));
            DemError::damaged(self.path, format!("byte {}", self.at), found, what)
        })
    }

    fn at_end(&mut self) -> bool {
        let before = self.at;
        let next = self.token();
        self.at = before;
        next.is_none()
    }

    fn profile(&mut self) -> Result<Profile, DemError> {
        let _row: i32 = self.number("the row of a profile")?;
        let _column: i32 = self.number("the column of a profile")?;
        let count: u32 = self.number("the count of a profile's heights")?;
        let across: u32 = self.number("1, a profile's width")?;
        if across != 1 {
            let found = format!("a profile of {across} columns");
            return Err(DemError::damaged(
                self.path,
                format!("byte {}", self.at),
                found,
                "1",
            ));
        }
        let mut real = |what| self.number::<f64>(what);
        let (x, y) = (real("a profile's x")?, real("a profile's y")?);
        let datum = real("a profile's datum")?;
        let (_lowest, _highest) = (real("a profile's minimum")?, real("a profile's maximum")?);
        // A height takes two bytes at least, so a forged count ends with the file.
        let mut values = Vec::new();
        for _ in 0..count {
            values.push(self.number("a height")?);
        }
        Ok(Profile {
            x,
            y,
            datum,
            values,
        })
    }
}

impl RecordA {
    fn read(text: &[u8], path: &Path) -> Result<Self, DemError> {
        let field = |at: usize, length: usize| {
            let bytes = text.get(at..at + length).unwrap_or_default();
            String::from_utf8_lossy(bytes)
                .trim()
                .replace(['D', 'd'], "E")
        };
        let damaged = |at: usize, length: usize, expected: &str| {
            let found = format!("{:?}", field(at, length));
            DemError::damaged(path, format!("byte {at} of record A"), found, expected)
        };
        let whole = |at, what| -> Result<i32, DemError> {
            field(at, 6).parse().map_err(|_| damaged(at, 6, what))
        };
        let step = |at| -> Result<f64, DemError> {
            let parsed = field(at, 12).parse::<f64>().ok();
            let sound = parsed.filter(|step| step.is_finite() && *step > 0.0);
            sound.ok_or_else(|| damaged(at, 12, "a step above 0"))
        };
        let unit_m = match whole(534, "the unit of heights")? {
            1 => FOOT_M,
            2 => 1.0,
            _ => return Err(damaged(534, 6, "1 (feet) or 2 (metres)")),
        };
        let ground = whole(528, "the unit of places")?;
        let system = whole(156, "the reference system")?;
        if !matches!((system, ground), (0, 3) | (1, 2)) {
            let what = format!("reference system {system} in unit {ground}");
            let hint = format!("convert it: gdal_translate {}", in_and_out(path));
            return Err(DemError::unsupported(path, what, hint));
        }
        let profiles = u32::try_from(whole(858, "the count of profiles")?).unwrap_or_default();
        if profiles == 0 {
            return Err(damaged(858, 6, "the count of profiles"));
        }
        let code = |at| field(at, 2).parse().unwrap_or_default();
        let corner = |i: usize| field(570 + 48 * i, 24).parse().unwrap_or(f64::NAN);
        Ok(Self {
            system: system.unsigned_abs(),
            zone: whole(162, "the zone")?,
            unit_m,
            steps: [step(816)?, step(828)?, step(840)?],
            profiles,
            corners_y: [corner(0), corner(1), corner(2), corner(3)],
            vertical: vertical_datum(code(888)),
            horizontal: code(890),
        })
    }

    fn crs(&self, path: &Path) -> Result<Crs, DemError> {
        // Files before 1988 say no datum: it was NAD27.
        let (datum, geographic) = match self.horizontal {
            0 | 1 => ("NAD27", 4267),
            2 => ("WGS72", 4322),
            3 => ("WGS84", 4326),
            4 => ("NAD83", 4269),
            other => return Err(unknown(path, &format!("horizontal datum {other}"))),
        };
        if self.system == 0 {
            let radius_m = match geographic {
                4267 => 6_378_206.4,
                4322 => 6_378_135.0,
                _ => 6_378_137.0,
            };
            let name = format!("EPSG:{geographic}");
            return Ok(Crs::Geographic { name, radius_m });
        }
        let code = u16::try_from(self.zone.unsigned_abs())
            .ok()
            .and_then(|zone| prj::utm_code(datum, zone, self.zone < 0))
            .ok_or_else(|| unknown(path, &format!("UTM zone {} on {datum}", self.zone)))?;
        Ok(Crs::Projected {
            name: format!("EPSG:{code}"),
            metres_per_unit: 1.0,
        })
    }

    /// South and north of a box that reaches to the row beyond the southern and northern corner,
    /// unless they are far off: then it is them that are wrong.
    fn with_corners(&self, south: f64, north: f64) -> (f64, f64) {
        let rows = |beyond: f64| match (beyond / self.steps[1]).ceil() {
            rows if rows > 0.0 && rows <= MOST_ROWS_BEYOND => rows,
            _ => 0.0,
        };
        let most =
            |of: &dyn Fn(f64) -> f64| self.corners_y.iter().map(|y| of(*y)).fold(0.0, f64::max);
        let below = most(&|y| rows(south - y));
        let above = most(&|y| rows(y - north));
        (south - below * self.steps[1], north + above * self.steps[1])
    }

    /// Degrees of seconds of arc, or metres as they are.
    fn in_crs_units(&self, value: f64) -> f64 {
        if self.system == 0 {
            value / 3600.0
        } else {
            value
        }
    }
}

fn unknown(path: &Path, what: &str) -> DemError {
    let hint = format!("convert it: gdal_translate {}", in_and_out(path));
    DemError::unsupported(path, what, hint)
}

fn vertical_datum(code: u32) -> Option<String> {
    match code {
        1 => Some(vertical::from_code(5714)),
        2 => vertical::from_text("NGVD29 height"),
        3 => Some(vertical::from_code(5703)),
        _ => None,
    }
}

/// Where profiles lie on the lattice: first x, north row's y, columns and rows.
struct Frame {
    x0: f64,
    y0: f64,
    width: u32,
    height: u32,
}

impl UsgsDem {
    /// Reads the whole file: the box around its profiles is known only then.
    ///
    /// # Errors
    /// [`DemError::Damaged`] naming the byte; [`DemError::Unsupported`] for systems other than
    /// UTM and longitude and latitude; [`DemError::Limits`].
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Self, DemError> {
        let text = read(path)?;
        let a = RecordA::read(&text, path)?;
        let profiles = profiles(&text, &a, path)?;
        let frame = frame(&profiles, &a, path)?;
        let flat = profiles.iter().all(|p| p.datum == profiles[0].datum);
        let offset = if flat { profiles[0].datum } else { 0.0 };
        let rule = HeightRule {
            step_m: a.steps[2] * a.unit_m,
            offset_m: offset * a.unit_m,
            nodata: Some(f64::from(VOID)),
        };
        let sample_type = if flat {
            SampleType::I32
        } else {
            SampleType::F32
        };
        let rule = HeightRule::resolve(rule, options, sample_type, path)?;
        let info = DemInfo {
            path: path.into(),
            format: "USGS ASCII DEM",
            width: frame.width,
            height: frame.height,
            placement: Placement {
                x0: a.in_crs_units(frame.x0),
                y0: a.in_crs_units(frame.y0),
                dx: a.in_crs_units(a.steps[0]),
                dy: a.in_crs_units(a.steps[1]),
            },
            crs: a.crs(path)?,
            registration: Registration::Grid,
            sample_type,
            height_step_m: rule.step_m,
            nodata: rule.nodata,
            vertical: a.vertical.clone(),
        };
        info.check_size()?;
        let samples = gridded(
            &profiles,
            &frame,
            &a,
            if flat { None } else { Some(a.steps[2]) },
        );
        Ok(Self {
            info,
            rule,
            samples,
        })
    }
}

fn read(path: &Path) -> Result<Vec<u8>, DemError> {
    let found = std::fs::metadata(path)
        .map_err(|e| DemError::io(path, "ask the size", e))?
        .len();
    if found > MAX_FILE_BYTES {
        let what = "this ASCII DEM (gdal_translate makes a GeoTIFF of it)";
        return Err(DemError::limits(path, what, found, MAX_FILE_BYTES, "bytes"));
    }
    std::fs::read(path).map_err(|e| DemError::io(path, "read", e))
}

fn profiles(text: &[u8], a: &RecordA, path: &Path) -> Result<Vec<Profile>, DemError> {
    let mut numbers = Numbers { text, at: 0, path };
    // The first profile is number 1 1.
    let start = B_STARTS
        .into_iter()
        .filter(|at| *at < text.len())
        .find(|at| {
            numbers.at = *at;
            let fits = numbers.token().is_some_and(|t| t == "1");
            fits && numbers.token().is_some_and(|t| t == "1" || t == "0")
        });
    let Some(start) = start else {
        let expected = "the first profile, 1 1";
        return Err(DemError::damaged(
            path,
            "the end of record A",
            "something else",
            expected,
        ));
    };
    numbers.at = start;
    let mut profiles = Vec::new();
    while profiles.len() < a.profiles as usize {
        if numbers.at_end() {
            let found = format!("{} profiles", profiles.len());
            let expected = format!("{} (is the file cut short?)", a.profiles);
            return Err(DemError::damaged(
                path,
                "the end of the file",
                found,
                expected,
            ));
        }
        profiles.push(numbers.profile()?);
    }
    Ok(profiles)
}

/// The box around all profiles.
fn frame(profiles: &[Profile], a: &RecordA, path: &Path) -> Result<Frame, DemError> {
    let [dx, dy, _] = a.steps;
    let filled = || profiles.iter().filter(|p| !p.values.is_empty());
    let least = |of: fn(&Profile) -> f64| filled().map(of).fold(f64::INFINITY, f64::min);
    let (x0, south) = (least(|p| p.x), least(|p| p.y));
    let east = filled().map(|p| p.x).fold(f64::NEG_INFINITY, f64::max);
    let top = |p: &Profile| p.y + (p.values.len() - 1) as f64 * dy;
    let north = filled().map(top).fold(f64::NEG_INFINITY, f64::max);
    // The corners of the sheet count, too, though no sample may lie at them.
    let (south, north) = a.with_corners(south, north);
    let (width, height) = ((east - x0) / dx + 1.0, (north - south) / dy + 1.0);
    let sound = width.is_finite() && height.is_finite();
    if !sound || width.round() * height.round() > MAX_SAMPLES as f64 {
        let found = format!("a box of {width:.0} x {height:.0} samples");
        let expected = format!("at most {MAX_SAMPLES} samples");
        return Err(DemError::damaged(
            path,
            "the places of its profiles",
            found,
            expected,
        ));
    }
    for (i, p) in profiles.iter().enumerate() {
        let (column, row) = ((p.x - x0) / dx, (p.y - south) / dy);
        // A start that is no number is off, too.
        let on = |cells: f64| (cells - cells.round()).abs() <= MAX_OFF_LATTICE;
        let fits = p.values.is_empty() || (on(column) && on(row));
        if !fits {
            let place = format!("profile {}", i + 1);
            let found = format!("a start at {}, {}", p.x, p.y);
            let expected = format!("whole steps of {dx}, {dy} from {x0}, {south}");
            return Err(DemError::damaged(path, place, found, expected));
        }
    }
    Ok(Frame {
        x0,
        y0: south + (height.round() - 1.0) * dy,
        width: width.round() as u32,
        height: height.round() as u32,
    })
}

/// Rows from the north-west. With `step` each profile has its own datum, which is added in steps.
fn gridded(profiles: &[Profile], frame: &Frame, a: &RecordA, step: Option<f64>) -> Vec<f32> {
    let (width, height) = (frame.width as usize, frame.height as usize);
    let mut samples = vec![f32::NAN; width * height];
    for p in profiles {
        let column = ((p.x - frame.x0) / a.steps[0]).round() as usize;
        let bottom = ((frame.y0 - p.y) / a.steps[1]).round() as usize;
        for (up, value) in p.values.iter().enumerate() {
            let added = step.map_or(0.0, |step| p.datum / step);
            let stored = match *value {
                VOID => f64::from(VOID),
                value => f64::from(value) + added,
            };
            if let Some(row) = bottom.checked_sub(up) {
                samples[row * width + column] = stored as f32;
            }
        }
    }
    samples
}

impl DemSource for UsgsDem {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        let from = first_row as usize * self.info.width as usize;
        for (height, stored) in out.iter_mut().zip(&self.samples[from..]) {
            *height = self.rule.height_m(f64::from(*stored));
        }
        heights::check(&self.info, first_row, out)
    }
}

#[cfg(test)]
mod tests;
