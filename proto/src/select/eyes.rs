//! Where the eye may be: what is selected for all of it is enough wherever in it the eye is.

/// A box of places of an eye, metres.
///
/// Distances are the largest of those along the axes, so the least distance from anywhere in a box
/// is found axis by axis: a box costs a selection no more than a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Eyes {
    pub(super) lo_m: [f64; 3],
    pub(super) hi_m: [f64; 3],
}

impl Eyes {
    /// One place.
    pub const fn at(eye_m: [f64; 3]) -> Eyes {
        Eyes {
            lo_m: eye_m,
            hi_m: eye_m,
        }
    }

    /// All that is on the way from one place to another, and so far beside it along each axis.
    pub fn between(a_m: [f64; 3], b_m: [f64; 3], beside_m: f64) -> Eyes {
        let end = |i: usize| (a_m[i].min(b_m[i]), a_m[i].max(b_m[i]));
        Eyes {
            lo_m: std::array::from_fn(|i| end(i).0 - beside_m),
            hi_m: std::array::from_fn(|i| end(i).1 + beside_m),
        }
    }

    /// Whether a place is in it.
    pub fn hold(&self, eye_m: [f64; 3]) -> bool {
        (0..3).all(|i| (self.lo_m[i]..=self.hi_m[i]).contains(&eye_m[i]))
    }
}
