//! The command line of `escarp-tiles`.

mod build;
mod grid;
mod info;
mod input;
mod mosaic;
mod progress;
mod regions;
mod source;
mod verify;

use anyhow::Result;
use clap::{Args, Parser, Subcommand};
use std::path::PathBuf;
use std::process::ExitCode;

/// Make tiled, error-bounded terrain datasets from DEM files, look at them, and verify them.
///
/// A dataset is a folder NAME.escarp; escarp-server hosts it.
#[derive(Debug, Parser)]
#[command(name = "escarp-tiles", version, after_help = EXAMPLES)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "\
Examples:
  escarp-tiles build moon.tif -o moon.escarp
  escarp-tiles build srtm/*.hgt.zip -o sierra.escarp       several inputs make one mosaic
  escarp-tiles build heights.png --spacing 160 --height-step 0.1 -o puget.escarp
  escarp-tiles verify moon.escarp --against moon.tif
  escarp-tiles sample -o demo.tif --size 2048 --seed 7

Exit codes: 0 done; 1 failed, or a bound does not hold; 2 wrong usage.";

#[derive(Debug, Subcommand)]
enum Command {
    /// Build a dataset from one DEM or a mosaic of several
    Build(build::BuildArgs),
    /// Say what a dataset holds
    Info(info::InfoArgs),
    /// Check every checksum, and bounds by brute force
    Verify(verify::VerifyArgs),
    /// Write a synthetic DEM: ridges, valleys, a lake, a cliff, detail
    Sample(SampleArgs),
}

#[derive(Debug, Args)]
struct SampleArgs {
    /// GeoTIFF to write
    #[arg(short, long, value_name = "FILE.tif")]
    output: PathBuf,
    /// Samples a side
    #[arg(long, default_value_t = 2048)]
    size: u32,
    /// The same seed gives the same terrain, on every machine
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Runs a command.
///
/// # Errors
/// What stopped it.
pub fn run(cli: Cli) -> Result<ExitCode> {
    match cli.command {
        Command::Build(args) => build::run(&args),
        Command::Info(args) => info::run(&args),
        Command::Verify(args) => verify::run(&args),
        Command::Sample(args) => {
            crate::synth::write_geotiff(&args.output, args.size, args.seed)?;
            let (file, side) = (args.output.display(), args.size);
            println!(
                "{file}: {side} x {side} samples, 10 m apart, seed {}",
                args.seed
            );
            Ok(ExitCode::SUCCESS)
        }
    }
}
