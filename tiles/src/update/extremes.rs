//! The lowest and the highest height of a dataset outside some rectangles, exactly: pages are
//! looked into in the order of what their bounds promise, until none can promise more.

use super::place::Rectangle;
use crate::dataset::{Dataset, DatasetError, PageReader};
use escarp_proto::geometry::{PAGE_CELLS, PAGE_SAMPLES, PageId, Slot};
use escarp_proto::page::{ChildSlot, PAGE_AREA, Page};
use std::collections::BinaryHeap;

/// Which end is looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum End {
    Lowest,
    Highest,
}

/// The lowest or highest height of the samples outside all rectangles; `None` if there are none.
pub(super) fn extreme(
    dataset: &Dataset,
    end: End,
    outside: &[Rectangle],
) -> Result<Option<i32>, DatasetError> {
    let mut reader = PageReader::new(dataset);
    let mut best = None;
    // What may be found below a page, the most promising first.
    let mut open = BinaryHeap::from([(i64::MAX, PageId::ROOT)]);
    while let Some((promise, id)) = open.pop() {
        if best.is_some_and(|best| promise <= best) {
            break;
        }
        if is_inside(dataset, id, outside) {
            continue;
        }
        let page = reader.page(id)?;
        let found = samples(dataset, &page, outside).map(|height| end.signed(height));
        best = found.max().max(best);
        if page.is_finest() {
            continue;
        }
        for slot in (0..=u8::MAX).map(Slot::from_index) {
            if let (Some(promise), Some(child)) = (promise_of(&page, slot, end), id.child(slot))
                && best.is_none_or(|best| promise > best)
            {
                open.push((promise, child));
            }
        }
    }
    Ok(best.map(|best| end.signed_back(best)))
}

impl End {
    /// So that the end looked for is the largest.
    const fn signed(self, height: i32) -> i64 {
        match self {
            End::Lowest => -(height as i64),
            End::Highest => height as i64,
        }
    }

    const fn signed_back(self, signed: i64) -> i32 {
        match self {
            End::Lowest => -signed as i32,
            End::Highest => signed as i32,
        }
    }
}

/// Whether all samples of a page lie in one of the rectangles.
fn is_inside(dataset: &Dataset, id: PageId, rectangles: &[Rectangle]) -> bool {
    let (x, y) = dataset.grid().page_origin(id);
    let cells = dataset.grid().square_cells(id.level());
    let inside = |r: &Rectangle| r.contains(x, y) && r.contains(x + cells, y + cells);
    rectangles.iter().any(inside)
}

/// Heights of a page's samples outside all rectangles.
fn samples(dataset: &Dataset, page: &Page, outside: &[Rectangle]) -> impl Iterator<Item = i32> {
    let (x, y) = dataset.grid().page_origin(page.id());
    let stride = dataset.grid().page_stride(page.id());
    (0..PAGE_AREA)
        .filter(move |&i| {
            let x = x + (i % PAGE_SAMPLES) as u32 * stride;
            let y = y + (i / PAGE_SAMPLES) as u32 * stride;
            page.is_valid(i) && !outside.iter().any(|r| r.contains(x, y))
        })
        .map(|i| page.height(i))
}

/// What the samples below a slot can reach at most; `None` if there are none.
fn promise_of(page: &Page, slot: Slot, end: End) -> Option<i64> {
    let (column, row) = slot.position();
    let corner = row * PAGE_SAMPLES + column;
    let corners = [0, 1, PAGE_CELLS + 1, PAGE_CELLS + 2].map(|step| corner + step);
    match page.slot(slot) {
        ChildSlot::Empty => None,
        ChildSlot::Mixed(range) => Some(match end {
            End::Lowest => end.signed(range.lo),
            End::Highest => end.signed(range.hi),
        }),
        ChildSlot::Full(error) | ChildSlot::Cut(error) => {
            let heights = corners.map(|at| end.signed(page.height(at)));
            let reach = i64::from(error.bound());
            heights.into_iter().max().map(|most| most + reach)
        }
    }
}
