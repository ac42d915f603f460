//! The synthetic DEM in the place of a file: `synth:size=4097,seed=1,spacing=10`.

use super::{MAX_SPACING_CM, SPACING_CM, SynthSource};
use crate::dem::{DemError, MAX_SIDE_SAMPLES};
use std::path::Path;

/// How such a name starts.
const PREFIX: &str = "synth:";

const HINT: &str = "write synth:size=SAMPLES,seed=NUMBER,spacing=METRES; seed (1) and spacing (10) may be left out";

/// The name that makes this DEM.
pub(super) fn words(size: u32, seed: u64, spacing_cm: u32) -> String {
    let spacing_m = f64::from(spacing_cm) / 100.0;
    format!("{PREFIX}size={size},seed={seed},spacing={spacing_m}")
}

impl SynthSource {
    /// The DEM of a name as `synth:size=4097,seed=1,spacing=10`; `None` for names that do not
    /// start so. Size is in samples a side; spacing in metres, whole centimetres.
    ///
    /// # Errors
    /// [`DemError::Usage`] for anything else behind `synth:`.
    pub fn parse(path: &Path) -> Option<Result<SynthSource, DemError>> {
        let items = path.to_str()?.strip_prefix(PREFIX)?;
        Some(parse(items).map_err(|what| DemError::usage(path, what, HINT)))
    }
}

fn parse(items: &str) -> Result<SynthSource, String> {
    let (mut size, mut seed, mut spacing_cm) = (None, 1, SPACING_CM);
    for item in items.split(',') {
        let wrong = |allowed: String| format!("{item:?} is not {allowed}");
        match item.split_once('=') {
            Some(("size", value)) => {
                let found = value.parse().ok();
                size = found.filter(|size| (1..=MAX_SIDE_SAMPLES).contains(size));
                if size.is_none() {
                    return Err(wrong(format!("a size of 1 to {MAX_SIDE_SAMPLES} samples")));
                }
            }
            Some(("seed", value)) => {
                let found = value.parse();
                seed = found.map_err(|_| wrong("a seed of 0 to 2^64 - 1".into()))?;
            }
            Some(("spacing", value)) => {
                let most_m = MAX_SPACING_CM / 100;
                spacing_cm = centimetres(value).ok_or_else(|| {
                    wrong(format!(
                        "a spacing of 0.01 to {most_m} m, in whole centimetres"
                    ))
                })?;
            }
            _ => return Err(wrong("one of size=, seed=, spacing=".into())),
        }
    }
    let size = size.ok_or("no size is given")?;
    Ok(SynthSource::with_spacing_cm(size, seed, spacing_cm))
}

fn centimetres(metres: &str) -> Option<u32> {
    let cm = metres.parse::<f64>().ok()? * 100.0;
    let whole = cm.round();
    let fits = (whole - cm).abs() < 1e-6 && (1.0..=f64::from(MAX_SPACING_CM)).contains(&whole);
    fits.then_some(whole as u32)
}
