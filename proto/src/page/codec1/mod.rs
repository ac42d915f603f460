//! Codec 1: residuals of interpolating predictions, with static contexts, in one stream of range
//! asymmetric numeral systems. `tiles/FORMAT.md` says what a record holds; codec 0 is the oracle.
//!
//! One traversal, [`Traversal`], serves encoder, decoder and the maker of tables: each passes its
//! own [`Coder`]. Decoding is safe on untrusted input: it allocates one page, takes as many steps
//! as a page has vertices and slots, and checks what comes out.

mod levels;
mod rans;
mod slots;
mod symbols;
mod tables;
mod train;

pub use train::{CodedBits, SymbolCounts};

use super::codec0::{self, CORNERS};
use super::record::{CUTS, Codec, HOLES, RAW, Tag};
use super::{MAX_HEIGHT, PAGE_AREA, Page, PageError, Range, SLOT_PART, level_step};
use crate::err8::Err8;
use crate::geometry::{PAGE_LEVELS, PAGE_SAMPLES, PageId};
use levels::{LANES, Levels, Line, Phase, Row};
use rans::{Coder, Decoder, Encoder, Known, START};
use symbols::{CORNER, MASK, REST, RISE, residual, unzigzag, zigzag};

/// Encodes a whole page. Where prediction is of no use, heights are stored as they are.
pub(super) fn encode(page: &Page) -> Vec<u8> {
    let dense = encode_as(page, None);
    let raw = Raw::of(page);
    if dense.len() <= raw.least_bytes() {
        return dense;
    }
    let plain = encode_as(page, Some(raw));
    if plain.len() < dense.len() {
        plain
    } else {
        dense
    }
}

fn encode_as(page: &Page, raw: Option<Raw>) -> Vec<u8> {
    let mut coder = Encoder::new();
    run(page, raw, &mut coder);
    let holes = if page.has_holes() { HOLES } else { 0 };
    let raw = if raw.is_some() { RAW } else { 0 };
    let cuts = if page.has_cuts { CUTS } else { 0 };
    coder.finish(Codec::Dense as u8 | holes | raw | cuts)
}

/// Codes a page that is whole and sound, so that no check can fail.
fn run(page: &Page, raw: Option<Raw>, coder: &mut impl Coder) {
    let mut page = page.clone();
    let last = page.last_part();
    let mut traversal = Traversal::new(&mut page, raw);
    for part in 1..=last {
        let _ = traversal.part(part, coder);
    }
}

/// Heights as they are, above the lowest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Raw {
    lowest: i32,
    /// Of a height.
    bits: u32,
}

impl Raw {
    fn of(page: &Page) -> Raw {
        let range = page.heights.iter().fold(Range::EMPTY, |r, &h| r.with(h));
        Raw {
            lowest: range.lo,
            bits: u32::BITS - range.span().leading_zeros(),
        }
    }

    /// No record of heights alone is shorter, if there are no holes.
    const fn least_bytes(self) -> usize {
        PAGE_AREA * self.bits as usize / 8
    }

    fn height(self, coder: &mut impl Coder, known: i32) -> i32 {
        let above = coder.bits(self.bits, known.wrapping_sub(self.lowest) as u32);
        self.lowest.wrapping_add(above as i32)
    }
}

/// Where the decoder of a page stands that is not whole.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Stream {
    state: u32,
    raw: Option<Raw>,
}

impl Stream {
    /// Before the first part of a record with this tag.
    pub(super) fn start(tag: Tag) -> Stream {
        Stream {
            state: 0,
            raw: tag.is_raw.then(Raw::default),
        }
    }
}

/// Decodes the parts that follow those that a page has, from their bytes. Gives where each part
/// ends. On an error the page is as it was, if it had any parts.
pub(super) fn extend(
    page: &mut Page,
    stream: Stream,
    parts: u8,
    bytes: &[u8],
) -> Result<Ends, PageError> {
    if page.parts == 0 {
        return extend_in_place(page, stream, parts, bytes);
    }
    let mut longer = page.clone();
    let ends = extend_in_place(&mut longer, stream, parts, bytes)?;
    *page = longer;
    Ok(ends)
}

/// Where parts 1 to 5 end in the bytes that were decoded, as far as they were.
pub(super) type Ends = [usize; SLOT_PART as usize];

fn extend_in_place(
    page: &mut Page,
    stream: Stream,
    parts: u8,
    bytes: &[u8],
) -> Result<Ends, PageError> {
    let (id, last) = (page.id, page.last_part());
    let mut coder = Decoder::new(stream.state, bytes);
    let (ends, raw) = decode_parts(page, stream, parts, &mut coder)?;
    let (left, state) = (bytes.len() - coder.position(), coder.state());
    if left > 0 {
        return Err(PageError::Long {
            page: id,
            part: parts,
            left,
        });
    }
    if parts == last && state != START {
        return Err(PageError::Value {
            page: id,
            field: "last state",
            found: i64::from(state),
            allowed: "1",
        });
    }
    page.parts = parts;
    page.stream = (parts < last).then_some(Stream { state, raw });
    Ok(ends)
}

/// Decodes parts as far as they are wanted, and no bytes more. Gives where they end.
fn decode_parts(
    page: &mut Page,
    stream: Stream,
    parts: u8,
    coder: &mut Decoder<'_>,
) -> Result<(Ends, Option<Raw>), PageError> {
    let known = page.parts;
    let mut traversal = Traversal::new(page, stream.raw);
    for part in 1..=known {
        traversal.part(part, &mut Known)?;
    }
    let mut ends = Ends::default();
    for part in known + 1..=parts {
        traversal.part(part, coder)?;
        ends[usize::from(part) - 1] = coder.position();
    }
    if known < PAGE_LEVELS {
        traversal.settle(parts.min(PAGE_LEVELS));
    }
    let raw = traversal.raw;
    check(page, parts.min(PAGE_LEVELS))?;
    Ok((ends, raw))
}

/// Where the first parts of a whole record end, header first, which is one byte. All parts are
/// held against the end of the record, some are not.
pub(super) fn part_ends(
    id: PageId,
    finest: bool,
    tag: Tag,
    record: &[u8],
    parts: u8,
) -> Result<Vec<usize>, PageError> {
    let mut page = Page::blank(id, finest);
    page.valid = tag.has_holes.then(|| Box::new([true; PAGE_AREA]));
    page.has_cuts = tag.has_cuts;
    let (stream, bytes) = (Stream::start(tag), record.get(1..).unwrap_or_default());
    let ends = match parts == page.last_part() {
        true => extend_in_place(&mut page, stream, parts, bytes)?,
        false => {
            let mut coder = Decoder::new(stream.state, bytes);
            decode_parts(&mut page, stream, parts, &mut coder)?.0
        }
    };
    let ends = ends.into_iter().take(usize::from(parts));
    Ok(std::iter::once(0).chain(ends).map(|end| end + 1).collect())
}

/// A page on its way through a coder, part by part.
struct Traversal<'a> {
    page: &'a mut Page,
    raw: Option<Raw>,
    levels: Levels,
    /// Of the south-west corner: predictions are of what is above it.
    base: i32,
}

impl<'a> Traversal<'a> {
    fn new(page: &'a mut Page, raw: Option<Raw>) -> Traversal<'a> {
        Traversal {
            page,
            raw,
            levels: Levels::new(),
            base: 0,
        }
    }

    fn part(&mut self, part: u8, coder: &mut impl Coder) -> Result<(), PageError> {
        if part == SLOT_PART {
            return slots::code(self.page, coder);
        }
        if part == 1 {
            self.corners(coder)?;
        }
        let largest = match (self.raw, self.page.has_holes()) {
            (Some(raw), _) => self.raw_level(part, raw, coder),
            (None, true) => self.level::<true, _>(part, coder),
            (None, false) => self.level::<false, _>(part, coder),
        };
        self.rest(part, largest, coder)?;
        if part < PAGE_LEVELS && self.raw.is_none() {
            self.levels.close();
        }
        Ok(())
    }

    /// Puts decoded heights down to a level in the page, if they are not there yet.
    fn settle(&mut self, level: u8) {
        if self.raw.is_none() && !self.page.has_holes() {
            let heights = &mut *self.page.heights;
            self.levels.give(heights, level_step(level), self.base);
        }
    }

    /// What may still be missing after a part, as against the part's largest residual. After the
    /// last level of a finest page nothing is.
    fn rest(&mut self, part: u8, largest: u32, coder: &mut impl Coder) -> Result<(), PageError> {
        if self.page.finest && part == PAGE_LEVELS {
            return Ok(());
        }
        let rest = &mut self.page.rest[usize::from(part) - 1];
        let likely =
            Err8::covering(largest.min(super::MAX_SPAN)).map_or(0, |code| i32::from(code.0));
        let table = REST + usize::from(part) - 1;
        let more = zigzag(i32::from(rest.0) - likely);
        let found = likely.wrapping_add(unzigzag(symbols::scaled(coder, table, 0, more)));
        match u8::try_from(found) {
            Ok(code) => *rest = Err8(code),
            Err(_) => return Err(self.page.value("rest error", i64::from(found), "0..=255")),
        }
        Ok(())
    }

    fn corners(&mut self, coder: &mut impl Coder) -> Result<(), PageError> {
        if self.page.has_holes() {
            self.range(coder)?;
        }
        if let Some(raw) = &mut self.raw {
            raw.lowest = unzigzag(symbols::plain(coder, zigzag(raw.lowest)));
            raw.bits = coder.few_bits(6, raw.bits).min(u32::BITS);
        }
        if self.page.has_holes() || self.raw.is_some() {
            self.holed_corners(coder);
        } else {
            self.full_corners(coder);
        }
        for at in CORNERS {
            codec0::check_height(self.page.id, i64::from(self.page.heights[at]))?;
        }
        self.base = self.page.heights[CORNERS[0]];
        let above = CORNERS.map(|at| self.page.heights[at].wrapping_sub(self.base));
        self.levels.start(above);
        Ok(())
    }

    fn full_corners(&mut self, coder: &mut impl Coder) {
        let heights = &mut self.page.heights;
        let [sw, se, nw, ne] = CORNERS;
        heights[sw] = symbols::long(coder, CORNER, heights[sw]);
        let base = heights[sw];
        let rise = symbols::long(coder, RISE, heights[se].wrapping_sub(base));
        heights[se] = base.wrapping_add(rise);
        let expected = rise.unsigned_abs().min(MAX_HEIGHT as u32) + 8;
        let other = heights[nw].wrapping_sub(base);
        let other = residual(coder, expected << 1, other);
        heights[nw] = base.wrapping_add(other);
        let predicted = heights[se].wrapping_add(other);
        let twist = heights[ne].wrapping_sub(predicted);
        let twist = residual(coder, expected, twist);
        heights[ne] = predicted.wrapping_add(twist);
    }

    fn range(&mut self, coder: &mut impl Coder) -> Result<(), PageError> {
        let known = self.page.range;
        if coder.few_bits(1, u32::from(!known.is_empty())) == 0 {
            self.page.range = Range::EMPTY;
            return Ok(());
        }
        let lo = unzigzag(symbols::plain(coder, zigzag(known.lo)));
        let span = symbols::plain(coder, known.span());
        self.page.range = codec0::checked_range(self.page.id, i64::from(lo), u64::from(span))?;
        Ok(())
    }

    fn holed_corners(&mut self, coder: &mut impl Coder) {
        let mut last = codec0::corner_start(self.page);
        for at in CORNERS {
            if self.has_data(at, MASK, coder) {
                let known = self.page.heights[at];
                last = match self.raw {
                    Some(raw) => raw.height(coder, known),
                    None => {
                        let more = symbols::long(coder, RISE, known.wrapping_sub(last));
                        last.wrapping_add(more)
                    }
                };
            }
            self.page.heights[at] = last;
        }
    }

    fn has_data(&mut self, at: usize, table: usize, coder: &mut impl Coder) -> bool {
        let Some(valid) = &mut self.page.valid else {
            return true;
        };
        valid[at] = coder.symbol(table, u32::from(valid[at])) == 1;
        valid[at]
    }

    /// Codes a level's vertices. Gives the largest magnitude of a residual.
    fn level<const HOLES: bool, C: Coder>(&mut self, level: u8, coder: &mut C) -> u32 {
        let mut largest = 0;
        self.levels.open();
        for phase in Phase::ALL {
            let of_phase = match HOLES {
                true => self.holed_phase(level, phase, coder),
                false => self.full_phase(level, phase, coder),
            };
            largest = largest.max(of_phase);
        }
        largest
    }

    /// A phase without holes: all predictions first, then all symbols. What is decoded is taken
    /// from the levels after the last one.
    fn full_phase<C: Coder>(&mut self, level: u8, phase: Phase, coder: &mut C) -> u32 {
        let (step, cells) = (level_step(level), self.levels.cells());
        let (lines, vertices) = phase.lines(cells);
        let mut rows = [Row::default(); LANES];
        for (line, row) in rows.iter_mut().enumerate().take(lines) {
            *row = self.levels.predict(phase, line);
        }
        let mut residuals = [[0; LANES]; LANES];
        for (line, (row, residuals)) in rows.iter().zip(&mut residuals).enumerate().take(lines) {
            if !C::DECODES {
                let (first, stride) = phase.samples(cells, line, step);
                let told = residuals.iter_mut().zip(&row.predicted).take(vertices);
                for (i, (residual, &predicted)) in told.enumerate() {
                    let known = self.page.heights[first + i * stride].wrapping_sub(self.base);
                    *residual = known.wrapping_sub(predicted);
                }
            }
            coder.residuals(&row.expected, vertices, residuals);
        }
        let mut largest = 0;
        for (line, (row, residuals)) in rows.iter().zip(&residuals).enumerate().take(lines) {
            let height = |i: usize| row.predicted[i].wrapping_add(residuals[i]);
            let line_of = Line {
                heights: std::array::from_fn(height),
                residuals: *residuals,
            };
            self.levels.put(phase, line, vertices, &line_of);
            largest = line_of.largest(largest);
        }
        largest
    }

    fn holed_phase<C: Coder>(&mut self, level: u8, phase: Phase, coder: &mut C) -> u32 {
        let (step, cells) = (level_step(level), self.levels.cells());
        let (lines, vertices) = phase.lines(cells);
        let mut largest = 0;
        for line in 0..lines {
            let row = self.levels.predict(phase, line);
            let (first, stride) = phase.samples(cells, line, step);
            let places = (0..vertices.min(LANES)).map(move |i| first + i * stride);
            let line_of = self.holed_line(level, phase, places, &row, coder);
            self.levels.put(phase, line, vertices, &line_of);
            largest = line_of.largest(largest);
        }
        largest
    }

    fn holed_line<C: Coder>(
        &mut self,
        level: u8,
        phase: Phase,
        places: impl Iterator<Item = usize>,
        row: &Row,
        coder: &mut C,
    ) -> Line {
        let mut line = Line::default();
        for (i, at) in places.enumerate() {
            if !self.vertex_has_data(level, phase, at, coder) {
                let (x, y) = (at % PAGE_SAMPLES, at / PAGE_SAMPLES);
                let fill = codec0::prediction(&self.page.heights, level, x, y);
                self.page.heights[at] = fill;
                line.heights[i] = fill.wrapping_sub(self.base);
                continue;
            }
            let predicted = row.predicted[i];
            let known = self.page.heights[at].wrapping_sub(self.base);
            let missed = residual(coder, row.expected[i], known.wrapping_sub(predicted));
            line.heights[i] = predicted.wrapping_add(missed);
            line.residuals[i] = missed;
            self.page.heights[at] = line.heights[i].wrapping_add(self.base);
        }
        line
    }

    /// A level's vertices as they are. Gives the largest span that they can have.
    fn raw_level(&mut self, level: u8, raw: Raw, coder: &mut impl Coder) -> u32 {
        let (step, cells) = (level_step(level), 1 << (level - 1));
        for phase in Phase::ALL {
            let (lines, vertices) = phase.lines(cells);
            for (line, i) in (0..lines).flat_map(|line| (0..vertices).map(move |i| (line, i))) {
                let (x, y) = phase.place(cells, line, i);
                let at = y * step * PAGE_SAMPLES + x * step;
                let has_data =
                    !self.page.has_holes() || self.vertex_has_data(level, phase, at, coder);
                self.page.heights[at] = match has_data {
                    true => raw.height(coder, self.page.heights[at]),
                    false => codec0::prediction(&self.page.heights, level, x * step, y * step),
                };
            }
        }
        ((1u64 << raw.bits) - 1) as u32
    }

    /// Whether a vertex has data, from how many of its neighbours have.
    fn vertex_has_data(
        &mut self,
        level: u8,
        phase: Phase,
        at: usize,
        coder: &mut impl Coder,
    ) -> bool {
        let step = level_step(level);
        let (column, row) = (at % PAGE_SAMPLES, at / PAGE_SAMPLES);
        let ways: [(isize, isize); 4] = match phase {
            Phase::Centres => [(-1, -1), (1, -1), (-1, 1), (1, 1)],
            _ => [(-1, 0), (1, 0), (0, -1), (0, 1)],
        };
        let neighbour = |(dx, dy): (isize, isize)| {
            // Beyond the page, what is on the other side stands for it.
            let over = |from: usize, way: isize| {
                let to = from as isize + way * step as isize;
                match (0..PAGE_SAMPLES as isize).contains(&to) {
                    true => to as usize,
                    false => (from as isize - way * step as isize) as usize,
                }
            };
            self.page
                .is_valid(over(row, dy) * PAGE_SAMPLES + over(column, dx))
        };
        let with_data = ways.into_iter().filter(|&way| neighbour(way)).count();
        let kind = usize::from(phase != Phase::Centres);
        self.has_data(at, MASK + 1 + 5 * kind + with_data, coder)
    }
}

/// Whether all heights down to a level are allowed. Those of parts that are missing are 0.
fn check(page: &Page, level: u8) -> Result<(), PageError> {
    let sizes = page.heights.iter().map(|height| height.unsigned_abs());
    // Heights have magnitudes of at most 2^31, and their signs do not matter here.
    codec0::check_height(page.id, i64::from(sizes.fold(0, u32::max)))?;
    if !page.has_holes() {
        return Ok(());
    }
    let places = || (0..PAGE_SAMPLES).step_by(level_step(level));
    let samples = places().flat_map(|row| places().map(move |column| row * PAGE_SAMPLES + column));
    let outside = samples
        .filter(|&at| page.is_valid(at))
        .map(|at| page.heights[at])
        .find(|height| !(page.range.lo..=page.range.hi).contains(height));
    match outside {
        Some(height) => Err(page.value("height", i64::from(height), "the page's range")),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests;
