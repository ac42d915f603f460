//! Making the tables: counts of symbols over sample pages, and the source text of `tables.rs`.

use super::rans::{Counter, PRECISION, SYMBOLS};
use super::symbols::{CORNER, KIND, MASK, RESIDUAL, REST, SLOT, TABLES};
use super::tables::FREQUENCIES;
use crate::page::Page;
use std::fmt::Write;
use std::ops::Range;

/// How often codec 1 uses each symbol of each of its tables.
#[derive(Debug, Clone)]
pub struct SymbolCounts {
    tables: Vec<[u64; SYMBOLS]>,
    /// Bits that are coded without a table.
    bits: u64,
}

/// What the contents of records weigh, in bits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CodedBits {
    /// Corners and residuals.
    pub heights: f64,
    /// Bounds of what is missing after each part.
    pub rests: f64,
    /// Child slots.
    pub slots: f64,
    /// Masks of holes.
    pub masks: f64,
}

impl Default for SymbolCounts {
    fn default() -> Self {
        SymbolCounts {
            tables: vec![[0; SYMBOLS]; TABLES],
            bits: 0,
        }
    }
}

impl SymbolCounts {
    /// Counts the symbols of a whole page.
    pub fn add(&mut self, page: &Page) {
        let mut counter = Counter {
            tables: &mut self.tables,
            bits: &mut self.bits,
        };
        super::run(page, None, &mut counter);
    }

    /// Adds other counts, scaled so that each of their tables counts for at most `weight`
    /// symbols: however large a source is, it is one among others.
    pub fn add_scaled(&mut self, other: &SymbolCounts, weight: u64) {
        for (own, other) in self.tables.iter_mut().zip(&other.tables) {
            let all: u64 = other.iter().sum();
            for (own, &count) in own.iter_mut().zip(other) {
                *own += match all > weight {
                    true => {
                        (u128::from(count) * u128::from(weight)).div_ceil(u128::from(all)) as u64
                    }
                    false => count,
                };
            }
        }
    }

    /// What is counted weighs so much with the tables as they are. Bits without a table are
    /// nearly all of heights, and are counted there.
    pub fn weigh(&self) -> CodedBits {
        let weight = |tables: Range<usize>| -> f64 {
            let symbols = tables.flat_map(|table| (0..SYMBOLS).map(move |symbol| (table, symbol)));
            symbols
                .map(|(table, symbol)| {
                    let share = f64::from(FREQUENCIES[table][symbol]) / f64::from(1 << PRECISION);
                    match self.tables[table][symbol] {
                        0 => 0.0,
                        count => -share.log2() * count as f64,
                    }
                })
                .sum()
        };
        CodedBits {
            heights: weight(RESIDUAL..REST) + self.bits as f64,
            rests: weight(REST..SLOT),
            slots: weight(SLOT..MASK),
            masks: weight(MASK..TABLES),
        }
    }

    /// The source text of the tables that suit these counts.
    pub fn to_source(&self) -> String {
        let mut text = String::from(HEAD);
        for (table, counts) in self.tables.iter().enumerate() {
            let frequencies = frequencies(table, counts);
            let numbers = frequencies.map(|frequency| frequency.to_string());
            // A string takes whatever is written.
            let _ = writeln!(text, "    [{}],", numbers.join(", "));
        }
        text + "];\n"
    }
}

const HEAD: &str = "\
//! Frequencies of symbols, a row a table. Made by `escarp-tiles bench --train`: to be made anew\n\
//! with a change of what is coded, which is a new codec; never changed otherwise.\n\
\n\
use super::rans::SYMBOLS;\n\
use super::symbols::TABLES;\n\
\n\
#[rustfmt::skip]\n\
pub(super) const FREQUENCIES: [[u16; SYMBOLS]; TABLES] = [\n";

/// Frequencies that add up to the scale. A symbol of a residual may have none, but for the last
/// one, which stands for any.
fn frequencies(table: usize, counts: &[u64; SYMBOLS]) -> [u16; SYMBOLS] {
    let scale = 1u64 << PRECISION;
    let all: u64 = counts.iter().sum::<u64>().max(1);
    let must = |symbol: usize| match table {
        MASK.. => symbol < 2,
        KIND.. => symbol < 3,
        REST.. => symbol == 30,
        CORNER.. => true,
        _ => symbol == 30,
    };
    let mut out: [u64; SYMBOLS] = std::array::from_fn(|symbol| {
        let share = (counts[symbol] * scale + all / 2) / all;
        share.max(u64::from(must(symbol)))
    });
    // The most frequent one gives or takes what is left.
    let largest = (0..SYMBOLS).max_by_key(|&symbol| out[symbol]).unwrap_or(0);
    let others: u64 = out.iter().sum::<u64>() - out[largest];
    out[largest] = scale.saturating_sub(others);
    out.map(|frequency| frequency as u16)
}
