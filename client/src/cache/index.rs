//! Which pages are on disk, and where. In memory, bounded.

use super::segment::Head;
use escarp_proto::wire::Have;
use std::collections::HashMap;

/// Pages of a dataset that are known at a time; about 100 bytes each.
pub(super) const MAX_PAGES: usize = 1 << 20;

/// Where a record lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Piece {
    /// By [`Index::segments`].
    pub(super) segment: u32,
    pub(super) offset: u32,
    pub(super) head: Head,
}

/// A page: records whose parts follow each other, from the first.
#[derive(Debug, Clone)]
pub(super) struct Entry {
    pub(super) revision: u32,
    /// Of the manifest that it is known to belong to.
    tag: u64,
    pub(super) pieces: Vec<Piece>,
}

impl Entry {
    pub(super) fn last_part(&self) -> u8 {
        self.pieces.last().map_or(0, |piece| piece.head.last_part)
    }

    fn place(&self) -> (u32, u32) {
        let last = self.pieces.last();
        last.map_or((0, 0), |piece| (piece.segment, piece.offset))
    }
}

/// The pages of one address.
#[derive(Debug, Default)]
pub(super) struct Index {
    pages: HashMap<u64, Entry>,
    /// Of the manifest of this session.
    tag: u64,
    /// Whether the disk has been looked through.
    pub(super) is_ready: bool,
    /// The manifest that was kept, if any.
    pub(super) manifest: Option<Vec<u8>>,
    /// What went wrong, until it was told.
    pub(super) trouble: Option<String>,
}

impl Index {
    /// Takes a record over. Records come in the order in which they were written: a newer revision
    /// takes an older one's place, more parts that of fewer.
    pub(super) fn add(&mut self, piece: Piece) {
        let head = piece.head;
        let has_room = self.pages.len() < MAX_PAGES || self.pages.contains_key(&head.page);
        match self.pages.get_mut(&head.page) {
            Some(entry) if head.confirms() && entry.revision == head.revision => {
                entry.tag = head.tag;
            }
            _ if head.confirms() => {}
            Some(entry) if head.first_part > 0 => {
                let joins = entry.revision == head.revision
                    && entry.last_part().checked_add(1) == Some(head.first_part);
                if joins {
                    entry.pieces.push(piece);
                }
            }
            Some(entry)
                if entry.revision == head.revision && entry.last_part() > head.last_part =>
            {
                entry.tag = head.tag;
            }
            _ if head.first_part == 0 && has_room => {
                let entry = Entry {
                    revision: head.revision,
                    tag: head.tag,
                    pieces: vec![piece],
                };
                self.pages.insert(head.page, entry);
            }
            _ => {}
        }
    }

    /// Whether a chunk says something new that can be kept.
    pub(super) fn lacks(&self, head: &Head) -> bool {
        match (self.pages.get(&head.page), head.first_part) {
            (None, first) => first == 0 && self.pages.len() < MAX_PAGES,
            (Some(entry), 0) => {
                entry.revision != head.revision
                    || entry.tag != head.tag
                    || entry.last_part() < head.last_part
            }
            (Some(entry), first) => {
                entry.revision == head.revision && entry.last_part().checked_add(1) == Some(first)
            }
        }
    }

    /// Whether a confirmation says something new.
    pub(super) fn confirms(&self, head: &Head) -> bool {
        let entry = self.pages.get(&head.page);
        entry.is_some_and(|entry| entry.revision == head.revision && entry.tag != head.tag)
    }

    pub(super) fn get(&self, page: u64) -> Option<&Entry> {
        self.pages.get(&page)
    }

    /// The last part of a page that is known to belong to this session's manifest.
    pub(super) fn current(&self, page: u64) -> Option<u8> {
        let entry = self.pages.get(&page)?;
        (entry.tag == self.tag).then(|| entry.last_part())
    }

    pub(super) fn tag(&self) -> u64 {
        self.tag
    }

    pub(super) fn set_tag(&mut self, tag: u64) {
        self.tag = tag;
    }

    pub(super) fn remove(&mut self, page: u64) {
        self.pages.remove(&page);
    }

    /// What was written last, newest first.
    pub(super) fn newest(&self, most: usize) -> Vec<Have> {
        let mut all: Vec<_> = self.pages.iter().collect();
        let newest = |(_, entry): &(&u64, &Entry)| std::cmp::Reverse(entry.place());
        if all.len() > most {
            all.select_nth_unstable_by_key(most, newest);
            all.truncate(most);
        }
        all.sort_unstable_by_key(newest);
        all.into_iter()
            .map(|(&page, entry)| Have {
                page,
                revision: entry.revision,
                parts: entry.last_part(),
            })
            .collect()
    }

    pub(super) fn len(&self) -> usize {
        self.pages.len()
    }
}
