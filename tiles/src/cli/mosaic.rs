//! What the user says of how several inputs become one, and of voids.

use crate::dem::{DemSource, JoinOptions, MAX_SEAM_SAMPLES, OpenOptions, Priority, Seam, join_all};
use anyhow::Result;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// How inputs are joined.
#[derive(Debug, Clone, Args)]
pub(super) struct MosaicArgs {
    /// Which input counts where several overlap; a hole never counts
    #[arg(long, value_enum, default_value_t = PriorityArg::First)]
    priority: PriorityArg,
    /// How heights go from one input to the next: "exact", or "blend:N", over N samples inside
    /// their overlap
    #[arg(long, value_name = "SEAM", default_value = "exact", value_parser = seam)]
    seam: Seam,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum PriorityArg {
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
    /// One source of all inputs.
    pub(super) fn join(
        &self,
        inputs: &[PathBuf],
        options: &OpenOptions,
    ) -> Result<Box<dyn DemSource>> {
        let join = JoinOptions {
            priority: match self.priority {
                PriorityArg::First => Priority::First,
                PriorityArg::Last => Priority::Last,
            },
            seam: self.seam,
        };
        Ok(join_all(inputs, options, join)?)
    }
}
