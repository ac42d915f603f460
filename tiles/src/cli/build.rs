//! `escarp-tiles build`.

use super::progress::Progress;
use super::regions::RegionArgs;
use super::source::SourceArgs;
use crate::build::{BuildOptions, Quantum, build};
use crate::dataset::Dataset;
use crate::dem::{Fills, OverlapReport};
use crate::process;
use anyhow::{Context, Result};
use clap::Args;
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

/// Inputs that a manifest names.
const MOST_SOURCES: usize = 256;

#[derive(Debug, Args)]
pub(super) struct BuildArgs {
    /// DEM files: GeoTIFF, SRTM .hgt and .hgt.zip, 8 and 16 bit greyscale PNG. Where several overlap, the one
    /// named first counts
    #[arg(required = true, value_name = "INPUT")]
    inputs: Vec<PathBuf>,
    /// Dataset to make
    #[arg(short, long, value_name = "NAME.escarp")]
    output: PathBuf,
    /// Metres a unit of stored height; default: the input's own step, 0.01 for floating point
    #[arg(
        long,
        value_name = "M",
        conflicts_with = "lossless",
        allow_negative_numbers = true
    )]
    quantum: Option<f64>,
    /// Store every height exactly
    #[arg(long)]
    lossless: bool,
    /// Threads; default: one a core
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u16).range(..=1024))]
    jobs: u16,
    /// Replace a dataset of this name
    #[arg(long)]
    overwrite: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    source: SourceArgs,
    #[command(flatten)]
    regions: RegionArgs,
}

pub(super) fn run(args: &BuildArgs) -> Result<ExitCode> {
    let started = Instant::now();
    rayon::ThreadPoolBuilder::new()
        .num_threads(usize::from(args.jobs))
        .build_global()
        .context("cannot start the threads")?;
    let source = args.source.open(&args.inputs)?;
    let name = |path: &PathBuf| {
        path.file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned()
    };
    let quantum = match (args.quantum, args.lossless) {
        (Some(metres), _) => Quantum::Metres(metres),
        (None, true) => Quantum::Lossless,
        (None, false) => Quantum::Natural,
    };
    let (mut source, quantum) = args.regions.coarsen(source, quantum)?;
    let options = BuildOptions {
        quantum,
        overwrite: args.overwrite,
    };
    let progress = Progress::new("building", args.json);
    let mut sources: Vec<String> = args.inputs.iter().map(name).take(MOST_SOURCES).collect();
    if args.inputs.len() > MOST_SOURCES {
        sources.push(format!("and {} more", args.inputs.len() - MOST_SOURCES));
    }
    let manifest = build(
        &mut *source,
        &args.output,
        sources,
        options,
        &|done, total| {
            progress.at(done, total);
        },
    )?;
    progress.end();
    let overlaps = source.overlaps();
    let fills = source.fills().cloned();
    let bytes = Dataset::open(&args.output)?.total_bytes();
    let samples = u64::from(manifest.samples[0]) * u64::from(manifest.samples[1]);
    let (wall_s, usage) = (started.elapsed().as_secs_f64(), process::usage());
    if args.json {
        let summary = json!({
            "samples": samples, "valid_samples": manifest.valid_samples, "pages": manifest.pages,
            "bytes": bytes, "bits_a_sample": bytes as f64 * 8.0 / samples as f64,
            "storage_error_m": manifest.storage_error_m, "wall_s": wall_s,
            "cpu_s": usage.map(|u| u.cpu_s), "peak_memory_bytes": usage.map(|u| u.peak_memory_bytes),
            "overlaps": overlaps.map(|o| json!({
                "overlapping": o.overlapping, "differing": o.differing, "largest_m": o.largest_m,
                "largest_at": o.largest_at,
            })),
            "fills": fills.map(|f| json!({
                "samples": f.samples, "voids": f.voids, "voids_left": f.left,
            })),
        });
        println!("{summary:#}");
        return Ok(ExitCode::SUCCESS);
    }
    let [width, height] = manifest.samples;
    if width < 2 || height < 2 {
        eprintln!("warning: one row or column of samples has no surface: there is nothing to draw");
    }
    println!(
        "{}: {width} x {height} samples, {} pages, {:.1} MB, {:.2} bits a sample",
        args.output.display(),
        manifest.pages,
        bytes as f64 / 1e6,
        bytes as f64 * 8.0 / samples as f64
    );
    println!(
        "stored in steps of {} m; largest difference from the input {} m",
        manifest.georef.quantum_m,
        rounded_up(manifest.storage_error_m)
    );
    for tolerance in &manifest.tolerances {
        println!("{}", super::info::describe_tolerance(tolerance));
    }
    let voids = samples - manifest.valid_samples;
    if voids > 0 {
        let share = 100.0 * voids as f64 / samples as f64;
        println!("{voids} samples without data ({share:.1} %): they stay holes");
    }
    if let Some(fills) = fills {
        print_fills(&fills, samples);
    }
    if let Some(overlaps) = overlaps {
        print_overlaps(&overlaps);
    }
    match usage {
        Some(usage) => println!(
            "{wall_s:.1} s, {:.1} s CPU, {:.1} million samples a CPU second, peak memory {:.0} MB",
            usage.cpu_s,
            samples as f64 / 1e6 / usage.cpu_s.max(1e-3),
            usage.peak_memory_bytes as f64 / 1e6
        ),
        None => println!("{wall_s:.1} s"),
    }
    Ok(ExitCode::SUCCESS)
}

/// To a millionth, for people.
pub(super) fn rounded_up(metres: f64) -> f64 {
    (metres * 1e6).ceil() / 1e6
}

fn print_fills(fills: &Fills, samples: u64) {
    let share = 100.0 * fills.samples as f64 / samples as f64;
    println!(
        "{} voids filled, {} samples ({share:.2} %); {} larger ones stay holes",
        fills.voids, fills.samples, fills.left
    );
}

fn print_overlaps(overlaps: &OverlapReport) {
    let OverlapReport {
        overlapping,
        differing,
        largest_m,
        largest_at,
    } = overlaps;
    print!("inputs overlap at {overlapping} samples and differ at {differing}");
    match largest_at {
        Some([x, y]) => println!(", by at most {largest_m} m, at {x} east, {y} north"),
        None => println!(),
    }
}
