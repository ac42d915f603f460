//! A page's record: its parts, one after the other, and where each ends.

use super::{MAX_RECORD_BYTES, Page, PageError, Range, codec0, codec1, last_part};
use crate::bytes::Reader;
use crate::geometry::PageId;
use std::ops::Range as Bytes;

/// The encoded parts of a page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Record {
    bytes: Vec<u8>,
}

/// How a record's parts are coded. The number stands in the lower four bits of its first byte.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Codec {
    /// Zig-zag varints: simple, and the oracle of the other.
    Plain = 0,
    /// Residuals of interpolating predictions in one entropy-coded stream.
    Dense = 1,
}

impl Codec {
    /// Bit `n` is set for codec `n`: what this crate reads and writes.
    pub const KNOWN: u32 = 1 << Codec::Plain as u32 | 1 << Codec::Dense as u32;

    /// The codec of a number; `None` if there is none.
    pub const fn from_u8(number: u8) -> Option<Codec> {
        match number {
            0 => Some(Codec::Plain),
            1 => Some(Codec::Dense),
            _ => None,
        }
    }
}

impl Record {
    /// Encodes a whole page.
    pub fn encode(page: &Page, codec: Codec) -> Record {
        Record {
            bytes: match codec {
                Codec::Plain => codec0::encode(page),
                Codec::Dense => codec1::encode(page),
            },
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
    pub(super) range: Range,
    /// `ends[k]`: where part `k` ends; `ends[0]` is the header's own length.
    ends: Vec<usize>,
}

/// Bit of the tag byte: the page has a mask plane. The lower four bits name the codec.
pub(super) const HOLES: u8 = 0x10;
/// Bit of the tag byte: heights are stored as they are.
pub(super) const RAW: u8 = 0x20;
/// Bit of the tag byte: some of the page's slots are cut.
pub(super) const CUTS: u8 = 0x40;
const CODEC: u8 = 0x0f;

/// What a record's first byte says.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tag {
    pub(super) codec: Codec,
    pub(super) has_holes: bool,
    pub(super) has_cuts: bool,
    /// Heights are stored as they are.
    pub(super) is_raw: bool,
}

impl Tag {
    pub(super) fn read(page: PageId, finest: bool, record: &[u8]) -> Result<Tag, PageError> {
        let value = |field, found, allowed| PageError::Value {
            page,
            field,
            found,
            allowed,
        };
        let tag = *record
            .first()
            .ok_or(PageError::Short { page, field: "tag" })?;
        let codec = tag & CODEC;
        let codec = Codec::from_u8(codec).ok_or(value("codec", i64::from(codec), "0 or 1"))?;
        let cuts = if finest { 0 } else { CUTS };
        let (flags, allowed) = match codec {
            Codec::Plain => (HOLES | cuts, "holes, or cuts in a page with slots"),
            Codec::Dense => (
                HOLES | RAW | cuts,
                "holes, raw, or cuts in a page with slots",
            ),
        };
        if tag & !(CODEC | flags) != 0 {
            return Err(value("flags", i64::from(tag >> 4), allowed));
        }
        Ok(Tag {
            codec,
            has_holes: tag & HOLES != 0,
            has_cuts: tag & CUTS != 0,
            is_raw: tag & RAW != 0,
        })
    }
}

impl RecordHeader {
    /// Reads what a whole record holds, and where.
    ///
    /// # Errors
    /// [`PageError`] if a field is cut short or out of range. The parts of a plain record are not
    /// looked at, but their lengths add up to at most [`MAX_RECORD_BYTES`]. A dense record does
    /// not say how long its parts are: it is decoded, which may fail for all that
    /// [`Page::decode`] may fail for.
    pub fn read(page: PageId, finest: bool, record: &[u8]) -> Result<RecordHeader, PageError> {
        let tag = Tag::read(page, finest, record)?;
        let has_holes = tag.has_holes;
        match tag.codec {
            Codec::Plain => read_plain(page, finest, has_holes, record),
            Codec::Dense => Ok(RecordHeader {
                range: Range::EMPTY,
                ends: codec1::part_ends(page, finest, tag, record, last_part(finest))?,
            }),
        }
    }

    /// Where parts `first..=last` lie in a whole record whose checksum has been compared. `None` if
    /// there are no such parts. A dense record is decoded only as far as that needs: not at all if
    /// the whole record is asked for.
    ///
    /// # Errors
    /// As [`read`](Self::read); what is not decoded is not checked.
    pub fn find_parts(
        page: PageId,
        finest: bool,
        record: &[u8],
        first: u8,
        last: u8,
    ) -> Result<Option<Bytes<usize>>, PageError> {
        let tag = Tag::read(page, finest, record)?;
        if first > last || last > last_part(finest) {
            return Ok(None);
        }
        if tag.codec == Codec::Plain {
            return Ok(Self::read(page, finest, record)?.part_bytes(first, last));
        }
        let to_end = last == last_part(finest);
        let known = if to_end {
            first.saturating_sub(1)
        } else {
            last
        };
        let ends = match known {
            0 => vec![1],
            _ => codec1::part_ends(page, finest, tag, record, known)?,
        };
        let start = first.checked_sub(1).map(|before| ends[usize::from(before)]);
        let end = if to_end {
            record.len()
        } else {
            ends[usize::from(last)]
        };
        Ok(Some(start.unwrap_or(0)..end))
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

fn read_plain(
    page: PageId,
    finest: bool,
    has_holes: bool,
    record: &[u8],
) -> Result<RecordHeader, PageError> {
    let mut reader = Reader::new(record);
    let short = |field| move || PageError::Short { page, field };
    let value = |field, found, allowed| PageError::Value {
        page,
        field,
        found,
        allowed,
    };
    reader.u8().ok_or_else(short("tag"))?;
    let mut lengths = Vec::with_capacity(6);
    for _ in 1..=last_part(finest) {
        let length = reader.varint().ok_or_else(short("part length"))?;
        if length > MAX_RECORD_BYTES as u64 {
            return Err(value("part length", length as i64, "0..=8192"));
        }
        lengths.push(length as usize);
    }
    let range = match has_holes {
        true => read_range(page, &mut reader)?,
        false => Range::EMPTY,
    };
    let ends = ends_of(reader.position(), &lengths);
    match ends.last() {
        Some(&end) if end > MAX_RECORD_BYTES => Err(value("record length", end as i64, "0..=8192")),
        _ => Ok(RecordHeader { range, ends }),
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
