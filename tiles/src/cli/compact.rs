//! `escarp-tiles compact`.

use super::progress::Progress;
use crate::dataset::Dataset;
use crate::update::{CompactReport, compact};
use anyhow::Result;
use clap::Args;
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Debug, Args)]
pub(super) struct CompactArgs {
    /// The dataset
    #[arg(value_name = "NAME.escarp")]
    dataset: PathBuf,
    /// Write a segment anew if more than this share of it is dead, per cent
    #[arg(
        long,
        value_name = "PERCENT",
        default_value_t = 25,
        value_parser = clap::value_parser!(u8).range(..=100)
    )]
    dead: u8,
    /// Write every segment anew in which anything is dead
    #[arg(long, conflicts_with = "dead")]
    full: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &CompactArgs) -> Result<ExitCode> {
    let dataset = Dataset::open(&args.dataset)?;
    let share = if args.full {
        0.0
    } else {
        f64::from(args.dead) / 100.0
    };
    let progress = Progress::new("compacting", args.json);
    let report = compact(&dataset, share, &|done, total| progress.at(done, total));
    progress.end();
    let report = report?;
    if args.json {
        println!("{:#}", json!(report));
        return Ok(ExitCode::SUCCESS);
    }
    let CompactReport {
        generation,
        bytes_before,
        bytes_after,
        segments,
    } = report;
    println!(
        "{}: {:.3} MB before, {:.3} MB now; {segments} segments written anew; generation {generation}",
        args.dataset.display(),
        bytes_before as f64 / 1e6,
        bytes_after as f64 / 1e6
    );
    Ok(ExitCode::SUCCESS)
}
