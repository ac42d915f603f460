//! What a dataset has of a part of a level: samples, slots, records.

use crate::build::{Band, FAMILY_CELLS, HOLE, Level, Slots};
use crate::dataset::{Dataset, DatasetError, FamilyId, PageReader};
use escarp_proto::geometry::{PAGE_CELLS, PAGE_SAMPLES, PAGE_SLOTS, PageId, Slot};
use escarp_proto::page::ChildSlot;

/// Columns and rows of pages, the ends not included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Pages {
    pub(crate) x: [usize; 2],
    pub(crate) y: [usize; 2],
}

/// The records of a family by slot.
pub(crate) type Records<'a> = Vec<Option<&'a [u8]>>;

/// The records of a family, each checked, by slot; and how many there are.
pub(crate) fn records(dataset: &Dataset, family: FamilyId) -> Result<Records<'_>, DatasetError> {
    let mut records = vec![None; PAGE_SLOTS];
    let Some(entry) = dataset.find(family) else {
        return Ok(records);
    };
    for record in dataset.family(&entry)?.records() {
        let record = record?;
        let slot = record.page.parent().map_or(0, |(_, slot)| slot.index());
        records[slot] = Some(record.bytes);
    }
    Ok(records)
}

/// What the level above knows of a page; `None` of the root.
pub(crate) fn slot_of(
    reader: &mut PageReader<'_>,
    page: PageId,
) -> Result<Option<ChildSlot>, DatasetError> {
    let Some((parent, slot)) = page.parent() else {
        return Ok(None);
    };
    Ok(Some(reader.page(parent)?.slot(slot)))
}

/// The samples of a family's band that lie in some pages or at their borders; the others are
/// holes. A sample that pages share may be in some of them only, as those without a surface are
/// not stored: so the pages around count as well.
pub(crate) fn samples(
    reader: &mut PageReader<'_>,
    level: &Level,
    (column, row): (usize, usize),
    pages: Pages,
) -> Result<Band, DatasetError> {
    let west = (column * FAMILY_CELLS).saturating_sub(1);
    let south = row * FAMILY_CELLS;
    let stride = (column + 1) * FAMILY_CELLS + 1 - west;
    let mut samples = vec![HOLE; stride * (FAMILY_CELLS + 1)];
    let around =
        |[first, end]: [usize; 2], count: usize| first.saturating_sub(1)..(end + 1).min(count);
    let (columns, rows) = level.pages();
    for y in around(pages.y, rows) {
        for x in around(pages.x, columns) {
            let Some(id) = PageId::new(level.level(), x as u32, y as u32) else {
                continue;
            };
            let page = reader.page(id)?;
            for i in (0..PAGE_SAMPLES * PAGE_SAMPLES).filter(|&i| page.is_valid(i)) {
                let x = (x * PAGE_CELLS + i % PAGE_SAMPLES).checked_sub(west);
                let y = (y * PAGE_CELLS + i / PAGE_SAMPLES).checked_sub(south);
                if let (Some(x), Some(y)) = (x, y)
                    && x < stride
                    && y <= FAMILY_CELLS
                {
                    samples[y * stride + x] = page.height(i);
                }
            }
        }
    }
    Ok(Band {
        west,
        stride,
        samples,
    })
}

/// The slots of some pages of a family: what they know of the level below.
pub(crate) fn slots(
    reader: &mut PageReader<'_>,
    (column, row): (usize, usize),
    pages: &[PageId],
) -> Result<Slots, DatasetError> {
    let first = (column * FAMILY_CELLS, row * FAMILY_CELLS);
    let mut slots = Slots::window(first, FAMILY_CELLS, FAMILY_CELLS);
    for &id in pages {
        let page = reader.page(id)?;
        for slot in (0..=u8::MAX).map(Slot::from_index) {
            if let Some(child) = id.child(slot) {
                let below = child.square();
                slots.set(below.x as usize, below.y as usize, page.slot(slot));
            }
        }
    }
    Ok(slots)
}
