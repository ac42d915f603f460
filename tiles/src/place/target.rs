//! Which grid a source is brought to.
//!
//! Within its own CRS a source's lattice stays: another spacing counts from its north-west sample,
//! so that a multiple takes exact samples. In another CRS samples lie at multiples of the spacing,
//! so that all that is brought to one spacing lies on one lattice.

use super::mapping::Mapping;
use crate::dem::{Crs, DemError, DemInfo, MAX_SIDE_SAMPLES, Placement};

/// Places along each side of the source by which its extent in another CRS is found.
const ALONG: u32 = 512;
/// How far outside bounds, in cells, a sample still counts as inside.
const SLACK: f64 = 1e-6;

/// A grid in a CRS.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Target {
    pub placement: Placement,
    pub width: u32,
    pub height: u32,
    pub crs: Crs,
}

impl Target {
    /// The grid for a source: `crs` and `spacing` only where they differ from the source's.
    ///
    /// # Errors
    /// [`DemError::Usage`], [`DemError::Limits`].
    pub fn choose(
        info: &DemInfo,
        mapping: &Mapping,
        crs: Option<&Crs>,
        spacing: Option<f64>,
        bounds: Option<[f64; 4]>,
    ) -> Result<Target, DemError> {
        check_wish(info, spacing, bounds)?;
        let extent = match crs {
            Some(_) => extent_in(info, mapping)?,
            None => own_extent(info),
        };
        let wanted = match bounds {
            Some(bounds) => {
                let bounds = in_the_turn_of(&extent, bounds, crs.unwrap_or(&info.crs), info);
                within(
                    info,
                    extent,
                    bounds,
                    mapping.turn.is_some() && crs.is_none(),
                )?
            }
            None => extent,
        };
        let (steps, anchor) = match (crs, spacing) {
            (None, None) => {
                let place = &info.placement;
                ([place.dx, place.dy], [place.x0, place.y0])
            }
            (None, Some(step)) => ([step; 2], [info.placement.x0, info.placement.y0]),
            (Some(_), step) => {
                let step = match step {
                    Some(step) => step,
                    None => natural_step(info, mapping)?,
                };
                ([step; 2], [0.0; 2])
            }
        };
        Self::on_lattice(info, crs.unwrap_or(&info.crs), wanted, steps, anchor)
    }

    /// The lattice's samples inside a box.
    fn on_lattice(
        info: &DemInfo,
        crs: &Crs,
        [west, south, east, north]: [f64; 4],
        [dx, dy]: [f64; 2],
        [x, y]: [f64; 2],
    ) -> Result<Target, DemError> {
        let first = ((west - x) / dx - SLACK).ceil();
        let last = ((east - x) / dx + SLACK).floor();
        let top = ((y - north) / dy - SLACK).ceil();
        let bottom = ((y - south) / dy + SLACK).floor();
        let side = |name: &str, from: f64, to: f64| {
            let samples = to - from + 1.0;
            if samples > f64::from(MAX_SIDE_SAMPLES) {
                let what = format!("the {name} of the grid (a wider --spacing makes it smaller)");
                let (found, allowed) = (samples as u64, u64::from(MAX_SIDE_SAMPLES));
                return Err(DemError::limits(
                    &info.path, what, found, allowed, "samples",
                ));
            }
            // One line of samples has no surface.
            let least = if info.width.min(info.height) < 2 {
                1.0
            } else {
                2.0
            };
            if samples.is_nan() || samples < least {
                let what = format!(
                    "fewer than {least} columns or rows of the grid lie inside west {west}, south {south}, \
                     east {east}, north {north}"
                );
                let hint = "give wider --bounds or a finer --spacing, in the units of the grid's CRS (degrees for \
                     longitude and latitude; for metres give a projected --crs, too)";
                return Err(DemError::usage(&info.path, what, hint));
            }
            Ok(samples as u32)
        };
        Ok(Target {
            width: side("width", first, last)?,
            height: side("height", top, bottom)?,
            placement: Placement {
                x0: x + first * dx,
                y0: y - top * dy,
                dx,
                dy,
            },
            crs: crs.clone(),
        })
    }

    /// First column and row of the source that the grid's are, where it is a window of them.
    pub fn window_of(&self, info: &DemInfo) -> Option<[u32; 2]> {
        let (a, b) = (&self.placement, &info.placement);
        let column = ((a.x0 - b.x0) / b.dx).round();
        let row = ((b.y0 - a.y0) / b.dy).round();
        let inside = column >= 0.0
            && row >= 0.0
            && column + f64::from(self.width) <= f64::from(info.width)
            && row + f64::from(self.height) <= f64::from(info.height);
        inside.then_some([column as u32, row as u32])
    }

    /// What is known of the source on this grid.
    pub fn info(&self, source: &DemInfo) -> DemInfo {
        DemInfo {
            width: self.width,
            height: self.height,
            placement: self.placement,
            crs: self.crs.clone(),
            ..source.clone()
        }
    }
}

fn check_wish(
    info: &DemInfo,
    spacing: Option<f64>,
    bounds: Option<[f64; 4]>,
) -> Result<(), DemError> {
    if let Some(spacing) = spacing
        && !(spacing.is_finite() && spacing > 0.0)
    {
        let what = format!("a spacing of {spacing}");
        return Err(DemError::usage(&info.path, what, "give a length above 0"));
    }
    if let Some(bounds) = bounds
        && !bounds.iter().all(|v| v.is_finite())
    {
        let what = format!("bounds of {bounds:?}");
        return Err(DemError::usage(&info.path, what, "give four numbers"));
    }
    Ok(())
}

/// West, south, east, north of the source's outer samples.
fn own_extent(info: &DemInfo) -> [f64; 4] {
    let Placement { x0, y0, dx, dy } = info.placement;
    [
        x0,
        y0 - f64::from(info.height - 1) * dy,
        x0 + f64::from(info.width - 1) * dx,
        y0,
    ]
}

/// The source's extent in another CRS, by a lattice of places. Longitudes are those around that of
/// its middle.
fn extent_in(info: &DemInfo, mapping: &Mapping) -> Result<[f64; 4], DemError> {
    let last = [f64::from(info.width - 1), f64::from(info.height - 1)];
    let middle = mapping.to_target(last.map(|n| n / 2.0), -180.0);
    let west = middle.map_or(-180.0, |[x, _]| x - 180.0);
    let mut found = [
        f64::INFINITY,
        f64::INFINITY,
        f64::NEG_INFINITY,
        f64::NEG_INFINITY,
    ];
    for r in 0..=ALONG {
        for c in 0..=ALONG {
            // The border densely, and what is inside at every eighth place.
            if r % ALONG != 0 && c % ALONG != 0 && (r % 8 != 0 || c % 8 != 0) {
                continue;
            }
            let at = |n: u32, last: f64| f64::from(n) / f64::from(ALONG) * last;
            let place = [at(c, last[0]), at(r, last[1])];
            if let Some([x, y]) = mapping.to_target(place, west) {
                found = [
                    found[0].min(x),
                    found[1].min(y),
                    found[2].max(x),
                    found[3].max(y),
                ];
            }
        }
    }
    if found.iter().all(|v| v.is_finite()) {
        return Ok(found);
    }
    let hint = "give a CRS that covers the source's area";
    Err(DemError::usage(
        &info.path,
        "no part of it lies in the wanted CRS",
        hint,
    ))
}

/// Bounds as the user gives them, moved to where the extent is: by whole turns if they are
/// longitudes, by the southern row if they are metres from it.
fn in_the_turn_of(extent: &[f64; 4], bounds: [f64; 4], crs: &Crs, info: &DemInfo) -> [f64; 4] {
    let [mut west, mut south, mut east, mut north] = bounds;
    match crs {
        Crs::Geographic { .. } => {
            if east < west {
                east += 360.0; // across the date line
            }
            let middle = |a: f64, b: f64| f64::midpoint(a, b);
            let turns = ((middle(extent[0], extent[2]) - middle(west, east)) / 360.0).round();
            west += turns * 360.0;
            east += turns * 360.0;
        }
        Crs::Local => {
            let place = &info.placement;
            let lowest = place.y0 - f64::from(info.height - 1) * place.dy;
            south += lowest;
            north += lowest;
        }
        Crs::Projected { .. } => {}
    }
    [west, south, east, north]
}

/// The part of the bounds that the source covers; a whole turn covers every longitude.
fn within(
    info: &DemInfo,
    extent: [f64; 4],
    bounds: [f64; 4],
    whole_turn: bool,
) -> Result<[f64; 4], DemError> {
    let mut cut = [
        extent[0].max(bounds[0]),
        extent[1].max(bounds[1]),
        extent[2].min(bounds[2]),
        extent[3].min(bounds[3]),
    ];
    if whole_turn {
        (cut[0], cut[2]) = (bounds[0], bounds[2].min(bounds[0] + 360.0));
    }
    if cut[0] <= cut[2] && cut[1] <= cut[3] {
        return Ok(cut);
    }
    let what = format!(
        "it does not reach the bounds west {}, south {}, east {}, north {}",
        bounds[0], bounds[1], bounds[2], bounds[3]
    );
    let [west, south, east, north] = extent;
    let hint = format!(
        "it covers {west},{south},{east},{north} in the units of the grid's CRS: give --bounds in it"
    );
    Err(DemError::usage(&info.path, what, hint))
}

/// The smaller of the distances of neighbouring source samples in the middle, in the target's
/// units, cut to two digits: so no detail is lost, and the number can be said.
fn natural_step(info: &DemInfo, mapping: &Mapping) -> Result<f64, DemError> {
    let middle = [info.width, info.height].map(|n| f64::from((n - 1) / 2));
    let here = mapping.to_target(middle, -180.0);
    let distance = |dx: f64, dy: f64| {
        let here = here?;
        let there = mapping.to_target([middle[0] + dx, middle[1] + dy], here[0] - 180.0)?;
        Some((there[0] - here[0]).hypot(there[1] - here[1]))
    };
    let smallest = match (distance(1.0, 0.0), distance(0.0, 1.0)) {
        (Some(east), Some(south)) => east.min(south),
        _ => f64::NAN,
    };
    if !(smallest.is_finite() && smallest > 0.0) {
        let hint = "give --spacing, or a CRS that covers the source's area";
        let what = "its middle does not lie in the wanted CRS";
        return Err(DemError::usage(&info.path, what, hint));
    }
    let exponent = smallest.log10().floor() as i32 - 1;
    let digits = (smallest / 10f64.powi(exponent)).floor().max(1.0);
    // As text, so that 0.00027 is the number nearest to it.
    Ok(format!("{digits}e{exponent}").parse().unwrap_or(smallest))
}
