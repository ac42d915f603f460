//! Blended seams: inside an overlap, heights go from the one input's to the other's.
//!
//! A sample's weight follows from two distances, in samples, the larger of the two axes: `a` to
//! the nearest sample that only the lower input has, `b` to the nearest one that only the higher
//! ones have. The higher one's weight is `a / min(n + 1, a + b)`, at most 1: beside what only the
//! lower has it is nearly the lower's, from `n` samples on it is the higher's alone, and an
//! overlap of less than `n` samples is used from side to side. What an input has is judged by its
//! data, not by its rectangle: a border of nodata moves the seam with it.

use std::ops::Range;

/// A window of the mosaic: whole rows.
pub(super) struct Window {
    pub(super) width: usize,
    pub(super) heights: Vec<f64>,
}

/// An input in a window.
pub(super) struct Layer<'a> {
    /// Its columns and rows in the window.
    pub(super) columns: Range<usize>,
    pub(super) rows: Range<usize>,
    pub(super) heights: &'a [f64],
}

impl Layer<'_> {
    fn at(&self, column: usize, row: usize) -> f64 {
        if !self.columns.contains(&column) || !self.rows.contains(&row) {
            return f64::NAN;
        }
        self.heights[(row - self.rows.start) * self.columns.len() + column - self.columns.start]
    }
}

/// The higher input's weight for each sample of a layer, row by row; 1 where they do not overlap.
pub(super) fn weights(window: &Window, layer: &Layer<'_>, over: u16) -> Vec<f32> {
    let reach = usize::from(over);
    let all_rows = window.heights.len() / window.width;
    let columns =
        layer.columns.start.saturating_sub(reach)..(layer.columns.end + reach).min(window.width);
    let rows = layer.rows.start.saturating_sub(reach)..(layer.rows.end + reach).min(all_rows);
    let side = columns.len();
    let mut to_lower = vec![over + 1; side * rows.len()];
    let mut to_higher = to_lower.clone();
    for (j, row) in rows.clone().enumerate() {
        for (i, column) in columns.clone().enumerate() {
            let higher = !window.heights[row * window.width + column].is_nan();
            match (higher, !layer.at(column, row).is_nan()) {
                (true, false) => to_higher[j * side + i] = 0,
                (false, true) => to_lower[j * side + i] = 0,
                _ => {}
            }
        }
    }
    spread(&mut to_lower, side);
    spread(&mut to_higher, side);
    let mut weights = Vec::with_capacity(layer.heights.len());
    for row in layer.rows.clone() {
        for column in layer.columns.clone() {
            let at = (row - rows.start) * side + column - columns.start;
            let (a, b) = (f32::from(to_lower[at]), f32::from(to_higher[at]));
            let ramp = (f32::from(over) + 1.0).min(a + b);
            weights.push(if ramp > 0.0 { (a / ramp).min(1.0) } else { 1.0 });
        }
    }
    weights
}

/// Distances to the nearest zero, along the longer axis, no larger than what stands there: one
/// sweep from the first sample on and one back are exact for this measure (Rosenfeld and Pfaltz,
/// "Sequential Operations in Digital Picture Processing", 1966).
fn spread(distances: &mut [u16], side: usize) {
    let rows = distances.len() / side;
    let mut step = |row: usize, column: usize, backwards: bool| {
        let at = row * side + column;
        let mut nearest = distances[at];
        let mut ask = |there: bool, index: usize| {
            if there {
                nearest = nearest.min(distances[index].saturating_add(1));
            }
        };
        if backwards {
            let south = row + 1 < rows;
            ask(column + 1 < side, at + 1);
            ask(south, at + side);
            ask(south && column > 0, (at + side).wrapping_sub(1));
            ask(south && column + 1 < side, at + side + 1);
        } else {
            let north = row > 0;
            ask(column > 0, at.wrapping_sub(1));
            ask(north, at.wrapping_sub(side));
            ask(north && column > 0, at.wrapping_sub(side + 1));
            ask(
                north && column + 1 < side,
                at.wrapping_sub(side).wrapping_add(1),
            );
        }
        distances[at] = nearest;
    };
    for row in 0..rows {
        for column in 0..side {
            step(row, column, false);
        }
    }
    for row in (0..rows).rev() {
        for column in (0..side).rev() {
            step(row, column, true);
        }
    }
}

/// A height between two, in whole steps from the higher input's where heights have a step.
pub(super) fn between(higher_m: f64, lower_m: f64, weight: f32, step_m: Option<f64>) -> f64 {
    let move_m = (lower_m - higher_m) * (1.0 - f64::from(weight));
    match step_m {
        Some(step_m) => higher_m + (move_m / step_m).round() * step_m,
        None => higher_m + move_m,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The nearest zero, by looking at all.
    fn nearest(distances: &[u16], side: usize, at: usize) -> u16 {
        let place = |i: usize| (i % side, i / side);
        let (x, y) = place(at);
        let far = |i: usize| {
            let (u, v) = place(i);
            (u.abs_diff(x).max(v.abs_diff(y)) as u16).saturating_add(distances[i])
        };
        (0..distances.len()).map(far).min().unwrap()
    }

    proptest! {
        #[test]
        fn distances_are_those_to_the_nearest_sample(
            side in 1usize..12,
            zeros in prop::collection::vec(prop::bool::weighted(0.1), 1..150),
        ) {
            let rows = zeros.len().div_ceil(side);
            let mut distances = vec![7u16; rows * side];
            for (distance, zero) in distances.iter_mut().zip(&zeros) {
                *distance = if *zero { 0 } else { 7 };
            }
            let given = distances.clone();
            spread(&mut distances, side);
            for (at, distance) in distances.into_iter().enumerate() {
                prop_assert_eq!(distance, nearest(&given, side, at));
            }
        }
    }

    #[test]
    fn a_wide_overlap_is_left_after_n_samples_and_a_narrow_one_is_used_from_side_to_side() {
        let row = |columns: Range<usize>| {
            let mut heights = vec![f64::NAN; 40];
            heights[columns].fill(1.0);
            heights
        };
        let weights_of = |columns: Range<usize>, over| {
            let window = Window {
                width: 40,
                heights: row(0..20),
            };
            let heights = vec![2.0; columns.len()];
            let layer = Layer {
                columns,
                rows: 0..1,
                heights: &heights,
            };
            weights(&window, &layer, over)
        };
        let wide = weights_of(5..30, 3);
        assert_eq!(wide[..12], [1.0; 12]);
        assert_eq!(wide[12..15], [0.75, 0.5, 0.25]);
        let narrow = weights_of(17..30, 8);
        assert_eq!(narrow[..3], [0.75, 0.5, 0.25]);
    }

    #[test]
    fn blended_whole_metres_stay_whole() {
        assert_eq!(between(10.5, 13.5, 0.5, Some(1.0)), 12.5);
        assert_eq!(between(10.0, 13.0, 0.5, None), 11.5);
    }
}
