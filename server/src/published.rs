//! A generation of a dataset, ready to be pushed from: its pages, and what of them selections
//! need.

use crate::sketches::{DEFAULT_SKETCH_BYTES, Sketches};
use crate::source::PageSource;
use escarp_proto::select::{Need, Selection};
use escarp_proto::view::View;
use escarp_proto::wire::Scope;
use std::sync::{Arc, Mutex, PoisonError};

/// Scratch that waits for the next selections: as many as are likely to go on at a time.
const MOST_IDLE: usize = 8;

/// One generation of a dataset.
pub struct Published {
    source: Arc<dyn PageSource>,
    sketches: Sketches,
    idle: Mutex<Vec<Selection>>,
}

impl Published {
    /// Of these pages.
    pub fn new(source: Arc<dyn PageSource>) -> Published {
        Published {
            sketches: Sketches::new(source.clone(), DEFAULT_SKETCH_BYTES),
            source,
            idle: Mutex::default(),
        }
    }

    /// The pages.
    pub fn source(&self) -> &Arc<dyn PageSource> {
        &self.source
    }
}

impl Published {
    /// What a view needs, coarse pages first; whether that is all. Reads records, so it may block
    /// on the disk.
    pub fn select(&self, view: &View, scope: Scope, limit: usize, needs: &mut Vec<Need>) -> bool {
        let idle = self
            .idle
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .pop();
        let mut selection = idle.unwrap_or_default();
        let manifest = self.source.manifest();
        let space = (manifest.grid_levels, &manifest.georef);
        let outcome = selection.select(space, view, scope, &mut &self.sketches, limit, needs);
        let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        if idle.len() < MOST_IDLE {
            idle.push(selection);
        }
        !outcome.truncated
    }
}
