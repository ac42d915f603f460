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

    /// The largest window of at most so many cells without a hole, nearest to the middle of a
    /// dataset, by steps of 16 rows; with the column and row of its south-west corner.
    ///
    /// # Errors
    /// Those of reading pages.
    pub fn middle_of(
        dataset: &Dataset,
        most_cells: u32,
    ) -> Result<Option<(Window, [u32; 2])>, DatasetError> {
        let [width, height] = dataset.manifest().samples;
        let mut cells = most_cells;
        while cells >= 16 {
            if let (Some(last_x), Some(last_y)) =
                (width.checked_sub(cells + 1), height.checked_sub(cells + 1))
            {
                let middle = last_y / 2;
                let mut rows: Vec<u32> = (0..=last_y).step_by(16).collect();
                rows.sort_by_key(|row| row.abs_diff(middle));
                for row in rows {
                    let band = read_rows(dataset, row, cells + 1)?;
                    if let Some(column) = clear_column(&band, width, cells, last_x / 2) {
                        let at = |x, y| (y * width + column + x) as usize;
                        let window = Window::of(cells, |x, y| band[at(x, y)].unwrap_or(0));
                        return Ok(Some((window, [column, row])));
                    }
                }
            }
            cells /= 2;
        }
        Ok(None)
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

/// The column nearest to `middle` from which on a band has no hole.
fn clear_column(band: &[Option<i32>], width: u32, cells: u32, middle: u32) -> Option<u32> {
    let width = width as usize;
    let holes = |x: usize| band.iter().skip(x).step_by(width).any(Option::is_none);
    // How many columns up to each one have a hole.
    let mut holed = vec![0u32];
    for x in 0..width {
        holed.push(holed[x] + u32::from(holes(x)));
    }
    let side = cells as usize + 1;
    let clear = |&x: &usize| holed[x + side] == holed[x];
    let columns = (0..=width - side).filter(clear);
    let nearest = columns.min_by_key(|&x| (x as u32).abs_diff(middle))?;
    Some(nearest as u32)
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
