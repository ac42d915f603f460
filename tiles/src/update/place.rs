//! Where in a dataset's grid a patch lies, and a rectangle of coordinates.

use crate::build::BuildError;
use crate::dem::{Crs, DemInfo};
use escarp_proto::georef::{Georef, Plane};
use escarp_proto::manifest::Manifest;

/// How far, in cells, a patch's samples may be off the dataset's.
const MAX_OFF_LATTICE: f64 = 0.01;

/// Samples of the grid, ends included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Rectangle {
    pub(super) x: [u32; 2],
    pub(super) y: [u32; 2],
}

impl Rectangle {
    /// Whether a sample lies in it.
    pub(super) const fn contains(&self, x: u32, y: u32) -> bool {
        self.x[0] <= x && x <= self.x[1] && self.y[0] <= y && y <= self.y[1]
    }
}

/// The samples of a patch in the grid of a dataset.
///
/// # Errors
/// [`BuildError::Unfit`] if the patch has another coordinate system, spacing or lattice, or does
/// not lie within the dataset.
pub(super) fn place(manifest: &Manifest, info: &DemInfo) -> Result<Rectangle, BuildError> {
    let unfit = |why: String| BuildError::Unfit {
        path: info.path.clone(),
        why,
    };
    let georef = &manifest.georef;
    let [east, north] = metres_per_unit(georef, info).map_err(unfit)?;
    let spacing = [info.placement.dx * east, info.placement.dy * north];
    let most = info.width.max(info.height);
    for (given, own) in spacing.into_iter().zip(georef.sample_spacing_m) {
        if ((given - own) / own).abs() * f64::from(most) > MAX_OFF_LATTICE {
            return Err(unfit(format!(
                "samples {given} m apart, those of the dataset are {own} m; bring it to the \
                 dataset's grid first (gdalwarp -tr ... -tap)"
            )));
        }
    }
    let south = info.placement.y0 - f64::from(info.height - 1) * info.placement.dy;
    let [x, y] = grid_position(georef, [info.placement.x0, south]);
    if (x - x.round()).abs() > MAX_OFF_LATTICE || (y - y.round()).abs() > MAX_OFF_LATTICE {
        return Err(unfit(format!(
            "its south-west sample falls on column {x:.3}, row {y:.3} of the dataset, allowed are \
             whole numbers; bring it to the dataset's grid first (gdalwarp -te ... -tr ...)"
        )));
    }
    let [width, height] = manifest.samples;
    let ends = [
        x.round() + f64::from(info.width - 1),
        y.round() + f64::from(info.height - 1),
    ];
    let inside = x.round() >= 0.0
        && y.round() >= 0.0
        && ends[0] < f64::from(width)
        && ends[1] < f64::from(height);
    if !inside {
        return Err(unfit(format!(
            "it covers columns {:.0} to {:.0} and rows {:.0} to {:.0} (from the south-west), the \
             dataset has 0 to {} and 0 to {}; cut it to the dataset (gdal_translate -projwin), or \
             build a larger dataset of both",
            x.round(),
            ends[0],
            y.round(),
            ends[1],
            width - 1,
            height - 1
        )));
    }
    let (x, y) = (x.round() as u32, y.round() as u32);
    Ok(Rectangle {
        x: [x, x + info.width - 1],
        y: [y, y + info.height - 1],
    })
}

/// Metres of the world a unit of the patch's coordinates, to the east and to the north.
fn metres_per_unit(georef: &Georef, info: &DemInfo) -> Result<[f64; 2], String> {
    let same = match (&georef.plane, &info.crs) {
        (
            Plane::Projected {
                crs,
                metres_per_unit,
                ..
            },
            Crs::Projected {
                name,
                metres_per_unit: given,
                ..
            },
        ) => crs == name && metres_per_unit == given,
        (
            Plane::Geographic { crs, radius_m, .. },
            Crs::Geographic {
                name, radius_m: r, ..
            },
        ) => crs == name && radius_m == r,
        (Plane::Local, Crs::Local) => true,
        _ => false,
    };
    match same {
        true => Ok(scale(&georef.plane)),
        false => Err(format!(
            "its coordinate system is {}, that of the dataset {:?}; bring it to the dataset's \
             first (gdalwarp -t_srs ...)",
            info.crs, georef.plane
        )),
    }
}

/// Metres of the world a unit of the coordinate system, to the east and to the north.
fn scale(plane: &Plane) -> [f64; 2] {
    match plane {
        Plane::Projected {
            metres_per_unit, ..
        } => [*metres_per_unit; 2],
        Plane::Geographic {
            radius_m,
            middle_latitude_deg,
            ..
        } => {
            let north = radius_m.to_radians();
            [north * middle_latitude_deg.to_radians().cos(), north]
        }
        Plane::Local => [1.0; 2],
    }
}

/// Column and row, with fractions, of coordinates of the dataset's coordinate system.
fn grid_position(georef: &Georef, [x, y]: [f64; 2]) -> [f64; 2] {
    let [east, north] = scale(&georef.plane);
    let (x0, y0) = match georef.plane {
        Plane::Geographic {
            middle_longitude_deg,
            middle_latitude_deg,
            ..
        } => (middle_longitude_deg, middle_latitude_deg),
        _ => (0.0, 0.0),
    };
    georef.grid((x - x0) * east, (y - y0) * north)
}

/// The samples within a rectangle of coordinates `[west, south, east, north]`, its border
/// included; `None` if there are none.
pub(super) fn rectangle(manifest: &Manifest, bounds: [f64; 4]) -> Option<Rectangle> {
    let [west, south, east, north] = bounds;
    let low = grid_position(&manifest.georef, [west, south]);
    let high = grid_position(&manifest.georef, [east, north]);
    // A millionth of a cell is within what coordinates written in decimal may miss.
    let side = |i: usize| {
        let first = (low[i] - 1e-6).ceil().max(0.0);
        let last = (high[i] + 1e-6)
            .floor()
            .min(f64::from(manifest.samples[i] - 1));
        (first <= last).then_some([first as u32, last as u32])
    };
    Some(Rectangle {
        x: side(0)?,
        y: side(1)?,
    })
}
