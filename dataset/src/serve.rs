//! Reading for others, while the files may be cut short or written over by someone who should
//! not: a dataset that is hosted for months.
//!
//! Every record is checked after it was read, whichever way it was. What differs is what happens
//! to a program whose segment becomes shorter:
//!
//! - [`Io::Pread`] copies the bytes by positioned reads. A short read is a damaged file, and
//!   nothing can go wrong between check and use.
//! - [`Io::Mmap`] shares the mapping. The file's length is asked for before each access; if the
//!   file is cut between that and the last use of the bytes, the process dies by SIGBUS, and if
//!   it is written over, what is sent is not what was checked.

use super::family::{Head, MAX_TABLE_BYTES};
use super::map::Mapped;
use super::{Dataset, DatasetError, FamilyId, FamilyTable, IndexEntry};
use crate::checksum::crc32c;
use bytes::Bytes;
use escarp_proto::geometry::PageId;
use std::fs::File;
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use thiserror::Error;

/// How the bytes of a segment get into memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Io {
    /// By positioned reads into memory of their own.
    #[default]
    Pread,
    /// By the mapping, without a copy.
    Mmap,
}

/// Whether to wait for the disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wait {
    /// As long as it takes.
    Yes,
    /// Not at all: only what the system has in memory is read, by [`Io::Pread`] on Linux.
    No,
}

/// Bytes of a dataset, and the checksum that names them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stored {
    /// A record's revision; of a family, its table's CRC-32C.
    pub checksum: u32,
    /// The record; of a family, its table and all records.
    pub bytes: Bytes,
}

/// Why nothing was read.
#[derive(Debug, Error)]
pub enum ReadError {
    /// The system does not have it in memory, or does not say: read it with [`Wait::Yes`].
    #[error("it would have to be read from the disk")]
    WouldWait,
    /// The files are not what was published, or cannot be read.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
}

impl Dataset {
    /// Chooses how [`read_record`](Self::read_record) and its like get at the bytes; a dataset is
    /// opened with [`Io::Pread`].
    #[must_use]
    pub fn with_io(self, io: Io) -> Dataset {
        Dataset { io, ..self }
    }

    /// A page's record, checked against its revision; `None` if none is stored.
    ///
    /// # Errors
    /// [`ReadError::Dataset`] if the segment is too short or cannot be read, or if the family's
    /// table or the record does not match its checksum; [`ReadError::WouldWait`].
    pub fn read_record(&self, page: PageId, wait: Wait) -> Result<Option<Stored>, ReadError> {
        let Some((at, entry)) = self.entry_of(page) else {
            return Ok(None);
        };
        let segment = self.segment(&entry);
        let table = self.table(at, &entry, wait)?;
        let head = Head::parse(&entry, &table, segment.path())?;
        let Some(place) = head.place(page)? else {
            return Ok(None);
        };
        let bytes = segment.read(head.offset_of(&place), place.bytes, self.io, wait)?;
        head.check(page, &place, &bytes)?;
        let checksum = place.revision;
        Ok(Some(Stored { checksum, bytes }))
    }

    /// The revision of a page's record, from its family's table alone; `None` if none is stored.
    ///
    /// # Errors
    /// As [`read_record`](Self::read_record), of the table.
    pub fn read_revision(&self, page: PageId, wait: Wait) -> Result<Option<u32>, ReadError> {
        let Some((at, entry)) = self.entry_of(page) else {
            return Ok(None);
        };
        let table = self.table(at, &entry, wait)?;
        let head = Head::parse(&entry, &table, self.segment(&entry).path())?;
        Ok(head.place(page)?.map(|place| place.revision))
    }

    /// The family below a page, its table and all records checked; `None` if none is stored.
    ///
    /// # Errors
    /// As [`read_record`](Self::read_record).
    pub fn read_family(&self, parent: PageId, wait: Wait) -> Result<Option<Stored>, ReadError> {
        let holds = self.grid().holds(parent);
        let found = holds.then(|| self.index.find(FamilyId::below(parent)));
        let Some((at, entry)) = found.flatten() else {
            return Ok(None);
        };
        let segment = self.segment(&entry);
        let bytes = segment.read(entry.offset, entry.bytes as usize, self.io, wait)?;
        self.checked.family(at, &bytes, || {
            let table = FamilyTable::read(&entry, &bytes, segment.path())?;
            table.records().try_for_each(|record| record.map(|_| ()))
        })?;
        let checksum = entry.table_crc32c;
        Ok(Some(Stored { checksum, bytes }))
    }

    fn entry_of(&self, page: PageId) -> Option<(usize, IndexEntry)> {
        let holds = self.grid().holds(page);
        holds.then(|| self.index.find(FamilyId::of(page))).flatten()
    }

    fn segment(&self, entry: &IndexEntry) -> &Mapped {
        &self.segments[entry.segment as usize]
    }

    /// The table of a family, which is number `at` in the index; checked.
    fn table(&self, at: usize, entry: &IndexEntry, wait: Wait) -> Result<Bytes, ReadError> {
        if let Some(table) = self.checked.table(at) {
            return Ok(table);
        }
        let segment = self.segment(entry);
        let bytes = (entry.bytes as usize).min(MAX_TABLE_BYTES);
        let bytes = segment.read(entry.offset, bytes, self.io, wait)?;
        let head = Head::read(entry, &bytes, segment.path())?;
        let table = Bytes::copy_from_slice(&bytes[..head.table_bytes()]);
        self.checked.keep_table(at, table.clone());
        Ok(table)
    }
}

/// A family's table, and the family's number.
type Table = (usize, Bytes);

/// Tables that are kept in memory, at most: of at most 1.6 KiB each.
const KEPT_TABLES: usize = 4096;
/// Set where a checksum is known.
const KNOWN: u64 = 1 << 32;

/// What was checked before, so that it need not be checked in the same way again.
#[derive(Debug)]
pub(super) struct Checked {
    /// Of each family, by its number in the index: the CRC-32C of all its bytes when its table and
    /// all its records were right. One checksum then does for some 250.
    families: Box<[AtomicU64]>,
    /// Tables that were right, each in the slot of its family's number.
    tables: Box<[Mutex<Option<Table>>]>,
}

impl Checked {
    pub(super) fn new(families: usize) -> Checked {
        let tables = families.min(KEPT_TABLES);
        Checked {
            families: (0..families).map(|_| AtomicU64::new(0)).collect(),
            tables: (0..tables).map(|_| Mutex::new(None)).collect(),
        }
    }

    /// Checks a family, unless its bytes are those that were right before.
    fn family(
        &self,
        at: usize,
        bytes: &[u8],
        check: impl FnOnce() -> Result<(), DatasetError>,
    ) -> Result<(), DatasetError> {
        let found = KNOWN | u64::from(crc32c(bytes));
        // It is a value of its own: nothing else is read because of it.
        if self.families[at].load(Ordering::Relaxed) != found {
            check()?;
            self.families[at].store(found, Ordering::Relaxed);
        }
        Ok(())
    }

    fn table(&self, at: usize) -> Option<Bytes> {
        let slot = self.tables[at % self.tables.len()].lock();
        let slot = slot.unwrap_or_else(PoisonError::into_inner);
        let kept = slot.as_ref().filter(|(number, _)| *number == at);
        kept.map(|(_, table)| table.clone())
    }

    fn keep_table(&self, at: usize, table: Bytes) {
        let slot = self.tables[at % self.tables.len()].lock();
        *slot.unwrap_or_else(PoisonError::into_inner) = Some((at, table));
    }
}

impl Mapped {
    /// Bytes of the file, which ended behind them when it was opened.
    fn read(&self, offset: u64, bytes: usize, io: Io, wait: Wait) -> Result<Bytes, ReadError> {
        match (io, wait) {
            (Io::Mmap, Wait::Yes) => self.share(offset, bytes),
            (Io::Mmap, Wait::No) => Err(ReadError::WouldWait),
            (Io::Pread, _) => self.copy(offset, bytes, wait),
        }
    }

    fn share(&self, offset: u64, bytes: usize) -> Result<Bytes, ReadError> {
        let found = self.file().metadata();
        let found = found.map_err(DatasetError::io(self.path(), "read length"))?;
        if found.len() < offset + bytes as u64 {
            return Err(self.cut_short(offset, bytes, found.len()));
        }
        Ok(self
            .shared()
            .slice(offset as usize..offset as usize + bytes))
    }

    fn copy(&self, offset: u64, bytes: usize, wait: Wait) -> Result<Bytes, ReadError> {
        let mut copied = vec![0; bytes];
        let read = match wait {
            Wait::Yes => read_at(self.file(), &mut copied, offset),
            Wait::No if read_at_once(self.file(), &mut copied, offset) => Ok(()),
            Wait::No => return Err(ReadError::WouldWait),
        };
        match read {
            Ok(()) => Ok(copied.into()),
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => {
                let found = self.file().metadata().map_or(0, |found| found.len());
                Err(self.cut_short(offset, bytes, found))
            }
            Err(error) => Err(DatasetError::io(self.path(), "read")(error).into()),
        }
    }

    fn cut_short(&self, offset: u64, bytes: usize, found: u64) -> ReadError {
        let why = format!(
            "{bytes} bytes at byte {offset} are wanted, and it is only {found} bytes long now: \
             it was cut short while it was in use"
        );
        DatasetError::damaged(self.path(), why).into()
    }
}

#[cfg(unix)]
fn read_at(file: &File, bytes: &mut [u8], offset: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, offset)
}

#[cfg(windows)]
fn read_at(file: &File, mut bytes: &mut [u8], mut offset: u64) -> io::Result<()> {
    while !bytes.is_empty() {
        match std::os::windows::fs::FileExt::seek_read(file, bytes, offset)? {
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            read => {
                bytes = &mut bytes[read..];
                offset += read as u64;
            }
        }
    }
    Ok(())
}

/// Whether all bytes were read, without waiting for the disk.
#[cfg(target_os = "linux")]
fn read_at_once(file: &File, bytes: &mut [u8], offset: u64) -> bool {
    use rustix::io::{ReadWriteFlags, preadv2};
    let wanted = bytes.len();
    let buffers = &mut [io::IoSliceMut::new(bytes)];
    // A part only, or a file system that cannot tell: whoever can wait finds out more.
    preadv2(file, buffers, offset, ReadWriteFlags::NOWAIT) == Ok(wanted)
}

/// Whether all bytes were read, without waiting for the disk: no other system can say.
#[cfg(not(target_os = "linux"))]
fn read_at_once(_: &File, _: &mut [u8], _: u64) -> bool {
    false
}
