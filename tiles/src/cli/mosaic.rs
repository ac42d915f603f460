//! What the user says of how several inputs become one, and of voids.

use crate::dem::{DemSource, OpenOptions, open_all};
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;

/// How inputs are joined.
#[derive(Debug, Clone, Args)]
pub(super) struct MosaicArgs {}

impl MosaicArgs {
    /// One source of all inputs.
    pub(super) fn join(
        &self,
        inputs: &[PathBuf],
        options: &OpenOptions,
    ) -> Result<Box<dyn DemSource>> {
        Ok(open_all(inputs, options)?)
    }
}
