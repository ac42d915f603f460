//! A generation of a dataset, ready to be pushed from: its pages, and what of them selections
//! need.

use crate::sketches::{DEFAULT_SKETCH_BYTES, Sketches};
use crate::source::PageSource;
use escarp_proto::select::{Look, Need, Selection};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Room for selections that waits for the next ones: for as many as are likely to go on at a time.
const MOST_IDLE: usize = 8;
/// Needs of one view. Views of large datasets at 1 px have some ten thousand.
const MOST_NEEDS: usize = 1 << 15;

/// How many there were in this process.
static COUNT: AtomicU64 = AtomicU64::new(0);

/// One generation of a dataset.
pub struct Published {
    source: Arc<dyn PageSource>,
    number: u64,
    id: String,
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
            number: COUNT.fetch_add(1, Ordering::Relaxed),
            id: source.generation_id().to_string(),
            sketches: Sketches::new(source.clone(), DEFAULT_SKETCH_BYTES),
            source,
            idle: Mutex::default(),
        }
    }

    /// The pages.
    pub fn source(&self) -> &Arc<dyn PageSource> {
        &self.source
    }

    /// No other one in this process has this number.
    pub fn number(&self) -> u64 {
        self.number
    }

    /// The generation's id as it stands in addresses.
    pub fn id(&self) -> &str {
        &self.id
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
