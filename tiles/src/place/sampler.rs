//! Heights of a source between its samples.

use super::Interpolation;
use super::blocks::{Key, Reader};
use std::collections::BTreeSet;

/// A source's size, and how its columns go around.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sampler {
    pub width: u32,
    pub height: u32,
    /// Columns in a whole turn, after which the first comes again.
    pub turn: Option<u32>,
    pub interpolation: Interpolation,
}

impl Sampler {
    /// Keys of the blocks that the height at a place may need.
    pub fn needs(&self, place: [f64; 2], shape: [u32; 2], keys: &mut BTreeSet<Key>) {
        if !place.iter().all(|v| v.is_finite()) {
            return;
        }
        let [c, r] = place.map(|v| v.floor() as i64);
        let reach = match self.interpolation {
            Interpolation::Linear => [0, 1],
            Interpolation::Cubic => [-1, 2],
        };
        for row in reach {
            for column in reach {
                // Where a neighbour does not exist, its nearest one may.
                if let (Some(c), Some(r)) = (self.column(c + column), self.row(r + row)) {
                    keys.insert((c / shape[0], r / shape[1]));
                }
            }
        }
        if let (Some(c), Some(r)) = (self.column(c), self.row(r)) {
            keys.insert((c / shape[0], r / shape[1]));
        }
    }

    /// The height at a column and row with fractions; NaN where a sample that counts is a hole,
    /// or outside.
    pub fn height(&self, [c, r]: [f64; 2], reader: &mut Reader<'_>) -> f64 {
        if !(c.is_finite() && r.is_finite()) {
            return f64::NAN;
        }
        let whole = [c.floor(), r.floor()];
        let part = [c - whole[0], r - whole[1]];
        let whole = whole.map(|v| v as i64);
        if self.interpolation == Interpolation::Cubic && part != [0.0; 2] {
            let cubic = self.cubic(whole, part, reader);
            if !cubic.is_nan() {
                return cubic;
            }
        }
        self.linear(whole, part, reader)
    }

    fn linear(&self, [c, r]: [i64; 2], [fc, fr]: [f64; 2], reader: &mut Reader<'_>) -> f64 {
        let mut row = |r: i64| {
            let west = self.sample(c, r, reader);
            // A sample without weight is not asked.
            if fc == 0.0 {
                return west;
            }
            west + (self.sample(c + 1, r, reader) - west) * fc
        };
        let north = row(r);
        if fr == 0.0 {
            return north;
        }
        north + (row(r + 1) - north) * fr
    }

    fn cubic(&self, [c, r]: [i64; 2], [fc, fr]: [f64; 2], reader: &mut Reader<'_>) -> f64 {
        let (across, down) = (weights(fc), weights(fr));
        let mut height = 0.0;
        for (row, weight) in (r - 1..).zip(down) {
            let mut along = 0.0;
            for (column, weight) in (c - 1..).zip(across) {
                along += weight * self.sample(column, row, reader);
            }
            height += weight * along;
        }
        height
    }

    fn sample(&self, column: i64, row: i64, reader: &mut Reader<'_>) -> f64 {
        match (self.column(column), self.row(row)) {
            (Some(column), Some(row)) => reader.at(column, row),
            _ => f64::NAN,
        }
    }

    fn column(&self, column: i64) -> Option<u32> {
        let column = match self.turn {
            Some(turn) => column.rem_euclid(i64::from(turn)),
            None => column,
        };
        u32::try_from(column).ok().filter(|c| *c < self.width)
    }

    fn row(&self, row: i64) -> Option<u32> {
        u32::try_from(row).ok().filter(|r| *r < self.height)
    }
}

/// Keys' weights of four samples for a place between the middle two, a = -1/2.
fn weights(f: f64) -> [f64; 4] {
    let (f2, f3) = (f * f, f * f * f);
    [
        -0.5 * f3 + f2 - 0.5 * f,
        1.5 * f3 - 2.5 * f2 + 1.0,
        -1.5 * f3 + 2.0 * f2 + 0.5 * f,
        0.5 * f3 - 0.5 * f2,
    ]
}
