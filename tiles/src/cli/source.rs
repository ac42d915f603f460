//! From the command line to one source: what `build` stores is what `verify` compares with.

use super::grid::GridArgs;
use super::input::InputArgs;
use super::mosaic::MosaicArgs;
use crate::dem::DemSource;
use anyhow::Result;
use clap::Args;
use escarp_proto::georef::{Georef, Plane};
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
    /// Files that its options name.
    pub(super) fn files(&self) -> Vec<PathBuf> {
        self.input.files()
    }

    /// Whether of overlapping inputs the one named last counts.
    pub(super) fn is_last_first(&self) -> bool {
        self.mosaic.is_last_first()
    }

    /// Opens the inputs, joins them, brings them to the dataset's grid, and fills voids.
    pub(super) fn open(&self, inputs: &[PathBuf]) -> Result<Box<dyn DemSource>> {
        self.open_spaced(inputs, None)
    }

    /// As [`open`](Self::open), on the grid of a dataset that is to be compared: it knows the
    /// spacing of inputs without georeference.
    pub(super) fn open_like(
        &self,
        inputs: &[PathBuf],
        georef: &Georef,
    ) -> Result<Box<dyn DemSource>> {
        let local = georef.plane == Plane::Local;
        self.open_spaced(inputs, local.then_some(georef.sample_spacing_m[0]))
    }

    fn open_spaced(
        &self,
        inputs: &[PathBuf],
        known_spacing_m: Option<f64>,
    ) -> Result<Box<dyn DemSource>> {
        let mut options = self.input.options();
        options.spacing_m = options.spacing_m.or(known_spacing_m);
        let joined = self.mosaic.join(inputs, &options)?;
        // Without georeference the reader has already laid its samples so far apart.
        let placed = self.grid.place(joined, options.spacing_m)?;
        self.mosaic.fill(placed)
    }
}
