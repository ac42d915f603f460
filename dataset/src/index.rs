//! The index: where each family lies. Sorted, in memory (28 bytes a family), searched by halving.

use super::map::open_file;
use super::{DatasetError, FamilyId};
use crate::checksum::crc32c;
use escarp_proto::bytes::Reader;
use escarp_proto::geometry::Slot;
use escarp_proto::manifest::{FileCheck, Manifest};
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

const MAGIC: &[u8; 8] = b"ESCARPIX";
const HEAD: usize = 8 + 8 + 8;
const ENTRY: usize = 8 + 8 + 4 + 4 + 4;

/// Where a family lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct IndexEntry {
    /// The family.
    pub family: FamilyId,
    /// Its first byte in the segment.
    pub offset: u64,
    /// Its length.
    pub bytes: u32,
    /// The segment's place in the manifest.
    pub segment: u32,
    /// CRC-32C of the family's table. It ties the records to the index, and so to `CURRENT`.
    pub table_crc32c: u32,
}

/// The index of a generation, checked.
#[derive(Debug)]
pub(super) struct Index {
    bytes: Vec<u8>,
}

fn index_path(folder: &Path, generation: u64) -> PathBuf {
    folder.join(format!("index-{generation}"))
}

impl Index {
    pub(super) fn open(folder: &Path, manifest: &Manifest) -> Result<Index, DatasetError> {
        let path = index_path(folder, manifest.generation);
        let length = manifest.index.bytes;
        let file = open_file(&path, length)?;
        let mut bytes = Vec::new();
        // Not a byte more, should the file grow meanwhile; a shorter one has another checksum.
        let read = file.take(length).read_to_end(&mut bytes);
        read.map_err(DatasetError::io(&path, "read"))?;
        let found = crc32c(&bytes);
        let stored = manifest.index.crc32c;
        if found != stored {
            let why = format!("checksum {found:08x}, the manifest says {stored:08x}");
            return Err(DatasetError::damaged(&path, why));
        }
        let index = Index { bytes };
        index.check(&path, manifest)?;
        Ok(index)
    }

    fn check(&self, path: &Path, manifest: &Manifest) -> Result<(), DatasetError> {
        let bytes = &self.bytes[..];
        let mut head = Reader::new(bytes);
        let magic = head.take(8) == Some(MAGIC);
        let generation = head.u64() == Some(manifest.generation);
        let count = head
            .u64()
            .and_then(|n| usize::try_from(n).ok()?.checked_mul(ENTRY));
        if !(magic && generation && count == Some(head.left())) {
            let why = "magic, generation or number of entries is not as in tiles/FORMAT.md";
            return Err(DatasetError::damaged(path, why));
        }
        let mut last = None;
        for (i, raw) in bytes[HEAD..].chunks_exact(ENTRY).enumerate() {
            let entry = parse(raw).filter(|entry| {
                let segment = manifest.segments.get(entry.segment as usize);
                let end = entry.offset.checked_add(u64::from(entry.bytes));
                let page = entry.family.page(Slot::from_index(0));
                let is_in_grid = page.is_some_and(|page| manifest.grid_levels.holds(page));
                let is_in_segment = segment.is_some_and(|s| end.is_some_and(|end| end <= s.bytes));
                Some(entry.family) > last && is_in_grid && is_in_segment
            });
            let Some(entry) = entry else {
                let why = format!(
                    "entry {i} is out of order, of no family of the grid, or points outside its \
                     segment"
                );
                return Err(DatasetError::damaged(path, why));
            };
            last = Some(entry.family);
        }
        Ok(())
    }

    pub(super) fn entries(&self) -> impl Iterator<Item = IndexEntry> + '_ {
        self.bytes[HEAD..].chunks_exact(ENTRY).filter_map(parse)
    }

    /// Number of families.
    pub(super) fn len(&self) -> usize {
        (self.bytes.len() - HEAD) / ENTRY
    }

    /// A family's entry, and which one of all it is.
    pub(super) fn find(&self, family: FamilyId) -> Option<(usize, IndexEntry)> {
        let (entries, _) = self.bytes[HEAD..].as_chunks::<ENTRY>();
        // Only ids are read until it is found: an entry begins with its id.
        let id = |entry: &[u8; ENTRY]| entry.first_chunk().map(|id| u64::from_le_bytes(*id));
        let wanted = Some(family.to_u64());
        let at = entries
            .binary_search_by(|entry| id(entry).cmp(&wanted))
            .ok()?;
        Some((at, parse(&entries[at])?))
    }
}

impl IndexEntry {
    /// Reads an entry as the index has it; `None` if the bytes end, or no family has the id.
    pub fn read(reader: &mut Reader<'_>) -> Option<IndexEntry> {
        Some(IndexEntry {
            family: FamilyId::from_u64(reader.u64()?)?,
            offset: reader.u64()?,
            bytes: reader.u32()?,
            segment: reader.u32()?,
            table_crc32c: reader.u32()?,
        })
    }

    /// Appends the entry as the index has it.
    pub fn put(&self, out: &mut Vec<u8>) {
        out.extend(self.family.to_u64().to_le_bytes());
        out.extend(self.offset.to_le_bytes());
        out.extend(self.bytes.to_le_bytes());
        out.extend(self.segment.to_le_bytes());
        out.extend(self.table_crc32c.to_le_bytes());
    }
}

fn parse(raw: &[u8]) -> Option<IndexEntry> {
    IndexEntry::read(&mut Reader::new(raw))
}

/// Writes and syncs the index of a generation. Sorts the entries.
pub(super) fn write_index(
    folder: &Path,
    generation: u64,
    entries: &mut [IndexEntry],
) -> Result<FileCheck, DatasetError> {
    entries.sort_unstable_by_key(|entry| entry.family);
    let mut bytes = Vec::with_capacity(HEAD + entries.len() * ENTRY);
    bytes.extend(MAGIC);
    bytes.extend(generation.to_le_bytes());
    bytes.extend((entries.len() as u64).to_le_bytes());
    for entry in entries.iter() {
        entry.put(&mut bytes);
    }
    let path = index_path(folder, generation);
    write_synced(&path, &bytes)?;
    Ok(FileCheck {
        bytes: bytes.len() as u64,
        crc32c: crc32c(&bytes),
    })
}

/// Writes a file and makes it durable.
pub(super) fn write_synced(path: &Path, bytes: &[u8]) -> Result<(), DatasetError> {
    let written = File::create(path).and_then(|mut file| {
        file.write_all(bytes)?;
        file.sync_all()
    });
    written.map_err(DatasetError::io(path, "write"))
}
