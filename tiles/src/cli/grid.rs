//! What the user says of the grid that inputs are brought to.

use crate::dem::DemSource;
use anyhow::Result;
use clap::Args;

/// The grid of the dataset, where it is not that of the inputs.
#[derive(Debug, Clone, Args)]
pub(super) struct GridArgs {}

impl GridArgs {
    /// The source on that grid.
    pub(super) fn place(&self, source: Box<dyn DemSource>) -> Result<Box<dyn DemSource>> {
        Ok(source)
    }
}
