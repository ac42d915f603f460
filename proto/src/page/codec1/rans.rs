//! The entropy coder: range asymmetric numeral systems with static tables (Duda, "Asymmetric
//! numeral systems: entropy coding combining speed of Huffman coding with compression rate of
//! arithmetic coding", 2013; the division-free step is Giesen's, "ryg_rans", 2014).
//!
//! A record is one stream, encoded from its end and decoded from its start, so that a reader of
//! some parts has taken the bytes of these parts and no more. The state starts at [`START`], not
//! at [`LOW`]: as long as nothing has been written there is nothing to take back, so a reader that
//! has run out of bytes goes on without. Hence a stream costs nothing but its contents.

use super::levels::LANES;
use super::symbols::{self, DIRECT, TABLES, unzigzag};
use super::tables::FREQUENCIES;

/// Symbols of a table.
pub(super) const SYMBOLS: usize = 32;
/// Frequencies of a table add up to `1 << PRECISION`.
pub(super) const PRECISION: u32 = 12;
const SCALE: usize = 1 << PRECISION;
/// While there are bytes, the state is kept at or above this before a symbol is decoded.
const LOW: u32 = 1 << 23;
/// The encoder's first state, hence the decoder's last.
pub(super) const START: u32 = 1;
/// Most bits that are coded at once: as many as leave the state within two bytes of [`LOW`].
const MOST_BITS: u32 = 12;

/// Something that codes symbols: encoder, decoder, or neither. Each call gives what is coded; the
/// decoder pays no heed to what it is told. So one traversal of a page serves all of them.
pub(super) trait Coder {
    /// Whether it pays no heed to what it is told, and need not be told anything.
    const DECODES: bool = false;

    /// A symbol of a table.
    fn symbol(&mut self, table: usize, symbol: u32) -> u32;

    /// A number below `1 << n`, all equally likely; `n` is at most 12.
    fn few_bits(&mut self, n: u32, value: u32) -> u32;

    /// A number below `1 << n`, all equally likely; `n` is at most 32.
    fn bits(&mut self, n: u32, value: u32) -> u32 {
        let (mut left, mut taken) = (n, 0);
        while left > 0 {
            let now = left.min(MOST_BITS);
            left -= now;
            let told = ((u64::from(value) >> left) as u32) & ((1 << now) - 1);
            taken = (u64::from(taken) << now) as u32 | self.few_bits(now, told);
        }
        taken
    }

    /// The first residuals of a line, of expected magnitudes.
    fn residuals(&mut self, expected: &[u32; LANES], count: usize, of: &mut [i32; LANES])
    where
        Self: Sized,
    {
        for (residual, &expected) in of.iter_mut().zip(expected).take(count) {
            *residual = symbols::residual(self, expected, *residual);
        }
    }
}

/// Codes nothing: what it is told is known.
pub(super) struct Known;

impl Coder for Known {
    fn residuals(&mut self, _: &[u32; LANES], _: usize, _: &mut [i32; LANES]) {}

    fn symbol(&mut self, _: usize, symbol: u32) -> u32 {
        symbol
    }

    fn few_bits(&mut self, _: u32, value: u32) -> u32 {
        value
    }
}

/// Where symbols lie, for one table.
struct Lookup {
    /// First slot of each symbol, and its frequency in the upper half; 256, so that any byte has
    /// a place.
    places: [u32; 256],
    /// The symbol at each slot.
    symbols: [u8; SCALE],
}

/// Of all tables, made while compiling.
static LOOKUPS: [Lookup; TABLES] = lookups();

const fn lookups() -> [Lookup; TABLES] {
    const NONE: Lookup = Lookup {
        places: [0; 256],
        symbols: [0; SCALE],
    };
    let mut all = [NONE; TABLES];
    let mut table = 0;
    while table < TABLES {
        let (mut symbol, mut slot) = (0, 0);
        while symbol < SYMBOLS {
            let frequency = FREQUENCIES[table][symbol] as usize;
            all[table].places[symbol] = (frequency << 16 | slot) as u32;
            let end = slot + frequency;
            while slot < end {
                all[table].symbols[slot] = symbol as u8;
                slot += 1;
            }
            symbol += 1;
        }
        assert!(slot == SCALE, "frequencies add up to the scale");
        table += 1;
    }
    all
}

/// What encoding a symbol takes, without a division.
#[derive(Clone, Copy)]
struct Step {
    frequency: u16,
    start: u16,
    /// `x * reciprocal >> 32 >> shift` is `x / frequency` for every state.
    reciprocal: u64,
    shift: u8,
}

static STEPS: [[Step; SYMBOLS]; TABLES] = steps();

const fn steps() -> [[Step; SYMBOLS]; TABLES] {
    const NONE: Step = Step {
        frequency: 0,
        start: 0,
        reciprocal: 0,
        shift: 0,
    };
    let mut all = [[NONE; SYMBOLS]; TABLES];
    let mut table = 0;
    while table < TABLES {
        let (mut symbol, mut start) = (0, 0);
        while symbol < SYMBOLS {
            let frequency = FREQUENCIES[table][symbol];
            let shift = match frequency {
                0 | 1 => 0,
                _ => 31 - (frequency as u32 - 1).leading_zeros(),
            };
            let reciprocal = match frequency {
                0 => 0,
                _ => (1u64 << (shift + 32)).div_ceil(frequency as u64),
            };
            all[table][symbol] = Step {
                frequency,
                start,
                reciprocal,
                shift: shift as u8,
            };
            start += frequency;
            symbol += 1;
        }
        table += 1;
    }
    all
}

/// Takes down what is to be coded; [`finish`](Self::finish) codes it from the end.
pub(super) struct Encoder {
    /// `table << 8 | symbol`, or [`RAW`] with a count of bits and their value.
    taken: Vec<u32>,
}

const RAW: u32 = 1 << 31;

impl Encoder {
    pub(super) fn new() -> Encoder {
        Encoder {
            taken: Vec::with_capacity(1024),
        }
    }

    /// The stream.
    pub(super) fn finish(self, head: u8) -> Vec<u8> {
        let mut state = START;
        let mut out = Vec::with_capacity(256);
        for taken in self.taken.into_iter().rev() {
            if taken & RAW == 0 {
                let step = &STEPS[(taken >> 8) as usize % TABLES][taken as usize % SYMBOLS];
                let frequency = u32::from(step.frequency);
                while state >= frequency << (31 - PRECISION) {
                    out.push(state as u8);
                    state >>= 8;
                }
                let quotient = ((u64::from(state) * step.reciprocal) >> 32) as u32 >> step.shift;
                state += u32::from(step.start) + quotient * (SCALE as u32 - frequency);
            } else {
                let n = taken >> 16 & 0xf;
                while state >= 1 << (31 - n) {
                    out.push(state as u8);
                    state >>= 8;
                }
                state = state << n | taken & 0xffff;
            }
        }
        while state > 0 {
            out.push(state as u8);
            state >>= 8;
        }
        out.push(head);
        out.reverse();
        out
    }
}

impl Coder for Encoder {
    fn symbol(&mut self, table: usize, symbol: u32) -> u32 {
        self.taken.push((table as u32) << 8 | symbol);
        symbol
    }

    fn few_bits(&mut self, n: u32, value: u32) -> u32 {
        self.taken.push(RAW | n << 16 | value);
        value
    }
}

/// Reads a stream. Safe on untrusted input: whatever the bytes are, each call gives some symbol.
pub(super) struct Decoder<'a> {
    bytes: &'a [u8],
    at: usize,
    state: u32,
}

impl<'a> Decoder<'a> {
    /// Goes on with a state, 0 at first, and the bytes that follow.
    pub(super) fn new(state: u32, bytes: &'a [u8]) -> Decoder<'a> {
        Decoder {
            bytes,
            at: 0,
            state,
        }
    }

    /// A residual, and what follows it, unless it is a rare one or the bytes may end in it.
    #[inline(always)]
    fn quick_residual(&self, state: u32, at: usize, expected: u32) -> Option<(i32, u32, usize)> {
        let (table, shift) = symbols::residual_table(expected);
        let (mut state, mut at, mut low) = (state, at, 0);
        if shift > 0 {
            (low, state, at) = self.quick_bits(state, at, shift)?;
        }
        let filled;
        (filled, at) = self.refilled(state, at)?;
        let (mut value, mut state) = step(filled, table);
        if value >= DIRECT {
            let (first, extra) = symbols::first_of(value)?;
            let above;
            (above, state, at) = self.quick_bits(state, at, extra)?;
            value = first + above;
        }
        Some((unzigzag(value << shift | low), state, at))
    }

    #[inline(always)]
    fn quick_bits(&self, state: u32, at: usize, n: u32) -> Option<(u32, u32, usize)> {
        let (state, at) = self.refilled(state, at)?;
        (n <= MOST_BITS).then_some((state & ((1 << n) - 1), state >> n, at))
    }

    /// Any residual.
    #[inline(never)]
    fn rare_residual(&mut self, expected: u32) -> i32 {
        symbols::residual(self, expected, 0)
    }

    /// Bytes taken so far.
    pub(super) fn position(&self) -> usize {
        self.at
    }

    pub(super) fn state(&self) -> u32 {
        self.state
    }

    /// As [`refill`](Self::refill), without a branch on how many bytes are missing. `None` where
    /// the bytes may end, and before the first one.
    #[inline(always)]
    fn refilled(&self, state: u32, at: usize) -> Option<(u32, usize)> {
        let &[first, second] = self.bytes.get(at..)?.first_chunk()?;
        let one = state << 8 | u32::from(first);
        let two = state << 16 | u32::from(first) << 8 | u32::from(second);
        let filled = if state < LOW { one } else { state };
        let filled = if state < LOW >> 8 { two } else { filled };
        let taken = usize::from(state < LOW) + usize::from(state < LOW >> 8);
        (state >= LOW >> 16).then_some((filled, at + taken))
    }

    #[inline(always)]
    fn refill(&mut self) {
        while self.state < LOW {
            let Some(&byte) = self.bytes.get(self.at) else {
                return;
            };
            self.state = self.state << 8 | u32::from(byte);
            self.at += 1;
        }
    }
}

/// The symbol of a table that a state stands for, and the state that follows.
#[inline(always)]
fn step(state: u32, table: usize) -> (u32, u32) {
    let lookup = &LOOKUPS[table];
    let slot = state & (SCALE as u32 - 1);
    let symbol = lookup.symbols[slot as usize];
    let place = lookup.places[usize::from(symbol)];
    let next = (state >> PRECISION) * (place >> 16) + slot - (place & 0xffff);
    (u32::from(symbol), next)
}

impl Coder for Decoder<'_> {
    const DECODES: bool = true;

    #[inline(always)]
    fn symbol(&mut self, table: usize, _: u32) -> u32 {
        self.refill();
        let (symbol, state) = step(self.state, table);
        self.state = state;
        symbol
    }

    /// Keeps the state in a register, as long as residuals are small and bytes are left.
    #[inline(always)]
    fn residuals(&mut self, expected: &[u32; LANES], count: usize, of: &mut [i32; LANES]) {
        let (mut state, mut at) = (self.state, self.at);
        for (residual, &expected) in of.iter_mut().zip(expected).take(count) {
            if let Some(quick) = self.quick_residual(state, at, expected) {
                (*residual, state, at) = quick;
                continue;
            }
            (self.state, self.at) = (state, at);
            *residual = self.rare_residual(expected);
            (state, at) = (self.state, self.at);
        }
        (self.state, self.at) = (state, at);
    }

    #[inline(always)]
    fn few_bits(&mut self, n: u32, _: u32) -> u32 {
        self.refill();
        let value = self.state & ((1 << n) - 1);
        self.state >>= n;
        value
    }
}

/// Counts symbols, and bits besides.
pub(super) struct Counter<'a> {
    pub(super) tables: &'a mut [[u64; SYMBOLS]],
    pub(super) bits: &'a mut u64,
}

impl Coder for Counter<'_> {
    fn symbol(&mut self, table: usize, symbol: u32) -> u32 {
        self.tables[table][symbol as usize % SYMBOLS] += 1;
        symbol
    }

    fn few_bits(&mut self, n: u32, value: u32) -> u32 {
        *self.bits += u64::from(n);
        value
    }
}
