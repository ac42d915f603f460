//! Which blocks of a band are cut, and the heights that follow.

use super::super::quantise::HOLE;
use escarp_proto::geometry::{
    GridLevels, PAGE_CELLS, PAGE_LEVELS, PAGE_SAMPLES, PAGE_SLOTS, PageId, Slot,
};
use escarp_proto::page::{PAGE_AREA, implied_heights};
use rayon::prelude::*;

/// Cells on the side of a small block: a finest page.
pub(super) const SMALL: u32 = PAGE_CELLS as u32;
/// Cells on the side of a large block, and rows of cells of a band: a family of finest pages.
pub(super) const BAND: u32 = SMALL * SMALL;

/// A page whose samples are what its corners imply.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cut {
    page: PageId,
    corners: [i32; 4],
}

/// Rows of a band as the source has them, in quanta, both borders included.
pub(super) struct Given {
    first_row: u32,
    width: u32,
    units: Vec<i32>,
    /// How far each may be moved, in quanta.
    allowed: Vec<u16>,
    regions: Vec<u8>,
}

impl Given {
    /// Rows of holes.
    pub(super) fn new(first_row: u32, rows: u32, width: u32) -> Given {
        let samples = rows as usize * width as usize;
        Given {
            first_row,
            width,
            units: vec![HOLE; samples],
            allowed: vec![0; samples],
            regions: vec![0; samples],
        }
    }

    pub(super) fn set(&mut self, x: u32, y: u32, units: i32, allowed: f64, region: u8) {
        let at = (y - self.first_row) as usize * self.width as usize + x as usize;
        self.units[at] = units;
        self.allowed[at] = allowed.clamp(0.0, f64::from(u16::MAX)) as u16;
        self.regions[at] = region;
    }

    fn index(&self, x: u32, y: u32) -> Option<usize> {
        let rows = (self.units.len() / self.width as usize) as u32;
        let row = y.checked_sub(self.first_row).filter(|row| *row < rows)?;
        (x < self.width).then(|| row as usize * self.width as usize + x as usize)
    }

    /// The height of a sample; `None` in a hole, and beyond the band.
    fn sample(&self, x: u32, y: u32) -> Option<i32> {
        self.index(x, y)
            .map(|at| self.units[at])
            .filter(|&h| h != HOLE)
    }

    /// Whether a sample may have a height instead of its own.
    fn allows(&self, x: u32, y: u32, units: i32) -> bool {
        self.index(x, y).is_some_and(|at| {
            self.units[at] != HOLE && units.abs_diff(self.units[at]) <= u32::from(self.allowed[at])
        })
    }

    /// The heights from some row on, as given.
    pub(super) fn field(&self, from_row: u32) -> Field {
        let start = (from_row as usize * self.width as usize).min(self.units.len());
        Field {
            first_row: self.first_row + from_row,
            width: self.width,
            units: self.units[start..].to_vec(),
        }
    }
}

/// Rows of heights in the making.
#[derive(Debug, Clone)]
pub(super) struct Field {
    first_row: u32,
    width: u32,
    units: Vec<i32>,
}

impl Field {
    /// A grid row.
    pub(super) fn row(&self, y: u32) -> &[i32] {
        let start = (y - self.first_row) as usize * self.width as usize;
        &self.units[start..start + self.width as usize]
    }

    fn rows(&self) -> u32 {
        (self.units.len() / self.width as usize) as u32
    }

    fn corner(&self, x: u32, y: u32) -> Option<i32> {
        let row = y
            .checked_sub(self.first_row)
            .filter(|row| *row < self.rows())?;
        let at = row as usize * self.width as usize + x as usize;
        (x < self.width)
            .then(|| self.units[at])
            .filter(|&h| h != HOLE)
    }

    /// Gives all samples of cut blocks, borders included, the heights that their corners imply, as
    /// far as they lie in these rows.
    pub(super) fn apply(&mut self, cuts: &[Cut], grid: GridLevels) {
        let rows = self.first_row..self.first_row + self.rows();
        for cut in cuts {
            each_sample(*cut, grid, &rows, &mut |x, y, units| {
                let at = (y - self.first_row) as usize * self.width as usize + x as usize;
                self.units[at] = units;
                true
            });
        }
    }

    /// Raises the farthest that a height of each region was moved.
    pub(super) fn note_moves(&self, given: &Given, largest: &mut [(f64, u32)]) {
        let given = given.units.iter().zip(&given.regions);
        for (units, (given, &region)) in self.units.iter().zip(given) {
            let (_, moved) = &mut largest[usize::from(region)];
            *moved = (*moved).max(units.abs_diff(*given));
        }
    }
}

/// Calls `each` for the samples of a cut block that lie in some rows, until it says `false`.
/// Whether it never did.
fn each_sample(
    cut: Cut,
    grid: GridLevels,
    rows: &std::ops::Range<u32>,
    each: &mut dyn FnMut(u32, u32, i32) -> bool,
) -> bool {
    let heights = implied_heights(cut.page, cut.corners);
    let cells = grid.page_stride(cut.page);
    let square = cut.page.square();
    let side = cells * PAGE_CELLS as u32;
    let (west, south) = (square.x * side, square.y * side);
    if grid.is_finest(cut.page) {
        return heights.iter().enumerate().all(|(at, &units)| {
            let y = south + (at / PAGE_SAMPLES) as u32;
            !rows.contains(&y) || each(west + (at % PAGE_SAMPLES) as u32, y, units)
        });
    }
    (0..PAGE_SLOTS).all(|i| {
        let slot = Slot::from_index(i as u8);
        let (column, row) = slot.position();
        let from = south + row as u32 * cells;
        if from >= rows.end || from + cells < rows.start {
            return true;
        }
        let Some(page) = cut.page.child(slot) else {
            return true;
        };
        let south_west = row * PAGE_SAMPLES + column;
        let beside = [0, 1, PAGE_SAMPLES, PAGE_SAMPLES + 1];
        let corners = beside.map(|corner| heights[south_west + corner]);
        each_sample(Cut { page, corners }, grid, rows, each)
    })
}

/// The block of a page, if each of its samples may have the height that its corners imply.
fn cut(
    given: &Given,
    grid: GridLevels,
    page: PageId,
    corner: impl Fn(u32, u32) -> Option<i32>,
) -> Option<Cut> {
    let side = grid.page_stride(page) * PAGE_CELLS as u32;
    let (x, y) = (page.square().x * side, page.square().y * side);
    let corners = [
        corner(x, y)?,
        corner(x + side, y)?,
        corner(x, y + side)?,
        corner(x + side, y + side)?,
    ];
    // Its middle first: it tells most blocks that are not cut.
    let middle = implied_heights(page, corners)[PAGE_AREA / 2];
    if !given.allows(x + side / 2, y + side / 2, middle) {
        return None;
    }
    let cut = Cut { page, corners };
    let allows = &mut |x, y, units| given.allows(x, y, units);
    each_sample(cut, grid, &(y..y + side + 1), allows).then_some(cut)
}

/// The blocks of 256 cells of a band that are cut.
pub(super) fn large_cuts(given: &Given, grid: GridLevels, band: u32) -> Vec<Cut> {
    let Some(level) = grid.finest_page_level().checked_sub(PAGE_LEVELS) else {
        return Vec::new();
    };
    let pages: Vec<PageId> = (0..given.width / BAND)
        .filter_map(|x| PageId::new(level, x, band))
        .collect();
    let sample = |x, y| given.sample(x, y);
    let cuts = pages
        .par_iter()
        .filter_map(|&page| cut(given, grid, page, sample));
    cuts.collect()
}

/// The blocks of 16 cells that are cut, in rows in which the large ones are.
pub(super) fn small_cuts(given: &Given, field: &Field, grid: GridLevels) -> Vec<Cut> {
    let level = grid.finest_page_level();
    let rows = field.first_row / SMALL..(field.first_row + field.rows() - 1) / SMALL;
    let columns = 0..(field.width - 1) / SMALL;
    let pages: Vec<PageId> = rows
        .flat_map(|y| columns.clone().map(move |x| (x, y)))
        .filter_map(|(x, y)| PageId::new(level, x, y))
        .collect();
    let corner = |x, y| field.corner(x, y);
    let cuts = pages
        .par_iter()
        .filter_map(|&page| cut(given, grid, page, corner));
    cuts.collect()
}
