//! A coarse source between its samples, as a dataset shows it: on two triangles a cell.
//!
//! The diagonals are those of `tiles/FORMAT.md`: where the samples are corners of a dataset's
//! pages, the heights between are what the format implies there, rounding apart.

use crate::dem::{DemError, DemInfo, DemSource, OverlapReport, Placement};
use escarp_proto::manifest::Resampling;

/// A source with so many cells for each of its own.
pub struct Facets {
    source: Box<dyn DemSource>,
    info: DemInfo,
    cells: u32,
    /// The diagonal of the south-western cell runs from south-west to north-east.
    rises: bool,
    /// The two source rows last read, and the number of the northern one.
    rows: Option<(u32, [Vec<f64>; 2])>,
}

impl Facets {
    /// `cells` for each cell of the source, on both sides; `rises` says that the diagonal of its
    /// south-western cell runs from south-west to north-east.
    pub fn new(source: Box<dyn DemSource>, cells: u32, rises: bool) -> Facets {
        let from = source.info();
        let Placement { x0, y0, dx, dy } = from.placement;
        let side = |samples: u32| (samples - 1) * cells + 1;
        let info = DemInfo {
            width: side(from.width),
            height: side(from.height),
            placement: Placement {
                x0,
                y0,
                dx: dx / f64::from(cells),
                dy: dy / f64::from(cells),
            },
            ..from.clone()
        };
        Facets {
            source,
            info,
            cells,
            rises,
            rows: None,
        }
    }

    /// Has the two source rows around a row.
    fn load(&mut self, north: u32) -> Result<(), DemError> {
        let have = match self.rows.take() {
            Some((number, rows)) if number == north => {
                self.rows = Some((number, rows));
                return Ok(());
            }
            Some((number, [_, south])) if number + 1 == north => Some(south),
            _ => None,
        };
        let (width, height) = (self.source.info().width, self.source.info().height);
        let mut read = |row: u32| -> Result<Vec<f64>, DemError> {
            let mut heights = vec![f64::NAN; width as usize];
            self.source
                .read_rows(row.min(height - 1), 1, &mut heights)?;
            Ok(heights)
        };
        let first = match have {
            Some(heights) => heights,
            None => read(north)?,
        };
        self.rows = Some((north, [first, read(north + 1)?]));
        Ok(())
    }
}

impl DemSource for Facets {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        let (cells, width) = (self.cells, self.info.width as usize);
        let source_rows = self.source.info().height;
        for (row, out) in (first_row..).zip(out.chunks_exact_mut(width)) {
            let north = row / cells;
            self.load(north)?;
            let Some((_, [above, below])) = &self.rows else {
                continue;
            };
            // Of the cells below this source row, counted from the south.
            let from_south = (source_rows - 1 - north).saturating_sub(1);
            let fy = 1.0 - f64::from(row % cells) / f64::from(cells);
            for (x, out) in out.iter_mut().enumerate() {
                let (column, part) = (x / cells as usize, x % cells as usize);
                let east = (column + 1).min(above.len() - 1);
                let rises = (column as u32 + from_south).is_multiple_of(2) == self.rises;
                let corners = [below[column], below[east], above[column], above[east]];
                *out = on_triangle(corners, rises, [part as f64 / f64::from(cells), fy]);
            }
        }
        Ok(())
    }

    fn overlaps(&self) -> Option<OverlapReport> {
        self.source.overlaps()
    }

    fn finish(&mut self) -> Result<(), DemError> {
        self.source.finish()
    }

    fn resampling(&self) -> Option<Resampling> {
        self.source.resampling()
    }
}

/// The height at a place in a cell, `[0, 0]` the south-west; NaN where a corner that counts is a
/// hole.
fn on_triangle([sw, se, nw, ne]: [f64; 4], rises: bool, [fx, fy]: [f64; 2]) -> f64 {
    // On a sample or a side only its ends count.
    let along = |a: f64, b: f64, f: f64| match f {
        0.0 => a,
        1.0 => b,
        f => a + (b - a) * f,
    };
    match (fx, fy) {
        (_, 0.0) => along(sw, se, fx),
        (_, 1.0) => along(nw, ne, fx),
        (0.0, _) => along(sw, nw, fy),
        _ if rises && fx == fy => along(sw, ne, fx),
        _ if !rises && fx + fy == 1.0 => along(nw, se, fx),
        _ if rises && fx > fy => sw + (se - sw) * fx + (ne - se) * fy,
        _ if rises => sw + (ne - nw) * fx + (nw - sw) * fy,
        _ if fx + fy < 1.0 => sw + (se - sw) * fx + (nw - sw) * fy,
        _ => ne + (nw - ne) * (1.0 - fx) + (se - ne) * (1.0 - fy),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_follow_from_their_ends_and_a_hole_takes_only_its_triangles() {
        let hole = [1.0, f64::NAN, 5.0, 9.0];
        assert_eq!(on_triangle(hole, true, [0.0, 0.5]), 3.0);
        assert_eq!(on_triangle(hole, true, [0.5, 0.5]), 5.0);
        assert_eq!(on_triangle(hole, true, [0.25, 0.5]), 4.0);
        assert!(on_triangle(hole, true, [0.5, 0.25]).is_nan());
        assert!(on_triangle(hole, false, [0.25, 0.25]).is_nan());
        assert_eq!(on_triangle([0.0, 4.0, 8.0, 4.0], false, [0.25, 0.25]), 3.0);
        assert_eq!(
            on_triangle([0.0, 4.0, 8.0, 4.0], false, [0.75, 0.5]),
            5.0 - 0.0
        );
    }
}
