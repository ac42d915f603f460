//! A region given as a raster on the source's lattice: inside where it is neither 0 nor nodata.

use super::tolerance::Marks;
use crate::dem::{DemError, DemInfo, DemSource, OpenOptions, open};
use std::path::Path;

/// How far, in cells, samples may be off the source's lattice.
const MAX_OFF_LATTICE: f64 = 0.01;

pub(super) struct Mask {
    source: Box<dyn DemSource>,
    /// Columns and rows of the source before the mask's first; may be below zero.
    offset: [i64; 2],
    width: u32,
}

impl Mask {
    pub(super) fn open(path: &Path, info: &DemInfo) -> Result<Mask, DemError> {
        let options = OpenOptions {
            spacing_m: Some(info.placement.dx),
            ..OpenOptions::default()
        };
        let source = open(path, &options)?;
        let offset = offset(source.info(), info)?;
        Ok(Mask {
            source,
            offset,
            width: info.width,
        })
    }

    /// Marks samples that the region's cells touch, and those that only such cells touch.
    pub(super) fn mark(
        &mut self,
        first_row: u32,
        rows: u32,
        marks: Marks<'_>,
    ) -> Result<(), DemError> {
        let [column, row] = self.offset;
        let (mask_width, mask_height) = (self.source.info().width, self.source.info().height);
        // One more row on either side, in the mask's rows.
        let first = i64::from(first_row) - row - 1;
        let end = first + i64::from(rows) + 2;
        let top = first.clamp(0, mask_height.into());
        let bottom = end.clamp(top, mask_height.into());
        let mut values = vec![0.0; (bottom - top) as usize * mask_width as usize];
        if bottom > top {
            let (top, n) = (top as u32, (bottom - top) as u32);
            self.source.read_rows(top, n, &mut values)?;
        }
        let inside = |x: i64, y: i64| {
            let (u, v) = (x - column, y - row);
            let there = (0..i64::from(mask_width)).contains(&u) && (top..bottom).contains(&v);
            there && {
                let value = values[(v - top) as usize * mask_width as usize + u as usize];
                value != 0.0 && !value.is_nan()
            }
        };
        for at in 0..marks.touched.len() {
            let x = (at % self.width as usize) as i64;
            let y = i64::from(first_row) + (at / self.width as usize) as i64;
            let mut around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (x + dx, y + dy)));
            marks.touched[at] = around.clone().any(|(x, y)| inside(x, y));
            marks.core[at] = marks.touched[at] && around.all(|(x, y)| inside(x, y));
        }
        Ok(())
    }
}

fn offset(mask: &DemInfo, info: &DemInfo) -> Result<[i64; 2], DemError> {
    let (a, b) = (&info.placement, &mask.placement);
    let (east, south) = ((b.x0 - a.x0) / a.dx, (a.y0 - b.y0) / a.dy);
    let off = |cells: f64| (cells - cells.round()).abs() > MAX_OFF_LATTICE;
    let side = f64::from(mask.width.max(mask.height));
    let stretched = |a: f64, b: f64| ((a - b) / a).abs() * side > MAX_OFF_LATTICE;
    let fits = mask.crs == info.crs
        && !stretched(a.dx, b.dx)
        && !stretched(a.dy, b.dy)
        && !off(east)
        && !off(south);
    let meets = east < f64::from(info.width)
        && south < f64::from(info.height)
        && east + f64::from(mask.width) > 0.0
        && south + f64::from(mask.height) > 0.0;
    if fits && meets {
        return Ok([east.round() as i64, south.round() as i64]);
    }
    let what = if fits {
        "the mask does not meet the data".to_owned()
    } else {
        format!(
            "the mask's samples do not lie on those of the data ({})",
            info.crs
        )
    };
    let (west, north) = (a.x0 - a.dx / 2.0, a.y0 + a.dy / 2.0);
    let east = west + f64::from(info.width) * a.dx;
    let south = north - f64::from(info.height) * a.dy;
    let hint = format!(
        "bring it there: gdalwarp -te {west} {south} {east} {north} -ts {} {} -r near '{}' mask.tif",
        info.width,
        info.height,
        mask.path.display()
    );
    Err(DemError::usage(&mask.path, what, hint))
}
