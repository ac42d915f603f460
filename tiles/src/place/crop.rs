//! A window of a source, sample for sample.

use crate::dem::{DemError, DemInfo, DemSource, Grain, OverlapReport};
use std::ops::Range;

/// A source of which only a window is seen, and read.
pub(super) struct Cropped {
    source: Box<dyn DemSource>,
    info: DemInfo,
    column: u32,
    row: u32,
}

impl Cropped {
    /// The window that starts at a column and row; `info` is the window's.
    pub fn new(source: Box<dyn DemSource>, info: DemInfo, [column, row]: [u32; 2]) -> Cropped {
        Cropped {
            source,
            info,
            column,
            row,
        }
    }
}

impl DemSource for Cropped {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        self.read_window(first_row..first_row + rows, 0..self.info.width, out)
    }

    fn read_window(
        &mut self,
        rows: Range<u32>,
        columns: Range<u32>,
        out: &mut [f64],
    ) -> Result<(), DemError> {
        let rows = rows.start + self.row..rows.end + self.row;
        let columns = columns.start + self.column..columns.end + self.column;
        self.source.read_window(rows, columns, out)
    }

    fn block_shape(&self) -> [u32; 2] {
        self.source.block_shape()
    }

    fn data_columns(&self, first_row: u32, rows: u32) -> Vec<Range<u32>> {
        let shifted = |at: u32| at.saturating_sub(self.column).min(self.info.width);
        let columns = self.source.data_columns(first_row + self.row, rows);
        columns
            .into_iter()
            .map(|range| shifted(range.start)..shifted(range.end))
            .filter(|range| !range.is_empty())
            .collect()
    }

    fn overlaps(&self) -> Option<OverlapReport> {
        self.source.overlaps()
    }

    fn grains(&mut self, first_row: u32, rows: u32, out: &mut [Grain]) -> Result<(), DemError> {
        let across = self.source.info().width as usize;
        let mut band = vec![Grain::Finest; rows as usize * across];
        self.source.grains(first_row + self.row, rows, &mut band)?;
        let from = self.column as usize;
        let lines = band.chunks_exact(across);
        for (out, line) in out.chunks_exact_mut(self.info.width as usize).zip(lines) {
            out.copy_from_slice(&line[from..from + out.len()]);
        }
        Ok(())
    }

    fn is_nested(&self) -> bool {
        self.source.is_nested()
    }

    fn finish(&mut self) -> Result<(), DemError> {
        self.source.finish()
    }

    fn resampling(&self) -> Option<escarp_proto::manifest::Resampling> {
        self.source.resampling()
    }
}
