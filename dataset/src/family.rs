//! A family: the records of all children of one page, in one stretch of a segment.

use super::{DatasetError, IndexEntry};
use crate::checksum::crc32c;
use escarp_proto::bytes::Reader;
use escarp_proto::geometry::{PageId, Slot};
use escarp_proto::page::{MAX_RECORD_BYTES, revision};
use std::path::Path;

mod table;
use table::Table;

/// Names the children of a page, or the root page alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FamilyId(u64);

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

/// A family, the checksum of its table verified.
#[derive(Debug, Clone, Copy)]
pub struct FamilyTable<'a> {
    family: FamilyId,
    table: Table<'a>,
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
        let table = Table::read(&mut reader).ok_or_else(cut)?;
        let (table_bytes, records) = bytes.split_at(reader.position());
        let (found, stored) = (crc32c(table_bytes), entry.table_crc32c);
        if found != stored {
            return Err(damaged(format!(
                "table checksum {found:08x}, the index says {stored:08x}"
            )));
        }
        table.check(records.len()).map_err(damaged)?;
        Ok(FamilyTable {
            family,
            table,
            records,
            path,
            offset: offset + table_bytes.len() as u64,
        })
    }

    /// Number of records.
    pub fn len(&self) -> usize {
        self.table.len()
    }

    /// Never: a family without records is not stored.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// All records, each checked.
    pub fn records(&self) -> impl Iterator<Item = Result<StoredRecord<'a>, DatasetError>> + '_ {
        self.table.entries().map(|entry| self.record_of(entry))
    }

    /// The record of a page of this family, checked.
    pub(super) fn record(&self, page: PageId) -> Result<Option<StoredRecord<'a>>, DatasetError> {
        let slot = page.parent().map_or(0, |(_, slot)| slot.index() as u8);
        let entry = self.table.find(slot);
        entry.map(|entry| self.record_of(entry)).transpose()
    }

    fn record_of(&self, entry: table::Entry) -> Result<StoredRecord<'a>, DatasetError> {
        let damaged = |why: String| {
            let at = self.offset + entry.start as u64;
            DatasetError::damaged(self.path, format!("record at byte {at}: {why}"))
        };
        let page = self.family.page(Slot::from_index(entry.slot));
        let page = page.ok_or_else(|| damaged(format!("slot {}", entry.slot)))?;
        if entry.bytes > MAX_RECORD_BYTES {
            return Err(damaged(format!(
                "{} bytes, allowed are {MAX_RECORD_BYTES}",
                entry.bytes
            )));
        }
        let bytes = &self.records[entry.start..entry.start + entry.bytes];
        let (stored, found) = (entry.revision, revision(page, bytes));
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

/// The bytes of a family, and the CRC-32C of its table. Records come by slot, ascending.
pub(super) fn encode_family(family: FamilyId, records: &[(Slot, Vec<u8>)]) -> (Vec<u8>, u32) {
    let mut out = Vec::new();
    out.extend(family.0.to_le_bytes());
    let entries = records.iter().map(|(slot, record)| {
        // A family has only slots of its parent, so the page exists; the root has only slot 0.
        let page = family.page(*slot).unwrap_or(PageId::ROOT);
        (slot.index() as u8, record.len(), revision(page, record))
    });
    table::write(&entries.collect::<Vec<_>>(), &mut out);
    let table_crc32c = crc32c(&out);
    for (_, record) in records {
        out.extend(record);
    }
    (out, table_crc32c)
}
