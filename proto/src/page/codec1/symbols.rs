//! From numbers to symbols: residuals by their expected magnitude, and numbers of which little
//! is expected.

use super::rans::{Coder, SYMBOLS};
use super::tables::FREQUENCIES;

/// Tables of residuals, by expected magnitude in half octaves. From [`SCALED`] on all octaves
/// share two tables: their residuals are of one shape, and differ in scale.
pub(super) const RESIDUAL: usize = 0;
const SCALED: u32 = 18;
/// Length in bits of a corner.
pub(super) const CORNER: usize = RESIDUAL + SCALED as usize + 2;
/// Length in bits of the difference of the first two corners.
pub(super) const RISE: usize = CORNER + 1;
/// What a rest is more than the level's largest residual: a table a part.
pub(super) const REST: usize = RISE + 1;
/// What a slot's error is more than its neighbours': by how much they differ.
pub(super) const SLOT: usize = REST + 4;
/// A slot's kind: by the kinds of its neighbours in the west and in the south.
pub(super) const KIND: usize = SLOT + 5;
/// Whether a sample has data: of a corner, of a centre and of an edge vertex by how many of its
/// four neighbours have.
pub(super) const MASK: usize = KIND + 9;
/// How many there are.
pub(super) const TABLES: usize = MASK + 11;

/// Numbers below have a symbol of their own; above, half an octave has.
pub(super) const DIRECT: u32 = 16;
/// Any number, with all its bits.
const ESCAPE: u32 = 30;
/// In tables of lengths: this many bits or more.
const LONG: u32 = SYMBOLS as u32 - 1;

pub(super) const fn zigzag(v: i32) -> u32 {
    (v << 1 ^ v >> 31) as u32
}

pub(super) const fn unzigzag(v: u32) -> i32 {
    (v >> 1) as i32 ^ -((v & 1) as i32)
}

/// The table of residuals of an expected magnitude in 64ths, and how many low bits are coded
/// without it.
#[inline(always)]
pub(super) fn residual_table(expected: u32) -> (usize, u32) {
    let expected = expected.max(1);
    let octave = expected.ilog2();
    // The bit below the highest one says which half of the octave it is.
    let half = (u64::from(expected) << 1 >> octave) as u32 & 1;
    let context = 2 * octave + half;
    let (context, shift) = match context < SCALED {
        true => (context, 0),
        false => (SCALED + half, octave - SCALED / 2),
    };
    (RESIDUAL + context as usize, shift)
}

/// A residual of an expected magnitude, which is in 64ths.
#[inline(always)]
pub(super) fn residual(coder: &mut impl Coder, expected: u32, residual: i32) -> i32 {
    let (table, shift) = residual_table(expected);
    unzigzag(scaled(coder, table, shift, zigzag(residual)))
}

/// A number whose lowest `shift` bits are equally likely, and the rest of it is as a table says.
#[inline(always)]
pub(super) fn scaled(coder: &mut impl Coder, table: usize, shift: u32, value: u32) -> u32 {
    let low = match shift {
        0 => 0,
        _ => coder.bits(shift, value & ((1 << shift) - 1)),
    };
    number(coder, table, value >> shift) << shift | low
}

/// A number by a symbol for its half octave, and bits.
#[inline(always)]
fn number(coder: &mut impl Coder, table: usize, value: u32) -> u32 {
    let symbol = coder.symbol(table, symbol_of(table, value));
    if symbol < DIRECT {
        return symbol;
    }
    match first_of(symbol) {
        Some((first, extra)) => {
            first + coder.bits(extra, value.wrapping_sub(first) & ((1 << extra) - 1))
        }
        None => coder.bits(32, value),
    }
}

/// The lowest number of a half octave's symbol, and how many bits follow. `None` for the escape.
#[inline(always)]
pub(super) fn first_of(symbol: u32) -> Option<(u32, u32)> {
    let extra = 3 + symbol.checked_sub(DIRECT)? / 2;
    (symbol < ESCAPE).then_some(((2 + symbol % 2) << extra, extra))
}

fn symbol_of(table: usize, value: u32) -> u32 {
    let symbol = match value {
        0..DIRECT => value,
        _ => {
            let octave = value.ilog2();
            DIRECT + 2 * (octave - 4) + (value >> (octave - 1) & 1)
        }
    };
    // What was never seen while the tables were made has no room in them.
    let fits = symbol < ESCAPE && FREQUENCIES[table][symbol as usize] > 0;
    if fits { symbol } else { ESCAPE }
}

/// A signed number by its length.
pub(super) fn long(coder: &mut impl Coder, table: usize, value: i32) -> i32 {
    let value = zigzag(value);
    let length = (u32::BITS - value.leading_zeros()).min(LONG);
    match coder.symbol(table, length) {
        0 => 0,
        LONG => unzigzag(coder.bits(32, value)),
        length => {
            let first = 1 << (length - 1);
            unzigzag(first | coder.bits(length - 1, value & (first - 1)))
        }
    }
}

/// Any number: 6 bits for its length, and its bits.
pub(super) fn plain(coder: &mut impl Coder, value: u32) -> u32 {
    let length = coder.few_bits(6, u32::BITS - value.leading_zeros()).min(32);
    coder.bits(length, value)
}
