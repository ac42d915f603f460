//! Axes: from values to pixels, ticks and their labels.

/// How values are laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// In proportion.
    Linear,
    /// By their logarithm. Values must be positive.
    Log,
}

/// One axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// What it has, with its unit.
    pub label: String,
    /// How values are laid out.
    pub scale: Scale,
    /// Least and greatest value.
    pub range: [f64; 2],
}

/// A value with a label, or without one for a line of the grid alone.
#[derive(Debug, Clone, PartialEq)]
pub struct Tick {
    /// Where.
    pub value: f64,
    /// What it says.
    pub label: Option<String>,
}

impl Axis {
    /// An axis that holds all values, with some room, or from zero if it is linear. Values that
    /// the scale does not have are passed over.
    pub fn around(label: &str, scale: Scale, values: impl Iterator<Item = f64>) -> Axis {
        let usable = |v: &f64| v.is_finite() && (scale == Scale::Linear || *v > 0.0);
        let ends = values
            .filter(usable)
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[lo, hi], v| {
                [lo.min(v), hi.max(v)]
            });
        let range = match (scale, ends) {
            (_, [lo, hi]) if lo > hi => [0.1, 1.0],
            (Scale::Linear, [lo, hi]) => {
                let top = if hi > 0.0 { hi * 1.05 } else { 1.0 };
                [lo.min(0.0), top]
            }
            (Scale::Log, [lo, hi]) => {
                let room = (hi / lo).powf(0.06).max(1.25);
                [lo / room, hi * room]
            }
        };
        Axis {
            label: label.into(),
            scale,
            range,
        }
    }

    /// Share of the axis at which a value lies, between 0 and 1 if it is in range.
    pub fn share(&self, value: f64) -> f64 {
        let [lo, hi] = self.range;
        match self.scale {
            Scale::Linear => (value - lo) / (hi - lo),
            Scale::Log => (value.max(f64::MIN_POSITIVE) / lo).ln() / (hi / lo).ln(),
        }
    }

    /// Whether a value can be drawn.
    pub fn holds(&self, value: f64) -> bool {
        let positive = self.scale == Scale::Linear || value > 0.0;
        value.is_finite() && positive && (-1e-9..=1.0 + 1e-9).contains(&self.share(value))
    }

    /// Ticks, ascending.
    pub fn ticks(&self) -> Vec<Tick> {
        match self.scale {
            Scale::Linear => self.linear_ticks(),
            Scale::Log => self.log_ticks(),
        }
    }

    fn linear_ticks(&self) -> Vec<Tick> {
        let [lo, hi] = self.range;
        let rough = (hi - lo) / 5.0;
        let decade = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 2.5, 5.0, 10.0]
            .map(|n| n * decade)
            .into_iter()
            .find(|step| *step >= rough * 0.999)
            .unwrap_or(rough);
        let first = (lo / step).ceil() as i64;
        let last = (hi / step + 1e-9).floor() as i64;
        let tick = |i: i64| Tick {
            value: i as f64 * step,
            label: Some(number(i as f64 * step)),
        };
        (first..=last).map(tick).collect()
    }

    fn log_ticks(&self) -> Vec<Tick> {
        let [lo, hi] = self.range;
        let decades = (hi / lo).log10();
        let labelled: &[u32] = match decades {
            d if d < 1.2 => &[1, 2, 3, 5, 7],
            d if d < 3.0 => &[1, 2, 5],
            _ => &[1],
        };
        // Labels of very long axes would touch.
        let every = (decades / 8.0).ceil().max(1.0) as i32;
        let mut ticks = Vec::new();
        for power in lo.log10().floor() as i32..=hi.log10().ceil() as i32 {
            for n in 1..10u32 {
                let value = f64::from(n) * 10f64.powi(power);
                if self.holds(value) && (decades < 9.0 || n == 1) {
                    let says = labelled.contains(&n) && power.rem_euclid(every) == 0;
                    let label = says.then(|| number(value));
                    ticks.push(Tick { value, label });
                }
            }
        }
        ticks
    }
}

/// A number as people write it, of three digits.
pub fn number(value: f64) -> String {
    let size = value.abs();
    let trimmed = |text: String| match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    };
    match size {
        0.0 => "0".into(),
        _ if !value.is_finite() => "–".into(),
        s if !(1e-4..1e15).contains(&s) => {
            let text = format!("{value:.1e}");
            text.replace(".0e", "e")
        }
        s if s >= 999.5e9 => trimmed(format!("{:.2}", value / 1e12)) + "T",
        s if s >= 999.5e6 => trimmed(digits(value / 1e9)) + "G",
        s if s >= 999.5e3 => trimmed(digits(value / 1e6)) + "M",
        s if s >= 9999.5 => trimmed(digits(value / 1e3)) + "k",
        _ => trimmed(digits(value)),
    }
}

/// Three digits, or all of a whole number.
fn digits(value: f64) -> String {
    let size = value.abs();
    let after = match size {
        s if s >= 99.95 => 0,
        s if s >= 9.995 => 1,
        s if s >= 0.9995 => 2,
        s => (2 - s.log10().floor() as i32).clamp(3, 8) as usize,
    };
    format!("{value:.after$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_digits_and_no_idle_zeros() {
        for (value, text) in [
            (0.0, "0"),
            (0.5, "0.5"),
            (0.012_345, "0.0123"),
            (12.0, "12"),
            (1234.0, "1234"),
            (12_345.0, "12.3k"),
            (1.5e6, "1.5M"),
            (2e-7, "2e-7"),
            (100.0, "100"),
        ] {
            assert_eq!(number(value), text);
        }
    }

    #[test]
    fn ticks_lie_on_the_axis_and_some_are_labelled() {
        for scale in [Scale::Linear, Scale::Log] {
            for ends in [[1.0, 2.0], [0.001, 1e6], [3.0, 3.0], [1e-20, 1e20]] {
                let axis = Axis::around("x", scale, ends.into_iter());
                let ticks = axis.ticks();
                assert!(ticks.iter().all(|tick| axis.holds(tick.value)), "{axis:?}");
                let labels = ticks.iter().filter(|tick| tick.label.is_some()).count();
                assert!((1..=14).contains(&labels), "{axis:?}: {labels} labels");
            }
        }
        let nothing = Axis::around("x", Scale::Log, [f64::NAN, -1.0].into_iter());
        assert!(nothing.range[0] < nothing.range[1]);
    }
}
