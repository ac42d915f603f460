//! `escarp-tiles build`.

use super::progress::Progress;
use super::regions::RegionArgs;
use super::resume::{announce, identity, kept};
use super::source::SourceArgs;
use crate::build::{BuildOptions, CHECKPOINT_SAMPLES, Quantum, build};
use crate::dataset::{Dataset, Figures};
use crate::dem::{Fills, OverlapReport, expand};
use crate::process;
use anyhow::{Context, Result, anyhow};
use clap::Args;
use escarp_proto::page::Codec;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

/// Inputs that a manifest names.
const MOST_SOURCES: usize = 256;

#[derive(Debug, Args)]
pub(super) struct BuildArgs {
    /// DEM files of any format that docs/tiles.md lists, told by content, gzip and zip around them;
    /// folders of them; folders of tiles {z}/{x}/{y}.png; `synth:size=N,seed=N,spacing=M`, the
    /// synthetic DEM of N x N samples
    #[arg(required_unless_present = "more_inputs", value_name = "INPUT")]
    inputs: Vec<PathBuf>,
    /// One more input
    #[arg(long = "input", id = "more_inputs", value_name = "INPUT")]
    more_inputs: Vec<PathBuf>,
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
    /// How records are coded: 1 is small, 0 is simple, and for comparison
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(0..=1))]
    codec: u8,
    /// Replace a dataset of this name
    #[arg(long)]
    overwrite: bool,
    /// Go on with a build of the same inputs and options that was stopped on its way
    #[arg(long)]
    resume: bool,
    /// With --resume: go on although inputs changed, as when a bad block was repaired; what was
    /// read of them before must be the same
    #[arg(long, requires = "resume")]
    accept_changed: bool,
    /// Samples between two checkpoints, from which --resume can go on
    #[arg(long, value_name = "N", default_value_t = CHECKPOINT_SAMPLES)]
    checkpoint: u64,
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
    let inputs = [&args.inputs[..], &args.more_inputs].concat();
    let source = args.source.open(&inputs)?;
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
        codec: Codec::from_u8(args.codec).unwrap_or(Codec::Dense),
        overwrite: args.overwrite,
        resume: args.resume,
        identity: identity(&expand(&inputs)?, &(&args.source, &args.regions)),
        accept_changed: args.accept_changed,
        checkpoint_samples: args.checkpoint,
    };
    announce(&args.output, args.resume);
    let progress = Progress::new("building", args.json);
    let mut sources: Vec<String> = inputs.iter().map(name).take(MOST_SOURCES).collect();
    if inputs.len() > MOST_SOURCES {
        sources.push(format!("and {} more", inputs.len() - MOST_SOURCES));
    }
    let manifest = build(
        &mut *source,
        &args.output,
        sources,
        options,
        &|done, total| {
            progress.at(done, total);
        },
    );
    progress.end();
    let manifest = manifest.map_err(|error| with_note(error.into(), &args.output))?;
    let overlaps = source.overlaps();
    let fills = source.fills().cloned();
    let dataset = Dataset::open(&args.output)?;
    let bytes = dataset.total_bytes();
    let samples = u64::from(manifest.samples[0]) * u64::from(manifest.samples[1]);
    let wall_s = started.elapsed().as_secs_f64();
    let usage = process::usage();
    let figures = usage.map(|usage| Figures {
        wall_s,
        cpu_s: usage.cpu_s,
        peak_memory_bytes: usage.peak_memory_bytes,
        jobs: rayon::current_num_threads(),
        // The CPU time of the runs before is not known.
        samples_a_cpu_s: (!args.resume).then(|| samples as f64 / usage.cpu_s.max(1e-2)),
    });
    if let Some(figures) = figures {
        figures.keep(&dataset)?;
    }
    if args.json {
        let summary = json!({
            "samples": samples, "valid_samples": manifest.valid_samples, "pages": manifest.pages,
            "bytes": bytes, "bits_a_sample": bytes as f64 * 8.0 / samples as f64,
            "storage_error_m": manifest.storage_error_m, "wall_s": wall_s,
            "resampling": manifest.resampling, "vertical": manifest.vertical,
            "scale_error_percent": manifest.scale_error_percent,
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
        "stored in steps of {} m; largest difference from the {}input {} m",
        manifest.georef.quantum_m,
        if manifest.resampling.is_some() {
            "resampled "
        } else {
            ""
        },
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
    super::place::print(&manifest);
    super::place::warn(&manifest);
    if let Some(fills) = fills {
        print_fills(&fills, samples);
    }
    if let Some(overlaps) = overlaps {
        print_overlaps(&overlaps);
    }
    match figures {
        Some(figures) => println!("{figures}"),
        None => println!("{wall_s:.1} s"),
    }
    Ok(ExitCode::SUCCESS)
}

/// An error, and below it what the build left behind.
fn with_note(error: anyhow::Error, folder: &Path) -> anyhow::Error {
    match kept(folder) {
        Some(note) => anyhow!("{error:#}\n{note}"),
        None => error,
    }
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
