//! Sums and products of double-precision numbers without any rounding.
//!
//! A number is a sum of doubles that do not overlap, smallest first (J. R. Shewchuk, "Adaptive
//! Precision Floating-Point Arithmetic and Fast Robust Geometric Predicates", 1997). Exact as long
//! as nothing overflows and no part is below the smallest normal number.

/// An exact number.
#[derive(Debug, Clone, PartialEq)]
pub struct Exact(Vec<f64>);

impl Exact {
    /// A double as it is.
    pub fn of(value: f64) -> Exact {
        Exact(vec![value])
    }

    /// The exact product of two doubles.
    pub fn product(a: f64, b: f64) -> Exact {
        let (high, low) = two_product(a, b);
        Exact(vec![low, high])
    }

    /// The exact sum with a double.
    pub fn plus(mut self, value: f64) -> Exact {
        let mut carried = value;
        for part in &mut self.0 {
            let (high, low) = two_sum(carried, *part);
            *part = low;
            carried = high;
        }
        self.0.push(carried);
        self.0.retain(|part| *part != 0.0);
        self
    }

    /// The exact sum.
    pub fn and(self, other: &Exact) -> Exact {
        other.0.iter().fold(self, |sum, part| sum.plus(*part))
    }

    /// The exact difference.
    pub fn less(self, other: &Exact) -> Exact {
        other.0.iter().fold(self, |sum, part| sum.plus(-*part))
    }

    /// The exact product with a double.
    pub fn times(&self, factor: f64) -> Exact {
        let products = self.0.iter().map(|part| Exact::product(*part, factor));
        products.fold(Exact(Vec::new()), |sum, product| sum.and(&product))
    }

    /// The exact square of a sum of doubles.
    pub fn squared(&self) -> Exact {
        let products = self.0.iter().map(|part| self.times(*part));
        products.fold(Exact(Vec::new()), |sum, product| sum.and(&product))
    }

    /// The double nearest to it, or its neighbour.
    pub fn near(&self) -> f64 {
        self.0.iter().sum()
    }

    /// Whether it is below zero.
    pub fn is_negative(&self) -> bool {
        self.0.last().is_some_and(|largest| *largest < 0.0)
    }
}

/// A rounded sum, and what rounding took (D. E. Knuth, "The Art of Computer Programming" 2, 1969).
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let b_in = sum - a;
    (sum, (a - (sum - b_in)) + (b - b_in))
}

/// A rounded product, and what rounding took.
fn two_product(a: f64, b: f64) -> (f64, f64) {
    let product = a * b;
    (product, a.mul_add(b, -product))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A double as a multiple of 2^-40, if it is one.
    fn fixed(value: f64) -> i128 {
        (value * 2f64.powi(40)) as i128
    }

    proptest! {
        #[test]
        fn sums_and_products_are_those_of_integers(
            a in -1i64 << 50..1i64 << 50, b in -1i64 << 50..1i64 << 50,
            c in -1i64 << 30..1i64 << 30, x in 0u32..1 << 20,
        ) {
            let [a, b, c] = [a, b, c].map(|v| v as f64 / 2f64.powi(40));
            let found = Exact::product(f64::from(x), a).plus(b).less(&Exact::of(c));
            let right = i128::from(x) * fixed(a) + fixed(b) - fixed(c);
            let parts: i128 = found.0.iter().map(|part| fixed(*part)).sum();
            prop_assert_eq!(parts, right);
            prop_assert_eq!(found.is_negative(), right < 0);
            let near = right as f64 / 2f64.powi(40);
            prop_assert!((found.near() - near).abs() <= near.abs() * f64::EPSILON);
        }

        #[test]
        fn a_square_is_that_of_integers(a in -1i64 << 40..1i64 << 40, b in -1i64 << 20..1i64 << 20) {
            let sum = Exact::of(a as f64).plus(b as f64 / 1024.0).squared();
            let right = (i128::from(a) * 1024 + i128::from(b)).pow(2);
            let parts: i128 = sum.0.iter().map(|part| (*part * 1_048_576.0) as i128).sum();
            prop_assert_eq!(parts, right);
        }
    }
}
