//! Every formula that meets the GPU, in the precision that it has there, against double precision
//! and exact numbers: how far it is off, and how far it moves when its inputs move by one unit in
//! the last place.
//!
//! In reading order: [exact numbers](exact), a [setup] of eye and vertex and where they come out on
//! the screen, then the formulas: [placing], [depth], [plain] ones, their [conditioning], and the
//! [adapter] at hand.

pub mod exact;

pub mod setup;

mod placing;

mod depth;

mod plain;

mod conditioning;

mod adapter;

use super::Case;

pub use setup::{clip, place};

/// Formulas against exact numbers.
pub fn cases() -> Vec<Case> {
    let mut cases = placing::cases();
    cases.extend(adapter::cases());
    cases.extend(depth::cases());
    cases.extend(plain::cases());
    cases
}

/// How far results move with their inputs.
pub fn conditioning_cases() -> Vec<Case> {
    conditioning::cases()
}
