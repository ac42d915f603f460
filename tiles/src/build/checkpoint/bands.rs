//! The bytes of a checkpoint: what bands left for the level above, and sums.

use super::super::above::Above;
use super::super::level::Level;
use super::super::quantise::HOLE;
use super::super::rows::Stored;
use escarp_proto::bytes::{Reader, put_varint, put_zigzag};
use escarp_proto::err8::Err8;
use escarp_proto::geometry::PAGE_CELLS;
use escarp_proto::page::{ChildSlot, Kind, MAX_HEIGHT, Range};

/// Appends the sums of what was stored.
pub(super) fn put_stored(stored: Stored, out: &mut Vec<u8>) {
    out.extend(stored.valid_samples.to_le_bytes());
    out.extend(stored.largest_error_m.to_bits().to_le_bytes());
    out.push(u8::from(stored.range.is_some()));
    for height in stored.range.unwrap_or_default() {
        out.extend(height.to_le_bytes());
    }
}

/// Reads what [`put_stored`] wrote of at most so many samples.
pub(super) fn read_stored(reader: &mut Reader<'_>, samples: u64) -> Option<Stored> {
    let (valid_samples, largest_error_m) = (reader.u64()?, f64::from_bits(reader.u64()?));
    let has_range = reader.u8()? == 1;
    let range = [reader.u32()? as i32, reader.u32()? as i32];
    let is_range = range.is_sorted() && range.into_iter().all(is_height);
    let is_error = largest_error_m.is_finite() && largest_error_m >= 0.0;
    let fits = valid_samples <= samples && is_error && (is_range || !has_range);
    fits.then_some(Stored {
        valid_samples,
        largest_error_m,
        range: has_range.then_some(range),
    })
}

fn is_height(height: i32) -> bool {
    (-MAX_HEIGHT..=MAX_HEIGHT).contains(&height)
}

/// Rows of page corners that a band adds, and rows of slots. The northern row of corners is that
/// of the band before.
fn rows_of(level: &Level, number: usize, above: &Above) -> [std::ops::Range<usize>; 2] {
    let first = number * PAGE_CELLS;
    let is_northern = number + 1 == level.bands();
    let corners = first + PAGE_CELLS + usize::from(is_northern);
    [
        first..corners.min(above.height),
        first..(first + PAGE_CELLS).min(above.height - 1),
    ]
}

/// Appends what a band left: heights as differences along rows, slots in runs of a kind.
pub(super) fn put_band(level: &Level, number: usize, above: &Above, out: &mut Vec<u8>) {
    let [corners, slots] = rows_of(level, number, above);
    for row in corners {
        let mut last = 0;
        for &height in &above.heights[row * above.width..][..above.width] {
            put_zigzag(i64::from(height) - last, out);
            last = i64::from(height);
        }
    }
    for row in slots {
        let slots: Vec<ChildSlot> = (0..above.width - 1)
            .map(|column| above.slots.get(column, row))
            .collect();
        for run in slots.chunk_by(|a, b| sort_of(*a) == sort_of(*b)) {
            out.push(sort_of(run[0]));
            put_varint(run.len() as u64, out);
            run.iter().for_each(|slot| put_slot(*slot, out));
        }
    }
}

/// Stands for a slot that is cut; the others have their kinds.
const CUT: u8 = 3;

fn sort_of(slot: ChildSlot) -> u8 {
    match slot {
        ChildSlot::Cut(_) => CUT,
        slot => slot.kind() as u8,
    }
}

fn put_slot(slot: ChildSlot, out: &mut Vec<u8>) {
    match slot {
        ChildSlot::Full(error) | ChildSlot::Cut(error) => out.push(error.0),
        ChildSlot::Empty => {}
        ChildSlot::Mixed(range) => {
            put_zigzag(i64::from(range.lo), out);
            put_zigzag(i64::from(range.hi), out);
        }
    }
}

fn read_slot(kind: u8, reader: &mut Reader<'_>) -> Option<ChildSlot> {
    let height = |reader: &mut Reader<'_>| i32::try_from(reader.zigzag()?).ok();
    Some(match kind {
        CUT => ChildSlot::Cut(Err8(reader.u8()?)),
        kind if kind == Kind::Full as u8 => ChildSlot::Full(Err8(reader.u8()?)),
        kind if kind == Kind::Empty as u8 => ChildSlot::Empty,
        kind if kind == Kind::Mixed as u8 => {
            let (lo, hi) = (height(reader)?, height(reader)?);
            let fits = is_height(lo) && is_height(hi) && lo <= hi;
            ChildSlot::Mixed(fits.then_some(Range { lo, hi })?)
        }
        _ => return None,
    })
}

/// Reads what [`put_band`] wrote. `None` if it does not fit; `above` is then of no use.
pub(super) fn read_band(
    level: &Level,
    number: usize,
    above: &mut Above,
    reader: &mut Reader<'_>,
) -> Option<()> {
    let [corners, slots] = rows_of(level, number, above);
    for row in corners {
        let mut last = 0;
        for height in &mut above.heights[row * above.width..][..above.width] {
            last += reader.zigzag()?;
            *height = i32::try_from(last).ok()?;
            (*height == HOLE || is_height(*height)).then_some(())?;
        }
    }
    for row in slots {
        let mut column = 0;
        while column < above.width - 1 {
            let (kind, run) = (reader.u8()?, reader.varint()? as usize);
            if run == 0 || run > above.width - 1 - column {
                return None;
            }
            for column in column..column + run {
                above.slots.set(column, row, read_slot(kind, reader)?);
            }
            column += run;
        }
    }
    Some(())
}
