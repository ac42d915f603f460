//! From a wish to the bytes that answer it.

use super::queue::Wish;
use crate::source::{PageSource, Revised};
use escarp_proto::page::{RecordHeader, last_part as last_part_of};
use escarp_proto::wire::{Chunk, MissReason};

/// At most so many bytes of a Pages message are not chunks: its tag and its count.
pub(super) const PAGES_OVERHEAD: usize = 1 + 3;
/// At most so many bytes of a chunk are not parts: key, revision, two parts, length.
const CHUNK_OVERHEAD: usize = 9 + 5 + 1 + 1 + 3;

/// An upper bound of a chunk's length in a Pages message, bytes.
pub(super) fn encoded_len(chunk: &Chunk) -> usize {
    CHUNK_OVERHEAD + chunk.bytes.len()
}

/// Reads a page's record and cuts the wanted parts out of it, as far as it has them. May block on
/// the disk.
pub(super) fn chunk_of(source: &dyn PageSource, wish: Wish) -> Result<Chunk, MissReason> {
    let Wish {
        page, first_part, ..
    } = wish;
    let damaged = |why: String| {
        tracing::debug!(%page, why, "record not sent");
        MissReason::Damaged
    };
    let record = source
        .record(page)
        .map_err(|error| damaged(error.to_string()))?;
    let Revised {
        revision,
        bytes: record,
    } = record.ok_or(MissReason::NotFound)?;
    let finest = source.manifest().grid_levels.is_finest(page);
    let last_part = wish.last_part.min(last_part_of(finest));
    if first_part > last_part {
        return Err(MissReason::NotFound);
    }
    let parts = RecordHeader::find_parts(page, finest, &record, first_part, last_part)
        .map_err(|error| damaged(error.to_string()))?
        .ok_or(MissReason::NotFound)?;
    let bytes = record
        .get(parts)
        .ok_or_else(|| damaged("record cut short".into()))?;
    Ok(Chunk {
        page: page.key(),
        revision,
        first_part,
        last_part,
        bytes: bytes.to_vec(),
    })
}
