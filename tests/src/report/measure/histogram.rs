//! Weighted histograms with bins of equal ratio.

/// Bins an octave.
const PER_OCTAVE: u32 = 32;
/// Values from `2^-24` to `2^24` have bins of their own.
const OCTAVES: i32 = 24;
const BINS: usize = (2 * OCTAVES as usize) * PER_OCTAVE as usize;
/// Mantissa bits that a bin's number keeps, and those that it drops.
const DROPPED: u32 = f64::MANTISSA_DIGITS - 1 - PER_OCTAVE.trailing_zeros();
/// Number of the first bin, as its lower edge's leading bits have it.
const FIRST: u64 = ((1023 - OCTAVES) as u64) << PER_OCTAVE.trailing_zeros();

const _: () = assert!(PER_OCTAVE.is_power_of_two());

/// How often which values occur. Values below the first bin count as zero.
#[derive(Debug, Clone, PartialEq)]
pub struct Histogram {
    zero: f64,
    bins: Vec<f64>,
    beyond: f64,
}

impl Default for Histogram {
    fn default() -> Histogram {
        Histogram {
            zero: 0.0,
            bins: vec![0.0; BINS],
            beyond: 0.0,
        }
    }
}

impl Histogram {
    /// Adds a value that is not negative, with a weight.
    pub fn add(&mut self, value: f64, weight: f64) {
        let number = value.to_bits() >> DROPPED;
        match number.checked_sub(FIRST) {
            None => self.zero += weight,
            Some(bin) => match self.bins.get_mut(bin as usize) {
                Some(bin) => *bin += weight,
                None => self.beyond += weight,
            },
        }
    }

    /// Adds values that are zero.
    pub fn add_zeros(&mut self, weight: f64) {
        self.zero += weight;
    }

    /// Adds another histogram.
    pub fn merge(&mut self, other: &Histogram) {
        self.zero += other.zero;
        self.beyond += other.beyond;
        for (own, other) in self.bins.iter_mut().zip(&other.bins) {
            *own += other;
        }
    }

    /// All weights.
    pub fn total(&self) -> f64 {
        self.zero + self.bins.iter().sum::<f64>() + self.beyond
    }

    /// The value that this share of the weight does not exceed, rounded up to the end of its bin,
    /// at most 2.2 % more; infinite beyond the last bin, 0 if there is nothing.
    pub fn quantile(&self, share: f64) -> f64 {
        let wanted = share * self.total();
        let mut below = self.zero;
        if below >= wanted {
            return 0.0;
        }
        for (bin, weight) in self.bins.iter().enumerate() {
            below += weight;
            if below >= wanted {
                return upper_edge(bin);
            }
        }
        f64::INFINITY
    }

    /// Share of the weight in values above one, which must be an edge of a bin to be exact.
    pub fn share_above(&self, value: f64) -> f64 {
        let total = self.total();
        if total <= 0.0 {
            return 0.0;
        }
        let above = |bin: &usize| upper_edge(*bin) > value;
        let bins: f64 = (0..BINS).filter(above).map(|bin| self.bins[bin]).sum();
        (bins + self.beyond) / total
    }

    /// `(value, share)`: which share of the weight is at most that value, from zero to the last
    /// bin in which there is anything; bins are joined by fours.
    pub fn cumulative(&self) -> Vec<(f64, f64)> {
        let total = self.total();
        if total <= 0.0 {
            return Vec::new();
        }
        let mut below = self.zero;
        let mut points = vec![(0.0, below / total)];
        for (i, four) in self.bins.chunks(4).enumerate() {
            let here: f64 = four.iter().sum();
            below += here;
            if here > 0.0 {
                points.push((upper_edge(4 * i + 3), below / total));
            }
        }
        points
    }

    /// `(lower edge, share)` by halves of octaves, zero first; the empty ones at both ends left
    /// out.
    pub fn by_half_octaves(&self) -> Vec<(f64, f64)> {
        let total = self.total().max(f64::MIN_POSITIVE);
        let width = PER_OCTAVE as usize / 2;
        let mut rows: Vec<(f64, f64)> = self
            .bins
            .chunks(width)
            .enumerate()
            .map(|(i, bins)| (lower_edge(i * width), bins.iter().sum::<f64>() / total))
            .collect();
        rows.push((2f64.powi(OCTAVES), self.beyond / total));
        let used = |row: &(f64, f64)| row.1 > 0.0;
        let first = rows.iter().position(used).unwrap_or(rows.len());
        let last = rows.iter().rposition(used).map_or(first, |last| last + 1);
        let mut kept = vec![(0.0, self.zero / total)];
        kept.extend_from_slice(&rows[first..last]);
        kept
    }
}

fn lower_edge(bin: usize) -> f64 {
    f64::from_bits((FIRST + bin as u64) << DROPPED)
}

fn upper_edge(bin: usize) -> f64 {
    lower_edge(bin + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_quantile_is_that_of_the_sorted_values_rounded_up_a_little(
            mut values in prop::collection::vec(1e-6f64..1e6, 1..200),
            share in 0.01f64..1.0,
        ) {
            let mut histogram = Histogram::default();
            values.iter().for_each(|&value| histogram.add(value, 1.0));
            values.sort_by(f64::total_cmp);
            let rank = (share * values.len() as f64).ceil() as usize - 1;
            let (exact, found) = (values[rank], histogram.quantile(share));
            prop_assert!(found >= exact && found <= exact * 1.04, "{found} for {exact}");
        }
    }

    #[test]
    fn edges_are_exact_and_extremes_have_a_place() {
        let mut histogram = Histogram::default();
        for value in [0.0, 1e-30, 0.5, 1.0, 2.0, 1e30, f64::INFINITY] {
            histogram.add(value, 1.0);
        }
        assert_eq!(histogram.total(), 7.0);
        assert_eq!(histogram.quantile(2.0 / 7.0), 0.0);
        assert_eq!(histogram.quantile(1.0), f64::INFINITY);
        assert!((histogram.share_above(1.0) - 4.0 / 7.0).abs() < 1e-12);
        assert!((histogram.share_above(1.1) - 3.0 / 7.0).abs() < 1e-12);
        let shares: f64 = histogram.by_half_octaves().iter().map(|row| row.1).sum();
        assert!((shares - 1.0).abs() < 1e-12);
        assert_eq!(Histogram::default().quantile(0.5), 0.0);
    }
}
