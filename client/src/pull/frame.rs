//! Which part of the server's grid is taken, and where it lies in the new dataset's grid.

use super::PullError;
use escarp_proto::geometry::{GridLevels, PAGE_CELLS, PAGE_LEVELS, PageId};
use escarp_proto::georef::{Georef, Plane};
use escarp_proto::manifest::Manifest;

/// West, south, east, north.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// The four, in metres of the world, or in degrees.
    pub sides: [f64; 4],
    /// Longitude and latitude, degrees.
    pub is_lonlat: bool,
}

/// A rectangle of the grid: its samples, and those on its border, are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Region {
    /// Western and eastern grid column; both are multiples of a page's cells.
    pub x: [u32; 2],
    /// Southern and northern grid row, likewise.
    pub y: [u32; 2],
}

impl Region {
    /// The region of a dataset that bounds ask for, widened to whole pages, and at most by an
    /// eighth on each side.
    ///
    /// # Errors
    /// [`PullError::Usage`] for bounds that are no rectangle, or beside the data, or in degrees
    /// where the dataset's plane is not one of longitude and latitude.
    pub fn of(bounds: &Bounds, manifest: &Manifest) -> Result<Region, PullError> {
        let [west, south, east, north] = in_metres(bounds, &manifest.georef)?;
        let extent = manifest.extent_m();
        let is_beside = |from: f64, to: f64, [least, most]: [f64; 2]| to < least || from > most;
        if is_beside(west, east, extent[0]) || is_beside(south, north, extent[1]) {
            let [[w, e], [s, n], _] = extent;
            return Err(PullError::Usage(format!(
                "the bounds {west:.1},{south:.1},{east:.1},{north:.1} m lie beside the data, \
                 which is at {w:.1},{s:.1},{e:.1},{n:.1} m"
            )));
        }
        let [x0, y0] = manifest.georef.grid(west, south);
        let [x1, y1] = manifest.georef.grid(east, north);
        let wide = (x1 - x0).max(y1 - y0);
        let most = f64::from(manifest.grid_levels.cells_per_side());
        let mut unit = PAGE_CELLS as f64;
        while unit * PAGE_CELLS as f64 <= wide.min(most) / 8.0 {
            unit *= PAGE_CELLS as f64;
        }
        let [width, height] = manifest.samples;
        Ok(Region {
            x: widened([x0, x1], unit, width),
            y: widened([y0, y1], unit, height),
        })
    }

    /// The rectangle that a page and the region share, if it has cells; and whether it is the whole
    /// page.
    pub(super) fn overlap(&self, page: PageId, grid: GridLevels) -> Overlap {
        let (x, y) = grid.page_origin(page);
        let cells = grid.square_cells(page.level());
        let along = |from: u32, [least, most]: [u32; 2]| {
            let to = from + cells;
            (from < most && to > least, from >= least && to <= most)
        };
        match (along(x, self.x), along(y, self.y)) {
            ((_, true), (_, true)) => Overlap::Whole,
            ((true, _), (true, _)) => Overlap::Part,
            _ => Overlap::None,
        }
    }

    /// Whether a sample of the grid is in the region or on its border.
    pub(super) fn holds(&self, x: u32, y: u32) -> bool {
        (self.x[0]..=self.x[1]).contains(&x) && (self.y[0]..=self.y[1]).contains(&y)
    }

    fn longest(&self) -> u32 {
        (self.x[1] - self.x[0]).max(self.y[1] - self.y[0])
    }
}

/// How much of a page is in the region.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Overlap {
    /// No cell of it.
    None,
    /// Some of its cells.
    Part,
    /// All of it.
    Whole,
}

/// Columns or rows that hold a stretch, at multiples of a unit; the last one may lie beyond the
/// data, where there are holes anyway.
fn widened([from, to]: [f64; 2], unit: f64, samples: u32) -> [u32; 2] {
    let last = f64::from(samples - 1);
    let page = PAGE_CELLS as f64;
    let end = (last / page).ceil().max(1.0) * page;
    let least = ((from.max(0.0) / unit).floor() * unit).min(end - page);
    let most = ((to / unit).ceil() * unit).clamp(least + page, end);
    [least as u32, most as u32]
}

/// Bounds in metres of the world.
fn in_metres(bounds: &Bounds, georef: &Georef) -> Result<[f64; 4], PullError> {
    let [west, south, east, north] = bounds.sides;
    let usage = |why: String| Err(PullError::Usage(why));
    if !bounds.sides.iter().all(|v| v.is_finite()) || south >= north {
        return usage(format!(
            "the bounds {west},{south},{east},{north} are no rectangle; they are west, south, \
             east, north, south below north"
        ));
    }
    if !bounds.is_lonlat {
        return match west < east {
            true => Ok(bounds.sides),
            false => usage(format!(
                "the bounds' west, {west} m, is not west of their east, {east} m"
            )),
        };
    }
    let (radius_m, longitude, latitude) = match &georef.plane {
        Plane::Geographic {
            radius_m,
            middle_longitude_deg,
            middle_latitude_deg,
            ..
        } => (*radius_m, *middle_longitude_deg, *middle_latitude_deg),
        Plane::Projected {
            crs,
            metres_per_unit,
        } => {
            let factor = match *metres_per_unit {
                1.0 => String::new(),
                factor => format!(", in units of {factor} m"),
            };
            return usage(format!(
                "the dataset is in the plane of {crs}, for which this program has no projection; \
                 give --bounds in its metres, without --lonlat. GDAL brings corners there: \
                 echo {west} {south} | gdaltransform -s_srs EPSG:4326 -t_srs '{crs}'{factor}"
            ));
        }
        Plane::Local => {
            return usage(
                "the dataset has no georeference; give --bounds in metres from its south-west \
                 corner, without --lonlat"
                    .into(),
            );
        }
    };
    if south < -90.0 || north > 90.0 || west.abs() > 360.0 || east.abs() > 360.0 {
        return usage(format!(
            "the bounds {west},{south},{east},{north} are no degrees; allowed are longitudes of \
             -360 to 360, latitudes of -90 to 90"
        ));
    }
    // West may be given as 170, east as -170: the way is eastwards, and starts within half a turn
    // of the middle.
    let turn = (east - west).rem_euclid(360.0);
    let way = if turn == 0.0 { 360.0 } else { turn };
    let from = (west - longitude + 180.0).rem_euclid(360.0) - 180.0;
    let north_m = radius_m.to_radians();
    let east_m = north_m * latitude.to_radians().cos();
    Ok([
        from * east_m,
        (south - latitude) * north_m,
        (from + way) * east_m,
        (north - latitude) * north_m,
    ])
}

/// From the server's grid to the new one.
///
/// Pages from the *base* level down keep their shape, as the shift is by an even number of them:
/// their diagonals run as before. Coarser ones are made anew from the corners of these.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Frame {
    pub(super) old: GridLevels,
    pub(super) new: GridLevels,
    pub(super) region: Region,
    /// Grid column and row of the old grid that are the first of the new one.
    pub(super) shift: [u32; 2],
    /// Level of the base pages in the old grid.
    pub(super) base: u8,
    /// Samples of the new dataset.
    pub(super) samples: [u32; 2],
}

impl Frame {
    pub(super) fn new(region: Region, manifest: &Manifest) -> Result<Frame, PullError> {
        let old = manifest.grid_levels;
        let mut side = PAGE_CELLS as u32;
        while side
            .checked_mul(8 * PAGE_CELLS as u32)
            .is_some_and(|next| next <= region.longest())
        {
            side *= PAGE_CELLS as u32;
        }
        let floor = |from: u32| from / (2 * side) * (2 * side);
        let shift = [floor(region.x[0]), floor(region.y[0])];
        let last = |axis: usize, to: u32| to.min(manifest.samples[axis] - 1) - shift[axis];
        let samples = [last(0, region.x[1]) + 1, last(1, region.y[1]) + 1];
        let new = GridLevels::covering(samples[0], samples[1]).filter(|new| new.get() <= old.get());
        let new = new.ok_or_else(|| {
            PullError::Usage(format!("{samples:?} samples do not fit into a grid"))
        })?;
        let is_same = shift == [0, 0] && new == old;
        let base = match is_same {
            true => 0,
            false => old.get() - side.ilog2() as u8,
        };
        Ok(Frame {
            old,
            new,
            region,
            shift,
            base,
            samples,
        })
    }

    /// Level of base pages in the new grid.
    pub(super) const fn new_base(&self) -> u8 {
        self.base - (self.old.get() - self.new.get())
    }

    /// The page of the new grid that a page of the old one, at least as fine as the base, becomes.
    pub(super) fn renamed(&self, page: PageId) -> Option<PageId> {
        let level = page.level().checked_sub(self.old.get() - self.new.get())?;
        let cells = self.old.square_cells(page.level());
        let square = page.square();
        PageId::new(
            level,
            square.x.checked_sub(self.shift[0] / cells)?,
            square.y.checked_sub(self.shift[1] / cells)?,
        )
    }

    /// Levels of pages at a level of the old grid, and below.
    pub(super) const fn levels_from(&self, level: u8) -> u8 {
        (self.old.get() - level) / PAGE_LEVELS
    }

    /// Pages of a level of the old grid that have cells in the region, by row from the south.
    pub(super) fn pages(&self, level: u8) -> Vec<PageId> {
        let cells = self.old.square_cells(level);
        let range = |[from, to]: [u32; 2]| from / cells..to.div_ceil(cells);
        range(self.region.y)
            .flat_map(|y| range(self.region.x).filter_map(move |x| PageId::new(level, x, y)))
            .collect()
    }

    /// The new dataset's place in the world.
    pub(super) fn georef(&self, georef: &Georef) -> Georef {
        let [x, y] = self.shift;
        Georef {
            origin_m: [georef.world_x(x), georef.world_y(y)],
            ..georef.clone()
        }
    }
}
