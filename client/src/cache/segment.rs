//! The bytes of a segment: its head, and records. Safe on any bytes.
//!
//! | offset | bytes | what |
//! |---|---|---|
//! | 0 | 8 | `ESCARPC1` |
//! | 8 | 2 | length of the address |
//! | 10 | | the address |
//! | | 4 | CRC-32C of all before |
//!
//! A record: page's key (8), revision (4), first and last part (1 each), length (2), the tag of the
//! manifest that it came with (8), CRC-32C of these (4); the parts; CRC-32C of all before (4).
//! Part 0 of a page is never empty, so a record of it without bytes says something else: the page
//! as it is kept, if it has that revision, belongs to the manifest of that tag as well.

use escarp_dataset::checksum::crc32c;
use escarp_proto::page::MAX_RECORD_BYTES;

const MAGIC: &[u8; 8] = b"ESCARPC1";
/// Bytes of a record before its parts.
pub(super) const RECORD_HEAD: usize = 8 + 4 + 1 + 1 + 2 + 8 + 4;
const CRC: usize = 4;
/// No address is longer.
pub(super) const MAX_ADDRESS: usize = 8192;

/// What a record says of itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Head {
    pub(super) page: u64,
    pub(super) revision: u32,
    pub(super) first_part: u8,
    pub(super) last_part: u8,
    pub(super) length: u16,
    pub(super) tag: u64,
}

/// The head of a segment of an address.
pub(super) fn segment_head(address: &str) -> Vec<u8> {
    let address = &address.as_bytes()[..address.len().min(MAX_ADDRESS)];
    let mut bytes = MAGIC.to_vec();
    bytes.extend((address.len() as u16).to_le_bytes());
    bytes.extend(address);
    bytes.extend(crc32c(&bytes).to_le_bytes());
    bytes
}

impl Head {
    /// Whether it says of a page that is kept that it belongs to another manifest, too.
    pub(super) const fn confirms(&self) -> bool {
        self.length == 0 && self.first_part == 0
    }

    fn encode(&self) -> [u8; RECORD_HEAD] {
        let mut bytes = [0; RECORD_HEAD];
        bytes[..8].copy_from_slice(&self.page.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.revision.to_le_bytes());
        bytes[12] = self.first_part;
        bytes[13] = self.last_part;
        bytes[14..16].copy_from_slice(&self.length.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.tag.to_le_bytes());
        let crc = crc32c(&bytes[..24]);
        bytes[24..].copy_from_slice(&crc.to_le_bytes());
        bytes
    }

    /// Reads a head; `None` if it is damaged, or states what no record can have.
    fn decode(bytes: &[u8; RECORD_HEAD]) -> Option<Head> {
        let (fields, crc) = bytes.split_last_chunk::<CRC>()?;
        if crc32c(fields) != u32::from_le_bytes(*crc) {
            return None;
        }
        let number = |from: usize| Some(u64::from_le_bytes(*fields.get(from..)?.first_chunk()?));
        let head = Head {
            page: number(0)?,
            revision: u32::from_le_bytes(*fields.get(8..)?.first_chunk()?),
            first_part: fields[12],
            last_part: fields[13],
            length: u16::from_le_bytes([fields[14], fields[15]]),
            tag: number(16)?,
        };
        let is_sound =
            usize::from(head.length) <= MAX_RECORD_BYTES && head.first_part <= head.last_part;
        is_sound.then_some(head)
    }
}

/// A record's bytes.
pub(super) fn encode(head: &Head, parts: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(RECORD_HEAD + parts.len() + CRC);
    bytes.extend(head.encode());
    bytes.extend(parts);
    bytes.extend(crc32c(&bytes).to_le_bytes());
    bytes
}

/// Length of a record with so many bytes of parts.
pub(super) fn record_len(parts: u16) -> usize {
    RECORD_HEAD + usize::from(parts) + CRC
}

/// The parts of a whole record, all checked; `None` if it is not the one that is meant.
pub(super) fn decode<'a>(bytes: &'a [u8], meant: &Head) -> Option<&'a [u8]> {
    let (head, _) = bytes.split_first_chunk::<RECORD_HEAD>()?;
    let (all, crc) = bytes.split_last_chunk::<CRC>()?;
    let is_whole = crc32c(all) == u32::from_le_bytes(*crc);
    (is_whole && Head::decode(head)? == *meant).then(|| &all[RECORD_HEAD..])
}

/// What a segment has, by the heads of its records; parts are checked when they are read.
#[derive(Debug, Default)]
pub(super) struct Scan {
    /// Offset and head of each record.
    pub(super) records: Vec<(u32, Head)>,
    /// Where the last one ends.
    pub(super) end: usize,
    /// Whether nothing follows it.
    pub(super) is_clean: bool,
}

/// Looks through a segment of an address, up to the first head that is damaged or cut short.
/// `None` if it is of another address.
pub(super) fn scan(bytes: &[u8], address: &str) -> Option<Scan> {
    let head = segment_head(address);
    let mut rest = bytes.strip_prefix(&head[..])?;
    let mut found = Scan {
        end: head.len(),
        ..Scan::default()
    };
    while let Some((head, _)) = rest.split_first_chunk::<RECORD_HEAD>() {
        let Some(head) = Head::decode(head) else {
            break;
        };
        let length = record_len(head.length);
        let Some((_, after)) = rest.split_at_checked(length) else {
            break;
        };
        let Ok(offset) = u32::try_from(found.end) else {
            break;
        };
        found.records.push((offset, head));
        found.end += length;
        rest = after;
    }
    found.is_clean = rest.is_empty();
    Some(found)
}
