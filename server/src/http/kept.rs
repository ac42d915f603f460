//! What was asked for not long ago, as it was read and checked, so that it is neither read nor
//! checked again while others ask for it.
//!
//! What stays is chosen by quick_cache (S3-FIFO), so a client that asks for everything once does
//! not drive out what all ask for. Entries of generations that are hosted no longer are never
//! asked for, and go first.

use axum::body::Bytes;
use axum::http::HeaderValue;
use escarp_proto::geometry::PageId;
use quick_cache::Weighter;
use quick_cache::sync::Cache;

/// Memory that an entry takes beyond its content, bytes: slots of the table, tag, allocations.
const ENTRY_BYTES: u64 = 256;
/// Of a content with its entry, bytes: only for how large the tables are likely to be.
const TYPICAL_BYTES: u64 = 4096;

/// A dataset's bytes, one kind of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Thing {
    Manifest,
    /// The record of a page.
    Page(PageId),
    /// The family below a page.
    Pack(PageId),
}

/// Bytes, and the tag that names them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Content {
    /// In its quotes.
    pub tag: HeaderValue,
    pub bytes: Bytes,
}

impl Content {
    /// Bytes that a checksum names.
    pub(super) fn of(checksum: u32, bytes: Bytes) -> Content {
        Content::named(&format!("{checksum:08x}"), bytes)
    }

    /// Bytes that a name of letters, digits and `-` stands for.
    pub(super) fn named(name: &str, bytes: Bytes) -> Content {
        // What could not stand in a header would have no tag, and match nothing.
        let tag = HeaderValue::try_from(format!("\"{name}\""));
        Content {
            tag: tag.unwrap_or(HeaderValue::from_static("")),
            bytes,
        }
    }
}

/// The number of a [`Published`](crate::published::Published), and what of it.
type Key = (u64, Thing);

/// Contents in memory, up to a number of bytes.
pub(crate) struct Kept(Option<Cache<Key, Content, Size>>);

impl Kept {
    /// Room for so many bytes; 0 keeps nothing.
    pub(crate) fn new(bytes: u64) -> Kept {
        let items = usize::try_from(bytes / TYPICAL_BYTES).unwrap_or(usize::MAX);
        Kept((bytes > 0).then(|| Cache::with_weighter(items, bytes, Size)))
    }

    pub(super) fn get(&self, published: u64, what: Thing) -> Option<Content> {
        self.0.as_ref()?.get(&(published, what))
    }

    pub(super) fn keep(&self, published: u64, what: Thing, content: &Content) {
        if let Some(cache) = &self.0 {
            cache.insert((published, what), content.clone());
        }
    }
}

/// Bytes that an entry takes.
#[derive(Debug, Clone)]
struct Size;

impl Weighter<Key, Content> for Size {
    fn weight(&self, _: &Key, content: &Content) -> u64 {
        ENTRY_BYTES + content.bytes.len() as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn page(x: u32) -> Thing {
        Thing::Page(PageId::new(16, x, 0).unwrap())
    }

    #[test]
    fn what_is_kept_is_given_for_its_generation_and_kind_alone() {
        let kept = Kept::new(1 << 20);
        let content = Content::of(0xc0ffee, Bytes::from_static(b"record"));
        assert_eq!(content.tag, "\"00c0ffee\"");
        kept.keep(7, page(1), &content);
        assert_eq!(kept.get(7, page(1)), Some(content));
        assert_eq!(kept.get(8, page(1)), None);
        assert_eq!(kept.get(7, page(2)), None);
        assert_eq!(
            kept.get(7, Thing::Pack(PageId::new(16, 1, 0).unwrap())),
            None
        );
    }

    #[test]
    fn no_more_is_kept_than_there_is_room_for() {
        let (room, length) = (1 << 20, 1000);
        let kept = Kept::new(room);
        for x in 0..4000 {
            kept.keep(1, page(x), &Content::of(x, vec![x as u8; length].into()));
        }
        let found = (0..4000).filter(|&x| kept.get(1, page(x)).is_some());
        let bytes = found.count() as u64 * (length as u64 + ENTRY_BYTES);
        assert!((room / 2..=room).contains(&bytes), "{bytes}");
        let none = Kept::new(0);
        none.keep(1, page(1), &Content::of(1, Bytes::new()));
        assert_eq!(none.get(1, page(1)), None);
    }

    #[test]
    fn what_is_asked_for_again_outlasts_what_is_asked_for_once() {
        let kept = Kept::new(1 << 20);
        let often = Content::of(1, vec![1; 1000].into());
        kept.keep(1, page(0), &often);
        for x in 1..20_000 {
            assert_eq!(kept.get(1, page(0)).as_ref(), Some(&often), "{x}");
            kept.keep(1, page(x), &Content::of(x, vec![0; 1000].into()));
        }
    }
}
