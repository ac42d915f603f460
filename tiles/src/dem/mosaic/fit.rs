//! Whether inputs lie on one lattice, and the mosaic that they make on it.

use crate::crs::longitude;

use super::super::{Crs, DemError, DemInfo, MAX_SIDE_SAMPLES, Placement, SampleType};

/// How far, in cells, samples may be off the common lattice.
const MAX_OFF_LATTICE: f64 = 0.01;

/// How far spacings may differ, relative.
const MAX_SPACING_DIFFERENCE: f64 = 1e-6;

/// How far a height step may be from a whole number of finer ones, relative.
const MAX_OFF_STEP: f64 = 1e-9;

/// Refuses inputs that do not lie on one lattice.
pub(in crate::dem) fn check_fit(first: &DemInfo, other: &DemInfo) -> Result<(), DemError> {
    check_crs(first, other)?;
    let (a, b) = (&first.placement, &other.placement);
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

/// Refuses inputs in different CRSs.
pub(super) fn check_crs(first: &DemInfo, other: &DemInfo) -> Result<(), DemError> {
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
    Ok(())
}

/// Whether two inputs have one spacing.
pub(super) fn share_spacing(a: &DemInfo, b: &DemInfo) -> bool {
    let same = |a: f64, b: f64| ((a - b) / a).abs() <= MAX_SPACING_DIFFERENCE;
    same(a.placement.dx, b.placement.dx) && same(a.placement.dy, b.placement.dy)
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
pub(super) fn union(infos: &[DemInfo]) -> Result<DemInfo, DemError> {
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
    let (sample_type, height_step_m) = kind_of(infos);
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
        height_step_m,
        nodata,
        ..first.clone()
    })
}

pub(super) fn side(first: &DemInfo, cells: f64) -> Result<u32, DemError> {
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

/// The inputs with their longitudes on one turn of the circle, so that those on both sides of the
/// date line, or from 0 to 360 and from -180 to 180, lie beside each other.
pub(super) fn on_one_turn(infos: &[DemInfo]) -> Vec<DemInfo> {
    let mut turned = infos.to_vec();
    let geographic = |info: &DemInfo| matches!(info.crs, Crs::Geographic { .. });
    if infos.iter().all(geographic) {
        let extent = |info: &DemInfo| {
            let Placement { x0, dx, .. } = info.placement;
            [x0, x0 + f64::from(info.width - 1) * dx]
        };
        let extents: Vec<[f64; 2]> = infos.iter().map(extent).collect();
        for (info, turn) in turned.iter_mut().zip(longitude::window(&extents)) {
            info.placement.x0 += turn;
        }
    }
    turned
}

/// Column and row of an input's first sample in the mosaic.
pub(super) fn place(info: &DemInfo, mosaic: &Placement) -> (u32, u32) {
    let x0 = match info.crs {
        Crs::Geographic { .. } => {
            longitude::from_west(info.placement.x0, mosaic.x0 - mosaic.dx / 2.0)
        }
        _ => info.placement.x0,
    };
    let column = ((x0 - mosaic.x0) / mosaic.dx).round() as u32;
    let row = ((mosaic.y0 - info.placement.y0) / mosaic.dy).round() as u32;
    (column, row)
}

/// The kind of sample and the step that hold the heights of all inputs: their own where they
/// agree; whole numbers of the finest step where all are; else floating point.
fn kind_of(infos: &[DemInfo]) -> (SampleType, f64) {
    let first = &infos[0];
    let kind = |info: &DemInfo| (info.sample_type, info.height_step_m);
    if infos.iter().all(|info| kind(info) == kind(first)) {
        return kind(first);
    }
    let steps = infos.iter().map(|info| info.height_step_m.abs());
    let finest = steps.fold(f64::INFINITY, f64::min);
    let whole = |info: &DemInfo| {
        let steps = info.height_step_m.abs() / finest;
        info.sample_type.is_integer() && (steps - steps.round()).abs() <= MAX_OFF_STEP * steps
    };
    if infos.iter().all(whole) {
        (SampleType::I64, finest)
    } else {
        (SampleType::F64, 1.0)
    }
}
