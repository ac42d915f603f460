//! Reading checkpoints back. Nothing in them is trusted: what does not fit is refused.

use super::super::level::Level;
use super::super::rows::Stored;
use super::Done;
use super::bands::{read_band, read_stored};
use crate::dataset::{DatasetError, IndexEntry};
use escarp_proto::bytes::Reader;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// A journal, read back entry by entry.
pub(super) struct Replay {
    pub(super) path: PathBuf,
    /// Of the finest level: no more can have been stored.
    pub(super) samples: u64,
    /// The level that is being replayed.
    pub(super) level: Level,
    pub(super) index: Vec<IndexEntry>,
    pub(super) pages: u64,
    pub(super) stored: Stored,
    pub(super) done: BTreeMap<u8, Done>,
}

impl Replay {
    /// Takes the next entry.
    pub(super) fn take(&mut self, number: u64, content: &[u8]) -> Result<(), DatasetError> {
        let mut reader = Reader::new(content);
        let whole = self.read(&mut reader).is_some() && reader.left() == 0;
        match whole {
            true => Ok(()),
            false => {
                let why = format!("entry {number} makes no sense; start anew without --resume");
                Err(DatasetError::damaged(&self.path, why))
            }
        }
    }

    fn read(&mut self, reader: &mut Reader<'_>) -> Option<()> {
        self.pages = reader.u64()?;
        self.stored = read_stored(reader, self.samples)?;
        for _ in 0..reader.u32()? {
            let entry = IndexEntry::read(reader)?;
            self.level.has(entry.family).then_some(())?;
            self.index.push(entry);
        }
        for _ in 0..reader.u32()? {
            self.band(reader)?;
        }
        Some(())
    }

    /// Bands come as a build makes them: from north to south, the finest level first.
    fn band(&mut self, reader: &mut Reader<'_>) -> Option<()> {
        let (level, number) = (reader.u8()?, reader.u32()? as usize);
        let finished = self.done.get(&self.level.level());
        if finished.is_some_and(|done| done.bands_left == 0) {
            self.level = self.level.above()?;
        }
        if level != self.level.level() {
            return None;
        }
        let done = self.done.entry(level).or_insert_with(|| Done {
            above: self.level.new_above(),
            bands_left: self.level.bands(),
        });
        if done.bands_left.checked_sub(1)? != number {
            return None;
        }
        done.bands_left = number;
        read_band(&self.level, number, &mut done.above, reader)
    }
}
