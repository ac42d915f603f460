//! Between the points of a lattice: cubic B-splines, in integers, row by row.

use super::land::hash;
use std::ops::Range;

/// Weights are in parts of this power of two.
const WEIGHT_BITS: u32 = 10;

/// How much each of four lattice points counts, at each place between the second and the third.
pub(super) type Weights<const PITCH: usize> = [[i32; 4]; PITCH];

/// The weights of a uniform cubic B-spline. Each four add up to one exactly.
pub(super) const fn weights<const PITCH: usize>() -> Weights<PITCH> {
    let mut all = [[0; 4]; PITCH];
    let mut at = 0;
    while at < PITCH {
        let (t, p) = (at as i64, PITCH as i64);
        let (s, cube) = (p - t, p * p * p);
        let one = 1 << WEIGHT_BITS;
        let first = (s * s * s * one + 3 * cube) / (6 * cube);
        let third =
            ((cube + 3 * t * p * p + 3 * t * t * p - 3 * t * t * t) * one + 3 * cube) / (6 * cube);
        let last = (t * t * t * one + 3 * cube) / (6 * cube);
        all[at] = [
            first as i32,
            (one - first - third - last) as i32,
            third as i32,
            last as i32,
        ];
        at += 1;
    }
    all
}

/// The spline through four values. Only differences are multiplied, so that they may be large.
fn blend(weights: &[i32; 4], [a, b, c, d]: [i32; 4]) -> i32 {
    let [first, _, third, last] = weights;
    let sum = first * (a - b) + third * (c - b) + last * (d - b);
    b + (sum >> WEIGHT_BITS)
}

/// A row of lattice points between four rows of them.
pub(super) fn between_rows(weights: &[i32; 4], rows: [&[i32]; 4], out: &mut Vec<i32>) {
    let [a, b, c, d] = rows;
    let columns = a.iter().zip(b).zip(c.iter().zip(d));
    out.clear();
    out.extend(columns.map(|((&a, &b), (&c, &d))| blend(weights, [a, b, c, d])));
}

/// Calls `each` with every stretch of at most `PITCH` samples and their values. `points` starts
/// with the lattice point before the first sample's.
pub(super) fn along_row<const PITCH: usize>(
    weights: &Weights<PITCH>,
    points: &[i32],
    out: &mut [i32],
) {
    for (out, points) in out.chunks_mut(PITCH).zip(points.windows(4)) {
        let points = [points[0], points[1], points[2], points[3]];
        for (out, weights) in out.iter_mut().zip(weights) {
            *out = blend(weights, points);
        }
    }
}

/// Noise of one width: random values `PITCH` samples apart.
pub(super) struct Noise<const PITCH: usize> {
    weights: Weights<PITCH>,
    /// Lattice rows from `first` on, `columns` each.
    values: Vec<i32>,
    first: i64,
    columns: usize,
    row: Vec<i32>,
}

impl<const PITCH: usize> Noise<PITCH> {
    /// For samples `0..width` of some rows; values are at most `amplitude` either way.
    pub(super) fn new(seed: u64, rows: Range<i64>, width: usize, amplitude: i64) -> Self {
        let pitch = PITCH as i64;
        let (first, last) = (
            rows.start.div_euclid(pitch),
            (rows.end - 1).div_euclid(pitch) + 3,
        );
        let columns = width.div_ceil(PITCH) + 3;
        let salt = seed ^ (PITCH as u64).wrapping_mul(0xA24B_AED4_963E_E407);
        let value = |x: i64, y: i64| {
            let random = (hash(salt, x, y) >> 48) as i16;
            ((i64::from(random) * amplitude) >> 15) as i32
        };
        let values = (first..=last)
            .flat_map(|y| (0..columns as i64).map(move |x| value(x, y)))
            .collect();
        Noise {
            weights: weights(),
            values,
            first,
            columns,
            row: Vec::new(),
        }
    }

    /// One of the rows.
    pub(super) fn row(&mut self, y: i64, out: &mut [i32]) {
        let pitch = PITCH as i64;
        let at = (y.div_euclid(pitch) - self.first) as usize;
        let rows = [0, 1, 2, 3].map(|i| &self.values[(at + i) * self.columns..][..self.columns]);
        let weights = &self.weights[y.rem_euclid(pitch) as usize];
        between_rows(weights, rows, &mut self.row);
        along_row(&self.weights, &self.row, out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_add_up_and_are_those_of_the_spline() {
        const WEIGHTS: Weights<8> = weights();
        for (at, weights) in WEIGHTS.iter().enumerate() {
            assert_eq!(weights.iter().sum::<i32>(), 1 << WEIGHT_BITS);
            let t = at as f64 / 8.0;
            let exact = [
                (1.0 - t).powi(3) / 6.0,
                (3.0 * t.powi(3) - 6.0 * t * t + 4.0) / 6.0,
                (1.0 + 3.0 * t + 3.0 * t * t - 3.0 * t.powi(3)) / 6.0,
                t.powi(3) / 6.0,
            ];
            for (weight, exact) in weights.iter().zip(exact) {
                assert!((f64::from(*weight) - exact * 1024.0).abs() < 2.0);
            }
        }
    }

    #[test]
    fn a_lattice_on_a_plane_gives_the_plane() {
        let points: Vec<i32> = (0..10).map(|i| 5000 + 80 * i).collect();
        let mut out = [0; 50];
        along_row(&weights::<8>(), &points, &mut out);
        for (x, height) in out.into_iter().enumerate() {
            assert!(
                (height - (5080 + 10 * x as i32)).abs() <= 1,
                "{x}: {height}"
            );
        }
    }
}
