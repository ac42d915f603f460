//! A generation of a dataset, ready to be pushed from: its pages, and what of them selections
//! need.

use crate::sketches::{DEFAULT_SKETCH_BYTES, Sketches};
use crate::source::PageSource;
use escarp_proto::select::{Look, Need, Selection};
use std::sync::{Arc, Mutex, PoisonError};

/// Room for selections that waits for the next ones: for as many as are likely to go on at a time.
const MOST_IDLE: usize = 8;
/// Needs of one view. Views of large datasets at 1 px have some ten thousand.
const MOST_NEEDS: usize = 1 << 15;

/// One generation of a dataset.
pub struct Published {
    source: Arc<dyn PageSource>,
    sketches: Sketches,
    idle: Mutex<Vec<Room>>,
}

/// What a selection takes, kept for the next.
#[derive(Default)]
struct Room {
    selection: Selection,
    needs: Vec<Need>,
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

    /// Gives what a view needs, coarse pages first, to `take`, and with it, whether that is all.
    /// Reads records, so it may block on the disk.
    pub fn select<T>(&self, look: Look<'_>, take: impl FnOnce(&[Need], bool) -> T) -> T {
        let idle = || self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        let room = idle().pop();
        let mut room = room.unwrap_or_default();
        let manifest = self.source.manifest();
        let space = (manifest.grid_levels, &manifest.georef);
        let Room { selection, needs } = &mut room;
        let known = &mut &self.sketches;
        let outcome = selection.select_for(space, look, known, MOST_NEEDS, needs);
        let taken = take(needs, !outcome.truncated);
        let mut idle = idle();
        if idle.len() < MOST_IDLE {
            idle.push(room);
        }
        taken
    }
}
