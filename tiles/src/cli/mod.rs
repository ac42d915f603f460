//! The command line of `escarp-tiles`.

mod bench;
mod build;
mod compact;
mod diff;
mod export;
mod grid;
mod info;
mod input;
mod mosaic;
mod place;
mod progress;
mod regions;
mod resume;
mod source;
mod survey;
mod update;
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
  escarp-tiles build --input synth:size=100001,seed=1,spacing=1 -o large.escarp
  escarp-tiles update moon.escarp --with crater.tif        only what changed is written
  escarp-tiles build everest.tif --crs EPSG:32645 --spacing 90 -o everest.escarp
  escarp-tiles export everest.escarp --bounds 480000,3090000,500000,3110000 -o part.tif
  escarp-tiles verify moon.escarp --against moon.tif
  escarp-tiles bench moon.tif --max-error 0,1,4,8
  escarp-tiles sample -o demo.tif --size 2048 --seed 7

Exit codes: 0 done; 1 failed, or a bound does not hold, or two datasets differ; 2 wrong usage.";

#[derive(Debug, Subcommand)]
enum Command {
    /// Build a dataset from one DEM or a mosaic of several
    Build(build::BuildArgs),
    /// Change a part of a dataset: a new generation that shares all the rest
    Update(update::UpdateArgs),
    /// Drop what only old generations of a dataset need
    Compact(compact::CompactArgs),
    /// Say what a dataset holds
    Info(info::InfoArgs),
    /// Check checksums, borders of pages, and bounds by brute force
    Verify(verify::VerifyArgs),
    /// Measure size and speed of the codec on DEM files, at several largest errors
    Bench(bench::BenchArgs),
    /// Say how two datasets, or two generations of one, differ
    Diff(diff::DiffArgs),
    /// Write a dataset's heights as a GeoTIFF
    Export(export::ExportArgs),
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
        Command::Update(args) => update::run(&args),
        Command::Compact(args) => compact::run(&args),
        Command::Info(args) => info::run(&args),
        Command::Verify(args) => verify::run(&args),
        Command::Bench(args) => bench::run(&args),
        Command::Diff(args) => diff::run(&args),
        Command::Export(args) => export::run(&args),
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
