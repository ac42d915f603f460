//! Inputs of different spacing: one mosaic on the lattice of the finest.
//!
//! Inputs of one spacing make a layer, a mosaic of its own; a coarser layer is brought to the
//! finest lattice. Where its samples are at least [`PAGE_CELLS`] fine cells apart, it is brought to
//! the corners of the dataset's pages first, and between these its heights lie on the pages' two
//! triangles: so the pages there say nothing that their corners do not, and need not be stored.

use super::fit;
use super::inputs::Input;
use super::{Grain, JoinOptions, Mosaic, Priority};
use crate::dem::{DemError, DemInfo, DemSource, OpenOptions, Placement};
use crate::place::{Facets, onto};
use escarp_proto::geometry::PAGE_CELLS;
use escarp_proto::manifest::Resampling;

/// How much coarser an input must be, in both directions, to be brought to another's lattice: a
/// grid at nearly its own spacing loses more than it says.
const LEAST_RATIO: f64 = 1.5;

/// How far outside an input, in fine cells, a sample still counts as inside.
const SLACK: f64 = 1e-6;

/// The most samples of a mosaic of different spacings: those of a dataset.
const MAX_SAMPLES: u64 = crate::build::MAX_SAMPLES;

/// Inputs of one spacing.
struct Layer {
    source: Box<dyn DemSource>,
    /// Its longitudes may be some turns away from the source's.
    turned: DemInfo,
}

/// Where a layer lies on the finest lattice.
struct Nominal {
    info: DemInfo,
    is_coarse: bool,
}

/// One mosaic of inputs that differ in spacing.
pub(super) fn open(
    infos: Vec<DemInfo>,
    options: &OpenOptions,
    join: JoinOptions,
) -> Result<Mosaic, DemError> {
    let finest = finest_of(&infos);
    for info in &infos {
        fit::check_crs(&finest, info)?;
        check_ratio(&finest, info)?;
    }
    let layers = layers(infos, options, join)?;
    let at_finest = |layer: &&Layer| fit::share_spacing(&layer.turned, &finest);
    let Some(first) = layers.iter().find(at_finest) else {
        return Err(DemError::usage(
            &finest.path,
            "no layer holds it",
            "report this",
        ));
    };
    let lattice = first.turned.clone();
    let nominal = layers.iter().map(|layer| nominal(&lattice, &layer.turned));
    let nominal: Vec<Nominal> = nominal.collect::<Result<_, _>>()?;
    // The finest first: its samples are those that are not moved.
    let mut ordered: Vec<&Nominal> = nominal.iter().collect();
    ordered.sort_by_key(|nominal| nominal.is_coarse);
    let infos: Vec<DemInfo> = ordered.iter().map(|nominal| nominal.info.clone()).collect();
    let info = fit::union(&infos)?;
    check_samples(&info)?;
    let placed = layers.into_iter().zip(nominal);
    let inputs = placed.map(|(layer, nominal)| input(layer, nominal, &info));
    let inputs: Vec<Input> = inputs.collect::<Result<_, _>>()?;
    Ok(Mosaic::of(inputs, info, options, join.seam))
}

fn area(info: &DemInfo) -> f64 {
    info.placement.dx * info.placement.dy
}

fn finest_of(infos: &[DemInfo]) -> DemInfo {
    let finer = |a: DemInfo, b: &DemInfo| if area(b) < area(&a) { b.clone() } else { a };
    infos[1..].iter().fold(infos[0].clone(), finer)
}

/// Source steps in fine ones, the smaller of the two directions.
fn ratio(finest: &DemInfo, info: &DemInfo) -> f64 {
    let (a, b) = (&finest.placement, &info.placement);
    (b.dx / a.dx).min(b.dy / a.dy)
}

fn check_ratio(finest: &DemInfo, info: &DemInfo) -> Result<(), DemError> {
    if fit::share_spacing(finest, info) || ratio(finest, info) >= LEAST_RATIO {
        return Ok(());
    }
    let Placement { dx, dy, .. } = finest.placement;
    let (own_dx, own_dy) = (info.placement.dx, info.placement.dy);
    let what = format!(
        "its spacing {own_dx} x {own_dy} is neither that of {}, {dx} x {dy}, nor at least \
         {LEAST_RATIO} times as coarse in both directions",
        finest.path.display()
    );
    let path = info.path.display();
    let hint =
        format!("bring it there first: gdalwarp -tr {dx} {dy} -r bilinear '{path}' fine.tif");
    Err(DemError::usage(&info.path, what, hint))
}

fn check_samples(info: &DemInfo) -> Result<(), DemError> {
    let samples = u64::from(info.width) * u64::from(info.height);
    if samples <= MAX_SAMPLES {
        return Ok(());
    }
    let what = "the coarser inputs on the lattice of this, the finest one, (build a smaller area, \
                or bring this one to a wider spacing)";
    Err(DemError::limits(
        &info.path,
        what,
        samples,
        MAX_SAMPLES,
        "samples",
    ))
}

/// The inputs by spacing and priority, the highest first.
fn layers(
    infos: Vec<DemInfo>,
    options: &OpenOptions,
    join: JoinOptions,
) -> Result<Vec<Layer>, DemError> {
    let mut groups: Vec<Vec<DemInfo>> = Vec::new();
    for info in infos {
        let joins = |group: &Vec<DemInfo>| fit::share_spacing(&group[0], &info);
        let group = match join.priority {
            Priority::Finest => groups.iter_mut().find(|group| joins(group)),
            _ => groups.last_mut().filter(|group| joins(group)),
        };
        match group {
            Some(group) => group.push(info),
            None => groups.push(vec![info]),
        }
    }
    match join.priority {
        Priority::Finest => groups.sort_by(|a, b| area(&a[0]).total_cmp(&area(&b[0]))),
        Priority::First => {}
        Priority::Last => groups.reverse(),
    }
    let open = |group: Vec<DemInfo>| -> Result<_, DemError> {
        let source: Box<dyn DemSource> = match &group[..] {
            [one] => super::super::open::open(&one.path, options)?,
            _ => Box::new(Mosaic::of_infos(group, options, join)?),
        };
        Ok(source)
    };
    let sources: Vec<_> = groups.into_iter().map(open).collect::<Result<_, _>>()?;
    let infos: Vec<DemInfo> = sources.iter().map(|source| source.info().clone()).collect();
    let turned = fit::on_one_turn(&infos);
    let layers = sources.into_iter().zip(turned);
    Ok(layers
        .map(|(source, turned)| Layer { source, turned })
        .collect())
}

/// The samples of the finest lattice that a layer covers.
fn nominal(lattice: &DemInfo, layer: &DemInfo) -> Result<Nominal, DemError> {
    if fit::share_spacing(lattice, layer) {
        fit::check_fit(lattice, layer)?;
        return Ok(Nominal {
            info: layer.clone(),
            is_coarse: false,
        });
    }
    let Placement { x0, y0, dx, dy } = lattice.placement;
    let own = &layer.placement;
    let across = f64::from(layer.width - 1) * own.dx;
    let down = f64::from(layer.height - 1) * own.dy;
    let west = ((own.x0 - x0) / dx - SLACK).ceil();
    let east = ((own.x0 + across - x0) / dx + SLACK).floor();
    let north = ((y0 - own.y0) / dy - SLACK).ceil();
    let south = ((y0 - own.y0 + down) / dy + SLACK).floor();
    let info = DemInfo {
        width: fit::side(layer, (east - west + 1.0).max(1.0))?,
        height: fit::side(layer, (south - north + 1.0).max(1.0))?,
        placement: Placement {
            x0: x0 + west * dx,
            y0: y0 - north * dy,
            dx,
            dy,
        },
        ..layer.clone()
    };
    Ok(Nominal {
        info,
        is_coarse: true,
    })
}

/// A layer on the mosaic's lattice.
fn input(layer: Layer, nominal: Nominal, mosaic: &DemInfo) -> Result<Input, DemError> {
    if !nominal.is_coarse {
        return Ok(Input::layer(layer.turned, layer.source, Grain::Finest));
    }
    let mut cells = 1;
    while ratio(mosaic, &layer.turned) * (1.0 + SLACK) >= f64::from(cells * PAGE_CELLS as u32) {
        cells *= PAGE_CELLS as u32;
    }
    if cells > 1
        && let Some(corners) = corners_within(&nominal.info, mosaic, cells)
    {
        let parity = corners.parity;
        let source = onto(layer.source, corners.info)?;
        let facets = Facets::new(source, cells, parity);
        return Ok(Input::layer(
            facets.info().clone(),
            Box::new(facets),
            Grain::Facets(cells),
        ));
    }
    let info = nominal.info;
    let source = onto(layer.source, info.clone())?;
    Ok(Input::layer(info, source, Grain::Between))
}

/// Page corners inside a layer.
struct Corners {
    info: DemInfo,
    /// Whether the south-western cell of them is one whose diagonal rises.
    parity: bool,
}

/// The corners of pages of so many cells that lie inside; `None` if they enclose no page.
fn corners_within(nominal: &DemInfo, mosaic: &DemInfo, cells: u32) -> Option<Corners> {
    let (column, row) = fit::place(nominal, &mosaic.placement);
    // Rows of the grid count from the south.
    let south = mosaic.height - row - nominal.height;
    let ends = |from: u32, side: u32| [from.div_ceil(cells), (from + side - 1) / cells];
    let [west, east] = ends(column, nominal.width);
    let [south, north] = ends(south, nominal.height);
    if west >= east || south >= north {
        return None;
    }
    let Placement { x0, y0, dx, dy } = mosaic.placement;
    let north_row = mosaic.height - 1 - north * cells;
    Some(Corners {
        info: DemInfo {
            width: east - west + 1,
            height: north - south + 1,
            placement: Placement {
                x0: x0 + f64::from(west * cells) * dx,
                y0: y0 - f64::from(north_row) * dy,
                dx: f64::from(cells) * dx,
                dy: f64::from(cells) * dy,
            },
            ..nominal.clone()
        },
        parity: (west + south).is_multiple_of(2),
    })
}

/// What bringing several layers to one lattice cost, as one.
pub(super) fn together(all: impl Iterator<Item = Resampling>) -> Option<Resampling> {
    all.reduce(|a, b| {
        let squares = |r: &Resampling| r.rms_difference_m.powi(2) * r.compared as f64;
        let compared = a.compared + b.compared;
        let coarsest = match a.from_spacing[0] < b.from_spacing[0] {
            true => &b,
            false => &a,
        };
        Resampling {
            from_crs: coarsest.from_crs.clone(),
            from_spacing: coarsest.from_spacing,
            interpolation: coarsest.interpolation.clone(),
            compared,
            uncovered: a.uncovered + b.uncovered,
            largest_difference_m: a.largest_difference_m.max(b.largest_difference_m),
            rms_difference_m: ((squares(&a) + squares(&b)) / compared.max(1) as f64).sqrt(),
            horizontal_error_m: a.horizontal_error_m.max(b.horizontal_error_m),
        }
    })
}

#[cfg(test)]
mod tests;
