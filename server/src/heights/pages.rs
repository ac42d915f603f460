//! Decoded pages of a source, those without a record included.

use super::{HeightError, Work};
use crate::source::PageSource;
use escarp_proto::geometry::{GridLevels, PAGE_LEVELS, PageId};
use escarp_proto::manifest::Manifest;
use escarp_proto::page::{Page, last_part};
use std::sync::Arc;

/// Reads pages, and keeps the last one of each level, in which the next is likely to hang.
pub struct Pages<'a> {
    source: &'a dyn PageSource,
    last: Vec<Option<Arc<Page>>>,
    pub(super) work: Work<'a>,
}

impl<'a> Pages<'a> {
    /// A reader that has read nothing.
    pub fn new(source: &'a dyn PageSource, work: Work<'a>) -> Pages<'a> {
        let levels = usize::from(source.manifest().grid_levels.get() / PAGE_LEVELS);
        Pages {
            source,
            last: vec![None; levels],
            work,
        }
    }

    /// What the dataset is.
    pub fn manifest(&self) -> &'a Manifest {
        self.source.manifest()
    }

    pub(super) fn grid(&self) -> GridLevels {
        self.manifest().grid_levels
    }

    /// A page of the grid, from its record, or implied by its parent.
    ///
    /// # Errors
    /// [`HeightError::Page`] if it cannot be read, [`HeightError::TooMuch`] if no more may be.
    pub(super) fn page(&mut self, id: PageId) -> Result<Arc<Page>, HeightError> {
        let level = usize::from(id.level() / PAGE_LEVELS);
        let last = self.last.get(level).and_then(Option::as_ref);
        if let Some(page) = last.filter(|page| page.id() == id) {
            return Ok(page.clone());
        }
        self.work.page()?;
        let page = Arc::new(self.read(id)?);
        if let Some(last) = self.last.get_mut(level) {
            *last = Some(page.clone());
        }
        Ok(page)
    }

    fn read(&mut self, id: PageId) -> Result<Page, HeightError> {
        let grid = self.grid();
        if !grid.holds(id) {
            let why = "is not in the grid".into();
            return Err(HeightError::Page { page: id, why });
        }
        let finest = grid.is_finest(id);
        let found = self.source.record(id);
        if let Some(record) = found.map_err(|error| HeightError::damaged(id, &error))? {
            return Page::decode(id, finest, last_part(finest), &record.bytes).map_err(|error| {
                let why = error.to_string();
                HeightError::Page { page: id, why }
            });
        }
        let implied = match id.parent() {
            Some((parent, slot)) => self.page(parent)?.implied_child(slot, grid),
            None => Some(Page::empty(id, finest)),
        };
        implied.ok_or_else(|| {
            let why = "has no record, but the page above says that it has".into();
            HeightError::Page { page: id, why }
        })
    }
}
