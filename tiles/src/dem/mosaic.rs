//! Many sources that look like one.
//!
//! Invariants: all inputs share CRS and lattice, so each input's sample falls on exactly one of
//! the mosaic's; an earlier input wins, and a hole never wins over a value; inputs are open only
//! while the band being read touches them.

use std::path::PathBuf;

use super::open::open;
use super::{
    Crs, DemError, DemInfo, DemSource, MAX_SIDE_SAMPLES, OpenOptions, Placement, SampleType,
};

/// How far, in cells, samples may be off the common lattice.
const MAX_OFF_LATTICE: f64 = 0.01;

/// How far spacings may differ, relative.
const MAX_SPACING_DIFFERENCE: f64 = 1e-6;

/// What overlapping inputs said of the same samples, over the rows read so far.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct OverlapReport {
    /// Comparisons: times that an input had a height where an earlier one had given one.
    pub overlapping: u64,
    /// Of these, how many differed.
    pub differing: u64,
    /// The largest difference, in metres.
    pub largest_m: f64,
}

/// One input, at its place in the mosaic.
struct Part {
    info: DemInfo,
    column: u32,
    row: u32,
    source: Option<Box<dyn DemSource>>,
}

/// Several inputs as one source: their union's bounding box, with holes where none covers.
pub struct Mosaic {
    info: DemInfo,
    options: OpenOptions,
    parts: Vec<Part>,
    overlaps: OverlapReport,
    /// Rows whose overlaps are counted, so that reading a row twice counts once.
    counted: Vec<bool>,
}

impl Mosaic {
    /// Reads the headers of all inputs and checks that they fit together. Inputs stay closed.
    ///
    /// # Errors
    /// Those of [`open`]; [`DemError::Usage`] for no inputs, or inputs that differ in CRS, spacing
    /// or lattice (naming both and the command that aligns them); [`DemError::Limits`].
    pub fn open(paths: &[PathBuf], options: &OpenOptions) -> Result<Self, DemError> {
        let infos: Vec<DemInfo> = paths
            .iter()
            .map(|path| open(path, options).map(|source| source.info().clone()))
            .collect::<Result<_, _>>()?;
        let Some(first) = infos.first() else {
            let hint = "name at least one file";
            return Err(DemError::usage(
                &PathBuf::from("(no input)"),
                "no files were given",
                hint,
            ));
        };
        for other in &infos[1..] {
            check_fit(first, other)?;
        }
        let info = union(&infos)?;
        let parts = infos
            .into_iter()
            .map(|part| placed(part, &info.placement))
            .collect();
        let counted = vec![false; info.height as usize];
        let overlaps = OverlapReport::default();
        Ok(Self {
            info,
            options: options.clone(),
            parts,
            overlaps,
            counted,
        })
    }

    /// What overlapping inputs said of the same samples, over the rows read so far.
    pub fn overlaps(&self) -> OverlapReport {
        self.overlaps
    }

    /// Blends one input's rows into a band.
    fn blend(
        &mut self,
        part: usize,
        first_row: u32,
        rows: u32,
        out: &mut [f64],
    ) -> Result<(), DemError> {
        let Self {
            info,
            options,
            parts,
            overlaps,
            counted,
        } = self;
        let part = &mut parts[part];
        let top = part.row.max(first_row);
        let bottom = (part.row + part.info.height).min(first_row + rows);
        if top >= bottom {
            part.source = None; // behind the band, or not yet reached
            return Ok(());
        }
        let width = part.info.width as usize;
        let mut band = vec![0.0; (bottom - top) as usize * width];
        let source = match &mut part.source {
            Some(source) => source,
            closed => closed.insert(reopen(&part.info, options)?),
        };
        source.read_rows(top - part.row, bottom - top, &mut band)?;
        for (row, heights) in (top..).zip(band.chunks_exact(width)) {
            let start = (row - first_row) as usize * info.width as usize + part.column as usize;
            let report = (!counted[row as usize]).then_some(&mut *overlaps);
            blend_row(heights, &mut out[start..start + width], report);
        }
        Ok(())
    }
}

impl DemSource for Mosaic {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        out.fill(f64::NAN);
        for part in 0..self.parts.len() {
            self.blend(part, first_row, rows, out)?;
        }
        self.counted[first_row as usize..(first_row + rows) as usize].fill(true);
        Ok(())
    }

    fn overlaps(&self) -> Option<OverlapReport> {
        Some(self.overlaps)
    }
}

/// Earlier heights stay; holes are filled.
fn blend_row(heights: &[f64], out: &mut [f64], mut report: Option<&mut OverlapReport>) {
    for (new, have) in heights.iter().zip(out) {
        if have.is_nan() {
            *have = *new;
        } else if let Some(report) = &mut report
            && !new.is_nan()
        {
            let difference_m = (new - *have).abs();
            report.overlapping += 1;
            report.differing += u64::from(difference_m > 0.0);
            report.largest_m = report.largest_m.max(difference_m);
        }
    }
}

/// Opens an input again, and checks that it is still the one that was placed.
fn reopen(info: &DemInfo, options: &OpenOptions) -> Result<Box<dyn DemSource>, DemError> {
    let source = open(&info.path, options)?;
    if source.info() == info {
        return Ok(source);
    }
    let what = "the file changed while it was being read";
    Err(DemError::usage(
        &info.path,
        what,
        "start again when it is at rest",
    ))
}

/// Refuses inputs that do not lie on one lattice.
fn check_fit(first: &DemInfo, other: &DemInfo) -> Result<(), DemError> {
    let (a, b) = (&first.placement, &other.placement);
    if first.crs == Crs::Local || other.crs == Crs::Local {
        let hint = "give it one file without georeference, or files that all have one";
        let what = format!("it cannot be placed beside {}", first.path.display());
        return Err(DemError::usage(&other.path, what, hint));
    }
    if first.crs != other.crs {
        return Err(misfit(
            first,
            other,
            "the coordinate system",
            &first.crs,
            &other.crs,
        ));
    }
    let cells = f64::from(other.width.max(other.height));
    for (name, a, b) in [
        ("the spacing", a.dx, b.dx),
        ("the spacing north", a.dy, b.dy),
    ] {
        let relative = ((a - b) / a).abs();
        if relative > MAX_SPACING_DIFFERENCE || relative * cells > MAX_OFF_LATTICE {
            return Err(misfit(first, other, name, &a, &b));
        }
    }
    for (name, a0, b0, step) in [
        ("the lattice east", a.x0, b.x0, a.dx),
        ("the lattice north", a.y0, b.y0, a.dy),
    ] {
        let cells = (b0 - a0) / step;
        if (cells - cells.round()).abs() > MAX_OFF_LATTICE {
            return Err(misfit(first, other, name, &a0, &b0));
        }
    }
    Ok(())
}

fn misfit(
    first: &DemInfo,
    other: &DemInfo,
    what: &str,
    a: &dyn std::fmt::Display,
    b: &dyn std::fmt::Display,
) -> DemError {
    let (one, two) = (first.path.display(), other.path.display());
    let Placement { dx, dy, .. } = first.placement;
    let (Crs::Projected { name, .. } | Crs::Geographic { name, .. }) = &first.crs else {
        return DemError::usage(
            &other.path,
            format!("it does not fit {one}"),
            "build it alone",
        );
    };
    let what = format!("{what} is {b}, and {a} in {one}");
    let command =
        format!("gdalwarp -t_srs '{name}' -tr {dx} {dy} -r bilinear '{two}' '{one}' merged.tif");
    DemError::usage(&other.path, what, format!("merge them first: {command}"))
}

/// The info of the mosaic: the bounding box on the first input's lattice.
fn union(infos: &[DemInfo]) -> Result<DemInfo, DemError> {
    let first = &infos[0];
    let Placement { x0, y0, dx, dy } = first.placement;
    let mut box_cells = [
        f64::INFINITY,
        f64::INFINITY,
        f64::NEG_INFINITY,
        f64::NEG_INFINITY,
    ];
    for info in infos {
        let west = ((info.placement.x0 - x0) / dx).round();
        let north = ((y0 - info.placement.y0) / dy).round();
        box_cells[0] = box_cells[0].min(west);
        box_cells[1] = box_cells[1].min(north);
        box_cells[2] = box_cells[2].max(west + f64::from(info.width));
        box_cells[3] = box_cells[3].max(north + f64::from(info.height));
    }
    let [west, north, east, south] = box_cells;
    let (width, height) = (side(first, east - west)?, side(first, south - north)?);
    let same = |other: &DemInfo| {
        (other.sample_type, other.height_step_m) == (first.sample_type, first.height_step_m)
    };
    let sample_type = if infos.iter().all(same) {
        first.sample_type
    } else {
        SampleType::F64
    };
    let nodata = first
        .nodata
        .filter(|_| infos.iter().all(|info| info.nodata == first.nodata));
    let placement = Placement {
        x0: x0 + west * dx,
        y0: y0 - north * dy,
        dx,
        dy,
    };
    let format = "mosaic";
    Ok(DemInfo {
        format,
        width,
        height,
        placement,
        sample_type,
        nodata,
        ..first.clone()
    })
}

fn side(first: &DemInfo, cells: f64) -> Result<u32, DemError> {
    if cells <= f64::from(MAX_SIDE_SAMPLES) {
        return Ok(cells as u32);
    }
    let what = "the mosaic that starts with it (are all inputs of one area?), on one side,";
    let found = cells as u64;
    Err(DemError::limits(
        &first.path,
        what,
        found,
        u64::from(MAX_SIDE_SAMPLES),
        "samples",
    ))
}

fn placed(info: DemInfo, mosaic: &Placement) -> Part {
    let column = ((info.placement.x0 - mosaic.x0) / mosaic.dx).round() as u32;
    let row = ((mosaic.y0 - info.placement.y0) / mosaic.dy).round() as u32;
    Part {
        info,
        column,
        row,
        source: None,
    }
}

#[cfg(test)]
mod tests;
