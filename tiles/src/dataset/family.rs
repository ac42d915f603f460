//! A family: the records of all children of one page, in one stretch of a segment.

use super::{DatasetError, IndexEntry};
use crate::checksum::crc32c;
use escarp_proto::bytes::Reader;
use escarp_proto::geometry::{PAGE_SLOTS, PageId, Slot};
use escarp_proto::page::{MAX_RECORD_BYTES, revision};
use std::path::Path;

/// Names the children of a page, or the root page alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FamilyId(u64);

/// Length of one of the table's entries, bytes.
const ENTRY: usize = 1 + 2 + 4;

impl FamilyId {
    /// The family of the root page.
    pub const ROOT: FamilyId = FamilyId(u64::MAX);

    /// The family that a page belongs to.
    pub fn of(page: PageId) -> FamilyId {
        page.parent()
            .map_or(Self::ROOT, |(parent, _)| Self::below(parent))
    }

    /// The family of a page's children.
    pub fn below(parent: PageId) -> FamilyId {
        FamilyId(parent.key())
    }

    /// As stored in the index.
    pub const fn to_u64(self) -> u64 {
        self.0
    }

    /// As stored in the index; `None` if no family has it.
    pub fn from_u64(id: u64) -> Option<FamilyId> {
        (id == u64::MAX || PageId::from_key(id).is_some()).then_some(FamilyId(id))
    }

    /// The page in a slot of this family.
    pub fn page(self, slot: Slot) -> Option<PageId> {
        match PageId::from_key(self.0) {
            Some(parent) => parent.child(slot),
            None => (slot.index() == 0).then_some(PageId::ROOT),
        }
    }
}

/// A record as stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StoredRecord<'a> {
    /// The page.
    pub page: PageId,
    /// Its content address.
    pub revision: u32,
    /// The whole record.
    pub bytes: &'a [u8],
}

/// The table of a family, its checksum verified.
#[derive(Debug, Clone, Copy)]
pub struct FamilyTable<'a> {
    family: FamilyId,
    entries: &'a [u8],
    records: &'a [u8],
    path: &'a Path,
    /// Of the first record, in the segment.
    offset: u64,
}

impl<'a> FamilyTable<'a> {
    pub(super) fn read(
        entry: &IndexEntry,
        bytes: &'a [u8],
        path: &'a Path,
    ) -> Result<FamilyTable<'a>, DatasetError> {
        let (family, offset) = (entry.family, entry.offset);
        let damaged = |why: String| DatasetError::damaged(path, format!("at byte {offset}: {why}"));
        let cut = || damaged("family table cut short".into());
        let mut reader = Reader::new(bytes);
        let id = reader.u64().ok_or_else(cut)?;
        if id != family.0 {
            return Err(damaged(format!(
                "family {id:x}, the index says {:x}",
                family.0
            )));
        }
        let count = reader.u16().ok_or_else(cut)? as usize;
        if count == 0 || count > PAGE_SLOTS {
            return Err(damaged(format!("{count} records, allowed are 1..=256")));
        }
        let entries = reader.take(count * ENTRY).ok_or_else(cut)?;
        let found = crc32c(&bytes[..reader.position()]);
        let stored = entry.table_crc32c;
        if found != stored {
            return Err(damaged(format!(
                "table checksum {found:08x}, the index says {stored:08x}"
            )));
        }
        let slots = entries.chunks_exact(ENTRY).map(|entry| entry[0]);
        if !slots.is_sorted_by(|a, b| a < b) {
            return Err(damaged("slots of the table are not ascending".into()));
        }
        let records = &bytes[reader.position()..];
        let lengths: usize = entries.chunks_exact(ENTRY).map(length_of).sum();
        if lengths != records.len() {
            let there = records.len();
            return Err(damaged(format!(
                "records of {lengths} bytes in a space of {there}"
            )));
        }
        Ok(FamilyTable {
            family,
            entries,
            records,
            path,
            offset: offset + reader.position() as u64,
        })
    }

    /// Number of records.
    pub fn len(&self) -> usize {
        self.entries.len() / ENTRY
    }

    /// Never: a family without records is not stored.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// All records, each checked.
    pub fn records(&self) -> impl Iterator<Item = Result<StoredRecord<'a>, DatasetError>> + '_ {
        let mut start = 0;
        self.entries.chunks_exact(ENTRY).map(move |entry| {
            let at = start;
            start += length_of(entry);
            self.check(entry, at)
        })
    }

    /// The record of a page of this family, checked.
    pub(super) fn record(&self, page: PageId) -> Result<Option<StoredRecord<'a>>, DatasetError> {
        let slot = page.parent().map_or(0, |(_, slot)| slot.index());
        let mut start = 0;
        for entry in self.entries.chunks_exact(ENTRY) {
            if usize::from(entry[0]) == slot {
                return self.check(entry, start).map(Some);
            }
            start += length_of(entry);
        }
        Ok(None)
    }

    fn check(&self, entry: &[u8], start: usize) -> Result<StoredRecord<'a>, DatasetError> {
        let damaged = |why: String| {
            let at = self.offset + start as u64;
            DatasetError::damaged(self.path, format!("record at byte {at}: {why}"))
        };
        let slot = Slot::from_index(entry[0]);
        let page = self.family.page(slot);
        let page = page.ok_or_else(|| damaged(format!("slot {}", entry[0])))?;
        let bytes = &self.records[start..start + length_of(entry)];
        if bytes.len() > MAX_RECORD_BYTES {
            return Err(damaged(format!(
                "{} bytes, allowed are {MAX_RECORD_BYTES}",
                bytes.len()
            )));
        }
        let stored = u32::from_le_bytes([entry[3], entry[4], entry[5], entry[6]]);
        let found = revision(page, bytes);
        if found != stored {
            let why = format!("page {page} has checksum {found:08x}, stored is {stored:08x}");
            return Err(damaged(why));
        }
        Ok(StoredRecord {
            page,
            revision: stored,
            bytes,
        })
    }
}

fn length_of(entry: &[u8]) -> usize {
    usize::from(u16::from_le_bytes([entry[1], entry[2]]))
}

/// The bytes of a family, and the CRC-32C of its table. Records come by slot, ascending.
pub(super) fn encode_family(family: FamilyId, records: &[(Slot, Vec<u8>)]) -> (Vec<u8>, u32) {
    let mut out = Vec::new();
    out.extend(family.0.to_le_bytes());
    out.extend((records.len() as u16).to_le_bytes());
    for (slot, record) in records {
        // A family has only slots of its parent, so the page exists; the root has only slot 0.
        let page = family.page(*slot).unwrap_or(PageId::ROOT);
        out.push(slot.index() as u8);
        out.extend((record.len() as u16).to_le_bytes());
        out.extend(revision(page, record).to_le_bytes());
    }
    let table_crc32c = crc32c(&out);
    for (_, record) in records {
        out.extend(record);
    }
    (out, table_crc32c)
}
