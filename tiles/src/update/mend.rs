//! One level of an update: families in which something changed, made anew from what is left of
//! the old pages and from what changed. A page in which nothing changed keeps its record, byte for
//! byte, and a family in which no record changed is not written at all.

use super::old::{self, Pages};
use crate::build::{Band, BuildError, FAMILY_CELLS, Level, Slots};
use crate::dataset::{Dataset, FamilyBytes, FamilyId, PageReader};
use escarp_proto::geometry::{PAGE_CELLS, PAGE_SLOTS, PageId, Slot};
use escarp_proto::page::ChildSlot;
use std::collections::{BTreeMap, HashMap};

/// What changed of a level: samples by column and row, and what is known of the level below.
#[derive(Debug, Default)]
pub(super) struct Change {
    pub(super) samples: HashMap<(u32, u32), i32>,
    pub(super) slots: HashMap<PageId, ChildSlot>,
}

/// A family after the change.
#[derive(Debug)]
pub(super) struct Mended {
    pub(super) family: FamilyId,
    /// Its records, if any changed; `None` inside if none is left.
    pub(super) bytes: Option<Option<FamilyBytes>>,
    /// Records that it had before.
    pub(super) pages_before: usize,
    /// Records that are new or changed.
    pub(super) pages_changed: u64,
    /// Slots of the level above that changed.
    pub(super) slots: Vec<(PageId, ChildSlot)>,
}

/// Makes some pages of a family anew; the others stay.
pub(super) fn mend(
    dataset: &Dataset,
    reader: &mut PageReader<'_>,
    level: &Level,
    (column, row): (usize, usize),
    (band, slots): (&Band, Option<&Slots>),
    is_dirty: impl Fn(PageId) -> bool,
) -> Result<Mended, BuildError> {
    let (columns, rows) = level.pages();
    let first = PageId::new(
        level.level(),
        (column * PAGE_CELLS) as u32,
        (row * PAGE_CELLS) as u32,
    );
    let family = FamilyId::of(first.unwrap_or(PageId::ROOT));
    let before = old::records(dataset, family)?;
    let mut after = Vec::new();
    let mut mended = Mended {
        family,
        bytes: None,
        pages_before: before.iter().flatten().count(),
        pages_changed: 0,
        slots: Vec::new(),
    };
    for slot in (0..PAGE_SLOTS).map(|i| Slot::from_index(i as u8)) {
        let Some(page) = family.page(slot) else {
            continue;
        };
        let (x, y) = (page.square().x as usize, page.square().y as usize);
        if x >= columns || y >= rows {
            continue;
        }
        let before = before[slot.index()];
        if !is_dirty(page) {
            after.extend(before.map(|record| (slot, record.to_vec())));
            continue;
        }
        let (record, own) = level.record(band, page, slot.position().1, slots)?;
        if old::slot_of(reader, page)?.is_some_and(|known| known != own) {
            mended.slots.push((page, own));
        }
        mended.pages_changed += u64::from(record.as_deref() != before);
        after.extend(record.map(|record| (slot, record)));
    }
    if mended.pages_changed > 0 {
        mended.bytes = Some(FamilyBytes::encode(family, &after));
    }
    Ok(mended)
}

/// The pages of a level that a change below reaches, by column and row of their family.
pub(super) fn reached(level: &Level, change: &Change) -> BTreeMap<(usize, usize), Vec<PageId>> {
    let (columns, rows) = level.pages();
    let mut reached: BTreeMap<(usize, usize), Vec<PageId>> = BTreeMap::new();
    let mut add = |page: PageId| {
        let square = page.square();
        let side = PAGE_CELLS as u32;
        let family = ((square.x / side) as usize, (square.y / side) as usize);
        reached.entry(family).or_default().push(page);
    };
    for &(x, y) in change.samples.keys() {
        for row in pages_at(y as usize, rows) {
            for column in pages_at(x as usize, columns) {
                PageId::new(level.level(), column as u32, row as u32).map(&mut add);
            }
        }
    }
    for page in change.slots.keys() {
        if let Some((parent, _)) = page.parent() {
            add(parent);
        }
    }
    for pages in reached.values_mut() {
        pages.sort_unstable();
        pages.dedup();
    }
    reached
}

/// Columns of pages that have a column of samples, at most two.
pub(super) fn pages_at(sample: usize, count: usize) -> std::ops::Range<usize> {
    let last = sample / PAGE_CELLS;
    let first = match sample % PAGE_CELLS {
        0 => last.saturating_sub(1),
        _ => last,
    };
    first..(last + 1).min(count)
}

/// Makes anew the pages of a family of a coarser level that a change reaches.
pub(super) fn mend_above(
    dataset: &Dataset,
    level: &Level,
    at: (usize, usize),
    pages: &[PageId],
    change: &Change,
) -> Result<Mended, BuildError> {
    let mut reader = PageReader::new(dataset);
    let mut band = old::samples(&mut reader, level, at, spanned(pages))?;
    let mut slots = old::slots(&mut reader, at, pages)?;
    let (side, south) = (PAGE_CELLS as u32, at.1 * FAMILY_CELLS);
    for page in pages {
        let square = page.square();
        for y in square.y * side..=(square.y + 1) * side {
            for x in square.x * side..=(square.x + 1) * side {
                if let Some(&height) = change.samples.get(&(x, y)) {
                    let at = (y as usize - south) * band.stride + x as usize - band.west;
                    band.samples[at] = height;
                }
            }
        }
        for child in (0..=u8::MAX).filter_map(|i| page.child(Slot::from_index(i))) {
            if let Some(&slot) = change.slots.get(&child) {
                let below = child.square();
                slots.set(below.x as usize, below.y as usize, slot);
            }
        }
    }
    let is_dirty = |page| pages.binary_search(&page).is_ok();
    mend(
        dataset,
        &mut reader,
        level,
        at,
        (&band, Some(&slots)),
        is_dirty,
    )
}

/// The smallest rectangle that holds some pages.
fn spanned(pages: &[PageId]) -> Pages {
    let span = |of: fn(&PageId) -> u32| {
        let first = pages.iter().map(of).min().unwrap_or(0) as usize;
        let last = pages.iter().map(of).max().unwrap_or(0) as usize;
        [first, last + 1]
    };
    Pages {
        x: span(|page| page.square().x),
        y: span(|page| page.square().y),
    }
}
