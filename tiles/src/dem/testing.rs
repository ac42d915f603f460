//! Files for tests, made byte by byte so that no reader's view of a format can leak into them.

use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};

use tiff::encoder::compression::{CompressionAlgorithm, Deflate, Lzw, Packbits};

use super::SampleType;

/// A folder that goes with its test.
pub struct Folder(tempfile::TempDir);

impl Folder {
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub fn path(&self) -> &Path {
        self.0.path()
    }

    pub fn write(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }
}

/// The real DEMs, where a machine has them.
pub fn real_data() -> Option<PathBuf> {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data");
    let folder = std::env::var("ESCARP_DATA").unwrap_or_else(|_| beside.into());
    Some(PathBuf::from(folder)).filter(|folder| folder.is_dir())
}

pub fn hgt_bytes(side: u16, height: impl Fn(u16, u16) -> i16) -> Vec<u8> {
    let at = |row| (0..side).map(move |column| (row, column));
    (0..side)
        .flat_map(at)
        .flat_map(|(r, c)| height(r, c).to_be_bytes())
        .collect()
}

pub fn zip_bytes(name: &str, content: &[u8]) -> Vec<u8> {
    zip_many(&[(name, content)])
}

pub fn zip_many(members: &[(&str, &[u8])]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in members {
        zip.start_file(*name, zip::write::SimpleFileOptions::default())
            .unwrap();
        zip.write_all(content).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

pub fn png_bytes(
    width: u32,
    height: u32,
    sixteen: bool,
    grey: impl Fn(u32, u32) -> u16,
) -> Vec<u8> {
    use image::codecs::png::PngEncoder;
    use image::{ExtendedColorType, ImageEncoder};
    let greys = (0..height)
        .flat_map(|r| (0..width).map(move |c| (r, c)))
        .map(|(r, c)| grey(r, c));
    let (samples, colour): (Vec<u8>, _) = if sixteen {
        (
            greys.flat_map(u16::to_ne_bytes).collect(),
            ExtendedColorType::L16,
        )
    } else {
        (greys.map(|g| g as u8).collect(), ExtendedColorType::L8)
    };
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(&samples, width, height, colour)
        .unwrap();
    bytes
}

/// A value of a hand-made tag.
#[derive(Clone)]
pub enum Tag {
    Short(Vec<u16>),
    Long(Vec<u32>),
    Double(Vec<f64>),
    Text(&'static str),
}

/// A hand-made TIFF.
#[derive(Clone)]
pub struct Tiff {
    pub width: u32,
    pub height: u32,
    pub sample: SampleType,
    pub big_endian: bool,
    pub big: bool,
    /// Width and height of tiles; `None` for strips of 3 rows.
    pub tile: Option<(u32, u32)>,
    pub compression: u16,
    pub predictor: u16,
    /// Chunk left out, with offset and byte count 0.
    pub sparse: Option<usize>,
    pub tags: Vec<(u16, Tag)>,
}

impl Tiff {
    /// Strips, not compressed, little-endian, UTM 32N, north-west corner or sample at
    /// (500000, 5000000), steps 10 east and 20 south.
    pub fn plain(width: u32, height: u32, sample: SampleType) -> Self {
        let keys = vec![
            1, 1, 0, 3, 1024, 0, 1, 1, 3072, 0, 1, 32632, 3076, 0, 1, 9001,
        ];
        let tags = vec![
            (33550, Tag::Double(vec![10.0, 20.0, 0.0])),
            (33922, Tag::Double(vec![0.0, 0.0, 0.0, 5e5, 5e6, 0.0])),
            (34735, Tag::Short(keys)),
        ];
        Self {
            width,
            height,
            sample,
            big_endian: false,
            big: false,
            tile: None,
            compression: 1,
            predictor: 1,
            sparse: None,
            tags,
        }
    }

    pub fn with(mut self, tag: u16, value: Tag) -> Self {
        self.tags.retain(|(have, _)| *have != tag);
        self.tags.push((tag, value));
        self
    }

    pub fn without(mut self, tag: u16) -> Self {
        self.tags.retain(|(have, _)| *have != tag);
        self
    }

    /// The file: header, directory, tag values, chunks, so that every cut hurts something else.
    pub fn bytes(&self, height: impl Fn(u32, u32) -> f64) -> Vec<u8> {
        let chunks = self.chunks(&height);
        // The first pass only measures, with offsets of the same length.
        let head = self.head(&chunks, 0).len();
        let mut file = self.head(&chunks, head as u32);
        for chunk in chunks {
            file.extend(chunk);
        }
        file
    }

    fn head(&self, chunks: &[Vec<u8>], data_at: u32) -> Vec<u8> {
        let mut tags = self.all_tags(chunks, data_at);
        tags.sort_by_key(|(tag, _)| *tag);
        let field = if self.big { 8 } else { 4 };
        let mut file = self.header();
        let count = tags.len();
        file.extend(if self.big {
            self.long8(count as u64)
        } else {
            self.short(count as u16)
        });
        let values_at = file.len() + count * (4 + 2 * field) + field;
        let mut values = Vec::new();
        for (tag, value) in &tags {
            let (kind, count, mut bytes) = self.encode(value);
            file.extend([self.short(*tag), self.short(kind), self.field(count)].concat());
            if bytes.len() <= field {
                bytes.resize(field, 0);
                file.extend(bytes);
            } else {
                file.extend(self.field(values_at + values.len()));
                values.extend(bytes);
            }
        }
        file.extend(self.field(0));
        file.extend(values);
        file
    }

    fn header(&self) -> Vec<u8> {
        let order = if self.big_endian { b"MM" } else { b"II" };
        if self.big {
            [
                &order[..],
                &self.short(43),
                &self.short(8),
                &self.short(0),
                &self.field(16),
            ]
            .concat()
        } else {
            [&order[..], &self.short(42), &self.field(8)].concat()
        }
    }

    fn all_tags(&self, chunks: &[Vec<u8>], data_at: u32) -> Vec<(u16, Tag)> {
        let format = match self.sample {
            SampleType::U8 | SampleType::U16 | SampleType::U32 | SampleType::U64 => 1,
            SampleType::I8 | SampleType::I16 | SampleType::I32 | SampleType::I64 => 2,
            SampleType::F16 | SampleType::F32 | SampleType::F64 => 3,
        };
        let one = |value: u32| Tag::Long(vec![value]);
        let code = |value: u16| Tag::Short(vec![value]);
        let counts: Vec<u32> = chunks.iter().map(|c| c.len() as u32).collect();
        let start = |i: usize| {
            if counts[i] == 0 {
                0
            } else {
                data_at + counts[..i].iter().sum::<u32>()
            }
        };
        let offsets = (0..counts.len()).map(start).collect();
        let mut tags = vec![
            (256, one(self.width)),
            (257, one(self.height)),
            (258, code(self.sample.bytes() as u16 * 8)),
            (259, code(self.compression)),
            (262, code(1)),
            (277, code(1)),
            (317, code(self.predictor)),
            (339, code(format)),
        ];
        match self.tile {
            Some((w, h)) => tags.extend([
                (322, one(w)),
                (323, one(h)),
                (324, Tag::Long(offsets)),
                (325, Tag::Long(counts)),
            ]),
            None => tags.extend([
                (273, Tag::Long(offsets)),
                (278, one(3)),
                (279, Tag::Long(counts)),
            ]),
        }
        tags.retain(|(tag, _)| self.tags.iter().all(|(own, _)| own != tag));
        tags.extend(self.tags.iter().cloned());
        tags
    }

    fn chunks(&self, height: &impl Fn(u32, u32) -> f64) -> Vec<Vec<u8>> {
        let (across, down) = self.tile.unwrap_or((self.width, 3));
        let mut chunks = Vec::new();
        for top in (0..self.height).step_by(down as usize) {
            let rows = if self.tile.is_some() {
                down
            } else {
                down.min(self.height - top)
            };
            for left in (0..self.width).step_by(across as usize) {
                let row = |row: u32| {
                    let at = |c: u32| {
                        height(
                            (top + row).min(self.height - 1),
                            (left + c).min(self.width - 1),
                        )
                    };
                    self.row(&(0..across).map(at).collect::<Vec<_>>())
                };
                let raw: Vec<u8> = (0..rows).flat_map(row).collect();
                let skip = self.sparse == Some(chunks.len());
                chunks.push(if skip {
                    Vec::new()
                } else {
                    self.compress(&raw)
                });
            }
        }
        chunks
    }

    fn row(&self, heights: &[f64]) -> Vec<u8> {
        if self.predictor == 3 {
            let mut out = Vec::new();
            let row: Vec<f32> = heights.iter().map(|h| *h as f32).collect();
            let row: Vec<_> = row.iter().map(|h| h.to_be_bytes()).collect();
            super::write::predict(&row, &mut out);
            return out;
        }
        let mut last = 0;
        let mut out = Vec::new();
        for height in heights {
            let bits = self.bits(*height);
            let stored = if self.predictor == 2 {
                bits.wrapping_sub(last)
            } else {
                bits
            };
            last = bits;
            let len = self.sample.bytes() as usize;
            let bytes = stored.to_le_bytes();
            out.extend(self.ordered(bytes[..len].to_vec()));
        }
        out
    }

    fn bits(&self, height: f64) -> u64 {
        match self.sample {
            SampleType::F32 => u64::from((height as f32).to_bits()),
            SampleType::F64 => height.to_bits(),
            _ => height as i64 as u64,
        }
    }

    fn compress(&self, raw: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        match self.compression {
            5 => Lzw.write_to(&mut out, raw).unwrap(),
            8 => Deflate::default().write_to(&mut out, raw).unwrap(),
            32773 => Packbits.write_to(&mut out, raw).unwrap(),
            _ => return raw.to_vec(),
        };
        out
    }

    fn encode(&self, value: &Tag) -> (u16, usize, Vec<u8>) {
        match value {
            Tag::Short(v) => (3, v.len(), v.iter().flat_map(|v| self.short(*v)).collect()),
            Tag::Long(v) => (4, v.len(), v.iter().flat_map(|v| self.long(*v)).collect()),
            Tag::Double(v) => (
                12,
                v.len(),
                v.iter().flat_map(|v| self.long8(v.to_bits())).collect(),
            ),
            Tag::Text(v) => (2, v.len() + 1, [v.as_bytes(), &[0]].concat()),
        }
    }

    fn field(&self, value: usize) -> Vec<u8> {
        if self.big {
            self.long8(value as u64)
        } else {
            self.long(value as u32)
        }
    }

    fn short(&self, value: u16) -> Vec<u8> {
        self.ordered(value.to_le_bytes().to_vec())
    }

    fn long(&self, value: u32) -> Vec<u8> {
        self.ordered(value.to_le_bytes().to_vec())
    }

    fn long8(&self, value: u64) -> Vec<u8> {
        self.ordered(value.to_le_bytes().to_vec())
    }

    fn ordered(&self, mut little: Vec<u8>) -> Vec<u8> {
        if self.big_endian {
            little.reverse();
        }
        little
    }
}

/// Opens a file and reads all of it, by single rows from the south and by bands from the north,
/// which must agree.
pub fn read_all(
    path: &Path,
    options: &super::OpenOptions,
) -> Result<(super::DemInfo, Vec<f64>), super::DemError> {
    let mut dem = super::open(path, options)?;
    let info = dem.info().clone();
    let width = info.width as usize;
    let mut single = vec![0.0; width * info.height as usize];
    for row in (0..info.height).rev() {
        let at = row as usize * width;
        dem.read_rows(row, 1, &mut single[at..at + width])?;
    }
    let mut bands = vec![0.0; single.len()];
    for (first, out) in (0..).step_by(3).zip(bands.chunks_mut(3 * width)) {
        dem.read_rows(first, (out.len() / width) as u32, out)?;
    }
    let bits = |heights: &[f64]| heights.iter().map(|h| h.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&single), bits(&bands), "rows and bands differ");
    Ok((info, bands))
}

pub fn gzip_bytes(content: &[u8]) -> Vec<u8> {
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    gzip.write_all(content).unwrap();
    gzip.finish().unwrap()
}

/// A DTED tile with its south-west sample at 121.5 W 75 N, 6 and 3 seconds apart; heights by
/// column and row, row 0 the northern one.
pub fn dted_bytes(width: u32, height: u32, heights: impl Fn(u32, u32) -> i16) -> Vec<u8> {
    let mut file = vec![b' '; 80 + 648 + 2700];
    let mut put =
        |at: usize, text: &str| file[at..at + text.len()].copy_from_slice(text.as_bytes());
    put(0, "UHL11213000W0750000N00600030");
    put(47, &format!("{width:04}{height:04}0"));
    put(80, "DSI");
    put(80 + 141, "E96WGS84");
    put(80 + 264, "0000000.0");
    put(80 + 648, "ACC");
    for column in 0..width {
        let mut record = vec![0xaa, 0, 0, column as u8, 0, column as u8, 0, 0];
        for row in (0..height).rev() {
            let metres = heights(column, row);
            let sign = if metres < 0 { 0x8000 } else { 0 };
            record.extend((metres.unsigned_abs() | sign).to_be_bytes());
        }
        let sum: u32 = record.iter().map(|byte| u32::from(*byte)).sum();
        record.extend(sum.to_be_bytes());
        file.extend(record);
    }
    file
}

pub fn rgba_bytes(width: u32, height: u32, pixel: impl Fn(u32, u32) -> [u8; 4]) -> Vec<u8> {
    use image::codecs::png::PngEncoder;
    use image::{ExtendedColorType, ImageEncoder};
    let at = |row| (0..width).map(move |column| (row, column));
    let pixels: Vec<u8> = (0..height)
        .flat_map(at)
        .flat_map(|(r, c)| pixel(r, c))
        .collect();
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(&pixels, width, height, ExtendedColorType::Rgba8)
        .unwrap();
    bytes
}
