//! Codec 0: varint residuals, level by level. Slow to shrink and simple to check: it stays as
//! the oracle of every later codec.
//!
//! A level's vertices go row by row from the south-west. An edge vertex is predicted from the two
//! ends of its edge, a centre from its four corners, by the mean rounded down. In a hole the
//! prediction itself is the fill, so that prediction never needs a special case. Decoding is safe
//! on untrusted input: it allocates one page, whatever the bytes say.

use super::record::{self, CUTS, Codec, HOLES, RecordHeader, Tag};
use super::{
    ChildSlot, MAX_HEIGHT, MAX_SPAN, PAGE_AREA, Page, PageError, Range, SLOT_PART, codec1,
    last_part, level_step,
};
use crate::bytes::{Reader, put_varint, put_zigzag};
use crate::err8::Err8;
use crate::geometry::{PAGE_LEVELS, PAGE_SAMPLES, PAGE_SLOTS, PageId};

/// Kind of a slot that is cut; the others are those of [`Kind`](super::Kind).
const CUT: u8 = 3;

/// The page's corners: south-west, south-east, north-west, north-east.
pub(super) const CORNERS: [usize; 4] =
    [0, PAGE_SAMPLES - 1, PAGE_AREA - PAGE_SAMPLES, PAGE_AREA - 1];

pub(super) fn check_height(page: PageId, height: i64) -> Result<i32, PageError> {
    if height.unsigned_abs() <= MAX_HEIGHT as u64 {
        return Ok(height as i32);
    }
    Err(PageError::Value {
        page,
        field: "height",
        found: height,
        allowed: "-2^30..=2^30",
    })
}

pub(super) fn checked_range(page: PageId, lo: i64, span: u64) -> Result<Range, PageError> {
    let lo = check_height(page, lo)?;
    let hi = check_height(page, i64::from(lo) + span as i64)?;
    Ok(Range { lo, hi })
}

/// Samples of the page's level, in coding order.
fn level_vertices(level: u8) -> impl Iterator<Item = (usize, usize)> {
    let step = level_step(level);
    let on_coarser = move |i: usize| i.is_multiple_of(2 * step);
    (0..PAGE_SAMPLES).step_by(step).flat_map(move |row| {
        (0..PAGE_SAMPLES)
            .step_by(step)
            .filter(move |&column| !(on_coarser(column) && on_coarser(row)))
            .map(move |column| (column, row))
    })
}

/// Mean of the coarser vertices that a vertex of this level splits.
pub(super) fn prediction(heights: &[i32; PAGE_AREA], level: u8, column: usize, row: usize) -> i32 {
    let step = level_step(level);
    let at = row * PAGE_SAMPLES + column;
    let sum = |a: usize, b: usize| i64::from(heights[a]) + i64::from(heights[b]);
    let along_row = !column.is_multiple_of(2 * step);
    let along_column = !row.is_multiple_of(2 * step);
    let north = step * PAGE_SAMPLES;
    let mean = match (along_row, along_column) {
        (true, false) => sum(at - step, at + step) >> 1,
        (false, _) => sum(at - north, at + north) >> 1,
        (true, true) => {
            let south_pair = sum(at - north - step, at - north + step);
            (south_pair + sum(at + north - step, at + north + step)) >> 2
        }
    };
    mean as i32
}

/// What stands before the first valid corner.
pub(super) fn corner_start(page: &Page) -> i32 {
    if page.range.is_empty() {
        0
    } else {
        page.range.lo
    }
}

/// Gives every hole the height that decoding would give it.
pub(super) fn fill_holes(page: &mut Page) {
    let mut last = corner_start(page);
    for at in CORNERS {
        if page.is_valid(at) {
            last = page.heights[at];
        } else {
            page.heights[at] = last;
        }
    }
    for level in 1..=PAGE_LEVELS {
        for (column, row) in level_vertices(level) {
            let at = row * PAGE_SAMPLES + column;
            if !page.is_valid(at) {
                page.heights[at] = prediction(&page.heights, level, column, row);
            }
        }
    }
}

/// Encodes a whole page.
pub(super) fn encode(page: &Page) -> Vec<u8> {
    let parts: Vec<Vec<u8>> = (1..=page.last_part())
        .map(|part| encode_part(page, part))
        .collect();
    let flag = |set, bit| if set { bit } else { 0 };
    let mut out = vec![flag(page.has_holes(), HOLES) | flag(page.has_cuts, CUTS)];
    for part in &parts {
        put_varint(part.len() as u64, &mut out);
    }
    if page.has_holes() {
        record::write_range(page.range, &mut out);
    }
    out.extend(parts.concat());
    out
}

fn encode_part(page: &Page, part: u8) -> Vec<u8> {
    let mut out = Vec::new();
    if part == SLOT_PART {
        encode_slots(page, &mut out);
        return out;
    }
    out.push(page.rest[part as usize - 1].0);
    put_mask(page, part, &mut out);
    if part == 1 {
        let mut last = corner_start(page);
        for at in CORNERS.into_iter().filter(|&at| page.is_valid(at)) {
            put_zigzag(i64::from(page.heights[at]) - i64::from(last), &mut out);
            last = page.heights[at];
        }
    }
    for (column, row) in level_vertices(part) {
        let at = row * PAGE_SAMPLES + column;
        if page.is_valid(at) {
            let predicted = prediction(&page.heights, part, column, row);
            put_zigzag(i64::from(page.heights[at]) - i64::from(predicted), &mut out);
        }
    }
    out
}

/// Samples whose validity a part states: its level's vertices, and before them, in part 1, the corners.
fn masked_samples(part: u8) -> impl Iterator<Item = usize> {
    let corners: &[usize] = if part == 1 { &CORNERS } else { &[] };
    let vertices = level_vertices(part).map(|(column, row)| row * PAGE_SAMPLES + column);
    corners.iter().copied().chain(vertices)
}

fn put_mask(page: &Page, part: u8, out: &mut Vec<u8>) {
    if !page.has_holes() {
        return;
    }
    let samples: Vec<usize> = masked_samples(part).collect();
    out.extend(samples.chunks(8).map(|eight| {
        let bit = |(i, &at): (usize, &usize)| u8::from(page.is_valid(at)) << i;
        eight.iter().enumerate().map(bit).sum::<u8>()
    }));
}

/// Two bits for what a slot is.
const fn kind_code(slot: &ChildSlot) -> u8 {
    match slot {
        ChildSlot::Cut(_) => CUT,
        _ => slot.kind() as u8,
    }
}

fn encode_slots(page: &Page, out: &mut Vec<u8>) {
    let Some(slots) = &page.slots else { return };
    if page.has_holes() || page.has_cuts {
        for four in slots.chunks(4) {
            let pair = |(i, slot): (usize, &ChildSlot)| kind_code(slot) << (2 * i);
            out.push(four.iter().enumerate().map(pair).sum());
        }
    }
    for slot in slots.iter() {
        match *slot {
            ChildSlot::Full(error) | ChildSlot::Cut(error) => out.push(error.0),
            ChildSlot::Empty => {}
            ChildSlot::Mixed(range) => {
                put_zigzag(i64::from(range.lo) - i64::from(page.range.lo), out);
                put_varint(u64::from(range.span()), out);
            }
        }
    }
}

impl Page {
    /// Decodes a record's header and parts `1..=parts`.
    ///
    /// # Errors
    /// [`PageError`] if anything is cut short, left over or out of range.
    pub fn decode(id: PageId, finest: bool, parts: u8, bytes: &[u8]) -> Result<Page, PageError> {
        let mut page = Page::blank(id, finest);
        let tag = Tag::read(id, finest, bytes)?;
        page.valid = tag.has_holes.then(|| Box::new([true; PAGE_AREA]));
        page.has_cuts = tag.has_cuts;
        let start = match tag.codec {
            Codec::Plain => {
                let header = RecordHeader::read(id, finest, bytes)?;
                page.range = header.range;
                header.part_bytes(0, 0).map_or(0, |header| header.end)
            }
            Codec::Dense => {
                page.stream = Some(codec1::Stream::start(tag));
                1
            }
        };
        page.extend(parts, &bytes[start..])?;
        Ok(page)
    }

    /// Adds parts `parts() + 1..=parts`, from their bytes. On an error the page is as it was.
    ///
    /// # Errors
    /// [`PageError`] if anything is cut short, left over or out of range.
    pub fn extend(&mut self, parts: u8, bytes: &[u8]) -> Result<(), PageError> {
        let allowed = if self.finest { "1..=4" } else { "1..=5" };
        if parts <= self.parts || parts > last_part(self.finest) {
            return Err(PageError::Value {
                page: self.id,
                field: "last part",
                found: i64::from(parts),
                allowed,
            });
        }
        if let Some(stream) = self.stream {
            return codec1::extend(self, stream, parts, bytes).map(|_| ());
        }
        let mut longer = self.clone();
        let mut reader = Reader::new(bytes);
        for part in self.parts + 1..=parts {
            longer.decode_part(part, &mut reader)?;
            longer.parts = part;
        }
        if reader.left() > 0 {
            return Err(PageError::Long {
                page: self.id,
                part: parts,
                left: reader.left(),
            });
        }
        *self = longer;
        Ok(())
    }

    fn decode_part(&mut self, part: u8, reader: &mut Reader<'_>) -> Result<(), PageError> {
        if part == SLOT_PART {
            return self.decode_slots(reader);
        }
        let rest = reader.u8().ok_or(self.short("rest error"))?;
        self.rest[part as usize - 1] = Err8(rest);
        self.decode_mask(part, reader)?;
        if part == 1 {
            self.decode_corners(reader)?;
        }
        for (column, row) in level_vertices(part) {
            let at = row * PAGE_SAMPLES + column;
            let predicted = prediction(&self.heights, part, column, row);
            self.heights[at] = self.decode_height(at, predicted, reader)?;
        }
        Ok(())
    }

    fn decode_mask(&mut self, part: u8, reader: &mut Reader<'_>) -> Result<(), PageError> {
        let short = self.short("mask");
        let Some(valid) = &mut self.valid else {
            return Ok(());
        };
        let samples: Vec<usize> = masked_samples(part).collect();
        let mask = reader.take(samples.len().div_ceil(8)).ok_or(short)?;
        for (i, at) in samples.into_iter().enumerate() {
            valid[at] = mask[i / 8] >> (i % 8) & 1 == 1;
        }
        Ok(())
    }

    fn decode_corners(&mut self, reader: &mut Reader<'_>) -> Result<(), PageError> {
        let mut last = corner_start(self);
        for at in CORNERS {
            last = self.decode_height(at, last, reader)?;
            self.heights[at] = last;
        }
        Ok(())
    }

    /// The height of a sample: the prediction in a hole, else the prediction and a residual.
    fn decode_height(
        &self,
        at: usize,
        predicted: i32,
        reader: &mut Reader<'_>,
    ) -> Result<i32, PageError> {
        if !self.is_valid(at) {
            return Ok(predicted);
        }
        let residual = reader.zigzag().ok_or(self.short("residual"))?;
        let height = check_height(self.id, i64::from(predicted) + residual)?;
        let inside = self.range.lo <= height && height <= self.range.hi;
        if self.has_holes() && !inside {
            return Err(self.value("height", i64::from(height), "the page's range"));
        }
        Ok(height)
    }

    fn decode_slots(&mut self, reader: &mut Reader<'_>) -> Result<(), PageError> {
        let kinds = match self.has_holes() || self.has_cuts {
            true => Some(
                reader
                    .take(PAGE_SLOTS / 4)
                    .ok_or(self.short("slot kinds"))?,
            ),
            false => None,
        };
        let mut slots = Box::new([ChildSlot::Empty; PAGE_SLOTS]);
        for (i, slot) in slots.iter_mut().enumerate() {
            *slot = match kinds.map_or(0, |kinds| kinds[i / 4] >> (2 * (i % 4)) & 3) {
                0 => ChildSlot::Full(Err8(reader.u8().ok_or(self.short("slot error"))?)),
                CUT if self.has_cuts => {
                    ChildSlot::Cut(Err8(reader.u8().ok_or(self.short("slot error"))?))
                }
                1 if self.has_holes() => ChildSlot::Empty,
                2 if self.has_holes() => ChildSlot::Mixed(self.decode_slot_range(reader)?),
                kind => return Err(self.value("slot kind", i64::from(kind), "those of its flags")),
            };
        }
        self.slots = Some(slots);
        if self.has_cuts && !self.any_cut() {
            return Err(self.value("slots that are cut", 0, "at least 1, by its flags"));
        }
        Ok(())
    }

    fn decode_slot_range(&self, reader: &mut Reader<'_>) -> Result<Range, PageError> {
        let lo = reader.zigzag().ok_or(self.short("slot range"))?;
        let span = reader.varint().ok_or(self.short("slot range"))?;
        if span > u64::from(MAX_SPAN) {
            return Err(self.value("slot range", span as i64, "0..=2^31"));
        }
        let range = checked_range(self.id, lo + i64::from(self.range.lo), span)?;
        match self.range.contains(range) {
            true => Ok(range),
            false => Err(self.value("slot range", lo, "the page's range")),
        }
    }

    const fn short(&self, field: &'static str) -> PageError {
        PageError::Short {
            page: self.id,
            field,
        }
    }

    pub(super) const fn value(
        &self,
        field: &'static str,
        found: i64,
        allowed: &'static str,
    ) -> PageError {
        PageError::Value {
            page: self.id,
            field,
            found,
            allowed,
        }
    }
}
