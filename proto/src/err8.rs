//! Log-coded error bounds: one byte, steps of an eighth of an octave, always rounded up.

/// `ceil(2^(i/8) * 2^32)` for `i` in `0..8`.
const EIGHTHS: [u64; 8] = [
    4_294_967_296,
    4_683_695_048,
    5_107_605_668,
    5_569_883_476,
    6_074_001_000,
    6_623_745_059,
    7_223_245_206,
    7_877_004_752,
];

/// The largest bound a code can carry, in quanta.
pub const MAX_BOUND: u32 = Err8(255).bound();

/// A coded upper bound of an error, in quanta. Code 0 is exactly zero; code `c` is
/// `ceil(2^((c-1)/8))`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct Err8(pub u8);

impl Err8 {
    /// The smallest code whose bound is at least `error`; `None` above [`MAX_BOUND`].
    ///
    /// ```
    /// # use escarp_proto::err8::Err8;
    /// assert_eq!(Err8::covering(0), Some(Err8(0)));
    /// assert!(Err8::covering(1000).unwrap().bound() >= 1000);
    /// assert_eq!(Err8::covering(u32::MAX), None);
    /// ```
    pub fn covering(error: u32) -> Option<Err8> {
        if error == 0 {
            return Some(Err8(0));
        }
        let octave = error.ilog2();
        let lowest = (octave * 8 + 1) as u8;
        (lowest..=u8::MAX)
            .map(Err8)
            .find(|code| code.bound() >= error)
    }

    /// The bound, in quanta.
    pub const fn bound(self) -> u32 {
        if self.0 == 0 {
            return 0;
        }
        let step = (self.0 - 1) as u64;
        let scaled = (EIGHTHS[(step % 8) as usize] as u128) << (step / 8);
        scaled.div_ceil(1 << 32) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_code_never_rounds_down_and_is_the_tightest(error in 0u32..=MAX_BOUND) {
            let code = Err8::covering(error).unwrap();
            prop_assert!(code.bound() >= error);
            let tighter = (0..=255).map(|c| Err8(c).bound()).filter(|&b| b >= error).min();
            prop_assert_eq!(Some(code.bound()), tighter);
        }
    }

    #[test]
    fn bounds_grow_with_codes_by_an_eighth_octave_at_most() {
        for c in 1..=255u8 {
            let (below, above) = (Err8(c - 1).bound(), Err8(c).bound());
            assert!(above >= below);
            assert!(f64::from(above) <= f64::from(below) * 2f64.powf(0.125) + 1.0);
        }
    }

    #[test]
    fn the_eighths_are_rounded_up() {
        for (i, &eighth) in EIGHTHS.iter().enumerate() {
            let exact = 2f64.powf(i as f64 / 8.0) * 4_294_967_296.0;
            assert!(eighth as f64 >= exact - 1e-4 && (eighth as f64) < exact + 1.0001);
        }
    }
}
