//! DTED levels 0 to 2: columns from west to east, each from south to north, big-endian
//! sign-and-magnitude, -32767 a void, grid-registered.
//!
//! After MIL-PRF-89020B, "Performance Specification, Digital Terrain Elevation Data" (2000):
//! UHL (80 bytes), DSI (648), ACC (2700), then a record a column with a checksum. Towards the
//! poles columns are further apart than rows, in degrees.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use crate::crs::vertical;

use super::error::in_and_out;
use super::heights::{self, HeightRule};
use super::{Crs, DemError, DemInfo, DemSource, OpenOptions, Placement, Registration, SampleType};

const UHL_BYTES: usize = 80;
/// UHL, DSI and ACC.
const HEADER_BYTES: usize = UHL_BYTES + 648 + 2700;
/// Of the DSI, within the file: vertical and horizontal datum, and the angle of the grid.
const DATUMS: std::ops::Range<usize> = UHL_BYTES + 141..UHL_BYTES + 149;
const ANGLE: std::ops::Range<usize> = UHL_BYTES + 264..UHL_BYTES + 273;

/// Labels of the tape before the UHL, at most.
const MOST_LABELS: usize = 8;

/// First byte of a column's record.
const SENTINEL: u8 = 0xaa;
/// Bytes of a record before and after its heights.
const RECORD_HEAD_BYTES: u64 = 8;
const CHECKSUM_BYTES: u64 = 4;

const VOID: i16 = -32767;
/// No height is below this: the column was written in two's complement.
const LOWEST_M: i16 = -16000;

const RADIUS_M: f64 = 6_378_137.0;

/// One open tile; its columns are turned into rows when rows are first asked for (twice the
/// file's size in memory, at most 200 MB by the width of the header's fields).
pub(super) struct Dted {
    info: DemInfo,
    rule: HeightRule,
    /// First byte of the first column.
    data_at: u64,
    samples: Option<Vec<i16>>,
}

/// Where the UHL starts: after the labels of a tape.
fn uhl_at(head: &[u8]) -> Option<usize> {
    (0..=MOST_LABELS).map(|i| i * UHL_BYTES).find(|at| {
        head.get(*at..)
            .is_some_and(|rest| rest.starts_with(b"UHL1"))
    })
}

/// Whether first bytes are those of a tile, perhaps with labels before it.
pub(super) fn looks_like(head: &[u8]) -> bool {
    let label = [&b"VOL"[..], b"HDR", b"UHL"]
        .iter()
        .any(|sign| head.starts_with(sign));
    label && uhl_at(head).is_some()
}

/// The header's bytes, and where they are.
struct Header<'a> {
    bytes: Vec<u8>,
    at: usize,
    path: &'a Path,
}

impl Header<'_> {
    fn text(&self, range: std::ops::Range<usize>) -> String {
        String::from_utf8_lossy(&self.bytes[range])
            .trim()
            .to_string()
    }

    fn number(&self, range: std::ops::Range<usize>, what: &str) -> Result<u32, DemError> {
        let text = self.text(range.clone());
        text.parse()
            .map_err(|_| self.damaged(range.start, format!("{text:?}"), what))
    }

    /// `DDDMMSSH`, degrees.
    fn angle(&self, from: usize, what: &str) -> Result<f64, DemError> {
        let part = |a: usize, b: usize| self.number(from + a..from + b, what);
        let (degrees, minutes, seconds) = (part(0, 3)?, part(3, 5)?, part(5, 7)?);
        let size = f64::from(degrees) + f64::from(minutes) / 60.0 + f64::from(seconds) / 3600.0;
        match self.bytes[from + 7] {
            b'N' | b'E' if size <= 180.0 => Ok(size),
            b'S' | b'W' if size <= 180.0 => Ok(-size),
            _ => Err(self.damaged(from, format!("{:?}", self.text(from..from + 8)), what)),
        }
    }

    /// Tenths of a second of arc, degrees.
    fn interval(&self, from: usize, what: &str) -> Result<f64, DemError> {
        match self.number(from..from + 4, what)? {
            0 => Err(self.damaged(from, "0", what)),
            tenths => Ok(f64::from(tenths) / 36_000.0),
        }
    }

    fn damaged(&self, at: usize, found: impl Into<String>, expected: &str) -> DemError {
        DemError::damaged(self.path, format!("byte {}", self.at + at), found, expected)
    }

    fn crs(&self, horizontal: &str) -> Crs {
        let (name, radius_m) = match horizontal {
            "WGS72" => ("EPSG:4322", 6_378_135.0),
            _ => ("EPSG:4326", RADIUS_M), // the specification allows no other
        };
        Crs::Geographic {
            name: name.into(),
            radius_m,
        }
    }
}

fn header(path: &Path) -> Result<(Header<'_>, u64), DemError> {
    let file = File::open(path).map_err(|e| DemError::io(path, "open", e))?;
    let length = file
        .metadata()
        .map_err(|e| DemError::io(path, "ask the size", e))?
        .len();
    let mut bytes = Vec::new();
    let most = (HEADER_BYTES + MOST_LABELS * UHL_BYTES) as u64;
    file.take(most)
        .read_to_end(&mut bytes)
        .map_err(|e| DemError::io(path, "read", e))?;
    let at = uhl_at(&bytes).unwrap_or_default();
    bytes.drain(..at);
    if bytes.len() < HEADER_BYTES {
        let found = format!("{} bytes", bytes.len());
        let expected = format!("{HEADER_BYTES} (is the file cut short?)");
        return Err(DemError::damaged(path, "UHL, DSI and ACC", found, expected));
    }
    Ok((Header { bytes, at, path }, length))
}

impl Dted {
    /// Reads the header, and checks the file's length against it.
    ///
    /// # Errors
    /// [`DemError::Damaged`] naming the byte; [`DemError::Unsupported`] for a turned grid.
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Self, DemError> {
        let (header, length) = header(path)?;
        let (width, height) = (
            header.number(47..51, "the count of columns, 4 digits")?,
            header.number(51..55, "the count of rows, 4 digits")?,
        );
        let turned = header
            .text(ANGLE)
            .parse::<f64>()
            .is_ok_and(|angle| angle != 0.0);
        if turned {
            let hint = format!("straighten it: gdalwarp -r bilinear {}", in_and_out(path));
            return Err(DemError::unsupported(path, "a turned DTED grid", hint));
        }
        let dx = header.interval(20, "tenths of a second between columns, 4 digits")?;
        let dy = header.interval(24, "tenths of a second between rows, 4 digits")?;
        let south = header.angle(12, "a latitude, DDDMMSSH")?;
        let placement = Placement {
            x0: header.angle(4, "a longitude, DDDMMSSH")?,
            y0: south + f64::from(height.saturating_sub(1)) * dy,
            dx,
            dy,
        };
        let datums = header.text(DATUMS);
        let (vertical, horizontal) = datums.split_at_checked(3).unwrap_or_default();
        let file_rule = HeightRule {
            nodata: Some(f64::from(VOID)),
            ..HeightRule::METRES
        };
        let rule = HeightRule::resolve(file_rule, options, SampleType::I16, path)?;
        let info = DemInfo {
            path: path.into(),
            format: "DTED",
            width,
            height,
            placement,
            crs: header.crs(horizontal.trim()),
            registration: Registration::Grid,
            sample_type: SampleType::I16,
            height_step_m: rule.step_m,
            nodata: rule.nodata,
            vertical: vertical_datum(vertical),
        };
        info.check_size()?;
        let data_at = (header.at + HEADER_BYTES) as u64;
        let expected = data_at + u64::from(width) * record_bytes(height);
        if length < expected {
            let found = format!("{length} bytes");
            let expected = format!("{expected} for {width} columns of {height} heights");
            return Err(DemError::damaged(
                path,
                "the end of the columns",
                found,
                expected,
            ));
        }
        Ok(Self {
            info,
            rule,
            data_at,
            samples: None,
        })
    }

    /// All heights, row by row from the north-west.
    fn transposed(&self) -> Result<Vec<i16>, DemError> {
        let path = &self.info.path;
        let (width, height) = (self.info.width as usize, self.info.height as usize);
        let mut file = File::open(path).map_err(|e| DemError::io(path, "open", e))?;
        let failed = |e| DemError::io(path, "read", e);
        file.seek(SeekFrom::Start(self.data_at)).map_err(failed)?;
        let mut samples = vec![0; width * height];
        let mut record = vec![0; record_bytes(self.info.height) as usize];
        for column in 0..width {
            file.read_exact(&mut record).map_err(failed)?;
            let stored = checked(&record).map_err(|(found, expected)| {
                DemError::damaged(
                    path,
                    format!("the record of column {column}"),
                    found,
                    expected,
                )
            })?;
            for (from_south, bytes) in stored.as_chunks::<2>().0.iter().enumerate() {
                let row = height - 1 - from_south;
                samples[row * width + column] = metres(*bytes);
            }
        }
        Ok(samples)
    }
}

fn record_bytes(height: u32) -> u64 {
    RECORD_HEAD_BYTES + 2 * u64::from(height) + CHECKSUM_BYTES
}

/// The heights of a record whose sentinel and checksum (the sum of all bytes before) are right.
fn checked(record: &[u8]) -> Result<&[u8], (String, String)> {
    if record[0] != SENTINEL {
        return Err((
            format!("a record that starts with {:#04x}", record[0]),
            "0xaa".into(),
        ));
    }
    let (summed, sum) = record.split_at(record.len() - CHECKSUM_BYTES as usize);
    let found: u32 = summed.iter().map(|byte| u32::from(*byte)).sum();
    let stated = sum
        .iter()
        .fold(0u32, |sum, byte| sum << 8 | u32::from(*byte));
    if found != stated {
        return Err((
            format!("bytes that sum to {found}"),
            format!("{stated}, its checksum"),
        ));
    }
    Ok(&summed[RECORD_HEAD_BYTES as usize..])
}

/// Sign and magnitude; some makers wrote two's complement, whose small negative heights look
/// like ones that no ground has.
fn metres(bytes: [u8; 2]) -> i16 {
    let stored = i16::from_be_bytes(bytes);
    let magnitude = stored & i16::MAX;
    match stored < 0 {
        false => stored,
        true if magnitude == i16::MAX => VOID,
        true if -magnitude < LOWEST_M => stored,
        true => -magnitude,
    }
}

fn vertical_datum(code: &str) -> Option<String> {
    match code.trim() {
        "MSL" => Some(vertical::from_code(5714)),
        "E96" => Some(vertical::from_code(5773)),
        _ => None,
    }
}

impl DemSource for Dted {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        if self.samples.is_none() {
            self.samples = Some(self.transposed()?);
        }
        let samples = self.samples.as_deref().unwrap_or_default();
        let from = first_row as usize * self.info.width as usize;
        for (height, stored) in out.iter_mut().zip(&samples[from..]) {
            *height = self.rule.height_m(f64::from(*stored));
        }
        heights::check(&self.info, first_row, out)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Folder, dted_bytes, read_all};
    use super::*;

    fn read(bytes: &[u8]) -> Result<(DemInfo, Vec<f64>), DemError> {
        let folder = Folder::new();
        read_all(&folder.write("w.bin", bytes), &OpenOptions::default())
    }

    fn small() -> Vec<u8> {
        dted_bytes(3, 4, |column, row| match (column, row) {
            (1, 0) => -32767,
            _ => column as i16 * 100 - row as i16,
        })
    }

    #[test]
    fn columns_from_the_south_become_rows_from_the_north() {
        let (info, heights) = read(&small()).unwrap();
        let place = info.placement;
        let expected = (
            -121.5,
            75.0 + 3.0 * 30.0 / 36_000.0,
            60.0 / 36_000.0,
            30.0 / 36_000.0,
        );
        assert_eq!((place.x0, place.y0, place.dx, place.dy), expected);
        assert_eq!(
            (info.width, info.height, info.registration),
            (3, 4, Registration::Grid)
        );
        assert_eq!(info.vertical.as_deref(), Some("EGM96 height (EPSG:5773)"));
        assert!(heights[1].is_nan());
        assert_eq!(
            (heights[0], heights[2], heights[9], heights[11]),
            (0.0, 200.0, -3.0, 197.0)
        );
    }

    #[test]
    fn labels_of_a_tape_before_it_are_passed_over() {
        let labelled = [&b"VOL1"[..], &[b' '; 76], b"HDR1", &[b' '; 76], &small()].concat();
        let (plain, with_labels) = (read(&small()).unwrap(), read(&labelled).unwrap());
        assert_eq!(plain.0.placement, with_labels.0.placement);
        assert_eq!(plain.1[11], with_labels.1[11]);
    }

    #[test]
    fn small_negative_heights_in_twos_complement_are_understood() {
        let cases = [
            ([0x80, 0x05], -5),
            ([0xff, 0xfb], -5),
            ([0xff, 0xff], VOID),
            ([0x80, 0x00], 0),
            ([0x22, 0x98], 8856),
        ];
        for (bytes, expected) in cases {
            assert_eq!(metres(bytes), expected, "{bytes:x?}");
        }
    }

    #[test]
    fn every_short_prefix_is_an_error() {
        let bytes = small();
        let head = (0..100).chain((100..HEADER_BYTES).step_by(61));
        for length in head.chain(HEADER_BYTES..bytes.len()) {
            assert!(read(&bytes[..length]).is_err(), "{length}");
        }
    }

    #[test]
    fn any_changed_byte_of_a_column_fails_its_checksum() {
        let bytes = small();
        for at in HEADER_BYTES..bytes.len() {
            let mut changed = bytes.clone();
            changed[at] ^= 0x10;
            let error = read(&changed).unwrap_err().to_string();
            assert!(error.contains("the record of column"), "{at}: {error}");
        }
    }

    #[test]
    fn hostile_headers_are_refused_with_their_byte() {
        let cases: [(usize, &[u8], &str); 7] = [
            (47, b"9999", "the end of the columns"),
            (47, b"0000", "width"),
            (51, b"-001", "byte 51"),
            (20, b"0000", "byte 20"),
            (4, b"99912", "byte 4"),
            (11, b"X", "byte 4"),
            (ANGLE.start, b"0010000.0", "turned"),
        ];
        for (at, text, expected) in cases {
            let mut bytes = small();
            bytes[at..at + text.len()].copy_from_slice(text);
            let error = read(&bytes).unwrap_err().to_string();
            assert!(error.contains(expected), "{at}: {error}");
        }
    }
}
