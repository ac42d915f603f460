//! Samples row by row with nothing between them: what lies beside a header (`.bil`, `.flt`,
//! ENVI), and files whose shape the user gives. Rows are read where they lie.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use super::affine::Layout;
use super::heights::{self, HeightRule};
use super::{Crs, DemError, DemInfo, DemSource, OpenOptions, Registration, SampleType, side};

/// How the samples of a file without header lie: `WIDTHxHEIGHT:TYPE[:le|be][:SKIP]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RawShape {
    /// Samples in a row.
    pub width: u32,
    /// Rows, the north one first.
    pub height: u32,
    /// Of each sample.
    pub sample_type: SampleType,
    /// Most significant byte first.
    pub big_endian: bool,
    /// Bytes before the first sample.
    pub skip_bytes: u64,
}

impl std::str::FromStr for RawShape {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = "WIDTHxHEIGHT:TYPE[:le|be][:SKIP], such as 1025x1025:u16:le, with a TYPE \
                        of u8 i8 u16 i16 u32 i32 u64 i64 f32 f64";
        let wrong = |what: &str| format!("{what}; expected {expected}");
        let mut parts = text.split(':');
        let (width, height) = parts
            .next()
            .and_then(|size| size.split_once(['x', 'X']))
            .ok_or_else(|| wrong("no size"))?;
        let side = |t: &str| {
            t.trim()
                .parse::<u32>()
                .map_err(|_| wrong(&format!("size {t:?}")))
        };
        let (width, height) = (side(width)?, side(height)?);
        let name = parts.next().ok_or_else(|| wrong("no type"))?;
        let sample_type = type_of(name).ok_or_else(|| wrong(&format!("type {name:?}")))?;
        let mut shape = Self {
            width,
            height,
            sample_type,
            big_endian: false,
            skip_bytes: 0,
        };
        for part in parts {
            match (part, part.parse()) {
                ("le" | "be", _) => shape.big_endian = part == "be",
                (_, Ok(skip_bytes)) => shape.skip_bytes = skip_bytes,
                _ => return Err(wrong(&format!("{part:?}"))),
            }
        }
        Ok(shape)
    }
}

fn type_of(name: &str) -> Option<SampleType> {
    use SampleType as T;
    Some(match name.to_ascii_lowercase().as_str() {
        "u8" => T::U8,
        "i8" => T::I8,
        "u16" => T::U16,
        "i16" => T::I16,
        "u32" => T::U32,
        "i32" => T::I32,
        "u64" => T::U64,
        "i64" => T::I64,
        "f32" => T::F32,
        "f64" => T::F64,
        _ => return None,
    })
}

/// Where a header says that rows lie.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rows {
    pub shape: RawShape,
    /// Bytes from one row to the next.
    pub row_bytes: u64,
}

impl Rows {
    /// Rows that follow each other.
    pub fn packed(shape: RawShape) -> Self {
        let row_bytes = u64::from(shape.width) * u64::from(shape.sample_type.bytes());
        Self { shape, row_bytes }
    }

    /// Bytes up to the end of the last sample; `None` beyond 64 bits.
    fn end(&self) -> Option<u64> {
        let last_row = u64::from(self.shape.height.checked_sub(1)?);
        let row = u64::from(self.shape.width) * u64::from(self.shape.sample_type.bytes());
        last_row
            .checked_mul(self.row_bytes)?
            .checked_add(row)?
            .checked_add(self.shape.skip_bytes)
    }
}

/// What a header says of place and heights.
pub(super) struct Stated {
    pub format: &'static str,
    pub layout: Layout,
    pub crs: Crs,
    pub registration: Registration,
    pub rule: HeightRule,
    pub vertical: Option<String>,
}

/// One open file of samples.
pub(super) struct RawGrid {
    info: DemInfo,
    rule: HeightRule,
    rows: Rows,
    south_up: bool,
    file: File,
}

impl RawGrid {
    /// Opens a file whose shape the user gives; world file and `.prj` beside it place it.
    ///
    /// # Errors
    /// [`DemError::Usage`] where the shape asks for another length than the file's, or no place
    /// and no spacing is given.
    pub fn open(path: &Path, shape: &RawShape, options: &OpenOptions) -> Result<Self, DemError> {
        let rows = Rows::packed(*shape);
        let found = length_of(path)?;
        if rows.end() != Some(found) {
            let what = format!(
                "{}x{} samples of {} bytes after {} bytes are {} bytes, but the file has {found}",
                shape.width,
                shape.height,
                shape.sample_type.bytes(),
                shape.skip_bytes,
                rows.end().map_or("too many".into(), |end| end.to_string()),
            );
            return Err(DemError::usage(path, what, "correct --raw"));
        }
        let layout = side::world_file(path, shape.height)?;
        let projection = match layout {
            Some(_) => side::projection(path, options)?,
            None => None,
        };
        let (layout, crs) = side::settle(layout, projection.map(|p| p.crs), path, options)?;
        let stated = Stated {
            format: "RAW",
            layout,
            crs,
            registration: Registration::Grid,
            rule: HeightRule::METRES,
            vertical: None,
        };
        Self::new(path, rows, stated, options)
    }

    /// Opens the file that a header speaks of.
    ///
    /// # Errors
    /// [`DemError::Damaged`] where the file is shorter than its header says.
    pub fn new(
        path: &Path,
        rows: Rows,
        stated: Stated,
        options: &OpenOptions,
    ) -> Result<Self, DemError> {
        let shape = rows.shape;
        let rule = HeightRule::resolve(stated.rule, options, shape.sample_type, path)?;
        let info = DemInfo {
            path: path.into(),
            format: stated.format,
            width: shape.width,
            height: shape.height,
            placement: stated.layout.placement,
            crs: stated.crs,
            registration: stated.registration,
            sample_type: shape.sample_type,
            height_step_m: rule.step_m,
            nodata: rule.nodata,
            vertical: stated.vertical,
        };
        info.check_size()?;
        let found = length_of(path)?;
        if rows.end().is_none_or(|end| end > found) {
            let expected = rows
                .end()
                .map_or("fewer rows".into(), |end| format!("at least {end}"));
            let found = format!("{found} bytes");
            return Err(DemError::damaged(
                path,
                "the end of the samples",
                found,
                expected,
            ));
        }
        let file = File::open(path).map_err(|e| DemError::io(path, "open", e))?;
        let south_up = stated.layout.south_up;
        Ok(Self {
            info,
            rule,
            rows,
            south_up,
            file,
        })
    }

    /// Samples of one row as they are stored.
    fn row(&mut self, row: u32, bytes: &mut [u8]) -> Result<(), DemError> {
        let stored = match self.south_up {
            true => self.info.height - 1 - row,
            false => row,
        };
        let at = self.rows.shape.skip_bytes + u64::from(stored) * self.rows.row_bytes;
        self.file
            .seek(SeekFrom::Start(at))
            .and_then(|_| self.file.read_exact(bytes))
            .map_err(|e| DemError::io(&self.info.path, "read", e))
    }
}

impl DemSource for RawGrid {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        let width = self.info.width as usize;
        let mut bytes = vec![0; width * self.info.sample_type.bytes() as usize];
        for (row, heights) in (first_row..).zip(out.chunks_exact_mut(width)) {
            self.row(row, &mut bytes)?;
            decode(&bytes, self.rows.shape, &self.rule, heights);
        }
        heights::check(&self.info, first_row, out)
    }
}

fn decode(bytes: &[u8], shape: RawShape, rule: &HeightRule, out: &mut [f64]) {
    macro_rules! each {
        ($type:ty, $to:expr) => {
            for (height, stored) in out.iter_mut().zip(bytes.as_chunks().0) {
                let stored = match shape.big_endian {
                    true => <$type>::from_be_bytes(*stored),
                    false => <$type>::from_le_bytes(*stored),
                };
                *height = rule.height_m($to(stored));
            }
        };
    }
    match shape.sample_type {
        SampleType::U8 => each!(u8, f64::from),
        SampleType::I8 => each!(i8, f64::from),
        SampleType::U16 => each!(u16, f64::from),
        SampleType::I16 => each!(i16, f64::from),
        SampleType::U32 => each!(u32, f64::from),
        SampleType::I32 => each!(i32, f64::from),
        SampleType::U64 => each!(u64, |stored| stored as f64),
        SampleType::I64 => each!(i64, |stored| stored as f64),
        // No header and no shape gives this type, so it is not met.
        SampleType::F16 => out.fill(f64::NAN),
        SampleType::F32 => each!(f32, f64::from),
        SampleType::F64 => each!(f64, |stored| stored),
    }
}

fn length_of(path: &Path) -> Result<u64, DemError> {
    let metadata = std::fs::metadata(path).map_err(|e| DemError::io(path, "ask the size", e))?;
    Ok(metadata.len())
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Folder, read_all};
    use super::*;

    fn options(shape: &str) -> OpenOptions {
        OpenOptions {
            raw: Some(shape.parse().unwrap()),
            spacing_m: Some(10.0),
            ..OpenOptions::default()
        }
    }

    #[test]
    fn each_type_and_byte_order_is_read_as_the_shape_says() {
        let heights: [i16; 6] = [0, 1, 2, 100, 101, 102];
        let cases: [(&str, Vec<u8>); 8] = [
            ("3x2:u8", heights.map(|h| h as u8).to_vec()),
            ("3x2:i8", heights.map(|h| h as u8).to_vec()),
            ("3x2:i16:be", heights.map(i16::to_be_bytes).concat()),
            ("3x2:u16", heights.map(i16::to_le_bytes).concat()),
            (
                "3x2:i32:be",
                heights.map(|h| i32::from(h).to_be_bytes()).concat(),
            ),
            (
                "3x2:u64:le",
                heights.map(|h| (h as u64).to_le_bytes()).concat(),
            ),
            (
                "3x2:f32:be",
                heights.map(|h| f32::from(h).to_be_bytes()).concat(),
            ),
            (
                "3X2:F64",
                heights.map(|h| f64::from(h).to_le_bytes()).concat(),
            ),
        ];
        let folder = Folder::new();
        for (shape, bytes) in cases {
            let path = folder.write("a", &bytes);
            let (info, read) = read_all(&path, &options(shape)).unwrap();
            assert_eq!(read, heights.map(f64::from), "{shape}");
            assert_eq!((info.width, info.height), (3, 2));
            let skipped = folder.write("b", &[&[9; 7][..], &bytes].concat());
            let (_, read) = read_all(&skipped, &options(&format!("{shape}:7"))).unwrap();
            assert_eq!(read, heights.map(f64::from), "{shape}:7");
        }
    }

    #[test]
    fn a_shape_that_asks_for_another_length_is_refused_with_both() {
        let folder = Folder::new();
        let path = folder.write("a", &[0; 12]);
        for shape in [
            "3x2:u8",
            "3x2:i32",
            "3x2:u16:1",
            "0x0:u8",
            "4294967295x4294967295:f64",
        ] {
            let error = read_all(&path, &options(shape)).unwrap_err();
            assert!(matches!(error, DemError::Usage { .. }), "{shape}: {error}");
            assert!(error.to_string().contains("has 12"), "{shape}: {error}");
        }
    }

    #[test]
    fn shapes_that_are_none_say_how_one_looks() {
        for text in [
            "",
            "3",
            "3x",
            "3x2",
            "3x2:f16",
            "3x2:u8:middle",
            "-3x2:u8",
            "3x2:u8:-1",
        ] {
            let error = text.parse::<RawShape>().unwrap_err();
            assert!(error.contains("1025x1025:u16:le"), "{text}: {error}");
        }
    }

    #[test]
    fn a_world_file_and_a_prj_beside_it_place_it_by_sample_centres() {
        let folder = Folder::new();
        let path = folder.write("a.raw", &[1, 2, 3, 4, 5, 6]);
        folder.write("a.rww", b"10\n0\n0\n-20\n500000\n5000000\n");
        folder.write("a.PRJ", b"Projection UTM\nZone 32\nDatum WGS84\n");
        let placed = OpenOptions {
            spacing_m: None,
            ..options("3x2:u8")
        };
        let (info, read) = read_all(&path, &placed).unwrap();
        let place = info.placement;
        assert_eq!(
            (place.x0, place.y0, place.dx, place.dy),
            (5e5, 5e6, 10.0, 20.0)
        );
        assert_eq!(read, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        // South-up, the same place: the first stored sample is the south-west one.
        folder.write("a.rww", b"10 0 0 20 500000 4999980");
        let (info, read) = read_all(&path, &placed).unwrap();
        assert_eq!(info.placement, place);
        assert_eq!(read, [4.0, 5.0, 6.0, 1.0, 2.0, 3.0]);
    }

    #[test]
    fn a_rotated_or_broken_world_file_is_named() {
        let folder = Folder::new();
        let path = folder.write("a.raw", &[0; 6]);
        for text in [
            "10 1 1 -20 0 0",
            "10 0 0 -20 0",
            "10 0 0 -20 0 x",
            "0 0 0 0 0 0",
        ] {
            folder.write("a.wld", text.as_bytes());
            let error = read_all(&path, &options("3x2:u8")).unwrap_err();
            assert!(error.to_string().contains("a.wld"), "{text}: {error}");
        }
    }
}
