//! What selections need of a generation's pages, made once and shared by all sessions.

use crate::source::PageSource;
use escarp_proto::geometry::PageId;
use escarp_proto::page::{Page, last_part};
use escarp_proto::select::{Known, Sketch};
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Sketches of one generation.
pub struct Sketches {
    source: Arc<dyn PageSource>,
    most: usize,
    known: Mutex<HashMap<PageId, Arc<Sketch>>>,
}

impl Sketches {
    /// Keeps about so many bytes of them.
    pub fn new(source: Arc<dyn PageSource>, bytes: usize) -> Sketches {
        Sketches {
            source,
            most: bytes >> 10,
            known: Mutex::default(),
        }
    }

    fn make(&self, page: PageId) -> Option<Arc<Sketch>> {
        let manifest = self.source.manifest();
        let record = self.source.record(page).ok()??;
        let finest = manifest.grid_levels.is_finest(page);
        let page = Page::decode(page, finest, last_part(finest), &record.bytes).ok()?;
        let space = (manifest.grid_levels, &manifest.georef);
        Some(Arc::new(Sketch::of(&page, None, space.0, space.1)))
    }
}

impl Known for &Sketches {
    fn sketch(&mut self, page: PageId) -> Option<Arc<Sketch>> {
        let known = || self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(found) = known().get(&page) {
            return Some(found.clone());
        }
        let sketch = self.make(page)?;
        let mut known = known();
        if known.len() >= self.most {
            known.clear();
        }
        known.insert(page, sketch.clone());
        Some(sketch)
    }
}
