//! From the command line to one source: what `build` stores is what `verify` compares with.

use super::grid::GridArgs;
use super::input::InputArgs;
use super::mosaic::MosaicArgs;
use crate::dem::{DemSource, expand};
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;

/// Everything that decides which heights come of the inputs.
#[derive(Debug, Clone, Args)]
pub(super) struct SourceArgs {
    #[command(flatten)]
    input: InputArgs,
    #[command(flatten)]
    mosaic: MosaicArgs,
    #[command(flatten)]
    grid: GridArgs,
}

impl SourceArgs {
    /// Opens the inputs, joins them, brings them to the dataset's grid, and fills voids.
    pub(super) fn open(&self, inputs: &[PathBuf]) -> Result<Box<dyn DemSource>> {
        let inputs = expand(inputs)?;
        let options = self.input.options();
        let joined = self.mosaic.join(&inputs, &options)?;
        // Without georeference the reader has already laid its samples so far apart.
        let placed = self.grid.place(joined, options.spacing_m)?;
        self.mosaic.fill(placed)
    }
}
