//! Reading whole pages and rows of samples, pages without a record included.

use super::{Dataset, DatasetError};
use escarp_proto::geometry::{PAGE_CELLS, PAGE_LEVELS, PAGE_SAMPLES, PageId};
use escarp_proto::page::{Page, last_part};
use std::sync::Arc;

/// Reads decoded pages, and keeps the last one of each level, in which the next is likely to hang.
#[derive(Debug, Clone)]
pub struct PageReader<'a> {
    dataset: &'a Dataset,
    last: Vec<Option<Arc<Page>>>,
}

impl<'a> PageReader<'a> {
    /// A reader that has read nothing.
    pub fn new(dataset: &'a Dataset) -> Self {
        let levels = usize::from(dataset.grid().get() / PAGE_LEVELS);
        PageReader {
            dataset,
            last: vec![None; levels],
        }
    }

    /// A page of the grid, from its record, or implied by its parent.
    ///
    /// # Errors
    /// [`DatasetError::Damaged`] if a record is missing or does not decode.
    pub fn page(&mut self, id: PageId) -> Result<Arc<Page>, DatasetError> {
        if !self.dataset.grid().holds(id) {
            let why = format!("page {id} is asked for, which its grid has not");
            return Err(DatasetError::damaged(self.dataset.folder(), why));
        }
        let level = usize::from(id.level() / PAGE_LEVELS);
        if let Some(page) = self.last[level].as_ref().filter(|page| page.id() == id) {
            return Ok(page.clone());
        }
        let page = Arc::new(self.read(id)?);
        self.last[level] = Some(page.clone());
        Ok(page)
    }

    fn read(&mut self, id: PageId) -> Result<Page, DatasetError> {
        let finest = self.dataset.grid().is_finest(id);
        if let Some(record) = self.dataset.record(id)? {
            return Page::decode(id, finest, last_part(finest), record.bytes)
                .map_err(|error| DatasetError::damaged(self.dataset.folder(), error.to_string()));
        }
        let implied = match id.parent() {
            Some((parent, slot)) => self.page(parent)?.implied_child(slot, self.dataset.grid()),
            None => None,
        };
        implied.ok_or_else(|| {
            let why = format!("page {id} has no record, but its parent says that it has");
            DatasetError::damaged(self.dataset.folder(), why)
        })
    }

    /// Samples of 17 grid rows, the page row `row` of the finest pages, over the data's width;
    /// `None` is a hole. Rows and columns beyond the data are holes.
    ///
    /// # Errors
    /// As [`page`](Self::page).
    pub fn page_row(&mut self, row: u32) -> Result<Vec<Option<i32>>, DatasetError> {
        let width = self.dataset.manifest().samples[0] as usize;
        let level = self.dataset.grid().finest_page_level();
        let mut samples = vec![None; PAGE_SAMPLES * width];
        for column in 0..width.saturating_sub(1).div_ceil(PAGE_CELLS).max(1) {
            let Some(id) = PageId::new(level, column as u32, row) else {
                break;
            };
            let page = self.page(id)?;
            for i in 0..PAGE_SAMPLES * PAGE_SAMPLES {
                let x = column * PAGE_CELLS + i % PAGE_SAMPLES;
                if x < width && page.is_valid(i) {
                    samples[i / PAGE_SAMPLES * width + x] = Some(page.height(i));
                }
            }
        }
        Ok(samples)
    }
}
