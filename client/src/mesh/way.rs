//! How far an eye has come: what it takes to tell that a test cannot come out differently yet.

/// The length of an eye's way, in the measure of
/// [`WorldBox::distance_m`](escarp_proto::georef::WorldBox::distance_m).
#[derive(Debug, Default)]
pub(super) struct Way {
    eye_m: Option<[f64; 3]>,
    length_m: f64,
}

impl Way {
    /// Goes on to a place.
    pub(super) fn go(&mut self, eye_m: [f64; 3]) {
        if let Some(last) = self.eye_m.replace(eye_m) {
            let step = (0..3).map(|axis| (eye_m[axis] - last[axis]).abs());
            let step_m = step.fold(0.0, f64::max);
            // Never less than it is: steps too small for the sum count as its last digit.
            if step_m > 0.0 {
                self.length_m = (self.length_m + step_m.next_up()).next_up();
            }
        }
    }

    /// Counts from here.
    pub(super) fn restart(&mut self) {
        self.length_m = 0.0;
    }

    /// From the first place to the last, metres; never less than it is.
    pub(super) fn length_m(&self) -> f64 {
        self.length_m
    }

    /// How far it went since its length was this, metres; never less.
    pub(super) fn since_m(&self, length_m: f64) -> f64 {
        (self.length_m - length_m) * (1.0 + 1e-9)
    }
}

#[cfg(test)]
mod tests {
    use super::Way;

    #[test]
    fn millimetres_after_leaps_are_not_lost() {
        let mut way = Way::default();
        way.go([0.0; 3]);
        way.go([1e12, 0.0, 0.0]);
        way.go([0.0; 3]);
        let before = way.length_m();
        for i in 1..=1000 {
            way.go([0.0, f64::from(i) * 1e-3, 0.0]);
        }
        assert!(way.since_m(before) >= 1.0);
    }
}
