//! What is to be measured, checked before anything is.

use super::lines::Line;
use super::variant::Variant;
use escarp_proto::view::SCREEN_ERRORS_PX;
use serde::Serialize;

/// Most tolerances, meshers or lines of one report.
const MOST: usize = 32;

/// What is to be measured.
#[derive(Debug, Clone, Serialize)]
pub struct Plan {
    /// The meshers.
    pub meshers: Vec<Variant>,
    /// The tolerances, ascending, pixels.
    pub errors_px: Vec<f32>,
    /// The lines.
    pub lines: Vec<Line>,
    /// Windows of the flight.
    pub windows: u64,
    /// Frames of each.
    pub window_frames: u64,
    /// How often the times of a frame are taken.
    pub repeats: usize,
    /// Steps of the slow flight.
    pub slow_steps: u64,
    /// Measurements of a cold start.
    pub cold_measurements: usize,
    /// Virtual time that a cold start may take, seconds.
    pub cold_limit_s: u64,
    /// Whether it is a quick one.
    pub quick: bool,
}

impl Plan {
    /// The usual one, or the quick one, which takes under a minute for a million samples.
    pub fn usual(quick: bool) -> Plan {
        let lines: &[(f64, f64)] = match quick {
            true => &[(1e7, 50.0)],
            false => &[(1e6, 50.0), (1e7, 50.0), (1e8, 10.0)],
        };
        let line = |&(bits_per_s, delay_ms): &(f64, f64)| Line {
            bits_per_s,
            delay_ms,
        };
        Plan {
            meshers: Variant::all(),
            errors_px: match quick {
                true => vec![1.0, 2.0, 4.0, 16.0],
                false => vec![0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0],
            },
            lines: lines.iter().map(line).collect(),
            windows: if quick { 3 } else { 8 },
            window_frames: if quick { 8 } else { 40 },
            repeats: if quick { 1 } else { 3 },
            slow_steps: if quick { 12 } else { 60 },
            cold_measurements: if quick { 12 } else { 24 },
            cold_limit_s: 60,
            quick,
        }
    }

    /// Takes over what was asked for; what was not stays.
    ///
    /// # Errors
    /// What was found and what is allowed.
    pub fn with(
        mut self,
        meshers: Vec<Variant>,
        mut errors_px: Vec<f32>,
        lines: Vec<Line>,
    ) -> Result<Plan, String> {
        for (what, count) in [
            ("meshers", meshers.len()),
            ("tolerances", errors_px.len()),
            ("lines", lines.len()),
        ] {
            if count > MOST {
                return Err(format!("{count} {what}, allowed are {MOST}"));
            }
        }
        let [least, most] = SCREEN_ERRORS_PX;
        if let Some(px) = errors_px.iter().find(|px| !(least..=most).contains(*px)) {
            return Err(format!(
                "a tolerance of {px} px, allowed are {least} to {most} px"
            ));
        }
        errors_px.sort_unstable_by(f32::total_cmp);
        errors_px.dedup();
        if !errors_px.is_empty() {
            self.errors_px = errors_px;
        }
        if !meshers.is_empty() {
            self.meshers.clear();
            for mesher in meshers {
                if !self.meshers.contains(&mesher) {
                    self.meshers.push(mesher);
                }
            }
        }
        if !lines.is_empty() {
            self.lines = lines;
        }
        Ok(self)
    }

    /// The tolerance at which single figures are stated: 2 px, or the nearest there is.
    pub fn reference_px(&self) -> f32 {
        let far = |px: &f32| (px / 2.0).ln().abs();
        let nearest = self.errors_px.iter().copied();
        nearest
            .min_by(|a, b| far(a).total_cmp(&far(b)))
            .unwrap_or(2.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absurd_tolerances_are_refused_and_the_rest_is_put_in_order() {
        for px in [0.0, -1.0, f32::NAN, f32::INFINITY, 1e9] {
            let error = Plan::usual(true)
                .with(vec![], vec![px], vec![])
                .unwrap_err();
            assert!(error.contains("allowed are 0.05 to 1024"), "{error}");
        }
        let too_many = vec![1.0; 33];
        assert!(Plan::usual(true).with(vec![], too_many, vec![]).is_err());
        let plan = Plan::usual(false)
            .with(vec![], vec![8.0, 0.5, 8.0, 3.0], vec![])
            .unwrap();
        assert_eq!(plan.errors_px, [0.5, 3.0, 8.0]);
        assert_eq!(plan.reference_px(), 3.0);
        assert_eq!(Plan::usual(false).reference_px(), 2.0);
    }
}
