//! A square of samples, triangles over it, and how far these are from it.

use escarp_tiles::dataset::{Dataset, DatasetError, PageReader};

/// Corners as column and row of a [`Window`], counter-clockwise.
pub type Triangle = [(u32, u32); 3];

/// `2^n + 1` samples a side, without holes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Window {
    /// Cells a side, a power of two.
    pub cells: u32,
    /// Heights in quanta, row by row from the south.
    pub heights: Vec<i32>,
}

/// How far triangles are from the samples, in quanta.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Deviation {
    /// Largest deviation.
    pub largest: f64,
    /// Root of the mean square.
    pub rms: f64,
}

impl Window {
    /// A window from a function of column and row.
    pub fn of(cells: u32, height: impl Fn(u32, u32) -> i32) -> Window {
        let places = (0..=cells).flat_map(|y| (0..=cells).map(move |x| (x, y)));
        Window {
            cells,
            heights: places.map(|(x, y)| height(x, y)).collect(),
        }
    }

    /// The middle of a dataset, of the largest power of two of cells a side up to a limit, with the
    /// share of its samples that are holes: there it has the height of the nearest sample to the
    /// west, or else of that to the south. `None` where the dataset is too small.
    ///
    /// # Errors
    /// Those of reading pages.
    pub fn middle_of(
        dataset: &Dataset,
        most_cells: u32,
    ) -> Result<Option<(Window, f64)>, DatasetError> {
        let [width, height] = dataset.manifest().samples;
        let Some(cells) = width.min(height).min(most_cells + 1).checked_sub(1) else {
            return Ok(None);
        };
        let Some(cells) = cells.checked_ilog2().map(|log| 1 << log) else {
            return Ok(None);
        };
        // Rows of pages have 16 of samples.
        let (column, row) = ((width - 1 - cells) / 2, (height - 1 - cells) / 2 / 16 * 16);
        let band = read_rows(dataset, row, cells + 1)?;
        let mut heights = Vec::new();
        let mut holes = 0;
        for y in 0..=cells {
            for x in 0..=cells {
                let sample = band[(y * width + column + x) as usize];
                holes += usize::from(sample.is_none());
                let side = cells as usize + 1;
                let beside = if x > 0 { 1 } else { side };
                let near = heights.len().checked_sub(beside).map_or(0, |i| heights[i]);
                heights.push(sample.unwrap_or(near));
            }
        }
        let share = holes as f64 / heights.len() as f64;
        Ok(Some((Window { cells, heights }, share)))
    }

    /// Height at a column and row, quanta.
    pub fn height(&self, (x, y): (u32, u32)) -> i64 {
        i64::from(self.heights[(y * (self.cells + 1) + x) as usize])
    }

    /// Compares triangles that cover the window with every sample.
    pub fn deviation(&self, triangles: &[Triangle]) -> Deviation {
        let mut largest_at = vec![0.0f64; self.heights.len()];
        for triangle in triangles {
            self.visit(triangle, |(x, y), off, whole| {
                let known = &mut largest_at[(y * (self.cells + 1) + x) as usize];
                *known = known.max(off as f64 / whole as f64);
            });
        }
        let squares: f64 = largest_at.iter().map(|off| off * off).sum();
        Deviation {
            largest: largest_at.iter().copied().fold(0.0, f64::max),
            rms: (squares / largest_at.len() as f64).sqrt(),
        }
    }

    /// Visits all samples in a triangle, border included: their deviation from its plane is the
    /// second over the third that the visitor gets. Exact for heights below `2^31`.
    pub fn visit(&self, triangle: &Triangle, mut each: impl FnMut((u32, u32), i64, i64)) {
        let heights = triangle.map(|corner| self.height(corner));
        let [a, b, c] = triangle.map(|(x, y)| (i64::from(x), i64::from(y)));
        // Twice the area on the left of `p -> q`, as `ax + by + c`.
        let edge = |p: (i64, i64), q: (i64, i64)| {
            let (dx, dy) = (q.0 - p.0, q.1 - p.1);
            (-dy, dx, dy * p.0 - dx * p.1)
        };
        let edges = [edge(b, c), edge(c, a), edge(a, b)];
        let at = |(fx, fy, f1): (i64, i64, i64), x: i64, y: i64| fx * x + fy * y + f1;
        let whole = at(edges[2], c.0, c.1);
        let slope: i64 = (0..3).map(|i| edges[i].0 * heights[i]).sum();
        let (west, east) = (a.0.min(b.0).min(c.0), a.0.max(b.0).max(c.0));
        for y in a.1.min(b.1).min(c.1)..=a.1.max(b.1).max(c.1) {
            let (mut first, mut last) = (west, east);
            for (fx, fy, f1) in edges {
                let rest = fy * y + f1;
                match fx {
                    0 if rest < 0 => last = first - 1,
                    0 => {}
                    // `fx x >= -rest`
                    1.. => first = first.max((-rest + fx - 1).div_euclid(fx)),
                    _ => last = last.min(rest.div_euclid(-fx)),
                }
            }
            let mut plane: i64 = (0..3).map(|i| at(edges[i], first, y) * heights[i]).sum();
            for x in first..=last {
                let place = (x as u32, y as u32);
                let off = (self.height(place) * whole - plane).abs();
                each(place, off, whole);
                plane += slope;
            }
        }
    }
}

/// So many rows of samples from a row on that is a multiple of 16.
fn read_rows(dataset: &Dataset, first: u32, rows: u32) -> Result<Vec<Option<i32>>, DatasetError> {
    let width = dataset.manifest().samples[0] as usize;
    let mut band = vec![None; width * rows as usize];
    let mut reader = PageReader::new(dataset);
    for page_row in first / 16..(first + rows).div_ceil(16) {
        let start = (page_row - first / 16) as usize * 16 * width;
        for (to, from) in band[start..].iter_mut().zip(reader.page_row(page_row)?) {
            *to = to.or(from);
        }
    }
    Ok(band)
}
