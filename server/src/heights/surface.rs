//! The height of the surface at a place.

use super::accuracy::{metres_up, sum_up};
use super::{Accuracy, Detail, GridPlace, HeightError, Pages};
use escarp_proto::geometry::{PAGE_CELLS, PAGE_LEVELS, PAGE_SAMPLES, PageId, Slot};
use escarp_proto::page::{ChildSlot, Page};

/// A height, and how far it may be off.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Height {
    /// Metres above the dataset's vertical reference.
    pub height_m: f64,
    /// Bound of its difference from the surface of the source's samples, metres, rounded up.
    pub error_m: f64,
    /// Distance of the samples it was taken from, in grid cells.
    pub stride: u32,
}

/// In quanta.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Found {
    pub height: f64,
    pub bound: u32,
    pub stride: u32,
}

/// The height of the surface at a place; `None` where there is none.
///
/// # Errors
/// [`HeightError`] if a page cannot be read, or no more may be.
pub fn height_at(
    pages: &mut Pages<'_>,
    place: GridPlace,
    detail: Detail,
) -> Result<Option<Height>, HeightError> {
    let manifest = pages.manifest();
    let quantum_m = manifest.georef.quantum_m;
    let finest_m = Accuracy::of(manifest).finest_m();
    let found = found_at(pages, place, detail)?;
    Ok(found.map(|found| Height {
        height_m: found.height * quantum_m,
        error_m: sum_up(metres_up(f64::from(found.bound), quantum_m), finest_m),
        stride: found.stride,
    }))
}

/// Heights at many places, in their order; read in the order of the pages, so that each page is
/// read once.
///
/// # Errors
/// As [`height_at`].
pub fn heights_at(
    pages: &mut Pages<'_>,
    places: &[Option<GridPlace>],
    detail: Detail,
) -> Result<Vec<Option<Height>>, HeightError> {
    let level = pages.grid().finest_page_level();
    let key = |place: &GridPlace| {
        let [x, y] = place.0.map(|v| v as u32 / PAGE_CELLS as u32);
        PageId::new(level, x, y).map(PageId::key)
    };
    let mut order: Vec<(usize, GridPlace)> = places
        .iter()
        .enumerate()
        .filter_map(|(at, place)| Some((at, (*place)?)))
        .collect();
    order.sort_by_cached_key(|(_, place)| key(place));
    let mut heights = vec![None; places.len()];
    for (at, place) in order {
        heights[at] = height_at(pages, place, detail)?;
    }
    Ok(heights)
}

/// As [`height_at`], in quanta.
pub(super) fn found_at(
    pages: &mut Pages<'_>,
    place: GridPlace,
    detail: Detail,
) -> Result<Option<Found>, HeightError> {
    for cell in cells_of(place, pages.manifest().samples) {
        let found = descend(pages, cell, place, detail)?;
        if found.is_some() {
            return Ok(found);
        }
    }
    Ok(None)
}

/// The cells that hold a place: more than one where it lies on their border.
fn cells_of(GridPlace(place): GridPlace, samples: [u32; 2]) -> impl Iterator<Item = [u32; 2]> {
    let sides = [0, 1].map(|axis: usize| {
        let last = samples[axis].saturating_sub(2);
        let cell = (place[axis] as u32).min(last);
        let before = (f64::from(cell) == place[axis]).then(|| cell.checked_sub(1));
        [Some(cell), before.flatten()]
    });
    let [xs, ys] = sides;
    ys.into_iter()
        .flatten()
        .flat_map(move |y| xs.into_iter().flatten().map(move |x| [x, y]))
}

/// From the root down to the first page in which the place is fine enough.
fn descend(
    pages: &mut Pages<'_>,
    cell: [u32; 2],
    GridPlace(place): GridPlace,
    detail: Detail,
) -> Result<Option<Found>, HeightError> {
    let manifest = pages.manifest();
    let levels = pages.grid().get();
    for level in (0..levels).step_by(PAGE_LEVELS.into()) {
        let below = levels - level;
        let Some(id) = PageId::new(level, cell[0] >> below, cell[1] >> below) else {
            break;
        };
        let page = pages.page(id)?;
        let bits = below - PAGE_LEVELS;
        let square = cell.map(|v| v >> bits);
        let [column, row] = square.map(|v| v as usize % PAGE_CELLS);
        let stride = 1 << bits;
        let bound = match page.slot(Slot::at(column, row)) {
            ChildSlot::Empty => return Ok(None),
            ChildSlot::Mixed(_) if page.is_finest() => 0,
            ChildSlot::Mixed(_) => continue,
            ChildSlot::Full(error) | ChildSlot::Cut(error) => error.bound(),
        };
        if bound > 0 && !detail.allows(bound, stride, manifest) {
            continue;
        }
        let side = f64::from(stride);
        let inside = [0, 1].map(|axis: usize| place[axis] / side - f64::from(square[axis]));
        let height = Cell::of(&page, column, row, rises(square)).height(inside);
        return Ok(height.map(|height| Found {
            height,
            bound,
            stride,
        }));
    }
    Ok(None)
}

/// Whether the diagonal of a square runs from south-west to north-east.
pub(super) const fn rises([x, y]: [u32; 2]) -> bool {
    (x ^ y) & 1 == 0
}

/// A cell as two triangles. Heights in quanta: south-west, south-east, north-west, north-east.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cell {
    pub corners: [f64; 4],
    pub rises: bool,
    /// Whether the southern, the northern triangle is there.
    pub present: [bool; 2],
    /// How far the surface may be from the triangles.
    pub bound: f64,
}

impl Cell {
    /// A cell of a page at full depth.
    pub fn of(page: &Page, column: usize, row: usize, rises: bool) -> Cell {
        let south_west = row * PAGE_SAMPLES + column;
        let samples = [0, 1, PAGE_SAMPLES, PAGE_SAMPLES + 1].map(|corner| south_west + corner);
        Cell {
            corners: samples.map(|sample| f64::from(page.height(sample))),
            rises,
            present: present(samples.map(|sample| page.is_valid(sample)), rises),
            bound: 0.0,
        }
    }

    /// The height at a place of the cell, `[0, 0]` the south-west; `None` where no triangle is.
    pub fn height(&self, place: [f64; 2]) -> Option<f64> {
        self.plane(place).map(|plane| plane(place))
    }

    /// The plane of the triangle at a place of the cell; `None` where no triangle is. Exact at
    /// corners.
    pub fn plane(&self, [u, v]: [f64; 2]) -> Option<impl Fn([f64; 2]) -> f64 + use<>> {
        let [sw, se, nw, ne] = self.corners;
        let rises = self.rises;
        let [southern, northern] = self.present;
        let side = if rises { u - v } else { 1.0 - u - v };
        // On the diagonal either will do.
        let is_southern = southern && side >= 0.0;
        let is_northern = northern && side <= 0.0;
        if !(is_southern || is_northern) {
            return None;
        }
        Some(move |[u, v]: [f64; 2]| match (rises, is_southern) {
            (true, true) => sw + u * (se - sw) + v * (ne - se),
            (true, false) => sw + v * (nw - sw) + u * (ne - nw),
            (false, true) => sw + u * (se - sw) + v * (nw - sw),
            (false, false) => ne + (1.0 - u) * (nw - ne) + (1.0 - v) * (se - ne),
        })
    }
}

/// Which of a cell's two triangles have data at all their corners.
pub(super) const fn present([sw, se, nw, ne]: [bool; 4], rises: bool) -> [bool; 2] {
    match rises {
        true => [sw && se && ne, sw && nw && ne],
        false => [sw && se && nw, se && nw && ne],
    }
}
