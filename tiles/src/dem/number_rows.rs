//! Rows of numbers in a text: found once, then parsed where they lie.
//!
//! The text is gone through when it is opened: each row's first byte is noted, every number is
//! counted, so that a text cut short is known before anything is built. That takes 8 bytes a row
//! and no more; rows are then parsed in parallel, a few at a time.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::{DemError, MAX_HEIGHT_M, MAX_SIDE_SAMPLES};

/// The longest number, in bytes.
const MAX_NUMBER_BYTES: u64 = 64;

/// A row may have this many bytes a number, and [`ROW_SPARE_BYTES`].
const ROW_BYTES_A_NUMBER: u64 = MAX_NUMBER_BYTES + 64;
const ROW_SPARE_BYTES: u64 = 1 << 16;

/// Text of rows that is held at once.
const BATCH_BYTES: u64 = 16 << 20;

/// How numbers form rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Shape {
    /// That many numbers a row and rows, wherever lines end.
    Given(u32, u32),
    /// A row is a line, and all have the same count.
    Lines,
}

/// A text of numbers, gone through once.
#[derive(Debug)]
pub(super) struct NumberRows {
    file: File,
    path: PathBuf,
    width: u32,
    /// First byte of each row, and the end of the last.
    starts: Vec<u64>,
    is_whole: bool,
}

/// State of the first pass.
struct Scan<'a> {
    path: &'a Path,
    shape: Shape,
    width: u32,
    starts: Vec<u64>,
    /// Numbers that have begun.
    numbers: u64,
    in_row: u32,
    number_bytes: u64,
    is_whole: bool,
}

impl NumberRows {
    /// Goes through the numbers from byte `from` to the end.
    ///
    /// # Errors
    /// [`DemError::Damaged`] for a sign that is no part of a number, too few or too many numbers,
    /// or rows of odd length; [`DemError::Limits`]; [`DemError::Io`].
    pub fn index(path: &Path, from: u64, shape: Shape) -> Result<Self, DemError> {
        let failed = |error| DemError::io(path, "read", error);
        let mut file = File::open(path).map_err(|e| DemError::io(path, "open", e))?;
        file.seek(SeekFrom::Start(from)).map_err(failed)?;
        let mut scan = Scan::new(path, shape);
        let mut buffer = vec![0; 1 << 18];
        let mut at = from;
        loop {
            let read = file.read(&mut buffer).map_err(failed)?;
            if read == 0 {
                break;
            }
            scan.bytes(&buffer[..read], at)?;
            at += read as u64;
        }
        scan.end(at)?;
        Ok(Self {
            file,
            path: path.into(),
            width: scan.width,
            starts: scan.starts,
            is_whole: scan.is_whole,
        })
    }

    /// Numbers a row.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        (self.starts.len() - 1) as u32
    }

    /// Whether no number has a fraction or an exponent.
    pub fn is_whole(&self) -> bool {
        self.is_whole
    }

    /// Reads rows as they are stored: numbers, NaN where the text says so.
    ///
    /// # Errors
    /// [`DemError::Damaged`] for what is no number, or where the file changed; [`DemError::Io`].
    pub fn read(&mut self, first: u32, out: &mut [f64]) -> Result<(), DemError> {
        let width = self.width as usize;
        let mut rows = out.chunks_exact_mut(width).collect::<Vec<_>>();
        let (mut row, mut rest) = (first as usize, &mut rows[..]);
        while !rest.is_empty() {
            let fits = |n: &usize| self.starts[row + n] - self.starts[row] <= BATCH_BYTES;
            let count = (2..=rest.len()).take_while(fits).last().unwrap_or(1);
            let (batch, after) = rest.split_at_mut(count);
            self.read_batch(row, batch)?;
            (row, rest) = (row + count, after);
        }
        Ok(())
    }

    fn read_batch(&mut self, first: usize, rows: &mut [&mut [f64]]) -> Result<(), DemError> {
        let starts = &self.starts[first..=first + rows.len()];
        let mut text = vec![0; (starts[rows.len()] - starts[0]) as usize];
        self.file
            .seek(SeekFrom::Start(starts[0]))
            .and_then(|_| self.file.read_exact(&mut text))
            .map_err(|e| DemError::io(&self.path, "read", e))?;
        let path = &self.path;
        let one = |(i, row): (usize, &mut &mut [f64])| {
            let line =
                &text[(starts[i] - starts[0]) as usize..(starts[i + 1] - starts[0]) as usize];
            parse_row(line, row).map_err(|found| {
                let place = format!("row {} of the numbers", first + i);
                DemError::damaged(path, place, found, format!("{} numbers", row.len()))
            })
        };
        rows.par_iter_mut().enumerate().try_for_each(one)
    }
}

fn parse_row(line: &[u8], out: &mut [f64]) -> Result<(), String> {
    let mut tokens = line
        .split(u8::is_ascii_whitespace)
        .filter(|t| !t.is_empty());
    for number in out {
        let token = tokens.next().ok_or("fewer")?;
        let text = std::str::from_utf8(token).map_err(|_| "no text")?;
        let parsed = text.parse::<f64>().map_err(|_| format!("{text:?}"))?;
        *number = as_stored(parsed);
    }
    Ok(())
}

/// Numbers beyond any height stand for holes, and programs write them with more or fewer digits:
/// `-3.4028235e38`, `-3.40282347e+38`. As 32-bit floats they are the same.
pub(super) fn as_stored(number: f64) -> f64 {
    if number.abs() > MAX_HEIGHT_M && number.is_finite() {
        f64::from((number as f32).clamp(f32::MIN, f32::MAX))
    } else {
        number
    }
}

impl<'a> Scan<'a> {
    fn new(path: &'a Path, shape: Shape) -> Self {
        let width = match shape {
            Shape::Given(width, _) => width,
            Shape::Lines => 0,
        };
        Self {
            path,
            shape,
            width,
            starts: Vec::new(),
            numbers: 0,
            in_row: 0,
            number_bytes: 0,
            is_whole: true,
        }
    }

    fn bytes(&mut self, bytes: &[u8], from: u64) -> Result<(), DemError> {
        for (at, byte) in (from..).zip(bytes) {
            match byte {
                b'0'..=b'9' | b'-' | b'+' => self.part(at)?,
                b'.' | b'e' | b'E' | b'n' | b'N' | b'a' | b'A' => {
                    self.is_whole = false;
                    self.part(at)?;
                }
                b' ' | b'\t' | b'\r' => self.number_bytes = 0,
                b'\n' => {
                    self.number_bytes = 0;
                    self.line_end(at)?;
                }
                other => {
                    let found = format!("\"{}\"", other.escape_ascii());
                    let expected = "numbers with a decimal point, and blanks between them";
                    return Err(self.damaged(at, found, expected));
                }
            }
        }
        Ok(())
    }

    /// A byte of a number.
    #[inline]
    fn part(&mut self, at: u64) -> Result<(), DemError> {
        self.number_bytes += 1;
        if self.number_bytes > 1 {
            if self.number_bytes > MAX_NUMBER_BYTES {
                let expected = format!("at most {MAX_NUMBER_BYTES}");
                return Err(self.damaged(at, "a number of more bytes", &expected));
            }
            return Ok(());
        }
        if self.in_row == 0 || (self.shape != Shape::Lines && self.in_row == self.width) {
            self.start_row(at)?;
        }
        self.in_row += 1;
        self.numbers += 1;
        Ok(())
    }

    fn start_row(&mut self, at: u64) -> Result<(), DemError> {
        self.check_row_bytes(at)?;
        self.in_row = 0;
        let rows = self.starts.len() as u64 + 1;
        if let Shape::Given(width, height) = self.shape
            && rows > u64::from(height)
        {
            let expected = format!("{width} x {height} numbers and no more");
            return Err(self.damaged(at, "another number", &expected));
        }
        self.limit("the count of its rows", rows)?;
        self.starts.push(at);
        Ok(())
    }

    fn line_end(&mut self, at: u64) -> Result<(), DemError> {
        if self.shape != Shape::Lines || self.in_row == 0 {
            return Ok(());
        }
        self.limit("the count of numbers in a line", u64::from(self.in_row))?;
        if self.width == 0 {
            self.width = self.in_row;
        }
        if self.in_row != self.width {
            let found = format!("a line of {} numbers", self.in_row);
            let expected = format!("{}, as in the first", self.width);
            return Err(self.damaged(at, found, &expected));
        }
        self.in_row = 0;
        Ok(())
    }

    fn check_row_bytes(&self, at: u64) -> Result<(), DemError> {
        let most = u64::from(self.width.max(self.in_row)) * ROW_BYTES_A_NUMBER + ROW_SPARE_BYTES;
        match self.starts.last() {
            Some(start) if at - start > most => {
                let found = format!("a row of {} bytes", at - start);
                let expected = format!("at most {most}");
                Err(self.damaged(at, found, &expected))
            }
            _ => Ok(()),
        }
    }

    fn end(&mut self, at: u64) -> Result<(), DemError> {
        self.line_end(at)?;
        // Blanks at the end belong to no row.
        if let Some(start) = self.starts.last() {
            let most = u64::from(self.width) * ROW_BYTES_A_NUMBER + ROW_SPARE_BYTES;
            let end = at.min(start + most);
            self.starts.push(end);
        }
        let wanted = match self.shape {
            Shape::Given(width, height) => u64::from(width) * u64::from(height),
            Shape::Lines => self.numbers.max(1),
        };
        if self.numbers == wanted {
            return Ok(());
        }
        let found = format!("{} numbers", self.numbers);
        let expected = format!("{wanted} (is the file cut short?)");
        Err(self.damaged(at, found, &expected))
    }

    fn limit(&self, what: &str, found: u64) -> Result<(), DemError> {
        let allowed = u64::from(MAX_SIDE_SAMPLES);
        match found > allowed {
            true => Err(DemError::limits(self.path, what, found, allowed, "samples")),
            false => Ok(()),
        }
    }

    fn damaged(&self, at: u64, found: impl Into<String>, expected: &str) -> DemError {
        DemError::damaged(self.path, format!("byte {at}"), found, expected)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::Folder;
    use super::*;
    use proptest::prelude::*;

    fn read(text: &str, shape: Shape) -> Result<(NumberRows, Vec<f64>), DemError> {
        let folder = Folder::new();
        let path = folder.write("a.txt", text.as_bytes());
        let mut rows = NumberRows::index(&path, 0, shape)?;
        let mut out = vec![0.0; (rows.width() * rows.height()) as usize];
        rows.read(0, &mut out)?;
        Ok((rows, out))
    }

    #[test]
    fn rows_end_after_their_numbers_wherever_lines_do() {
        for text in ["1 2 3 4 5 6", "1\n2 3\n\n4\r\n5\t6  \n\n", "  1 2 3 4 5\n6"] {
            let (rows, out) = read(text, Shape::Given(3, 2)).unwrap();
            assert_eq!((rows.height(), rows.is_whole()), (2, true));
            assert_eq!(out, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "{text:?}");
        }
        let (rows, out) = read("1 2.5 nan\n4e1 -5 +6\n", Shape::Lines).unwrap();
        assert_eq!(
            (rows.width(), rows.height(), rows.is_whole()),
            (3, 2, false)
        );
        assert_eq!((out[1], out[2].is_nan(), out[3]), (2.5, true, 40.0));
    }

    #[test]
    fn too_few_too_many_and_odd_signs_are_damage_with_their_place() {
        let cases = [
            ("1 2 3 4 5", "5 numbers"),
            ("", "0 numbers"),
            ("1 2 3 4 5 6 7", "byte 12"),
            ("1 2,3 4 5 6", "byte 3"),
            ("1 2 3 4 5 x", "byte 10"),
            ("1 2 3 4 5 --6", "row 1"),
            ("1 2 3 4 5 6e", "row 1"),
        ];
        for (text, expected) in cases {
            let error = read(text, Shape::Given(3, 2)).unwrap_err().to_string();
            assert!(error.contains(expected), "{text:?}: {error}");
        }
        let error = read("1 2\n3\n", Shape::Lines).unwrap_err().to_string();
        assert!(error.contains("a line of 1 numbers"), "{error}");
    }

    #[test]
    fn blanks_and_digits_without_end_take_no_memory() {
        let blanks = format!("1 2 3 {}4 5 6", " ".repeat(1 << 20));
        let error = read(&blanks, Shape::Given(3, 2)).unwrap_err().to_string();
        assert!(error.contains("a row of"), "{error}");
        let digits = "1".repeat(1 << 20);
        assert!(read(&digits, Shape::Given(1, 1)).is_err());
        // At the end they do no harm.
        let (_, out) = read(&format!("1 2{}", "\n".repeat(1 << 20)), Shape::Given(1, 2)).unwrap();
        assert_eq!(out, [1.0, 2.0]);
    }

    proptest! {
        #[test]
        fn any_rows_in_any_order_are_those_of_a_naive_reader(
            numbers in prop::collection::vec(-9000.0f64..9000.0, 12),
            row in 0u32..4,
            gaps in prop::collection::vec("[ \t\r\n]{1,3}", 12),
        ) {
            let text: String = numbers.iter().zip(&gaps).map(|(n, g)| format!("{n}{g}")).collect();
            let folder = Folder::new();
            let path = folder.write("a.txt", text.as_bytes());
            let mut rows = NumberRows::index(&path, 0, Shape::Given(3, 4)).unwrap();
            let mut out = [0.0; 3];
            rows.read(row, &mut out).unwrap();
            let from = row as usize * 3;
            prop_assert_eq!(&out[..], &numbers[from..from + 3]);
        }
    }
}
