//! The finest level of a dataset, read as any other source.

use crate::crs::extent;
use crate::dataset::{Dataset, DatasetError, PageReader};
use crate::dem::{DemError, DemInfo, DemSource, Registration, SampleType};
use escarp_proto::geometry::{PAGE_CELLS, PAGE_SAMPLES, PageId};
use escarp_proto::manifest::Manifest;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// Pages that one task reads: those of one parent's row, so that parents are decoded once.
const PAGES_A_TASK: usize = 16;

/// A dataset's full-resolution heights.
#[derive(Clone)]
pub struct DatasetSource {
    dataset: Arc<Dataset>,
    info: DemInfo,
}

/// Samples of a page that lie in a window: where in it, and their heights.
type Found = Vec<(usize, f64)>;

impl DatasetSource {
    /// Reads a dataset's manifest; pages are read when rows are asked for.
    pub fn new(dataset: Dataset) -> DatasetSource {
        let manifest = dataset.manifest();
        let [width, height] = manifest.samples;
        let info = DemInfo {
            path: dataset.folder().to_path_buf(),
            format: "Escarp",
            width,
            height,
            placement: extent::placement_of(manifest),
            crs: extent::crs_of(&manifest.georef.plane),
            registration: Registration::Grid,
            sample_type: SampleType::I32,
            height_step_m: manifest.georef.quantum_m,
            nodata: None,
            vertical: manifest.vertical.clone(),
        };
        DatasetSource {
            dataset: Arc::new(dataset),
            info,
        }
    }

    /// What the dataset says of itself.
    pub fn manifest(&self) -> &Manifest {
        self.dataset.manifest()
    }

    /// Heights of some pages side by side, as far as they lie in a window.
    fn pages(
        &self,
        page_row: u32,
        page_columns: &[u32],
        window: &Window,
    ) -> Result<Found, DatasetError> {
        let mut reader = PageReader::new(&self.dataset);
        let level = self.dataset.grid().finest_page_level();
        let quantum_m = self.info.height_step_m;
        let mut found = Vec::new();
        for column in page_columns {
            let Some(id) = PageId::new(level, *column, page_row) else {
                continue;
            };
            let page = reader.page(id)?;
            for i in 0..PAGE_SAMPLES * PAGE_SAMPLES {
                let x = *column as usize * PAGE_CELLS + i % PAGE_SAMPLES;
                let y = page_row as usize * PAGE_CELLS + i / PAGE_SAMPLES;
                if let Some(at) = window.index(x, y).filter(|_| page.is_valid(i)) {
                    found.push((at, f64::from(page.height(i)) * quantum_m));
                }
            }
        }
        Ok(found)
    }
}

/// Columns, and grid rows counted from the south.
struct Window {
    columns: Range<u32>,
    rows: Range<u32>,
}

impl Window {
    /// Where a sample goes, the northern row first.
    fn index(&self, x: usize, y: usize) -> Option<usize> {
        let (x, y) = (u32::try_from(x).ok()?, u32::try_from(y).ok()?);
        if !self.columns.contains(&x) || !self.rows.contains(&y) {
            return None;
        }
        let row = (self.rows.end - 1 - y) as usize;
        Some(row * self.columns.len() + (x - self.columns.start) as usize)
    }
}

/// Pages that have samples of a range: a border belongs to both.
fn pages_of(samples: &Range<u32>) -> Range<u32> {
    let cells = PAGE_CELLS as u32;
    samples.start.saturating_sub(1) / cells..(samples.end - 1) / cells + 1
}

impl DemSource for DatasetSource {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        if rows == 0 {
            return Ok(());
        }
        self.read_window(first_row..first_row + rows, 0..self.info.width, out)
    }

    fn read_window(
        &mut self,
        rows: Range<u32>,
        columns: Range<u32>,
        out: &mut [f64],
    ) -> Result<(), DemError> {
        self.info.check_window(&rows, &columns, out)?;
        out.fill(f64::NAN);
        let window = Window {
            rows: self.info.height - rows.end..self.info.height - rows.start,
            columns,
        };
        let page_columns: Vec<u32> = pages_of(&window.columns).collect();
        for page_row in pages_of(&window.rows) {
            let found: Result<Vec<Found>, DatasetError> = page_columns
                .par_chunks(PAGES_A_TASK)
                .map(|columns| self.pages(page_row, columns, &window))
                .collect();
            let found = found.map_err(|error| {
                let found = error.to_string();
                DemError::damaged(&self.info.path, "a page", found, "a sound dataset")
            })?;
            for (at, height) in found.into_iter().flatten() {
                out[at] = height;
            }
        }
        Ok(())
    }

    fn block_shape(&self) -> [u32; 2] {
        let family = (PAGE_CELLS * PAGE_CELLS) as u32;
        [family, family]
    }
}
