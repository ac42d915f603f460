//! The tiles and strips of one TIFF image, decoded in parallel from one file handle.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use rayon::prelude::*;
use tiff::decoder::{ChunkType, Decoder, DecodingResult, Limits};
use tiff::tags::Tag;
use tiff::{TiffError, TiffUnsupportedError};

use super::error::in_and_out;
use super::{DemError, MAX_CHUNK_BYTES};

/// Decoder over a file that several decoders share.
pub(super) type FileDecoder = Decoder<BufReader<SharedFile>>;

/// A read position of its own in a shared file: one handle serves all threads, on every system.
#[derive(Debug, Clone)]
pub(super) struct SharedFile {
    file: Arc<Mutex<File>>,
    position: u64,
    length: u64,
}

impl SharedFile {
    /// Opens `path` at position 0.
    pub fn open(path: &Path) -> Result<Self, DemError> {
        let file = File::open(path).map_err(|e| DemError::io(path, "open", e))?;
        let length = file
            .metadata()
            .map_err(|e| DemError::io(path, "ask the size", e))?
            .len();
        Ok(Self {
            file: Arc::new(Mutex::new(file)),
            position: 0,
            length,
        })
    }

    /// Bytes in the file when it was opened.
    pub fn length(&self) -> u64 {
        self.length
    }
}

impl Read for SharedFile {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        // Each read seeks first, so a thread that died while it held the lock left no harm.
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        file.seek(SeekFrom::Start(self.position))?;
        let read = file.read(out)?;
        self.position += read as u64;
        Ok(read)
    }
}

impl Seek for SharedFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let position = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => self.position.checked_add_signed(by),
            SeekFrom::End(by) => self.length.checked_add_signed(by),
        };
        self.position = position.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.position)
    }
}

/// Opens a decoder on the first image of a file.
///
/// # Errors
/// As [`explain`] sorts them.
pub(super) fn decoder(file: SharedFile, path: &Path) -> Result<FileDecoder, DemError> {
    let opened = guarded(|| Decoder::new(BufReader::with_capacity(1 << 16, file)));
    let mut limits = Limits::default();
    limits.decoding_buffer_size = MAX_CHUNK_BYTES as usize;
    limits.intermediate_buffer_size = 2 * MAX_CHUNK_BYTES as usize;
    Ok(opened
        .map_err(|error| explain(error, path, "the TIFF header"))?
        .with_limits(limits))
}

/// How an image is cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Grid {
    /// Samples in an image row.
    pub width: u32,
    /// Image rows.
    pub height: u32,
    /// Samples across a chunk.
    pub chunk_width: u32,
    /// Rows in a chunk.
    pub chunk_height: u32,
    /// `tile` or `strip`, for messages.
    pub kind: &'static str,
}

/// Part of an image: rows and columns, ends exclusive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Window {
    pub top: u32,
    pub bottom: u32,
    pub left: u32,
    pub right: u32,
}

impl Grid {
    /// Chunks side by side.
    pub fn across(&self) -> u32 {
        self.width.div_ceil(self.chunk_width)
    }

    /// Numbers of the chunks that rows `top..bottom` touch.
    pub fn touching(&self, top: u32, bottom: u32) -> std::ops::Range<u32> {
        let (first, last) = (top / self.chunk_height, bottom.div_ceil(self.chunk_height));
        first * self.across()..last * self.across()
    }

    /// The part of the image that chunk `index` holds.
    pub fn window(&self, index: u32) -> Window {
        let top = index / self.across() * self.chunk_height;
        let left = index % self.across() * self.chunk_width;
        Window {
            top,
            bottom: self.height.min(top.saturating_add(self.chunk_height)),
            left,
            right: self.width.min(left.saturating_add(self.chunk_width)),
        }
    }
}

/// Samples of one chunk in rows of [`Grid::chunk_width`], only the rows that the image has; `None`
/// where the file stores none (a sparse file's byte count of 0), which is a hole.
pub(super) type Chunk = Option<DecodingResult>;

/// Reads chunks of one image.
pub(super) struct Chunks {
    path: PathBuf,
    file: SharedFile,
    grid: Grid,
    row_bytes: usize,
    byte_counts: Vec<u64>,
    idle: Mutex<Vec<FileDecoder>>,
}

impl Chunks {
    /// Takes over a decoder whose image has one sample a pixel, of `sample_bytes` bytes.
    ///
    /// # Errors
    /// [`DemError::Limits`] for chunks above [`MAX_CHUNK_BYTES`]; [`DemError::Damaged`] where a
    /// chunk lies outside the file: so a file cut short is found before it is read.
    pub fn new(
        mut decoder: FileDecoder,
        file: SharedFile,
        sample_bytes: u32,
        path: &Path,
    ) -> Result<Self, DemError> {
        let failed = |error| explain(error, path, "the TIFF chunk tags");
        let (width, height) = decoder.dimensions().map_err(failed)?;
        let (chunk_width, chunk_height) = decoder.chunk_dimensions();
        let (kind, offsets, counts) = match decoder.get_chunk_type() {
            ChunkType::Strip => ("strip", Tag::StripOffsets, Tag::StripByteCounts),
            ChunkType::Tile => ("tile", Tag::TileOffsets, Tag::TileByteCounts),
        };
        // One strip may claim more rows than there are: 2^32 - 1 is usual.
        let chunk_height = if kind == "strip" {
            chunk_height.min(height)
        } else {
            chunk_height
        };
        let grid = Grid {
            width,
            height,
            chunk_width,
            chunk_height,
            kind,
        };
        check_chunk_size(&grid, sample_bytes, path)?;
        let offsets = decoder.get_tag_u64_vec(offsets).map_err(failed)?;
        let byte_counts = decoder.get_tag_u64_vec(counts).map_err(failed)?;
        check_ranges(&grid, &offsets, &byte_counts, file.length(), path)?;
        let row_bytes = grid.chunk_width as usize * sample_bytes as usize;
        let idle = Mutex::new(vec![decoder]);
        Ok(Self {
            path: path.into(),
            file,
            grid,
            row_bytes,
            byte_counts,
            idle,
        })
    }

    /// How the image is cut.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Decodes chunks in parallel, in the order asked for.
    ///
    /// # Errors
    /// [`DemError::Damaged`] naming the chunk.
    pub fn decode(&self, indices: &[u32]) -> Result<Vec<Chunk>, DemError> {
        indices
            .par_iter()
            .map(|index| self.decode_one(*index))
            .collect()
    }

    fn decode_one(&self, index: u32) -> Result<Chunk, DemError> {
        if self
            .byte_counts
            .get(index as usize)
            .is_none_or(|count| *count == 0)
        {
            return Ok(None);
        }
        let mut decoder = match self.idle_decoders().pop() {
            Some(decoder) => decoder,
            None => decoder(self.file.clone(), &self.path)?,
        };
        let place = || format!("{} {index} of {}", self.grid.kind, self.byte_counts.len());
        // Rows as long as the chunk's own: asked to cut a tile at the image's border, the crate
        // (0.11.3) reads it piece by piece, and then takes sound LZW data for cut short.
        let mut samples = DecodingResult::U8(Vec::new());
        let decoded = guarded(|| decoder.read_chunk_to_buffer(&mut samples, index, self.row_bytes));
        decoded.map_err(|error| explain(error, &self.path, place()))?;
        self.idle_decoders().push(decoder);
        Ok(Some(samples))
    }

    fn idle_decoders(&self) -> std::sync::MutexGuard<'_, Vec<FileDecoder>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn check_chunk_size(grid: &Grid, sample_bytes: u32, path: &Path) -> Result<(), DemError> {
    let samples = u64::from(grid.chunk_width) * u64::from(grid.chunk_height);
    let bytes = samples.saturating_mul(u64::from(sample_bytes));
    if bytes <= MAX_CHUNK_BYTES {
        return Ok(());
    }
    let what = format!(
        "a TIFF {} (gdal_translate -co TILED=YES makes smaller ones)",
        grid.kind
    );
    Err(DemError::limits(
        path,
        what,
        bytes,
        MAX_CHUNK_BYTES,
        "bytes",
    ))
}

fn check_ranges(
    grid: &Grid,
    offsets: &[u64],
    counts: &[u64],
    length: u64,
    path: &Path,
) -> Result<(), DemError> {
    let expected = u64::from(grid.across()) * u64::from(grid.height.div_ceil(grid.chunk_height));
    if offsets.len() as u64 != expected || counts.len() as u64 != expected {
        let found = format!("{} offsets, {} byte counts", offsets.len(), counts.len());
        return Err(DemError::damaged(
            path,
            "the TIFF chunk tags",
            found,
            format!("{expected}"),
        ));
    }
    for (index, (offset, count)) in offsets.iter().zip(counts).enumerate() {
        let end = offset.saturating_add(*count);
        if *count > 0 && end > length {
            let place = format!("{} {index} of {expected}", grid.kind);
            let found = format!("bytes {offset}..{end}");
            let inside = format!("an end within the file's {length} bytes (is it cut short?)");
            return Err(DemError::damaged(path, place, found, inside));
        }
    }
    Ok(())
}

/// Runs the third-party decoder so that even a panic inside it is an error about the file.
fn guarded<T>(run: impl FnOnce() -> Result<T, TiffError>) -> Result<T, TiffError> {
    catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|_| {
        let error = io::Error::new(io::ErrorKind::InvalidData, "values the decoder cannot hold");
        Err(TiffError::IoError(error))
    })
}

/// Sorts a decoder's error by who must act.
pub(super) fn explain(error: TiffError, path: &Path, place: impl Into<String>) -> DemError {
    match error {
        TiffError::UnsupportedError(what) => unsupported(&what, path),
        TiffError::LimitsExceeded | TiffError::IntSizeError => DemError::damaged(
            path,
            place,
            "sizes beyond all limits",
            "at most 256 MiB a part",
        ),
        TiffError::IoError(error) => match error.kind() {
            io::ErrorKind::UnexpectedEof => {
                let expected = "more bytes (is the file cut short?)";
                DemError::damaged(path, place, "the end of the data", expected)
            }
            io::ErrorKind::InvalidData | io::ErrorKind::InvalidInput | io::ErrorKind::Other => {
                DemError::damaged(path, place, error.to_string(), "sound compressed data")
            }
            _ => DemError::io(path, "read", error),
        },
        other => DemError::damaged(path, place, other.to_string(), "a sound TIFF"),
    }
}

fn unsupported(what: &TiffUnsupportedError, path: &Path) -> DemError {
    let hint = format!(
        "convert it: gdal_translate -co COMPRESS=DEFLATE {}",
        in_and_out(path)
    );
    DemError::unsupported(path, format!("this TIFF ({what})"), hint)
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: Grid = Grid {
        width: 10,
        height: 7,
        chunk_width: 4,
        chunk_height: 3,
        kind: "tile",
    };

    #[test]
    fn rows_touch_whole_rows_of_chunks() {
        assert_eq!(GRID.across(), 3);
        assert_eq!(GRID.touching(0, 3), 0..3);
        assert_eq!(GRID.touching(2, 4), 0..6);
        assert_eq!(GRID.touching(6, 7), 6..9);
    }

    #[test]
    fn the_last_chunks_end_with_the_image() {
        assert_eq!(
            GRID.window(8),
            Window {
                top: 6,
                bottom: 7,
                left: 8,
                right: 10
            }
        );
        assert_eq!(
            GRID.window(0),
            Window {
                top: 0,
                bottom: 3,
                left: 0,
                right: 4
            }
        );
    }
}
