//! A page's record: its parts, one after the other, and where each ends.

use super::{MAX_RECORD_BYTES, Page, PageError, Range, codec0, last_part};
use crate::bytes::Reader;
use crate::geometry::PageId;
use std::ops::Range as Bytes;

/// The encoded parts of a page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Record {
    bytes: Vec<u8>,
}

impl Record {
    /// Encodes a whole page with codec 0.
    pub fn encode(page: &Page) -> Record {
        Record {
            bytes: codec0::encode(page),
        }
    }

    /// The bytes, header first.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }
}

/// The content address of a record: CRC-32C over the page's key and the record, so that a record
/// in the wrong place does not match. It serves as checksum and as revision.
pub fn revision(page: PageId, record: &[u8]) -> u32 {
    let mut digest = RevisionDigest::new(page);
    digest.update(record);
    digest.revision()
}

/// A [`revision`] in the making, for a record that comes in parts.
#[derive(Debug, Clone)]
pub struct RevisionDigest(crc_fast::Digest);

impl RevisionDigest {
    /// Of a page of which nothing has come.
    pub fn new(page: PageId) -> RevisionDigest {
        let mut digest = crc_fast::Digest::new(crc_fast::CrcAlgorithm::Crc32Iscsi);
        digest.update(&page.key().to_le_bytes());
        RevisionDigest(digest)
    }

    /// Takes the next bytes of the record.
    pub fn update(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    /// The revision, once the whole record has been taken.
    pub fn revision(&self) -> u32 {
        self.0.finalize() as u32
    }
}

/// Part 0 of a record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordHeader {
    pub(super) has_holes: bool,
    pub(super) has_cuts: bool,
    pub(super) range: Range,
    /// `ends[k]`: where part `k` ends; `ends[0]` is the header's own length.
    ends: Vec<usize>,
}

/// Bit of the tag byte: the page has a mask plane. The lower four bits name the codec.
pub(super) const HOLES: u8 = 0x10;
/// Bit of the tag byte: some of the page's slots are cut.
pub(super) const CUTS: u8 = 0x20;
const CODEC: u8 = 0x0f;

impl RecordHeader {
    /// Reads the header of a record, or of any prefix that holds it.
    ///
    /// # Errors
    /// [`PageError`] if a field is cut short or out of range; the parts themselves are not looked
    /// at, but their lengths add up to at most [`MAX_RECORD_BYTES`].
    pub fn read(page: PageId, finest: bool, record: &[u8]) -> Result<RecordHeader, PageError> {
        let mut reader = Reader::new(record);
        let short = |field| move || PageError::Short { page, field };
        let value = |field, found, allowed| PageError::Value {
            page,
            field,
            found,
            allowed,
        };
        let tag = reader.u8().ok_or_else(short("tag"))?;
        if tag & CODEC != 0 {
            return Err(value("codec", i64::from(tag & CODEC), "0"));
        }
        let allowed = if finest { HOLES } else { HOLES | CUTS };
        if tag & !(CODEC | allowed) != 0 {
            let allowed = if finest { "0 or 1" } else { "0 to 3" };
            return Err(value("flags", i64::from(tag >> 4), allowed));
        }
        let mut lengths = Vec::with_capacity(6);
        for _ in 1..=last_part(finest) {
            let length = reader.varint().ok_or_else(short("part length"))?;
            if length > MAX_RECORD_BYTES as u64 {
                return Err(value("part length", length as i64, "0..=8192"));
            }
            lengths.push(length as usize);
        }
        let has_holes = tag & HOLES != 0;
        let range = match has_holes {
            true => read_range(page, &mut reader)?,
            false => Range::EMPTY,
        };
        let ends = ends_of(reader.position(), &lengths);
        match ends.last() {
            Some(&end) if end > MAX_RECORD_BYTES => {
                Err(value("record length", end as i64, "0..=8192"))
            }
            _ => Ok(RecordHeader {
                has_holes,
                has_cuts: tag & CUTS != 0,
                range,
                ends,
            }),
        }
    }

    /// Length of the whole record, in bytes.
    pub fn record_len(&self) -> usize {
        self.ends.last().copied().unwrap_or(0)
    }

    /// Parts of the record, the header not counted.
    pub fn last_part(&self) -> u8 {
        (self.ends.len() - 1) as u8
    }

    /// Where parts `first..=last` lie in the record. `None` if there are no such parts.
    pub fn part_bytes(&self, first: u8, last: u8) -> Option<Bytes<usize>> {
        let start = match first.checked_sub(1) {
            None => 0,
            Some(before) => *self.ends.get(before as usize)?,
        };
        let end = *self.ends.get(last as usize)?;
        (start <= end).then_some(start..end)
    }
}

fn ends_of(header: usize, lengths: &[usize]) -> Vec<usize> {
    let mut end = header;
    let parts = lengths.iter().map(|length| {
        end += length;
        end
    });
    std::iter::once(header).chain(parts).collect()
}

fn read_range(page: PageId, reader: &mut Reader<'_>) -> Result<Range, PageError> {
    let short = || PageError::Short {
        page,
        field: "range",
    };
    let empty = reader.u8().ok_or_else(short)?;
    if empty == 0 {
        return Ok(Range::EMPTY);
    }
    let lo = reader.zigzag().ok_or_else(short)?;
    let span = reader.varint().ok_or_else(short)?;
    codec0::checked_range(page, lo, span)
}

pub(super) fn write_range(range: Range, out: &mut Vec<u8>) {
    use crate::bytes::{put_varint, put_zigzag};
    if range.is_empty() {
        return out.push(0);
    }
    out.push(1);
    put_zigzag(i64::from(range.lo), out);
    put_varint(u64::from(range.span()), out);
}
