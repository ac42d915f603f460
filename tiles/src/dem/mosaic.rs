//! Many sources that look like one.
//!
//! Invariants: all inputs share CRS and lattice, so each input's sample falls on exactly one of
//! the mosaic's; an input of higher priority wins, or is blended with the lower inside their
//! overlap, and a hole never wins over a value; inputs are open only while the band being read
//! touches them; a height does not depend on the bands that are asked for.

mod fit;
mod inputs;
mod nested;
mod report;
mod seam;

pub(super) use fit::check_fit;
pub use report::OverlapReport;

use std::ops::Range;
use std::path::PathBuf;

use super::open::open;
use super::{DemError, DemInfo, DemSource, OpenOptions, Placement};
use escarp_proto::manifest::Resampling;
use inputs::{Input, Inputs, Part, PartRows};
use seam::{Layer, Window};

/// The most samples that a seam may be blended over.
pub const MAX_SEAM_SAMPLES: u16 = 256;

/// Which of several inputs counts where they overlap.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Priority {
    /// The one with the finest spacing; of one spacing, the one named first.
    #[default]
    Finest,
    /// The one named first.
    First,
    /// The one named last.
    Last,
}

/// What a sample is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Grain {
    /// An input of the finest spacing, or it is blended with one, or a hole.
    #[default]
    Finest,
    /// A coarser input, which has, or was given, samples so many fine cells apart that are page
    /// corners: one of these, or a place on the triangles between.
    Facets(u32),
    /// A coarser input, between its samples.
    Between,
}

/// How heights go from one input to the next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Seam {
    /// Each height is that of one input.
    #[default]
    Exact,
    /// Inside an overlap, heights go from the one input's to the other's over this many samples,
    /// 1 to [`MAX_SEAM_SAMPLES`].
    Blend(u16),
}

/// How inputs are joined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct JoinOptions {
    /// Which input counts.
    pub priority: Priority,
    /// How heights go from one to the next.
    pub seam: Seam,
}

/// Several inputs as one source: their union's bounding box, with holes where none covers.
pub struct Mosaic {
    info: DemInfo,
    seam: Seam,
    inputs: Inputs,
    overlaps: OverlapReport,
    /// Rows whose overlaps are counted, so that reading a row twice counts once.
    counted: Vec<bool>,
    /// Whether some input is coarser than the mosaic.
    is_nested: bool,
    /// Where that is so: the grains of the rows last read, and the first one's number.
    grains: (u32, Vec<Grain>),
}

impl Mosaic {
    /// Reads the headers of all inputs and checks that they fit together. Inputs stay closed.
    ///
    /// # Errors
    /// Those of [`open`]; [`DemError::Usage`] for no inputs, or inputs that differ in CRS, spacing
    /// or lattice (naming both and the command that aligns them), or a seam wider than
    /// [`MAX_SEAM_SAMPLES`]; [`DemError::Limits`].
    pub fn open(
        paths: &[PathBuf],
        options: &OpenOptions,
        join: JoinOptions,
    ) -> Result<Self, DemError> {
        let infos: Vec<DemInfo> = paths
            .iter()
            .map(|path| open(path, options).map(|source| source.info().clone()))
            .collect::<Result<_, _>>()?;
        let Some(first) = infos.first() else {
            let hint = "name at least one file";
            let path = PathBuf::from("(no input)");
            return Err(DemError::usage(&path, "no files were given", hint));
        };
        if let Seam::Blend(over) = join.seam
            && !(1..=MAX_SEAM_SAMPLES).contains(&over)
        {
            let what = format!("a seam blended over {over} samples");
            let hint = format!("give 1 to {MAX_SEAM_SAMPLES}");
            return Err(DemError::usage(&first.path, what, hint));
        }
        match infos.iter().all(|info| fit::share_spacing(first, info)) {
            true => Self::of_infos(infos, options, join),
            false => nested::open(infos, options, join),
        }
    }

    /// Of inputs of one spacing.
    fn of_infos(
        mut infos: Vec<DemInfo>,
        options: &OpenOptions,
        join: JoinOptions,
    ) -> Result<Self, DemError> {
        let turned = fit::on_one_turn(&infos);
        for other in &turned[1..] {
            check_fit(&turned[0], other)?;
        }
        let info = fit::union(&turned)?;
        if join.priority == Priority::Last {
            infos.reverse();
        }
        let inputs = infos.into_iter().map(Input::file).collect();
        Ok(Self::of(inputs, info, options, join.seam))
    }

    /// `inputs` by priority, which lie on the lattice of `info`.
    fn of(inputs: Vec<Input>, info: DemInfo, options: &OpenOptions, seam: Seam) -> Self {
        let inputs = Inputs::new(inputs, &info, options);
        let is_nested = inputs.layers().next().is_some();
        Self {
            counted: vec![false; info.height as usize],
            is_nested,
            inputs,
            info,
            seam,
            overlaps: OverlapReport::default(),
            grains: (0, Vec::new()),
        }
    }

    /// What overlapping inputs said of the same samples, over the rows read so far.
    pub fn overlaps(&self) -> OverlapReport {
        self.overlaps
    }

    /// Each height from the highest input that has one.
    fn read_exact(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        out.fill(f64::NAN);
        let width = self.info.width as usize;
        let (grains, is_nested) = (&mut self.grains.1, self.is_nested);
        let (overlaps, counted, placement) =
            (&mut self.overlaps, &self.counted, &self.info.placement);
        self.inputs.read(first_row, rows, false, |part, read| {
            for (row, heights) in rows_of(part, read) {
                let start = (row - first_row) as usize * width + part.column as usize;
                let out = &mut out[start..start + heights.len()];
                if is_nested {
                    let grains = &mut grains[start..start + heights.len()];
                    mark_row(heights, out, grains, part, None);
                }
                let report = (!counted[row as usize]).then_some(&mut *overlaps);
                merge_row(heights, out, report, (part.column, row), placement);
            }
        })
    }

    /// As [`read_exact`](Self::read_exact), with heights blended inside overlaps: from a window
    /// that has as many more rows on either side as a seam reaches.
    fn read_blended(
        &mut self,
        first_row: u32,
        rows: u32,
        over: u16,
        out: &mut [f64],
    ) -> Result<(), DemError> {
        let width = self.info.width as usize;
        let top = first_row.saturating_sub(over.into());
        let bottom = (first_row + rows + u32::from(over)).min(self.info.height);
        let mut window = Window {
            width,
            heights: vec![f64::NAN; (bottom - top) as usize * width],
        };
        let step_m = (self.info.sample_type.is_integer()).then_some(self.info.height_step_m);
        let (grains, is_nested) = (&mut self.grains.1, self.is_nested);
        let (overlaps, counted, placement) =
            (&mut self.overlaps, &self.counted, &self.info.placement);
        self.inputs.read(top, bottom - top, true, |part, read| {
            let layer = layer(part, read, top);
            let weights = seam::weights(&window, &layer, over);
            let mut weights = weights.chunks_exact(part.info.width as usize);
            for (row, heights) in rows_of(part, read) {
                let start = (row - top) as usize * width + part.column as usize;
                let out = &mut window.heights[start..start + heights.len()];
                let weights = weights.next().unwrap_or_default();
                let asked = (first_row..first_row + rows).contains(&row);
                if asked && is_nested {
                    let start = (row - first_row) as usize * width + part.column as usize;
                    let grains = &mut grains[start..start + heights.len()];
                    mark_row(heights, out, grains, part, Some(weights));
                }
                if asked && !counted[row as usize] {
                    report_row(heights, out, overlaps, (part.column, row), placement);
                }
                for ((new, have), weight) in heights.iter().zip(out).zip(weights) {
                    if have.is_nan() {
                        *have = *new;
                    } else if !new.is_nan() {
                        *have = seam::between(*have, *new, *weight, step_m);
                    }
                }
            }
        })?;
        let start = (first_row - top) as usize * width;
        out.copy_from_slice(&window.heights[start..start + out.len()]);
        Ok(())
    }
}

impl DemSource for Mosaic {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        if self.is_nested {
            self.grains.0 = first_row;
            self.grains.1.clear();
            self.grains.1.resize(out.len(), Grain::Finest);
        }
        match self.seam {
            Seam::Exact => self.read_exact(first_row, rows, out)?,
            Seam::Blend(over) => self.read_blended(first_row, rows, over, out)?,
        }
        self.counted[first_row as usize..(first_row + rows) as usize].fill(true);
        Ok(())
    }

    fn overlaps(&self) -> Option<OverlapReport> {
        let layers = self.inputs.layers().filter_map(DemSource::overlaps);
        Some(layers.fold(self.overlaps, OverlapReport::and))
    }

    fn is_nested(&self) -> bool {
        self.is_nested
    }

    fn grains(&mut self, first_row: u32, rows: u32, out: &mut [Grain]) -> Result<(), DemError> {
        if self.is_nested && (self.grains.0, self.grains.1.len()) != (first_row, out.len()) {
            let mut heights = vec![0.0; out.len()];
            self.read_rows(first_row, rows, &mut heights)?;
        }
        match self.is_nested {
            true => out.copy_from_slice(&self.grains.1),
            false => out.fill(Grain::Finest),
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), DemError> {
        self.inputs.finish()
    }

    fn resampling(&self) -> Option<Resampling> {
        nested::together(self.inputs.layers().filter_map(DemSource::resampling))
    }

    fn data_columns(&self, first_row: u32, rows: u32) -> Vec<Range<u32>> {
        let columns = |number: usize| {
            let part = self.inputs.part(number);
            part.column..part.column + part.info.width
        };
        let met = self.inputs.meeting(first_row, rows);
        let mut met: Vec<Range<u32>> = met.into_iter().map(columns).collect();
        met.sort_unstable_by_key(|columns| columns.start);
        let mut joined: Vec<Range<u32>> = Vec::new();
        for columns in met {
            match joined.last_mut() {
                Some(last) if columns.start <= last.end => last.end = last.end.max(columns.end),
                _ => joined.push(columns),
            }
        }
        joined
    }
}

/// A part's rows with their numbers in the mosaic.
fn rows_of<'a>(part: &Part, read: &'a PartRows) -> impl Iterator<Item = (u32, &'a [f64])> {
    let rows = read.heights.chunks_exact(part.info.width as usize);
    (read.first_row..).zip(rows)
}

/// A part in a window that starts at row `top`.
fn layer<'a>(part: &Part, read: &'a PartRows, top: u32) -> Layer<'a> {
    let width = part.info.width as usize;
    let (column, row) = (part.column as usize, (read.first_row - top) as usize);
    Layer {
        columns: column..column + width,
        rows: row..row + read.heights.len() / width,
        heights: &read.heights,
    }
}

/// Notes of what grain a part's heights are, before they are merged. A height that is blended is
/// stored as it is.
fn mark_row(
    heights: &[f64],
    out: &[f64],
    grains: &mut [Grain],
    part: &Part,
    weights: Option<&[f32]>,
) {
    for (i, (new, have)) in heights.iter().zip(out).enumerate() {
        if new.is_nan() {
            continue;
        }
        let is_blended = weights.is_some_and(|weights| weights[i] < 1.0);
        if have.is_nan() {
            grains[i] = part.layer.unwrap_or_default();
        } else if is_blended {
            grains[i] = Grain::Finest;
        }
    }
}

/// Heights of higher priority stay; holes are filled.
fn merge_row(
    heights: &[f64],
    out: &mut [f64],
    report: Option<&mut OverlapReport>,
    place: (u32, u32),
    placement: &Placement,
) {
    if let Some(report) = report {
        report_row(heights, out, report, place, placement);
    }
    for (new, have) in heights.iter().zip(out) {
        if have.is_nan() {
            *have = *new;
        }
    }
}

/// Compares where both have a height. `place` is the column and row of the first sample.
fn report_row(
    heights: &[f64],
    out: &[f64],
    report: &mut OverlapReport,
    (column, row): (u32, u32),
    placement: &Placement,
) {
    for (i, (new, have)) in heights.iter().zip(out).enumerate() {
        if !have.is_nan() && !new.is_nan() {
            let at = (column as usize + i, row as usize);
            report.compare(*have, *new, at, placement);
        }
    }
}

#[cfg(test)]
mod tests;
