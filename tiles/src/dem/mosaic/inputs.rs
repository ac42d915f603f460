//! The inputs of a mosaic: found by row, opened when a band meets them, closed behind it.

use super::super::open::open;
use super::super::{DemError, DemInfo, DemSource, OpenOptions};
use super::{Grain, fit};
use rayon::prelude::*;

/// Rows of a bucket of the index.
const BUCKET_ROWS: u32 = 256;

/// Inputs that are open at a time: well below what systems allow a process by default.
const MOST_OPEN: usize = 128;

/// What open inputs may hold in memory together.
const MOST_OPEN_BYTES: u64 = 384 << 20;

/// What one input is taken to hold at most: readers keep a row of chunks, or a small file whole.
const MOST_HELD_BYTES: u64 = 32 << 20;

/// Inputs beyond those that may stay open are opened for each band, this many at a time.
const PASSING: usize = 8;

/// An input, before it is placed.
pub(super) struct Input {
    info: DemInfo,
    layer: Option<(Box<dyn DemSource>, Grain)>,
}

impl Input {
    /// One that is opened by its path.
    pub(super) fn file(info: DemInfo) -> Input {
        Input { info, layer: None }
    }

    /// One that stays open: `info` may have other longitudes than the source's own.
    pub(super) fn layer(info: DemInfo, source: Box<dyn DemSource>, grain: Grain) -> Input {
        let layer = Some((source, grain));
        Input { info, layer }
    }
}

/// One input, at its place in the mosaic.
pub(super) struct Part {
    pub(super) info: DemInfo,
    pub(super) column: u32,
    pub(super) row: u32,
    source: Option<Box<dyn DemSource>>,
    /// It is a layer that is never closed, of this grain.
    pub(super) layer: Option<Grain>,
    /// Rows of the last band that may be asked for again: the first one's number, and heights.
    kept: Option<(u32, Vec<f64>)>,
}

/// Rows of one input, in numbers of the mosaic's rows.
pub(super) struct PartRows {
    pub(super) part: usize,
    pub(super) first_row: u32,
    pub(super) heights: Vec<f64>,
}

/// All inputs, by priority, the highest first.
pub(super) struct Inputs {
    options: OpenOptions,
    parts: Vec<Part>,
    /// For each bucket of rows, the parts that meet it, by priority.
    buckets: Vec<Vec<u32>>,
    /// Parts that are open or keep rows.
    busy: Vec<usize>,
}

impl Inputs {
    /// `inputs` by priority; `mosaic` is what they make together.
    pub(super) fn new(inputs: Vec<Input>, mosaic: &DemInfo, options: &OpenOptions) -> Inputs {
        let mut buckets = vec![Vec::new(); mosaic.height.div_ceil(BUCKET_ROWS) as usize];
        let mut parts = Vec::with_capacity(inputs.len());
        for (number, Input { info, layer }) in inputs.into_iter().enumerate() {
            let (column, row) = fit::place(&info, &mosaic.placement);
            let (first, last) = (row / BUCKET_ROWS, (row + info.height - 1) / BUCKET_ROWS);
            for bucket in &mut buckets[first as usize..=last as usize] {
                bucket.push(number as u32);
            }
            let (source, layer) = layer.unzip();
            parts.push(Part {
                info,
                column,
                row,
                source,
                layer,
                kept: None,
            });
        }
        Inputs {
            options: options.clone(),
            parts,
            buckets,
            busy: Vec::new(),
        }
    }

    pub(super) fn part(&self, number: usize) -> &Part {
        &self.parts[number]
    }

    /// The parts that meet a band of rows, by priority.
    pub(super) fn meeting(&self, first_row: u32, rows: u32) -> Vec<usize> {
        let end = first_row + rows;
        let buckets = (first_row / BUCKET_ROWS) as usize..end.div_ceil(BUCKET_ROWS) as usize;
        let met = |&number: &usize| {
            let part = &self.parts[number];
            part.row < end && first_row < part.row + part.info.height
        };
        let mut parts: Vec<usize> = self.buckets[buckets]
            .iter()
            .flatten()
            .map(|&number| number as usize)
            .filter(met)
            .collect();
        parts.sort_unstable();
        parts.dedup();
        parts
    }

    /// Layers, which are always open.
    pub(super) fn layers(&self) -> impl Iterator<Item = &dyn DemSource> {
        let layers = self.parts.iter().filter(|part| part.layer.is_some());
        layers.filter_map(|part| part.source.as_deref())
    }

    pub(super) fn finish(&mut self) -> Result<(), DemError> {
        let layers = self.parts.iter_mut().filter(|part| part.layer.is_some());
        layers
            .filter_map(|part| part.source.as_mut())
            .try_for_each(|source| source.finish())
    }

    /// Gives the rows of all parts that meet a band to `take`, by priority. Parts that the band
    /// does not meet are closed. `keep` keeps the rows for a band that shares some of them.
    pub(super) fn read(
        &mut self,
        first_row: u32,
        rows: u32,
        keep: bool,
        mut take: impl FnMut(&Part, &PartRows),
    ) -> Result<(), DemError> {
        let met = self.meeting(first_row, rows);
        for number in std::mem::take(&mut self.busy) {
            if met.binary_search(&number).is_err() {
                self.parts[number].close();
                self.parts[number].kept = None;
            }
        }
        let staying = self.staying(&met);
        let (stay, pass) = met.split_at(staying);
        let groups = std::iter::once(stay).chain(pass.chunks(PASSING));
        for (group, numbers) in groups.enumerate() {
            let read = self.read_group(numbers, first_row..first_row + rows)?;
            for rows in read {
                let number = rows.part;
                take(&self.parts[number], &rows);
                let part = &mut self.parts[number];
                part.kept = keep.then_some((rows.first_row, rows.heights));
                if group > 0 {
                    part.close();
                }
                self.busy.push(number);
            }
        }
        Ok(())
    }

    /// How many of these parts, from the first, may stay open. Bands come one after the other and
    /// ask for the same parts, so that closing the one used longest ago would close each just
    /// before it is asked again.
    fn staying(&self, met: &[usize]) -> usize {
        let mut held_bytes = 0;
        let fits = |&&number: &&usize| {
            let info = &self.parts[number].info;
            let samples = u64::from(info.width) * u64::from(info.height);
            let bytes = samples * u64::from(info.sample_type.bytes());
            held_bytes += bytes.min(MOST_HELD_BYTES);
            held_bytes <= MOST_OPEN_BYTES
        };
        met.iter().take(MOST_OPEN).take_while(fits).count()
    }

    /// Reads a band from several parts at a time.
    fn read_group(
        &mut self,
        numbers: &[usize],
        band: std::ops::Range<u32>,
    ) -> Result<Vec<PartRows>, DemError> {
        let options = &self.options;
        let mut wanted = vec![false; numbers.last().map_or(0, |last| last + 1)];
        for &number in numbers {
            wanted[number] = true;
        }
        let mut parts: Vec<(usize, &mut Part)> = self
            .parts
            .iter_mut()
            .enumerate()
            .take(wanted.len())
            .filter(|(number, _)| wanted[*number])
            .collect();
        parts
            .par_iter_mut()
            .map(|(number, part)| part.read(*number, band.clone(), options))
            .collect()
    }

    #[cfg(test)]
    pub(super) fn open_now(&self) -> usize {
        let open = |part: &&Part| part.source.is_some();
        self.parts.iter().filter(open).count()
    }
}

impl Part {
    fn close(&mut self) {
        if self.layer.is_none() {
            self.source = None;
        }
    }

    /// The part's rows that lie in a band of the mosaic's rows; those that were kept are not read
    /// again.
    fn read(
        &mut self,
        number: usize,
        band: std::ops::Range<u32>,
        options: &OpenOptions,
    ) -> Result<PartRows, DemError> {
        let first_row = self.row.max(band.start);
        let end = (self.row + self.info.height).min(band.end);
        let width = self.info.width as usize;
        let mut heights = Vec::with_capacity((end - first_row) as usize * width);
        if let Some((kept_row, kept)) = self.kept.take() {
            let kept_end = kept_row + (kept.len() / width) as u32;
            if (kept_row..kept_end).contains(&first_row) {
                let from = (first_row - kept_row) as usize * width;
                let to = (end.min(kept_end) - kept_row) as usize * width;
                heights.extend_from_slice(&kept[from..to]);
            }
        }
        let have = heights.len();
        let next_row = first_row + (have / width) as u32;
        if next_row < end {
            heights.resize((end - first_row) as usize * width, f64::NAN);
            let source = match &mut self.source {
                Some(source) => source,
                closed => closed.insert(reopen(&self.info, options)?),
            };
            source.read_rows(next_row - self.row, end - next_row, &mut heights[have..])?;
        }
        Ok(PartRows {
            part: number,
            first_row,
            heights,
        })
    }
}

/// Opens an input again, and checks that it is still the one that was placed.
fn reopen(info: &DemInfo, options: &OpenOptions) -> Result<Box<dyn DemSource>, DemError> {
    let source = open(&info.path, options)?;
    if source.info() == info {
        return Ok(source);
    }
    let what = "the file changed while it was being read";
    let hint = "start again when it is at rest";
    Err(DemError::usage(&info.path, what, hint))
}
