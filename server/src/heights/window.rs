//! A rectangle of the surface in memory, at the finest level or a coarser one.

use super::surface::{Cell, present, rises};
use super::walk::{Relief, Top};
use super::{HeightError, Pages};
use escarp_proto::geometry::{GridLevels, PAGE_CELLS, PAGE_LEVELS, PAGE_SAMPLES, PageId};
use escarp_proto::page::{Bounds, Kind, Page};
use std::ops::RangeInclusive;

/// Heights every `2^stride_bits` samples, and what is known between them.
pub struct Window {
    stride_bits: u8,
    /// Column and row of its south-western cell.
    first: [u32; 2],
    /// Columns and rows of cells.
    cells: [u32; 2],
    /// Row by row from the south-west; one more a row than cells.
    heights: Vec<i32>,
    valid: Vec<bool>,
    /// How far the surface may be from a cell's triangles; only in a window of coarse cells that
    /// was asked for bounds.
    bounds: Option<Vec<CellBound>>,
    /// For each level of squares from the cells up. Empty until [`with_tops`](Self::with_tops).
    tops: Vec<Level>,
}

/// What is known of the ground at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Ground {
    /// There is none.
    Nothing,
    /// An outline crosses the coarse cell that holds it.
    Unclear,
    /// The surface.
    Surface {
        /// Its height on the window's triangles, in quanta.
        height: f64,
        /// How far the finest surface may be from it, in quanta.
        bound: f64,
    },
}

/// What is known of a coarse cell, in quanta.
#[derive(Debug, Clone, Copy)]
struct CellBound {
    kind: Kind,
    error: u32,
    highest: i32,
}

struct Level {
    columns: usize,
    /// `i32::MIN` where there is no surface.
    highest: Vec<i32>,
    whole: Vec<bool>,
}

const NO_CELL: CellBound = CellBound {
    kind: Kind::Empty,
    error: 0,
    highest: i32::MIN,
};

impl Window {
    /// How coarse a window over a rectangle of the grid, `[[west, east], [south, north]]`, must be
    /// to have at most so many samples; at least `stride_bits`.
    pub fn stride_bits(rectangle: [[f64; 2]; 2], stride_bits: u8, levels: u8, most: u64) -> u8 {
        let fits = |bits: &u8| {
            let (_, cells) = cells_of(rectangle, *bits);
            (u64::from(cells[0]) + 1) * (u64::from(cells[1]) + 1) <= most
        };
        // Squares above the root's children would say nothing more.
        let coarsest = levels - 1;
        let stride_bits = stride_bits.min(coarsest);
        (stride_bits..coarsest).find(fits).unwrap_or(coarsest)
    }

    /// Pages that a window reads at most, those included that have no record and follow from the
    /// ones above.
    pub fn pages(rectangle: [[f64; 2]; 2], stride_bits: u8, grid: GridLevels) -> u64 {
        let (first, cells) = cells_of(rectangle, stride_bits);
        let (_, depth) = place_of(stride_bits, grid);
        let along =
            pages_of(first, cells, depth).map(|pages| u64::from(pages.end() - pages.start()) + 1);
        let read = along[0] * along[1];
        // Row by row, one above for each 16, and so on; and at the ends of rows.
        read + read / 8 + 2 * along[1] * u64::from(grid.get() / PAGE_LEVELS)
    }

    /// Reads a window over a rectangle of the grid. With `bounds`, what is known between the
    /// samples of coarse cells is derived, too.
    ///
    /// # Errors
    /// [`HeightError`] if a page cannot be read, or no more may be.
    pub fn read(
        pages: &mut Pages<'_>,
        rectangle: [[f64; 2]; 2],
        stride_bits: u8,
        bounds: bool,
    ) -> Result<Window, HeightError> {
        let (first, cells) = cells_of(rectangle, stride_bits);
        let samples = (cells[0] as usize + 1) * (cells[1] as usize + 1);
        let with_bounds = bounds && stride_bits > 0;
        let mut window = Window {
            stride_bits,
            first,
            cells,
            heights: vec![0; samples],
            valid: vec![false; samples],
            bounds: with_bounds.then(|| vec![NO_CELL; cells[0] as usize * cells[1] as usize]),
            tops: Vec::new(),
        };
        let (level, depth) = place_of(stride_bits, pages.grid());
        let [columns, rows] = pages_of(first, cells, depth);
        for y in rows {
            for x in columns.clone() {
                if let Some(id) = PageId::new(level - depth, x, y) {
                    let page = pages.page(id)?;
                    window.take(&page, depth);
                }
            }
        }
        Ok(window)
    }

    /// Takes what a page has of it.
    fn take(&mut self, page: &Page, depth: u8) {
        let step = PAGE_CELLS >> depth;
        let side = 1u32 << depth;
        let origin = [page.id().square().x, page.id().square().y].map(|v| v * side);
        let columns = self.cells[0] as usize + 1;
        for y in self.shared(1, origin[1], side, 1) {
            for x in self.shared(0, origin[0], side, 1) {
                let [u, v] = [x - origin[0], y - origin[1]].map(|v| v as usize * step);
                let sample = v * PAGE_SAMPLES + u;
                if page.is_valid(sample) {
                    let at = self.index([x, y], columns);
                    self.heights[at] = page.height(sample);
                    self.valid[at] = true;
                }
            }
        }
        if self.bounds.is_some() {
            self.take_bounds(page, depth, origin);
        }
    }

    fn take_bounds(&mut self, page: &Page, depth: u8, origin: [u32; 2]) {
        let bounds = Bounds::derive(page, None);
        let side = 1u32 << depth;
        for y in self.shared(1, origin[1], side, 0) {
            for x in self.shared(0, origin[0], side, 0) {
                let place = [x - origin[0], y - origin[1]].map(|v| v as usize);
                let told = bounds.box_error(depth, place[0], place[1]);
                let at = self.index([x, y], self.cells[0] as usize);
                if let Some(known) = &mut self.bounds {
                    known[at] = CellBound {
                        kind: told.kind,
                        error: told.error,
                        highest: told.range.hi,
                    };
                }
            }
        }
    }

    /// The cells, or with `more` the samples, that a page's side from `origin` on has in common
    /// with the window.
    fn shared(&self, axis: usize, origin: u32, side: u32, more: u32) -> std::ops::Range<u32> {
        let first = self.first[axis];
        first.max(origin)..(first + self.cells[axis] + more).min(origin + side + more)
    }

    fn index(&self, [x, y]: [u32; 2], columns: usize) -> usize {
        (y - self.first[1]) as usize * columns + (x - self.first[0]) as usize
    }

    /// With the highest height of every square, for lines of sight.
    pub(super) fn with_tops(mut self) -> Window {
        let [columns, rows] = self.cells.map(|n| n as usize);
        let cells = (0..columns * rows).map(|i| self.cell_top(i % columns, i / columns));
        let (highest, whole) = cells.unzip();
        let mut level = Level {
            columns,
            highest,
            whole,
        };
        let mut rows = rows;
        while level.columns.max(rows) > 1 {
            let above = level.above(rows);
            rows = rows.div_ceil(2);
            self.tops.push(level);
            level = above;
        }
        self.tops.push(level);
        self
    }

    /// Highest height of a cell, and whether it is surface everywhere.
    fn cell_top(&self, column: usize, row: usize) -> (i32, bool) {
        if let Some(bounds) = &self.bounds {
            let told = bounds[row * self.cells[0] as usize + column];
            return match told.kind {
                Kind::Empty => (i32::MIN, false),
                kind => (told.highest, kind == Kind::Full),
            };
        }
        let cell = self.cell_at(column, row);
        let highest = cell.corners_present().fold(f64::NEG_INFINITY, f64::max);
        match highest == f64::NEG_INFINITY {
            true => (i32::MIN, false),
            false => (highest as i32, cell.present == [true; 2]),
        }
    }

    pub(super) fn cell_at(&self, column: usize, row: usize) -> Cell {
        let columns = self.cells[0] as usize + 1;
        let south_west = row * columns + column;
        let samples = [0, 1, columns, columns + 1].map(|corner| south_west + corner);
        let rises = rises([self.first[0] + column as u32, self.first[1] + row as u32]);
        let known = self.bounds.as_ref();
        let known = known.map(|known| known[row * self.cells[0] as usize + column]);
        let is_there = present(samples.map(|sample| self.valid[sample]), rises);
        Cell {
            corners: samples.map(|sample| f64::from(self.heights[sample])),
            rises,
            present: match known {
                // Where an outline crosses a coarse cell, its triangles say nothing.
                Some(known) if known.kind != Kind::Full => [false; 2],
                _ => is_there,
            },
            bound: known.map_or(0.0, |known| f64::from(known.error)),
        }
    }

    /// Grid cells between its samples.
    pub fn stride(&self) -> u32 {
        1 << self.stride_bits
    }

    /// A place of the grid in cells of the window.
    pub(super) fn local(&self, grid: [f64; 2]) -> [f64; 2] {
        let side = f64::from(self.stride());
        [0, 1].map(|axis: usize| grid[axis] / side - f64::from(self.first[axis]))
    }

    /// What is known of the ground at a place of the grid.
    pub fn ground(&self, grid: [f64; 2]) -> Ground {
        let place = self.local(grid);
        let mut ground = Ground::Nothing;
        for [column, row] in self.cells_at(place) {
            let cell = self.cell_at(column, row);
            let inside = [place[0] - column as f64, place[1] - row as f64];
            if let Some(height) = cell.height(inside) {
                let bound = cell.bound;
                return Ground::Surface { height, bound };
            }
            let known = self.bounds.as_ref();
            let known = known.map(|known| known[row * self.cells[0] as usize + column].kind);
            if known == Some(Kind::Mixed) {
                ground = Ground::Unclear;
            }
        }
        ground
    }

    /// The cells that hold a place: none outside, more than one on a border.
    fn cells_at(&self, place: [f64; 2]) -> impl Iterator<Item = [usize; 2]> {
        let [xs, ys] = [0, 1].map(|axis: usize| {
            let last = self.cells[axis] as usize;
            let inside = (0.0..=last as f64).contains(&place[axis]);
            let cell = (place[axis] as usize).min(last - 1);
            let before = (cell as f64 == place[axis]).then(|| cell.checked_sub(1));
            [Some(cell), before.flatten()].map(|cell| cell.filter(|_| inside))
        });
        ys.into_iter()
            .flatten()
            .flat_map(move |y| xs.into_iter().flatten().map(move |x| [x, y]))
    }
}

impl Cell {
    /// Heights of the corners of its triangles.
    fn corners_present(&self) -> impl Iterator<Item = f64> {
        let [southern, northern] = self.present;
        let used = match self.rises {
            true => [
                southern || northern,
                southern,
                northern,
                southern || northern,
            ],
            false => [
                southern,
                southern || northern,
                southern || northern,
                northern,
            ],
        };
        let corners = self.corners.into_iter().zip(used);
        corners.filter_map(|(height, used)| used.then_some(height))
    }
}

impl Level {
    /// The squares of which each has four of these.
    fn above(&self, rows: usize) -> Level {
        let columns = self.columns.div_ceil(2);
        let mut level = Level {
            columns,
            highest: vec![i32::MIN; columns * rows.div_ceil(2)],
            whole: vec![true; columns * rows.div_ceil(2)],
        };
        for (i, (&highest, &whole)) in self.highest.iter().zip(&self.whole).enumerate() {
            let (column, row) = (i % self.columns, i / self.columns);
            let at = row / 2 * columns + column / 2;
            level.highest[at] = level.highest[at].max(highest);
            level.whole[at] &= whole;
        }
        level
    }
}

/// First cell, and columns and rows of cells, that hold a rectangle of the grid.
fn cells_of(rectangle: [[f64; 2]; 2], stride_bits: u8) -> ([u32; 2], [u32; 2]) {
    let side = f64::from(1u32 << stride_bits);
    let ends = rectangle.map(|[_, to]| ((to / side).ceil() as u32).max(1));
    // A rectangle without extent has a cell, too, and no cell begins at the grid's end.
    let first = [0, 1].map(|axis: usize| ((rectangle[axis][0] / side) as u32).min(ends[axis] - 1));
    let cells = [0, 1].map(|axis: usize| ends[axis] - first[axis]);
    (first, cells)
}

/// The level of squares that are a window's cells, and how many levels above it their pages are.
fn place_of(stride_bits: u8, grid: GridLevels) -> (u8, u8) {
    let level = grid.get() - stride_bits;
    (level, (level - 1) % PAGE_LEVELS + 1)
}

/// Columns and rows of the pages that hold cells, `depth` levels below.
fn pages_of(first: [u32; 2], cells: [u32; 2], depth: u8) -> [RangeInclusive<u32>; 2] {
    [0, 1].map(|axis: usize| {
        let last = first[axis] + cells[axis] - 1;
        first[axis] >> depth..=last >> depth
    })
}

/// A window as the quadtree that its lines of sight pass.
pub(super) struct Pyramid<'w, 'p, 'a> {
    pub window: &'w Window,
    pub pages: &'p mut Pages<'a>,
}

impl Relief for Pyramid<'_, '_, '_> {
    fn levels(&self) -> u8 {
        (self.window.tops.len() - 1) as u8
    }

    fn top(&mut self, above: u8, [x, y]: [u32; 2]) -> Result<Top, HeightError> {
        let level = &self.window.tops[usize::from(above)];
        let at = y as usize * level.columns + x as usize;
        let inside = (x as usize) < level.columns;
        let highest = level.highest.get(at).copied().filter(|_| inside);
        Ok(Top {
            highest: match highest {
                None | Some(i32::MIN) => f64::NEG_INFINITY,
                Some(highest) => f64::from(highest),
            },
            whole: level.whole.get(at).copied().unwrap_or(false),
        })
    }

    fn cell(&mut self, [x, y]: [u32; 2]) -> Result<Cell, HeightError> {
        Ok(self.window.cell_at(x as usize, y as usize))
    }

    fn step(&mut self) -> Result<(), HeightError> {
        self.pages.work.step()
    }
}
