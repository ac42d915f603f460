//! What overlapping inputs said of the same samples.

use super::super::Placement;

/// What overlapping inputs said of the same samples, over the rows read so far.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct OverlapReport {
    /// Comparisons: times that an input had a height where one of higher priority had given one.
    pub overlapping: u64,
    /// Of these, how many differed.
    pub differing: u64,
    /// The largest difference, in metres.
    pub largest_m: f64,
    /// Where the largest difference is, the northernmost of its size, then the westernmost: east
    /// and north coordinate in the inputs' CRS.
    pub largest_at: Option<[f64; 2]>,
}

impl OverlapReport {
    /// Both together.
    pub(super) fn and(self, other: OverlapReport) -> OverlapReport {
        let larger = if other.largest_m > self.largest_m {
            &other
        } else {
            &self
        };
        OverlapReport {
            overlapping: self.overlapping + other.overlapping,
            differing: self.differing + other.differing,
            ..*larger
        }
    }

    /// Compares two heights of the sample at a column and row of the mosaic.
    pub(super) fn compare(
        &mut self,
        have_m: f64,
        new_m: f64,
        (column, row): (usize, usize),
        placement: &Placement,
    ) {
        let difference_m = (new_m - have_m).abs();
        self.overlapping += 1;
        self.differing += u64::from(difference_m > 0.0);
        if difference_m == 0.0 || difference_m < self.largest_m {
            return;
        }
        let Placement { x0, y0, dx, dy } = placement;
        let at = [x0 + column as f64 * dx, y0 - row as f64 * dy];
        let before = |have: [f64; 2]| at[1] > have[1] || at[1] == have[1] && at[0] < have[0];
        if difference_m > self.largest_m || self.largest_at.is_none_or(before) {
            self.largest_m = difference_m;
            self.largest_at = Some(at);
        }
    }
}
