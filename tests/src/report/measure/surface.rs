//! The full-resolution surface that meshes are measured against.

use super::scan::Area;
use anyhow::Result;
use escarp_proto::geometry::{PAGE_CELLS, PAGE_SAMPLES, PageId};
use escarp_proto::page::Page;
use escarp_tiles::dataset::{Dataset, PageReader};
use rayon::prelude::*;
use std::sync::Arc;

/// Samples of a dataset that is held in memory as a whole, at 8 bytes each.
pub const MOST_WHOLE_SAMPLES: u64 = 20_000_000;

/// Heights by grid coordinates.
pub trait Heights: Sync {
    /// Height in quanta; `None` in holes, and where nothing is known.
    fn height(&self, x: u32, y: u32) -> Option<i32>;
}

/// All samples of a dataset.
#[derive(Debug)]
pub struct Samples {
    size: [u32; 2],
    heights: Vec<Option<i32>>,
}

impl Heights for Samples {
    fn height(&self, x: u32, y: u32) -> Option<i32> {
        let [width, height] = self.size;
        if x >= width || y >= height {
            return None;
        }
        self.heights[y as usize * width as usize + x as usize]
    }
}

impl Samples {
    /// Reads them all.
    fn read(dataset: &Dataset) -> Result<Samples> {
        let size @ [width, height] = dataset.manifest().samples;
        let row_bytes = PAGE_CELLS * width as usize;
        let mut heights = vec![None; width as usize * height as usize];
        heights
            .par_chunks_mut(row_bytes)
            .enumerate()
            .try_for_each_init(
                || PageReader::new(dataset),
                |reader, (row, out)| -> Result<()> {
                    // The last row of samples may lie in no page row of its own.
                    let pages = (height - 1).div_ceil(PAGE_CELLS as u32).max(1);
                    let page_row = (row as u32).min(pages - 1);
                    let skipped = (row as u32 - page_row) as usize * row_bytes;
                    let samples = reader.page_row(page_row)?;
                    out.copy_from_slice(&samples[skipped..skipped + out.len()]);
                    let first = &mut out[..width as usize];
                    if page_row > 0 && skipped == 0 && first.contains(&None) {
                        // Of a border between pages one may be empty, and have no record.
                        let below = reader.page_row(page_row - 1)?;
                        for (to, from) in first.iter_mut().zip(&below[row_bytes..]) {
                            *to = to.or(*from);
                        }
                    }
                    Ok(())
                },
            )?;
        Ok(Samples { size, heights })
    }

    /// Columns and rows.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Whether a sample is a corner of a finest triangle that is valid. Others are part of no
    /// surface.
    pub fn is_on_surface(&self, x: u32, y: u32) -> bool {
        let valid = |dx: i32, dy: i32| {
            let place = (x.checked_add_signed(dx), y.checked_add_signed(dy));
            matches!(place, (Some(x), Some(y)) if self.height(x, y).is_some())
        };
        [(1, 1), (-1, 1), (-1, -1), (1, -1)]
            .into_iter()
            .any(|(dx, dy)| match (x + y) % 2 {
                0 => valid(dx, dy) && (valid(dx, 0) || valid(0, dy)),
                _ => valid(dx, 0) && valid(0, dy),
            })
    }
}

/// The samples of one of the finest pages.
pub struct Tile {
    page: Arc<Page>,
    origin: (u32, u32),
}

impl Heights for Tile {
    fn height(&self, x: u32, y: u32) -> Option<i32> {
        let column = x.checked_sub(self.origin.0)? as usize;
        let row = y.checked_sub(self.origin.1)? as usize;
        let sample = row * PAGE_SAMPLES + column;
        let known = column < PAGE_SAMPLES && row < PAGE_SAMPLES && self.page.is_valid(sample);
        known.then(|| self.page.height(sample))
    }
}

impl Tile {
    /// Reads the finest page in a column and row of them; `None` beyond the grid.
    pub fn read(reader: &mut PageReader<'_>, level: u8, place: (u32, u32)) -> Result<Option<Tile>> {
        let Some(id) = PageId::new(level, place.0, place.1) else {
            return Ok(None);
        };
        let side = PAGE_CELLS as u32;
        Ok(Some(Tile {
            page: reader.page(id)?,
            origin: (place.0 * side, place.1 * side),
        }))
    }

    /// What it covers.
    pub fn area(&self) -> Area {
        let side = PAGE_CELLS as u32;
        let (x, y) = self.origin;
        Area {
            x: [x, x + side],
            y: [y, y + side],
        }
    }
}

/// The surface, in memory if it is small enough.
#[derive(Debug)]
pub struct FullSurface<'a> {
    /// Where it is from.
    pub dataset: &'a Dataset,
    /// All of it, or nothing: it is then read page by page.
    pub whole: Option<Samples>,
}

impl<'a> FullSurface<'a> {
    /// Opens the surface of a dataset; in memory unless it has more samples than this.
    ///
    /// # Errors
    /// If the dataset is damaged.
    pub fn open(dataset: &'a Dataset, most_samples: u64) -> Result<FullSurface<'a>> {
        let [width, height] = dataset.manifest().samples;
        let fits = u64::from(width) * u64::from(height) <= most_samples;
        let whole = fits.then(|| Samples::read(dataset)).transpose()?;
        Ok(FullSurface { dataset, whole })
    }
}

/// Height of the finest triangulation between samples, quanta; `None` in holes.
///
/// The diagonal of a cell joins those of its corners whose coordinates add up to an even number.
pub fn surface_height(heights: &impl Heights, x: f64, y: f64) -> Option<f64> {
    let (column, row) = (x.floor(), y.floor());
    let (u, v) = (x - column, y - row);
    let (i, j) = (column as u32, row as u32);
    let at = |dx: u32, dy: u32, weight: f64| {
        // A corner without weight may be beyond the data.
        match weight > 0.0 {
            true => heights
                .height(i + dx, j + dy)
                .map(|h| f64::from(h) * weight),
            false => Some(0.0),
        }
    };
    let (a, b, c) = match ((i + j).is_multiple_of(2), u > v, u + v > 1.0) {
        (true, true, _) => (at(0, 0, 1.0 - u), at(1, 0, u - v), at(1, 1, v)),
        (true, false, _) => (at(0, 0, 1.0 - v), at(0, 1, v - u), at(1, 1, u)),
        (false, _, false) => (at(0, 0, 1.0 - u - v), at(1, 0, u), at(0, 1, v)),
        (false, _, true) => (at(1, 1, u + v - 1.0), at(0, 1, 1.0 - u), at(1, 0, 1.0 - v)),
    };
    Some(a? + b? + c?)
}
