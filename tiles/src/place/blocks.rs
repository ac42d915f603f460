//! What is read of a source while it is resampled: whole blocks, the last of which are kept.

use crate::dem::{DemError, DemSource};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

/// Samples that are kept, of 8 bytes: 256 MiB. One rectangle of the target may need no more.
pub(super) const KEPT_SAMPLES: usize = 32 << 20;
/// Blocks are at least this high and wide, so that few are looked up.
const LEAST_SIDE: u32 = 64;
/// Blocks are at most this large, in samples.
const MOST_SAMPLES: u32 = 4 << 20;

/// Column and row of a block among blocks.
pub(super) type Key = (u32, u32);

/// A source cut into blocks.
pub(super) struct Blocks {
    source: Box<dyn DemSource>,
    shape: [u32; 2],
    /// Samples of a block, and when it was last asked for.
    kept: HashMap<Key, (u64, Arc<Vec<f64>>)>,
    clock: u64,
    kept_samples: usize,
}

impl Blocks {
    pub fn new(source: Box<dyn DemSource>) -> Blocks {
        let info = source.info();
        let [width, height] = source.block_shape().map(|side| side.max(1));
        let wide = width.min(info.width);
        let wide = wide * LEAST_SIDE.div_ceil(wide);
        // Rows beyond the limit of a block are cut off: a file in one strip is one block.
        let high = (height * LEAST_SIDE.div_ceil(height)).min((MOST_SAMPLES / wide).max(1));
        let shape = [wide.min(info.width), high.min(info.height)];
        Blocks {
            source,
            shape,
            kept: HashMap::new(),
            clock: 0,
            kept_samples: 0,
        }
    }

    pub fn source(&self) -> &dyn DemSource {
        &*self.source
    }

    /// Columns and rows of a block.
    pub fn shape(&self) -> [u32; 2] {
        self.shape
    }

    /// The most samples that a block has.
    pub fn block_samples(&self) -> usize {
        self.shape[0] as usize * self.shape[1] as usize
    }

    /// Columns and rows of the source that a block holds: starts and ends.
    pub fn extent(&self, (column, row): Key) -> ([u32; 2], [u32; 2]) {
        let info = self.source.info();
        let range =
            |n: u32, step: u32, end: u32| [n * step, ((n + 1).saturating_mul(step)).min(end)];
        (
            range(column, self.shape[0], info.width),
            range(row, self.shape[1], info.height),
        )
    }

    /// Blocks by their keys, read where they are not kept.
    ///
    /// # Errors
    /// Those of reading the source.
    pub fn load(&mut self, keys: &BTreeSet<Key>) -> Result<Loaded, DemError> {
        let mut loaded = BTreeMap::new();
        for key in keys {
            self.clock += 1;
            let samples = match self.kept.get_mut(key) {
                Some((used, samples)) => {
                    *used = self.clock;
                    samples.clone()
                }
                None => self.read(*key)?,
            };
            loaded.insert(*key, samples);
        }
        Ok(Loaded {
            shape: self.shape,
            width: self.source.info().width,
            blocks: loaded,
        })
    }

    fn read(&mut self, key: Key) -> Result<Arc<Vec<f64>>, DemError> {
        let ([left, right], [top, bottom]) = self.extent(key);
        let mut samples = vec![0.0; (right - left) as usize * (bottom - top) as usize];
        self.source
            .read_window(top..bottom, left..right, &mut samples)?;
        self.make_room(samples.len());
        self.kept_samples += samples.len();
        let samples = Arc::new(samples);
        self.kept.insert(key, (self.clock, samples.clone()));
        Ok(samples)
    }

    /// Drops the blocks that were not asked for for longest.
    fn make_room(&mut self, samples: usize) {
        while self.kept_samples + samples > KEPT_SAMPLES {
            let oldest = self.kept.iter().min_by_key(|(_, (used, _))| *used);
            let Some(key) = oldest.map(|(key, _)| *key) else {
                return;
            };
            if let Some((_, block)) = self.kept.remove(&key) {
                self.kept_samples -= block.len();
            }
        }
    }
}

/// Blocks that some rectangle of the target needs.
pub(super) struct Loaded {
    shape: [u32; 2],
    width: u32,
    blocks: BTreeMap<Key, Arc<Vec<f64>>>,
}

impl Loaded {
    /// A reader that remembers the last block.
    pub fn reader(&self) -> Reader<'_> {
        Reader {
            loaded: self,
            left: 0,
            top: 0,
            right: 0,
            bottom: 0,
            samples: &[],
        }
    }
}

/// Reads samples of loaded blocks.
pub(super) struct Reader<'a> {
    loaded: &'a Loaded,
    left: u32,
    top: u32,
    right: u32,
    bottom: u32,
    samples: &'a [f64],
}

impl Reader<'_> {
    /// A sample; NaN where the block is not loaded.
    pub fn at(&mut self, column: u32, row: u32) -> f64 {
        let inside =
            column >= self.left && column < self.right && row >= self.top && row < self.bottom;
        if !inside {
            self.enter(column, row);
        }
        let across = self.right - self.left;
        let at = (row - self.top) as usize * across as usize + (column - self.left) as usize;
        self.samples.get(at).copied().unwrap_or(f64::NAN)
    }

    fn enter(&mut self, column: u32, row: u32) {
        let [wide, high] = self.loaded.shape;
        let key = (column / wide, row / high);
        let block = self.loaded.blocks.get(&key);
        self.samples = block.map_or(&[], |samples| &samples[..]);
        self.left = key.0 * wide;
        self.right = (self.left + wide).min(self.loaded.width);
        self.top = key.1 * high;
        self.bottom = self.top + high;
    }
}
