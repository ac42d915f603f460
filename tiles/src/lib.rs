//! Elevation data becomes a dataset of tiled files, and is read back from it.
//!
//! In reading order:

pub mod dem;

pub mod crs;

pub mod place;

pub mod synth;

pub mod frame;

pub mod build;

pub use escarp_dataset as dataset;
pub use escarp_dataset::checksum;

pub mod update;

pub mod export;

pub mod verify;

pub mod process;

pub mod cli;
