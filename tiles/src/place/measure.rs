//! How far the source's samples are from the surface of the resampled grid: the triangles that a
//! dataset has at full resolution.

use super::blocks::Loaded;
use super::mapping::{Mapping, fill_lattice};
use crate::dem::DemInfo;
use rayon::prelude::*;

/// Places in the target are right to this part of a cell halfway between exact ones.
const TOLERANCE: f64 = 0.001;
/// Source samples on a side of the parts that are looked at together.
const PART: u32 = 32;

/// Some rows of the target.
pub(super) struct Strip<'a> {
    pub target: &'a DemInfo,
    pub first_row: u32,
    pub end: u32,
    /// Of rows `first_row..end`.
    pub heights: &'a [f64],
}

/// What was found.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Measured {
    /// Source samples that lie below or above a triangle.
    pub compared: u64,
    /// Source samples with a height that lie inside the grid, but at no triangle.
    pub uncovered: u64,
    largest: f64,
    squares: f64,
}

impl Measured {
    /// In the order of calls, so that the sum does not depend on threads.
    pub fn add(&mut self, other: Measured) {
        self.compared += other.compared;
        self.uncovered += other.uncovered;
        self.largest = self.largest.max(other.largest);
        self.squares += other.squares;
    }

    /// Metres, rounded up.
    pub fn largest_m(&self) -> f64 {
        self.largest * (1.0 + 4.0 * f64::EPSILON)
    }

    /// Root of the mean square, metres.
    pub fn rms_m(&self) -> f64 {
        (self.squares / self.compared.max(1) as f64).sqrt()
    }

    fn sample(&mut self, source_m: f64, surface: Option<f64>) {
        match surface {
            Some(surface_m) => {
                let difference_m = (surface_m - source_m).abs();
                self.compared += 1;
                self.largest = self.largest.max(difference_m);
                self.squares += difference_m * difference_m;
            }
            None => self.uncovered += 1,
        }
    }
}

/// Compares the source samples of one block that lie between the strip's rows.
pub(super) fn measure(
    strip: &Strip<'_>,
    mapping: &Mapping,
    loaded: &Loaded,
    [left, right]: [u32; 2],
    [top, bottom]: [u32; 2],
) -> Measured {
    let parts: Vec<[u32; 2]> = (top..bottom)
        .step_by(PART as usize)
        .flat_map(|r| (left..right).step_by(PART as usize).map(move |c| [c, r]))
        .collect();
    let found: Vec<Measured> = parts
        .into_par_iter()
        .map(|[c, r]| {
            let size = [(right - c).min(PART), (bottom - r).min(PART)];
            measure_part(strip, mapping, loaded, [c, r], size)
        })
        .collect();
    let mut all = Measured::default();
    found.into_iter().for_each(|part| all.add(part));
    all
}

fn measure_part(
    strip: &Strip<'_>,
    mapping: &Mapping,
    loaded: &Loaded,
    [left, top]: [u32; 2],
    [columns, rows]: [u32; 2],
) -> Measured {
    let place = strip.target.placement;
    let to_target = |c: f64, r: f64| {
        let [x, y] = mapping.to_target([c, r], place.x0 - place.dx / 2.0)?;
        Some([
            snapped((x - place.x0) / place.dx),
            snapped((place.y0 - y) / place.dy),
        ])
    };
    let mut found = Measured::default();
    if strip.is_far_from(&to_target, [left, top], [columns, rows]) {
        return found;
    }
    let size = [columns as usize, rows as usize];
    let mut places = vec![[f64::NAN; 2]; size[0] * size[1]];
    fill_lattice(&to_target, [left, top], size, TOLERANCE, &mut places);
    let mut reader = loaded.reader();
    for (r, places) in (top..).zip(places.chunks_exact(size[0])) {
        for (c, place) in (left..).zip(places) {
            if strip.holds(*place) {
                let source_m = reader.at(c, r);
                if !source_m.is_nan() {
                    found.sample(source_m, strip.surface(*place));
                }
            }
        }
    }
    found
}

impl Strip<'_> {
    /// Whether a part's corners and middle lie so far above or below that none of it can be in
    /// the strip: by more than the part is large.
    fn is_far_from(
        &self,
        to_target: &dyn Fn(f64, f64) -> Option<[f64; 2]>,
        [left, top]: [u32; 2],
        [columns, rows]: [u32; 2],
    ) -> bool {
        let (c, r) = (f64::from(left), f64::from(top));
        let (w, h) = (f64::from(columns - 1), f64::from(rows - 1));
        let corners = [(c, r), (c + w, r), (c, r + h), (c + w, r + h)];
        let mut range = [f64::INFINITY, f64::NEG_INFINITY];
        for (c, r) in corners {
            let Some([_, row]) = to_target(c, r) else {
                return false;
            };
            range = [range[0].min(row), range[1].max(row)];
        }
        let slack = 2.0 + (range[1] - range[0]);
        range[1] + slack < f64::from(self.first_row) || range[0] - slack > f64::from(self.end)
    }

    /// Whether a place is between the strip's rows; the last one belongs to the next strip, if
    /// there is one.
    fn holds(&self, [c, r]: [f64; 2]) -> bool {
        let last = f64::from(self.end - 1);
        let below = match self.end == self.target.height {
            true => r <= last,
            false => r < last,
        };
        r >= f64::from(self.first_row) && below && c >= 0.0 && c <= f64::from(self.target.width - 1)
    }

    /// Height of the triangle at a place, as `tiles/FORMAT.md` has them; `None` where there is
    /// none.
    fn surface(&self, [c, r]: [f64; 2]) -> Option<f64> {
        let (width, height) = (self.target.width, self.target.height);
        if width < 2 || height < 2 {
            return None;
        }
        let column = (c.floor() as u32).min(width - 2);
        let row = (r.floor() as u32).min(self.end.max(2) - 2);
        let at = |column: u32, row: u32| {
            let index = (row - self.first_row) as usize * width as usize + column as usize;
            self.heights.get(index).copied().filter(|h| !h.is_nan())
        };
        let (fx, fy) = (c - f64::from(column), 1.0 - (r - f64::from(row)));
        let [sw, se] = [at(column, row + 1), at(column + 1, row + 1)];
        let [nw, ne] = [at(column, row), at(column + 1, row)];
        // Rows of the grid count from the south.
        if (column + (height - 2 - row)).is_multiple_of(2) {
            // The diagonal runs from south-west to north-east.
            let south = || Some(sw? + (se? - sw?) * fx + (ne? - se?) * fy);
            let north = || Some(sw? + (ne? - nw?) * fx + (nw? - sw?) * fy);
            on_side(fx - fy, south, north)
        } else {
            let south = || Some(sw? + (se? - sw?) * fx + (nw? - sw?) * fy);
            let north = || Some(ne? + (nw? - ne?) * (1.0 - fx) + (se? - ne?) * (1.0 - fy));
            on_side(1.0 - fx - fy, south, north)
        }
    }
}

/// The southern triangle's height where `side` is positive, the northern one's where it is
/// negative; on the diagonal, that of the one that is there.
fn on_side(
    side: f64,
    south: impl Fn() -> Option<f64>,
    north: impl Fn() -> Option<f64>,
) -> Option<f64> {
    match side {
        side if side.abs() < 1e-9 => south().or_else(north),
        side if side > 0.0 => south(),
        _ => north(),
    }
}

/// A place within a millionth of a cell of a sample is that sample.
fn snapped(cells: f64) -> f64 {
    let whole = cells.round();
    if (cells - whole).abs() < 1e-6 {
        whole
    } else {
        cells
    }
}
