//! What the user says of how to read input files.

use crate::dem::OpenOptions;
use clap::Args;

/// What the user says about inputs.
#[derive(Debug, Clone, Args)]
pub(super) struct InputArgs {
    /// Distance of samples: of files without georeference it states theirs, in metres; others are
    /// brought to it, in the units of the dataset's CRS (metres, feet, degrees)
    #[arg(long, value_name = "DISTANCE", allow_negative_numbers = true)]
    spacing: Option<f64>,
    /// Metres a stored unit stands for, for integer files (PNG: default 1)
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    height_step: Option<f64>,
    /// Metres added to every height
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    height_offset: Option<f64>,
    /// Stored value that means "no data"
    #[arg(long, value_name = "VALUE", allow_negative_numbers = true)]
    nodata: Option<f64>,
}

impl InputArgs {
    pub(super) fn options(&self) -> OpenOptions {
        OpenOptions {
            spacing_m: self.spacing,
            height_step_m: self.height_step,
            height_offset_m: self.height_offset,
            nodata: self.nodata,
        }
    }
}
