//! What the bytes of a dataset are spent on, and what its child slots promise.

use crate::dataset::{Dataset, DatasetError, IndexEntry};
use escarp_proto::err8::Err8;
use escarp_proto::geometry::Slot;
use escarp_proto::page::{ChildSlot, Page, RecordHeader, SLOT_PART, last_part};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;

/// Pages and bytes of a level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct LevelSurvey {
    /// Records.
    pub pages: u64,
    /// Their bytes.
    pub bytes: u64,
}

/// What the bytes of a dataset are spent on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Survey {
    /// By level of the pages' root squares.
    pub levels: BTreeMap<u8, LevelSurvey>,
    /// Bytes by part of the records: header, vertices of levels 1 to 4, child slots.
    pub parts: [u64; SLOT_PART as usize + 1],
    /// Bytes of the tables before the records of a family.
    pub tables: u64,
    /// Child slots that are full, by their error: `n` of at most so many metres, and more than the
    /// entry before.
    pub slot_errors: Vec<SlotErrors>,
    /// Child slots that an outline crosses.
    pub mixed_slots: u64,
    /// Child slots with no surface.
    pub empty_slots: u64,
}

/// Child slots with a similar error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SlotErrors {
    /// Their largest error, metres.
    pub most_m: f64,
    /// How many they are.
    pub slots: u64,
}

/// Codes of errors to an octave: what [`Err8`] has.
const OCTAVE: usize = 8;

#[derive(Debug, Clone)]
struct Counts {
    levels: BTreeMap<u8, LevelSurvey>,
    parts: [u64; SLOT_PART as usize + 1],
    tables: u64,
    /// By error code.
    full: Vec<u64>,
    mixed: u64,
    empty: u64,
}

/// Reads all records.
///
/// # Errors
/// [`DatasetError::Damaged`] at the first one that does not match its checksum.
pub fn survey(dataset: &Dataset) -> Result<Survey, DatasetError> {
    let families: Vec<IndexEntry> = dataset.families().collect();
    let counts = families
        .par_iter()
        .try_fold(Counts::new, |counts, entry| counts.with(dataset, entry))
        .try_reduce(Counts::new, |a, b| Ok(a.merge(b)))?;
    let quantum_m = dataset.manifest().georef.quantum_m;
    Ok(Survey {
        slot_errors: counts.errors(quantum_m),
        levels: counts.levels,
        parts: counts.parts,
        tables: counts.tables,
        mixed_slots: counts.mixed,
        empty_slots: counts.empty,
    })
}

impl Counts {
    fn new() -> Counts {
        Counts {
            levels: BTreeMap::new(),
            parts: [0; SLOT_PART as usize + 1],
            tables: 0,
            full: vec![0; 256],
            mixed: 0,
            empty: 0,
        }
    }

    fn with(mut self, dataset: &Dataset, entry: &IndexEntry) -> Result<Counts, DatasetError> {
        let damaged = |error: escarp_proto::page::PageError| {
            DatasetError::damaged(dataset.folder(), error.to_string())
        };
        let mut records = 0;
        for record in dataset.family(entry)?.records() {
            let record = record?;
            let finest = dataset.grid().is_finest(record.page);
            let level = self.levels.entry(record.page.level()).or_default();
            level.pages += 1;
            level.bytes += record.bytes.len() as u64;
            records += record.bytes.len() as u64;
            let header = RecordHeader::read(record.page, finest, record.bytes).map_err(damaged)?;
            for part in 0..=last_part(finest) {
                let bytes = header.part_bytes(part, part).unwrap_or(0..0);
                self.parts[usize::from(part)] += bytes.len() as u64;
            }
            if !finest {
                let page = Page::decode(record.page, finest, SLOT_PART, record.bytes);
                self.slots(&page.map_err(damaged)?);
            }
        }
        self.tables += u64::from(entry.bytes) - records;
        Ok(self)
    }

    fn slots(&mut self, page: &Page) {
        for slot in (0..=u8::MAX).map(Slot::from_index) {
            match page.slot(slot) {
                ChildSlot::Full(error) | ChildSlot::Cut(error) => {
                    self.full[usize::from(error.0)] += 1
                }
                ChildSlot::Mixed(_) => self.mixed += 1,
                ChildSlot::Empty => self.empty += 1,
            }
        }
    }

    fn merge(mut self, other: Counts) -> Counts {
        for (level, more) in other.levels {
            let level = self.levels.entry(level).or_default();
            level.pages += more.pages;
            level.bytes += more.bytes;
        }
        self.parts
            .iter_mut()
            .zip(other.parts)
            .for_each(|(a, b)| *a += b);
        self.full
            .iter_mut()
            .zip(other.full)
            .for_each(|(a, b)| *a += b);
        self.tables += other.tables;
        self.mixed += other.mixed;
        self.empty += other.empty;
        self
    }

    /// No error at all, and then octave by octave.
    fn errors(&self, quantum_m: f64) -> Vec<SlotErrors> {
        let octaves = self.full[1..]
            .chunks(OCTAVE)
            .enumerate()
            .map(|(octave, counts)| {
                let last = 1 + octave * OCTAVE + counts.len() - 1;
                SlotErrors {
                    most_m: f64::from(Err8(last as u8).bound()) * quantum_m,
                    slots: counts.iter().sum(),
                }
            });
        let none = SlotErrors {
            most_m: 0.0,
            slots: self.full[0],
        };
        let all = std::iter::once(none).chain(octaves);
        all.filter(|bin| bin.slots > 0).collect()
    }
}
