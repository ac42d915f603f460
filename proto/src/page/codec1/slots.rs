//! Part 5: the child slots, each from its neighbours in the west and in the south.

use super::rans::Coder;
use super::symbols::{KIND, SLOT, plain, scaled, unzigzag, zigzag};
use crate::err8::Err8;
use crate::geometry::{PAGE_CELLS, PAGE_LEVELS, PAGE_SLOTS};
use crate::page::{ChildSlot, Page, PageError, Range, codec0};

pub(super) fn code(page: &mut Page, coder: &mut impl Coder) -> Result<(), PageError> {
    let blank = || Box::new([ChildSlot::Empty; PAGE_SLOTS]);
    let mut slots = page.slots.take().unwrap_or_else(blank);
    for at in 0..PAGE_SLOTS {
        let west = (at % PAGE_CELLS > 0).then(|| slots[at.wrapping_sub(1)]);
        let south = at.checked_sub(PAGE_CELLS).map(|below| slots[below]);
        let kind = match page.has_holes() {
            true => kind(slots[at], west, south, coder),
            false => 0,
        };
        let cut = match page.has_cuts && kind == 0 {
            true => cut(slots[at], west, south, coder),
            false => 0,
        };
        slots[at] = match (kind, cut) {
            (0, 0) => ChildSlot::Full(error(page, slots[at], west, south, coder)?),
            (0, 1) => ChildSlot::Cut(error(page, slots[at], west, south, coder)?),
            (0, cut) => return Err(page.value("slot's cut", i64::from(cut), "0 or 1")),
            (1, _) => ChildSlot::Empty,
            (2, _) => ChildSlot::Mixed(range(page, slots[at], coder)?),
            (kind, _) => return Err(page.value("slot kind", i64::from(kind), "0..=2")),
        };
    }
    page.slots = Some(slots);
    match page.has_cuts && !page.any_cut() {
        true => Err(page.value("slots that are cut", 0, "at least 1, by its flags")),
        false => Ok(()),
    }
}

fn kind(
    slot: ChildSlot,
    west: Option<ChildSlot>,
    south: Option<ChildSlot>,
    coder: &mut impl Coder,
) -> u32 {
    let of = |slot: ChildSlot| slot.kind() as usize;
    coder.symbol(kind_table(west.map(of), south.map(of)), slot.kind() as u32)
}

/// Whether a full slot is cut: as likely to be as its neighbours as kinds are, in their tables.
fn cut(
    slot: ChildSlot,
    west: Option<ChildSlot>,
    south: Option<ChildSlot>,
    coder: &mut impl Coder,
) -> u32 {
    let of = |slot: ChildSlot| match slot {
        ChildSlot::Full(_) => 0,
        ChildSlot::Cut(_) => 1,
        _ => 2,
    };
    let is_cut = u32::from(matches!(slot, ChildSlot::Cut(_)));
    coder.symbol(kind_table(west.map(of), south.map(of)), is_cut)
}

/// On the page's own edge, the other neighbour stands for the one beyond.
fn kind_table(west: Option<usize>, south: Option<usize>) -> usize {
    let (west, south) = match (west, south) {
        (Some(west), Some(south)) => (west, south),
        (Some(only), None) | (None, Some(only)) => (only, only),
        (None, None) => (2, 2),
    };
    KIND + 3 * west + south
}

fn error(
    page: &Page,
    slot: ChildSlot,
    west: Option<ChildSlot>,
    south: Option<ChildSlot>,
    coder: &mut impl Coder,
) -> Result<Err8, PageError> {
    let of = |slot: Option<ChildSlot>| match slot {
        Some(ChildSlot::Full(error) | ChildSlot::Cut(error)) => Some(i32::from(error.0)),
        _ => None,
    };
    let (likely, context) = match (of(west), of(south)) {
        (Some(a), Some(b)) => {
            let context = match (a - b).abs() {
                0..=2 => 0,
                3..=6 => 1,
                7..=14 => 2,
                _ => 3,
            };
            ((a + b + 1) >> 1, context)
        }
        (Some(only), None) | (None, Some(only)) => (only, 4),
        (None, None) => (i32::from(page.rest[PAGE_LEVELS as usize - 1].0), 4),
    };
    let own = match slot {
        ChildSlot::Full(error) | ChildSlot::Cut(error) => i32::from(error.0),
        _ => 0,
    };
    let more = unzigzag(scaled(coder, SLOT + context, 0, zigzag(own - likely)));
    let found = likely.wrapping_add(more);
    match u8::try_from(found) {
        Ok(code) => Ok(Err8(code)),
        Err(_) => Err(page.value("slot error", i64::from(found), "0..=255")),
    }
}

fn range(page: &Page, slot: ChildSlot, coder: &mut impl Coder) -> Result<Range, PageError> {
    let (own, whole) = match slot {
        ChildSlot::Mixed(own) => (own, page.range),
        _ => (Range::EMPTY, page.range),
    };
    let above = plain(coder, own.lo.wrapping_sub(whole.lo) as u32);
    let span = plain(coder, own.span());
    let lo = i64::from(whole.lo) + i64::from(above);
    let range = codec0::checked_range(page.id, lo, u64::from(span))?;
    match whole.contains(range) {
        true => Ok(range),
        false => Err(page.value("slot range", lo, "the page's range")),
    }
}
