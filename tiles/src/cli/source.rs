//! From the command line to one source: what `build` stores is what `verify` compares with.

use super::grid::GridArgs;
use super::input::InputArgs;
use super::mosaic::MosaicArgs;
use crate::dem::DemSource;
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
    /// Whether of overlapping inputs the one named last counts.
    pub(super) fn is_last_first(&self) -> bool {
        self.mosaic.is_last_first()
    }

    /// Opens the inputs, joins them, brings them to the dataset's grid, and fills voids.
    pub(super) fn open(&self, inputs: &[PathBuf]) -> Result<Box<dyn DemSource>> {
        let joined = self.mosaic.join(inputs, &self.input.options())?;
        let placed = self.grid.place(joined)?;
        self.mosaic.fill(placed)
    }
}
