//! What the user says of how several inputs become one, and of voids.

use super::progress::Progress;
use crate::dem::{
    DemSource, Filled, JoinOptions, MAX_FILL_SAMPLES, MAX_SEAM_SAMPLES, OpenOptions, Priority,
    Seam, join_all,
};
use anyhow::Result;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// How inputs are joined.
#[derive(Debug, Clone, Args)]
pub(super) struct MosaicArgs {
    /// Which input counts where several overlap; a hole never counts
    #[arg(long, value_enum, default_value_t = PriorityArg::Finest)]
    priority: PriorityArg,
    /// How heights go from one input to the next: "exact", or "blend:N", over N samples inside
    /// their overlap
    #[arg(long, value_name = "SEAM", default_value = "exact", value_parser = seam)]
    seam: Seam,
    /// Fill voids that data encloses, of at most this many samples; the dataset knows which
    /// samples are fill
    #[arg(
        long,
        value_name = "SAMPLES",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = DEFAULT_FILL,
        value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_FILL_SAMPLES))
    )]
    fill: Option<u32>,
}

/// [`DEFAULT_FILL_SAMPLES`], for the command line.
const DEFAULT_FILL: &str = "262144";

#[derive(Debug, Clone, Copy, ValueEnum)]
enum PriorityArg {
    /// The one with the finest spacing; of one spacing, the one named first
    Finest,
    /// The one named first
    First,
    /// The one named last
    Last,
}

fn seam(text: &str) -> Result<Seam, String> {
    let over = match text {
        "exact" => return Ok(Seam::Exact),
        _ => text.strip_prefix("blend:").and_then(|n| n.parse().ok()),
    };
    match over {
        Some(over) if (1..=MAX_SEAM_SAMPLES).contains(&over) => Ok(Seam::Blend(over)),
        _ => Err(format!(
            "allowed are exact, and blend:N with N from 1 to {MAX_SEAM_SAMPLES}"
        )),
    }
}

impl MosaicArgs {
    /// Whether of overlapping inputs the one named last counts.
    pub(super) fn is_last_first(&self) -> bool {
        matches!(self.priority, PriorityArg::Last)
    }

    /// One source of all inputs.
    pub(super) fn join(
        &self,
        inputs: &[PathBuf],
        options: &OpenOptions,
    ) -> Result<Box<dyn DemSource>> {
        let join = JoinOptions {
            priority: match self.priority {
                PriorityArg::Finest => Priority::Finest,
                PriorityArg::First => Priority::First,
                PriorityArg::Last => Priority::Last,
            },
            seam: self.seam,
        };
        Ok(join_all(inputs, options, join)?)
    }

    /// The source with its voids filled, if that was asked for: on the dataset's grid, so that
    /// the dataset can say which samples are fill.
    pub(super) fn fill(&self, source: Box<dyn DemSource>) -> Result<Box<dyn DemSource>> {
        let Some(max_samples) = self.fill else {
            return Ok(source);
        };
        let progress = Progress::new("filling voids", false);
        let filled = Filled::new(source, max_samples, &|done, total| progress.at(done, total))?;
        progress.end();
        Ok(Box::new(filled))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dem::DEFAULT_FILL_SAMPLES;

    #[test]
    fn the_size_of_voids_to_fill_has_the_documented_default() {
        assert_eq!(DEFAULT_FILL.parse(), Ok(DEFAULT_FILL_SAMPLES));
    }

    #[test]
    fn seams_are_exact_or_blended_over_a_number_of_samples() {
        assert_eq!(seam("exact"), Ok(Seam::Exact));
        assert_eq!(seam("blend:16"), Ok(Seam::Blend(16)));
        for wrong in [
            "blend",
            "blend:",
            "blend:0",
            "blend:257",
            "blend:-1",
            "soft",
        ] {
            assert!(seam(wrong).unwrap_err().contains("blend:N"), "{wrong}");
        }
    }
}
