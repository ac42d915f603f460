//! From stored samples to heights in metres.

use std::ops::Range;

use super::{DemError, DemInfo, MAX_HEIGHT_M, OpenOptions, SampleType};

/// What a stored value means, as a file states it and as the user overrides it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct HeightRule {
    /// Metres a stored unit stands for.
    pub step_m: f64,
    /// Metres added.
    pub offset_m: f64,
    /// Stored value of a hole.
    pub nodata: Option<f64>,
}

impl HeightRule {
    /// Metres as they are, no holes.
    pub const METRES: Self = Self {
        step_m: 1.0,
        offset_m: 0.0,
        nodata: None,
    };

    /// The file's rule with the user's wishes on top; `sample_type` decides how nodata rounds.
    ///
    /// # Errors
    /// [`DemError::Usage`] for a step that is zero or not finite.
    pub fn resolve(
        file: Self,
        options: &OpenOptions,
        sample_type: SampleType,
        path: &std::path::Path,
    ) -> Result<Self, DemError> {
        let white_m = match options.max_height_m {
            Some(max_height_m) => Some(step_of_white(max_height_m, sample_type, path)?),
            None => None,
        };
        let rule = Self {
            step_m: options.height_step_m.or(white_m).unwrap_or(file.step_m),
            offset_m: options.height_offset_m.unwrap_or(file.offset_m),
            // Every NaN is a hole anyway, and would make no two infos equal.
            nodata: options
                .nodata
                .or(file.nodata)
                .filter(|value| !value.is_nan())
                .map(|value| as_stored(value, sample_type)),
        };
        if !rule.step_m.is_finite() || rule.step_m == 0.0 || !rule.offset_m.is_finite() {
            let what = format!("height step {} m, offset {} m", rule.step_m, rule.offset_m);
            return Err(DemError::usage(
                path,
                what,
                "both must be finite and the step not 0",
            ));
        }
        Ok(rule)
    }

    /// Height in metres; NaN for a hole.
    pub fn height_m(&self, stored: f64) -> f64 {
        if Some(stored) == self.nodata {
            f64::NAN
        } else {
            stored * self.step_m + self.offset_m
        }
    }
}

/// Metres of one grey level, where the whitest stands for `max_height_m`.
fn step_of_white(
    max_height_m: f64,
    sample_type: SampleType,
    path: &std::path::Path,
) -> Result<f64, DemError> {
    match sample_type {
        SampleType::U8 => Ok(max_height_m / 255.0),
        SampleType::U16 => Ok(max_height_m / 65535.0),
        other => {
            let what = format!("a largest height was given, but its samples are {other:?}");
            let hint = "--max-height is for greys of 8 or 16 bits; give --height-step";
            Err(DemError::usage(path, what, hint))
        }
    }
}

/// Nodata as it looks once stored: in an f32 file the declared `-3.4028234663852886e+38` (or a
/// shortened decimal of it) only matches after rounding to f32.
fn as_stored(nodata: f64, sample_type: SampleType) -> f64 {
    if sample_type != SampleType::F32 || !nodata.is_finite() {
        return nodata;
    }
    f64::from((nodata as f32).clamp(f32::MIN, f32::MAX))
}

/// Refuses heights that can be none: infinite, or beyond [`MAX_HEIGHT_M`].
///
/// # Errors
/// [`DemError::Damaged`] naming row and column, counted from 0 at the north-west.
pub(super) fn check(info: &DemInfo, first_row: u32, heights: &[f64]) -> Result<(), DemError> {
    check_window(info, first_row, 0..info.width, heights)
}

/// As [`check`], for some columns of rows.
///
/// # Errors
/// As [`check`].
pub(super) fn check_window(
    info: &DemInfo,
    first_row: u32,
    columns: Range<u32>,
    heights: &[f64],
) -> Result<(), DemError> {
    let beyond = |h: &f64| h.abs() > MAX_HEIGHT_M;
    let Some(at) = heights.iter().position(beyond) else {
        return Ok(());
    };
    let across = columns.len();
    let row = first_row as usize + at / across;
    let column = columns.start as usize + at % across;
    let place = format!("row {row}, column {column}");
    let found = format!("a height of {:e} m", heights[at]);
    let expected = "less than 1e9 m (if the value means a hole, give it as --nodata)";
    Err(DemError::damaged(&info.path, place, found, expected))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn f32_nodata_matches_after_rounding_however_it_was_printed() {
        for text in [
            "-3.4028234663852886e+38",
            "-3.40282347e+38",
            "-3.4028235e38",
            "-3.5e38",
        ] {
            let file = HeightRule {
                nodata: text.parse().ok(),
                ..HeightRule::METRES
            };
            let options = OpenOptions::default();
            let rule = HeightRule::resolve(file, &options, SampleType::F32, Path::new("f"));
            assert!(
                rule.unwrap().height_m(f64::from(f32::MIN)).is_nan(),
                "{text}"
            );
        }
    }

    #[test]
    fn the_users_step_offset_and_nodata_replace_the_files() {
        let options = OpenOptions {
            height_step_m: Some(0.1),
            height_offset_m: Some(-5.0),
            nodata: Some(7.0),
            ..OpenOptions::default()
        };
        let file = HeightRule {
            nodata: Some(0.0),
            ..HeightRule::METRES
        };
        let rule = HeightRule::resolve(file, &options, SampleType::U16, Path::new("f")).unwrap();
        assert_eq!(rule.height_m(100.0), 5.0);
        assert_eq!(rule.height_m(0.0), -5.0);
        assert!(rule.height_m(7.0).is_nan());
    }

    #[test]
    fn a_step_of_zero_is_refused() {
        let options = OpenOptions {
            height_step_m: Some(0.0),
            ..OpenOptions::default()
        };
        let rule =
            HeightRule::resolve(HeightRule::METRES, &options, SampleType::U8, Path::new("f"));
        assert!(matches!(rule, Err(DemError::Usage { .. })));
    }
}
