//! GeoTIFF, COG and BigTIFF with one band.
//!
//! The `tiff` crate decodes chunks; what the tags mean for a DEM is read here. The crate gives
//! wrong samples for sparse files and inverts white-is-zero ones, so both are caught before it.

use std::ops::Range;
use std::path::Path;

use tiff::decoder::DecodingResult;
use tiff::tags::{CompressionMethod, Tag};

use super::affine::{Layout, ModelTags};
use super::chunks::{Chunk, Chunks, FileDecoder, SharedFile, decoder, explain};
use super::error::in_and_out;
use super::geokeys::GeoKeys;
use super::heights::{self, HeightRule};
use super::side;
use super::{Crs, DemError, DemInfo, DemSource, OpenOptions, SampleType};

/// `GDAL_METADATA`: XML with scale, offset and unit of the band.
const GDAL_METADATA: Tag = Tag::Unknown(42112);

/// How the refusals start that [`super::handover`] may help with.
pub(super) const COMPRESSION: &str = "TIFF compression";
pub(super) const SAMPLE_FORMAT: &str = "sample format";

/// The longest text tag that is read, in bytes; longer ones are cut.
const MAX_TEXT_BYTES: u64 = 1 << 20;

/// Chunks that reach beyond the band just read are kept up to this many bytes, so that the next
/// band need not decode them again.
const KEPT_BYTES: u64 = 512 << 20;

/// Chunks decoded at once, so that a band over many large chunks holds few of them.
const BATCH: usize = 32;

/// One open GeoTIFF.
pub(super) struct GeoTiff {
    info: DemInfo,
    rule: HeightRule,
    south_up: bool,
    chunks: Chunks,
    kept: Vec<(u32, Chunk)>,
}

impl GeoTiff {
    /// Opens a file and checks that its chunks lie within it; decodes none yet.
    ///
    /// # Errors
    /// Every kind of [`DemError`] but `NotADem`.
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Self, DemError> {
        let file = SharedFile::open(path)?;
        let mut tiff = decoder(file.clone(), path)?;
        let sample_type = sample_type(&mut tiff, path)?;
        let (width, height) = tiff
            .dimensions()
            .map_err(|e| explain(e, path, "the TIFF size"))?;
        let keys = geo_keys(&mut tiff, path)?;
        let (layout, crs) = place(&mut tiff, &keys, height, path, options)?;
        let rule = height_rule(&mut tiff, &keys, options, path)?;
        let rule = HeightRule::resolve(rule, options, sample_type, path)?;
        let info = DemInfo {
            path: path.into(),
            format: "GeoTIFF",
            width,
            height,
            placement: layout.placement,
            crs,
            registration: keys.registration(),
            sample_type,
            height_step_m: rule.step_m,
            nodata: rule.nodata,
            vertical: keys.vertical(),
        };
        info.check_size()?;
        let chunks = Chunks::new(tiff, file, sample_type.bytes(), path)?;
        Ok(Self {
            info,
            rule,
            south_up: layout.south_up,
            chunks,
            kept: Vec::new(),
        })
    }

    /// Stored rows of a band: the same numbers, or counted from the other end.
    fn stored_rows(&self, first_row: u32, rows: u32) -> (u32, u32) {
        if self.south_up {
            let end = self.info.height - first_row;
            (end - rows, end)
        } else {
            (first_row, first_row + rows)
        }
    }

    /// Copies the part of a chunk that lies in stored rows `band` and in `columns` to `out`.
    fn place_chunk(
        &self,
        index: u32,
        chunk: &Chunk,
        band: (u32, u32),
        columns: &Range<u32>,
        out: &mut [f64],
    ) {
        let window = self.chunks.grid().window(index);
        let (left, right) = (
            window.left.max(columns.start),
            window.right.min(columns.end),
        );
        let across = (right - left) as usize;
        let width = columns.len();
        let chunk_width = self.chunks.grid().chunk_width as usize;
        for row in window.top.max(band.0)..window.bottom.min(band.1) {
            let out_row = if self.south_up {
                band.1 - 1 - row
            } else {
                row - band.0
            } as usize;
            let start = out_row * width + (left - columns.start) as usize;
            let from = (row - window.top) as usize * chunk_width + (left - window.left) as usize;
            copy(chunk, from, &self.rule, &mut out[start..start + across]);
        }
    }

    /// Chunks that touch stored rows and columns.
    fn touching(&self, band: (u32, u32), columns: &Range<u32>) -> Vec<u32> {
        let grid = self.chunks.grid();
        let beside = |index: &u32| {
            let window = grid.window(*index);
            window.left < columns.end && window.right > columns.start
        };
        grid.touching(band.0, band.1).filter(beside).collect()
    }

    /// Whether the next band may want a chunk again.
    fn reaches_beyond(&self, index: u32, band: (u32, u32)) -> bool {
        let window = self.chunks.grid().window(index);
        window.top < band.0 || window.bottom > band.1
    }
}

impl DemSource for GeoTiff {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        if rows == 0 {
            return Ok(());
        }
        self.read_window(first_row..first_row + rows, 0..self.info.width, out)
    }

    fn read_window(
        &mut self,
        rows: Range<u32>,
        columns: Range<u32>,
        out: &mut [f64],
    ) -> Result<(), DemError> {
        self.info.check_window(&rows, &columns, out)?;
        let band = self.stored_rows(rows.start, rows.end - rows.start);
        let mut kept = std::mem::take(&mut self.kept);
        let wanted = self.touching(band, &columns);
        kept.retain(|(index, _)| wanted.contains(index));
        for (index, chunk) in &kept {
            self.place_chunk(*index, chunk, band, &columns, out);
        }
        let missing: Vec<u32> = wanted
            .into_iter()
            .filter(|index| kept.iter().all(|(have, _)| have != index))
            .collect();
        kept.retain(|(index, _)| self.reaches_beyond(*index, band));
        let mut kept_bytes: u64 = kept.iter().map(|(_, chunk)| byte_len(chunk)).sum();
        for batch in missing.chunks(BATCH) {
            for (index, chunk) in batch.iter().zip(self.chunks.decode(batch)?) {
                self.place_chunk(*index, &chunk, band, &columns, out);
                let bytes = byte_len(&chunk);
                if self.reaches_beyond(*index, band) && kept_bytes + bytes <= KEPT_BYTES {
                    kept_bytes += bytes;
                    kept.push((*index, chunk));
                }
            }
        }
        self.kept = kept;
        heights::check_window(&self.info, rows.start, columns, out)
    }

    fn block_shape(&self) -> [u32; 2] {
        let grid = self.chunks.grid();
        [grid.chunk_width.min(grid.width), grid.chunk_height]
    }
}

/// Converts a run of a chunk's samples; a chunk that is not stored is a hole.
fn copy(chunk: &Chunk, from: usize, rule: &HeightRule, out: &mut [f64]) {
    use DecodingResult as D;
    match chunk {
        None => out.fill(f64::NAN),
        Some(D::U8(v)) => convert(v, from, rule, out, f64::from),
        Some(D::I8(v)) => convert(v, from, rule, out, f64::from),
        Some(D::U16(v)) => convert(v, from, rule, out, f64::from),
        Some(D::I16(v)) => convert(v, from, rule, out, f64::from),
        Some(D::U32(v)) => convert(v, from, rule, out, f64::from),
        Some(D::I32(v)) => convert(v, from, rule, out, f64::from),
        Some(D::U64(v)) => convert(v, from, rule, out, |s| s as f64),
        Some(D::I64(v)) => convert(v, from, rule, out, |s| s as f64),
        Some(D::F16(v)) => convert(v, from, rule, out, |s| s.to_f64()),
        Some(D::F32(v)) => convert(v, from, rule, out, f64::from),
        Some(D::F64(v)) => convert(v, from, rule, out, |s| s),
    }
}

fn convert<T: Copy>(
    samples: &[T],
    from: usize,
    rule: &HeightRule,
    out: &mut [f64],
    stored: impl Fn(T) -> f64,
) {
    for (height, sample) in out.iter_mut().zip(&samples[from..]) {
        *height = rule.height_m(stored(*sample));
    }
}

fn byte_len(chunk: &Chunk) -> u64 {
    use DecodingResult as D;
    let bytes = match chunk {
        None => 0,
        Some(D::U8(v)) => v.len(),
        Some(D::I8(v)) => v.len(),
        Some(D::U16(v)) => size_of_val(&v[..]),
        Some(D::I16(v)) => size_of_val(&v[..]),
        Some(D::F16(v)) => size_of_val(&v[..]),
        Some(D::U32(v)) => size_of_val(&v[..]),
        Some(D::I32(v)) => size_of_val(&v[..]),
        Some(D::F32(v)) => size_of_val(&v[..]),
        Some(D::U64(v)) => size_of_val(&v[..]),
        Some(D::I64(v)) => size_of_val(&v[..]),
        Some(D::F64(v)) => size_of_val(&v[..]),
    };
    bytes as u64
}

/// The sample type, after refusing what is no plain band of heights.
fn sample_type(tiff: &mut FileDecoder, path: &Path) -> Result<SampleType, DemError> {
    let code = |tiff: &mut FileDecoder, tag, default: u16| {
        let found = tiff.find_tag_unsigned_vec::<u16>(tag);
        let found = found.map_err(|e| explain(e, path, format!("{tag:?}")))?;
        Ok(found
            .and_then(|codes| codes.first().copied())
            .unwrap_or(default))
    };
    check_compression(code(tiff, Tag::Compression, 1)?, path)?;
    let bands = code(tiff, Tag::SamplesPerPixel, 1)?;
    if bands != 1 {
        let hint = format!("take one: gdal_translate -b 1 {}", in_and_out(path));
        return Err(DemError::unsupported(
            path,
            format!("an image with {bands} bands"),
            hint,
        ));
    }
    let photometric = code(tiff, Tag::PhotometricInterpretation, 1)?;
    if photometric != 1 {
        let options = "-co PHOTOMETRIC=MINISBLACK";
        let hint = format!("convert it: gdal_translate {options} {}", in_and_out(path));
        let what = format!("photometric interpretation {photometric} (1, black is zero, is read)");
        return Err(DemError::unsupported(path, what, hint));
    }
    let bits = code(tiff, Tag::BitsPerSample, 1)?;
    let format = code(tiff, Tag::SampleFormat, 1)?;
    match (format, bits) {
        (1, 8) => Ok(SampleType::U8),
        (1, 16) => Ok(SampleType::U16),
        (1, 32) => Ok(SampleType::U32),
        (1, 64) => Ok(SampleType::U64),
        (2, 8) => Ok(SampleType::I8),
        (2, 16) => Ok(SampleType::I16),
        (2, 32) => Ok(SampleType::I32),
        (2, 64) => Ok(SampleType::I64),
        (3, 16) => Ok(SampleType::F16),
        (3, 32) => Ok(SampleType::F32),
        (3, 64) => Ok(SampleType::F64),
        _ => {
            let hint = format!(
                "convert it: gdal_translate -ot Float32 {}",
                in_and_out(path)
            );
            let what = format!("{SAMPLE_FORMAT} {format} with {bits} bits");
            Err(DemError::unsupported(path, what, hint))
        }
    }
}

fn check_compression(code: u16, path: &Path) -> Result<(), DemError> {
    use CompressionMethod as C;
    let method = C::from_u16_exhaustive(code);
    if let C::None | C::LZW | C::Deflate | C::OldDeflate | C::PackBits | C::ZSTD = method {
        return Ok(());
    }
    let name = match code {
        2..=4 => "CCITT fax",
        6 | 7 => "JPEG",
        34887 => "LERC",
        34925 => "LZMA",
        50001 => "WebP",
        50002 => "JPEG XL",
        _ => "unknown",
    };
    let hint = format!(
        "convert it: gdal_translate -co COMPRESS=DEFLATE {}",
        in_and_out(path)
    );
    Err(DemError::unsupported(
        path,
        format!("{COMPRESSION} {code} ({name})"),
        hint,
    ))
}

fn geo_keys(tiff: &mut FileDecoder, path: &Path) -> Result<GeoKeys, DemError> {
    let directory = tiff.find_tag_unsigned_vec::<u16>(Tag::GeoKeyDirectoryTag);
    let directory = directory.map_err(|e| explain(e, path, "the GeoKeyDirectory tag"))?;
    let doubles = doubles(tiff, Tag::GeoDoubleParamsTag, path)?;
    let ascii = text(tiff, Tag::GeoAsciiParamsTag, path)?.unwrap_or_default();
    GeoKeys::parse(&directory.unwrap_or_default(), &doubles, &ascii, path)
}

/// Where samples lie and what that means.
fn place(
    tiff: &mut FileDecoder,
    keys: &GeoKeys,
    height: u32,
    path: &Path,
    options: &OpenOptions,
) -> Result<(Layout, Crs), DemError> {
    let tags = ModelTags {
        pixel_scale: doubles(tiff, Tag::ModelPixelScaleTag, path)?,
        tiepoints: doubles(tiff, Tag::ModelTiepointTag, path)?,
        transformation: doubles(tiff, Tag::ModelTransformationTag, path)?,
    };
    let layout = match tags.layout(height, keys.registration(), path)? {
        None => side::world_file(path, height)?,
        found => found,
    };
    let crs = match keys.crs(path)? {
        None if layout.is_some() => side::projection(path, options)?.map(|p| p.crs),
        found => found,
    };
    side::settle(layout, crs, path, options)
}

/// Scale, offset, unit and nodata as GDAL and the GeoKeys state them.
fn height_rule(
    tiff: &mut FileDecoder,
    keys: &GeoKeys,
    options: &OpenOptions,
    path: &Path,
) -> Result<HeightRule, DemError> {
    let metadata = text(tiff, GDAL_METADATA, path)?.unwrap_or_default();
    let number = |role, default| match metadata_item(&metadata, role) {
        None => Ok(default),
        Some(text) => parse(text, path, role),
    };
    let nodata = match text(tiff, Tag::GdalNodata, path)? {
        None => None,
        Some(text) => Some(parse(&text, path, "GDAL_NODATA")?),
    };
    let unit_m = match options.height_step_m {
        Some(_) => 1.0, // the user's step replaces it, so an unknown unit does no harm
        None => height_unit_m(metadata_item(&metadata, "unittype"), keys, path)?,
    };
    Ok(HeightRule {
        step_m: number("scale", 1.0)? * unit_m,
        offset_m: number("offset", 0.0)? * unit_m,
        nodata,
    })
}

fn height_unit_m(unit: Option<&str>, keys: &GeoKeys, path: &Path) -> Result<f64, DemError> {
    match unit.map(str::to_ascii_lowercase).as_deref() {
        None | Some("") => Ok(keys.vertical_metres(path)?.unwrap_or(1.0)),
        Some("m" | "metre" | "meter" | "metres" | "meters") => Ok(1.0),
        Some("ft" | "foot" | "feet" | "international foot") => Ok(0.3048),
        Some("us survey foot" | "ftus" | "us-ft" | "ft-us" | "us_ft") => Ok(1200.0 / 3937.0),
        Some("cm" | "centimetre" | "centimeter") => Ok(0.01),
        Some("dm" | "decimetre" | "decimeter") => Ok(0.1),
        Some(other) => {
            let hint = "give the metres of one unit as --height-step";
            Err(DemError::unsupported(
                path,
                format!("height unit {other:?}"),
                hint,
            ))
        }
    }
}

/// `<Item name="SCALE" sample="0" role="scale">0.1</Item>` by its role.
fn metadata_item<'a>(metadata: &'a str, role: &str) -> Option<&'a str> {
    let (_, rest) = metadata.split_once(&format!("role=\"{role}\""))?;
    let (_, rest) = rest.split_once('>')?;
    rest.split('<').next().map(str::trim)
}

fn parse(text: &str, path: &Path, place: &str) -> Result<f64, DemError> {
    let text = text.trim();
    text.parse()
        .map_err(|_| DemError::damaged(path, place, format!("{text:?}"), "a number"))
}

fn doubles(tiff: &mut FileDecoder, tag: Tag, path: &Path) -> Result<Vec<f64>, DemError> {
    let value = tiff
        .find_tag(tag)
        .and_then(|v| v.map(|v| v.into_f64_vec()).transpose());
    Ok(value
        .map_err(|e| explain(e, path, format!("{tag:?}")))?
        .unwrap_or_default())
}

/// A text tag without its closing NUL. Read as bytes, as old citations are not UTF-8.
fn text(tiff: &mut FileDecoder, tag: Tag, path: &Path) -> Result<Option<String>, DemError> {
    let mut ifd = tiff.image_ifd();
    let Some(entry) = ifd.find_entry(tag) else {
        return Ok(None);
    };
    let mut bytes = vec![0; entry.count().min(MAX_TEXT_BYTES) as usize];
    let read = ifd.find_tag_bytes(tag, &mut bytes, 0);
    let read = read
        .map_err(|e| explain(e, path, format!("{tag:?}")))?
        .unwrap_or(0);
    bytes.truncate(read);
    let text = String::from_utf8_lossy(&bytes);
    Ok(Some(text.trim_matches(['\0', ' ', '\n']).to_string()))
}

#[cfg(test)]
mod tests;
