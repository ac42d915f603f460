//! A family: the records of all children of one page, in one stretch of a segment.

use super::{DatasetError, IndexEntry};
use crate::checksum::crc32c;
use escarp_proto::bytes::Reader;
use escarp_proto::geometry::{PageId, Slot};
use escarp_proto::page::{MAX_RECORD_BYTES, revision};
use std::path::Path;

mod table;
pub(super) use table::Entry as Place;
use table::Table;

/// No table is longer, with its family's id, bytes.
pub(super) const MAX_TABLE_BYTES: usize = 8 + table::MAX_BYTES;

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

/// The table of a family, its checksum verified; the records may be elsewhere.
#[derive(Debug, Clone, Copy)]
pub(super) struct Head<'a> {
    family: FamilyId,
    table: Table<'a>,
    path: &'a Path,
    table_bytes: usize,
    /// Of the first record, in the segment.
    offset: u64,
}

/// A family, the checksum of its table verified.
#[derive(Debug, Clone, Copy)]
pub struct FamilyTable<'a> {
    head: Head<'a>,
    records: &'a [u8],
}

impl<'a> Head<'a> {
    /// Reads a family's table from its first bytes, [`MAX_TABLE_BYTES`] or all of them, and checks
    /// it.
    pub(super) fn read(
        entry: &IndexEntry,
        bytes: &'a [u8],
        path: &'a Path,
    ) -> Result<Head<'a>, DatasetError> {
        let head = Head::parse(entry, bytes, path)?;
        let damaged =
            |why: String| DatasetError::damaged(path, format!("at byte {}: {why}", entry.offset));
        let found = crc32c(&bytes[..head.table_bytes]);
        let stored = entry.table_crc32c;
        if found != stored {
            return Err(damaged(format!(
                "table checksum {found:08x}, the index says {stored:08x}"
            )));
        }
        // The table is no longer than the family: all its bytes are there.
        let records = (entry.bytes as usize).saturating_sub(head.table_bytes);
        head.table.check(records).map_err(damaged)?;
        Ok(head)
    }

    /// Reads a table that was checked before.
    pub(super) fn parse(
        entry: &IndexEntry,
        bytes: &'a [u8],
        path: &'a Path,
    ) -> Result<Head<'a>, DatasetError> {
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
        let table_bytes = reader.position();
        Ok(Head {
            family,
            table,
            path,
            table_bytes,
            offset: offset + table_bytes as u64,
        })
    }

    /// Bytes of the table.
    pub(super) fn table_bytes(&self) -> usize {
        self.table_bytes
    }

    /// Where the record of a page of this family lies, behind the table.
    pub(super) fn place(&self, page: PageId) -> Result<Option<Place>, DatasetError> {
        let slot = page.parent().map_or(0, |(_, slot)| slot.index() as u8);
        let place = self.table.find(slot);
        place.map(|place| self.sane(place)).transpose()
    }

    /// Where a record lies in the segment.
    pub(super) fn offset_of(&self, place: &Place) -> u64 {
        self.offset + place.start as u64
    }

    /// Holds a record against its revision.
    pub(super) fn check(
        &self,
        page: PageId,
        place: &Place,
        bytes: &[u8],
    ) -> Result<(), DatasetError> {
        let (stored, found) = (place.revision, revision(page, bytes));
        if found != stored {
            let why = format!("page {page} has checksum {found:08x}, stored is {stored:08x}");
            return Err(self.damaged(place, &why));
        }
        Ok(())
    }

    fn sane(&self, place: Place) -> Result<Place, DatasetError> {
        if place.bytes > MAX_RECORD_BYTES {
            let why = format!("{} bytes, allowed are {MAX_RECORD_BYTES}", place.bytes);
            return Err(self.damaged(&place, &why));
        }
        Ok(place)
    }

    fn damaged(&self, place: &Place, why: &str) -> DatasetError {
        let at = self.offset_of(place);
        DatasetError::damaged(self.path, format!("record at byte {at}: {why}"))
    }
}

impl<'a> FamilyTable<'a> {
    pub(super) fn read(
        entry: &IndexEntry,
        bytes: &'a [u8],
        path: &'a Path,
    ) -> Result<FamilyTable<'a>, DatasetError> {
        let head = Head::read(entry, bytes, path)?;
        let records = &bytes[head.table_bytes..];
        Ok(FamilyTable { head, records })
    }

    /// Number of records.
    pub fn len(&self) -> usize {
        self.head.table.len()
    }

    /// Never: a family without records is not stored.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// All records, each checked.
    pub fn records(&self) -> impl Iterator<Item = Result<StoredRecord<'a>, DatasetError>> + '_ {
        self.head.table.entries().map(|place| self.record_of(place))
    }

    /// The record of a page of this family, checked.
    pub(super) fn record(&self, page: PageId) -> Result<Option<StoredRecord<'a>>, DatasetError> {
        let place = self.head.place(page)?;
        place.map(|place| self.record_of(place)).transpose()
    }

    fn record_of(&self, place: Place) -> Result<StoredRecord<'a>, DatasetError> {
        let place = self.head.sane(place)?;
        let page = self.head.family.page(Slot::from_index(place.slot));
        let page = page.ok_or_else(|| {
            let why = format!("slot {}", place.slot);
            self.head.damaged(&place, &why)
        })?;
        let bytes = &self.records[place.start..place.start + place.bytes];
        self.head.check(page, &place, bytes)?;
        Ok(StoredRecord {
            page,
            revision: place.revision,
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
