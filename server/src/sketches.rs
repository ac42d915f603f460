//! Sketches of a dataset's pages, for the selections of all sessions.
//!
//! A sketch is made from a page's record and from what the page above says of it, and kept while
//! there is room. What is kept is split among [`SHARDS`] locks, none of which is held while a
//! record is read: sessions wait for each other only to look something up.
//!
//! Each shard has what was used of late, and what was before. When the new half is full, it
//! becomes the old one, and what was in that is dropped.

use crate::source::{PageSource, Revised};
use escarp_proto::geometry::{PAGE_SLOTS, PageId};
use escarp_proto::page::{Bounds, BoxError, ChildSlot, PAGE_AREA, Page, last_part};
use escarp_proto::select::{Known, Sketch};
use foldhash::fast::RandomState;
use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tracing::debug;

/// Memory for the sketches of one dataset if nobody says otherwise, bytes. A view of a large
/// dataset at 2 px takes about a thousand pages, of 1.7 KiB each.
pub const DEFAULT_SKETCH_BYTES: usize = 64 << 20;
/// Locks that the pages are split among.
const SHARDS: usize = 64;
/// Pages that are named in the log; of more, nothing is said.
const MOST_NAMED: u64 = 1000;
/// What an entry takes beside the sketch and the page, about.
const ENTRY_BYTES: usize = 2 * size_of::<(PageId, Entry)>();
/// What a page with slots takes.
const INTERIOR_BYTES: usize = size_of::<Interior>()
    + PAGE_AREA * size_of::<i32>()
    + PAGE_SLOTS * size_of::<ChildSlot>()
    + PAGE_AREA;

/// The sketches of one generation of a dataset.
pub struct Sketches {
    source: Arc<dyn PageSource>,
    shards: [Mutex<Shard>; SHARDS],
    /// Bytes that half a shard may take.
    half_bytes: usize,
    named: AtomicU64,
    read: AtomicU64,
}

#[derive(Default)]
struct Shard {
    new: HashMap<PageId, Entry, RandomState>,
    old: HashMap<PageId, Entry, RandomState>,
    new_bytes: usize,
    old_bytes: usize,
}

/// What is kept of a page: nothing if it is not there.
#[derive(Clone, Default)]
struct Entry {
    sketch: Option<Arc<Sketch>>,
    /// The page itself, if pages can hang below it.
    interior: Option<Arc<Interior>>,
}

/// A page, and what is known of it from the one above: what those below need.
struct Interior {
    page: Page,
    promise: Option<BoxError>,
}

impl Sketches {
    /// None yet, and never more than fit so many bytes.
    pub fn new(source: Arc<dyn PageSource>, most_bytes: usize) -> Sketches {
        Sketches {
            source,
            shards: std::array::from_fn(|_| Mutex::default()),
            half_bytes: most_bytes / SHARDS / 2,
            named: AtomicU64::new(0),
            read: AtomicU64::new(0),
        }
    }

    /// The dataset that they are of.
    pub fn source(&self) -> &Arc<dyn PageSource> {
        &self.source
    }

    /// The sketch of a page with a record, or of one that follows from the page above. `None` if
    /// there is no such page, or its record, or one above it, is damaged or cannot be read. Blocks
    /// on the disk unless it is kept.
    pub fn get(&self, page: PageId) -> Option<Arc<Sketch>> {
        let shard = &self.shards[shard_of(page)];
        let kept = lock(shard).new.get(&page).map(|entry| entry.sketch.clone());
        kept.unwrap_or_else(|| self.entry(page).sketch)
    }

    /// Memory that is taken, bytes.
    pub fn memory_bytes(&self) -> usize {
        let shards = self.shards.iter().map(lock);
        shards.map(|shard| shard.new_bytes + shard.old_bytes).sum()
    }

    /// Records that were read.
    pub fn records_read(&self) -> u64 {
        self.read.load(Ordering::Relaxed)
    }

    fn entry(&self, id: PageId) -> Entry {
        let shard = &self.shards[shard_of(id)];
        if let Some(entry) = lock(shard).find(id, self.half_bytes) {
            return entry;
        }
        // Another session may make the same meanwhile: that is work done twice, not an error.
        let entry = self.make(id).unwrap_or_default();
        lock(shard).put(id, entry.clone(), self.half_bytes);
        entry
    }

    fn make(&self, id: PageId) -> Option<Entry> {
        let manifest = self.source.manifest();
        let (grid, georef) = (manifest.grid_levels, &manifest.georef);
        if !grid.holds(id) {
            return None;
        }
        let above = match id.parent() {
            None => None,
            Some((above, slot)) => Some((self.entry(above).interior?, slot)),
        };
        let promise = above
            .as_ref()
            .map(|(above, slot)| Bounds::cell(&above.page, *slot, above.promise));
        let page = match self.stored(id) {
            Ok(Some(page)) => page,
            Ok(None) => above.and_then(|(above, slot)| above.page.implied_child(slot, grid))?,
            Err(why) => {
                self.name(id, &why);
                return None;
            }
        };
        let sketch = Arc::new(Sketch::of(&page, promise, grid, georef));
        let interior = page
            .has_slots()
            .then(|| Arc::new(Interior { page, promise }));
        Some(Entry {
            sketch: Some(sketch),
            interior,
        })
    }

    /// A page with a record.
    fn stored(&self, id: PageId) -> Result<Option<Page>, String> {
        self.read.fetch_add(1, Ordering::Relaxed);
        let record = self.source.record(id).map_err(|error| error.to_string())?;
        let Some(Revised { bytes, .. }) = record else {
            return Ok(None);
        };
        let finest = self.source.manifest().grid_levels.is_finest(id);
        let page = Page::decode(id, finest, last_part(finest), &bytes);
        page.map(Some).map_err(|error| error.to_string())
    }

    fn name(&self, id: PageId, why: &str) {
        if self.named.fetch_add(1, Ordering::Relaxed) < MOST_NAMED {
            debug!(page = %id, "nothing is selected below a page that is not there: {why}");
        }
    }
}

impl Known for &Sketches {
    fn sketch(&mut self, page: PageId) -> Option<Arc<Sketch>> {
        self.get(page)
    }
}

fn lock(shard: &Mutex<Shard>) -> MutexGuard<'_, Shard> {
    // A shard is whole between any two of its statements.
    shard.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Pages side by side are in different shards.
fn shard_of(id: PageId) -> usize {
    let mixed = id.key().wrapping_mul(0x9e37_79b9_7f4a_7c15);
    (mixed >> 32) as usize % SHARDS
}

impl Entry {
    fn bytes(&self) -> usize {
        let sketch = self
            .sketch
            .as_ref()
            .map_or(0, |sketch| sketch.memory_bytes());
        let interior = self.interior.as_ref().map_or(0, |_| INTERIOR_BYTES);
        ENTRY_BYTES + sketch + interior
    }
}

impl Shard {
    fn find(&mut self, id: PageId, half_bytes: usize) -> Option<Entry> {
        if let Some(entry) = self.new.get(&id) {
            return Some(entry.clone());
        }
        let entry = self.old.remove(&id)?;
        self.old_bytes -= entry.bytes();
        self.put(id, entry.clone(), half_bytes);
        Some(entry)
    }

    fn put(&mut self, id: PageId, entry: Entry, half_bytes: usize) {
        let bytes = entry.bytes();
        if self.new_bytes + bytes > half_bytes {
            self.old = std::mem::take(&mut self.new);
            self.old_bytes = std::mem::take(&mut self.new_bytes);
        }
        if bytes > half_bytes {
            return;
        }
        self.new_bytes += bytes;
        if let Some(before) = self.new.insert(id, entry) {
            self.new_bytes -= before.bytes();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::fake::{FakeSource, Kind};
    use escarp_proto::geometry::Slot;

    fn children() -> impl Iterator<Item = PageId> {
        let below = |slot| PageId::ROOT.child(Slot::from_index(slot)).unwrap();
        (0..=255).map(below)
    }

    #[test]
    fn what_is_kept_is_what_the_records_say_and_is_read_once() {
        let sketches = Sketches::new(FakeSource::shared(), DEFAULT_SKETCH_BYTES);
        let source = FakeSource::new();
        let manifest = source.manifest();
        let (grid, georef) = (manifest.grid_levels, &manifest.georef);
        let decode = |id| {
            let bytes = source.stored(id);
            Page::decode(
                id,
                grid.is_finest(id),
                last_part(grid.is_finest(id)),
                &bytes,
            )
            .unwrap()
        };
        let root = decode(PageId::ROOT);
        for _ in 0..2 {
            for id in children() {
                let (_, slot) = id.parent().unwrap();
                let promise = Bounds::cell(&root, slot, None);
                let found = sketches.get(id);
                match FakeSource::kind(id) {
                    Kind::Stored => {
                        let made = Sketch::of(&decode(id), Some(promise), grid, georef);
                        assert_eq!(found.as_deref(), Some(&made));
                    }
                    _ => assert_eq!(found, None),
                }
            }
            assert_eq!(sketches.records_read(), 257);
        }
        // Nothing is known below what is damaged, and the grid ends somewhere.
        let damaged = children()
            .find(|&id| FakeSource::kind(id) == Kind::Damaged)
            .unwrap();
        assert_eq!(sketches.get(damaged.child(Slot::at(1, 1)).unwrap()), None);
        assert_eq!(sketches.get(PageId::new(12, 0, 0).unwrap()), None);
    }

    #[test]
    fn no_more_memory_is_taken_than_is_allowed_and_what_is_used_stays() {
        let most = 64 * 40_000;
        let sketches = Sketches::new(FakeSource::shared(), most);
        for child in children().filter(|&id| FakeSource::kind(id) == Kind::Stored) {
            for slot in 0..=40 {
                sketches.get(child.child(Slot::from_index(slot)).unwrap());
                sketches.get(PageId::ROOT);
            }
            assert!(sketches.memory_bytes() <= most);
        }
        let read = sketches.records_read();
        assert!(sketches.get(PageId::ROOT).is_some());
        assert_eq!(sketches.records_read(), read);
        // Too little for a single page: each is made anew, and none is kept.
        let none = Sketches::new(FakeSource::shared(), 0);
        assert!(none.get(PageId::ROOT).is_some() && none.get(PageId::ROOT).is_some());
        assert_eq!((none.records_read(), none.memory_bytes()), (2, 0));
    }

    #[test]
    fn sessions_on_many_threads_see_the_same_sketches() {
        let sketches = Sketches::new(FakeSource::shared(), 64 * 40_000);
        let all = || children().map(|id| sketches.get(id)).collect::<Vec<_>>();
        let found: Vec<_> = std::thread::scope(|scope| {
            let threads = [0; 4].map(|_| scope.spawn(all));
            threads
                .into_iter()
                .map(|thread| thread.join().unwrap())
                .collect()
        });
        for other in &found[1..] {
            assert_eq!(other, &found[0]);
        }
    }
}
