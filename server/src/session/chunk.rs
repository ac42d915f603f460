//! From a wish to the bytes that answer it.

use super::queue::Wish;
use crate::source::{PageSource, Revised};
use escarp_proto::page::{RecordHeader, last_part as last_part_of};
use escarp_proto::wire::{Chunk, MissReason, PAGES_FRAME};

/// At most so many bytes of a Pages message are not chunks: its tag and its count.
pub(super) const PAGES_OVERHEAD: usize = 1 + 3;
/// At most so many bytes of a chunk are not parts: key, revision, numbers of parts, length.
const CHUNK_OVERHEAD: usize = 9 + 4 + 1 + 3;
/// The first messages are no longer than this, bytes, so that each comes with the packets of one
/// round trip while TCP's window is small,
const FIRST_FRAME: usize = 4 << 10;

/// An upper bound of a chunk's length in a Pages message, bytes.
pub(super) fn encoded_len(chunk: &Chunk) -> usize {
    CHUNK_OVERHEAD + chunk.bytes.len()
}

/// How many bytes to fill a Pages message with, after so many bytes of pages in all: messages grow
/// as TCP's window does.
pub(super) fn frame_bytes(sent_bytes: u64) -> usize {
    usize::try_from(sent_bytes).map_or(PAGES_FRAME, |sent| sent.clamp(FIRST_FRAME, PAGES_FRAME))
}

/// Brings the chunks of a message into the order in which they take fewest bytes, by keys; coarser
/// pages stay before finer ones. Parts of a page that follow each other become one chunk.
pub(super) fn arranged(mut chunks: Vec<Chunk>) -> Vec<Chunk> {
    chunks.sort_by_key(|chunk| (chunk.page, chunk.first_part));
    chunks.dedup_by(|next, chunk| {
        let follows = next.page == chunk.page
            && next.revision == chunk.revision
            && next.first_part == chunk.last_part + 1;
        if follows {
            chunk.last_part = next.last_part;
            chunk.bytes.append(&mut next.bytes);
        }
        follows
    });
    chunks
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn chunk(page: u64, first_part: u8, last_part: u8) -> Chunk {
        Chunk {
            page,
            revision: page as u32,
            first_part,
            last_part,
            bytes: (first_part..=last_part).collect(),
        }
    }

    proptest! {
        #[test]
        fn whatever_the_order_every_part_is_in_one_place_and_pages_come_by_keys(
            cuts in prop::collection::vec((0..6u8, 0..6u8), 0..20),
            seed: u64,
        ) {
            let pieces = cuts.iter().zip(0u64..).flat_map(|(&(a, b), page)| {
                let (first, last) = (a.min(b), a.max(b));
                [chunk(page, 0, first), chunk(page, first + 1, last + 1)]
            });
            let mut pieces: Vec<_> = pieces.collect();
            pieces.sort_by_key(|chunk| {
                (chunk.page ^ seed).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ u64::from(chunk.first_part)
            });
            let arranged = arranged(pieces);
            let whole: Vec<_> = cuts.iter().zip(0u64..).map(|(&(a, b), page)| chunk(page, 0, a.max(b) + 1)).collect();
            prop_assert_eq!(arranged, whole);
        }
    }

    #[test]
    fn parts_that_do_not_follow_or_are_of_another_revision_stay_apart() {
        let other = Chunk {
            revision: 9,
            ..chunk(2, 1, 2)
        };
        let pieces = vec![chunk(1, 0, 1), chunk(1, 3, 4), chunk(2, 0, 0), other];
        assert_eq!(arranged(pieces.clone()), pieces);
    }

    #[test]
    fn messages_grow_with_what_was_sent_up_to_the_limit() {
        let sizes = [0, 4096, 6000, 1 << 14, u64::MAX].map(frame_bytes);
        assert_eq!(sizes, [4096, 4096, 6000, PAGES_FRAME, PAGES_FRAME]);
    }
}
