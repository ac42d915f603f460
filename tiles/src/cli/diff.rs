//! `escarp-tiles diff`.

use super::progress::Progress;
use crate::dataset::Dataset;
use crate::verify::{Difference, diff};
use anyhow::Result;
use clap::Args;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Debug, Args)]
pub(super) struct DiffArgs {
    /// A dataset; NAME.escarp@3 is its generation 3, if it is still there
    #[arg(value_name = "A.escarp")]
    first: PathBuf,
    /// Another one
    #[arg(value_name = "B.escarp")]
    second: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &DiffArgs) -> Result<ExitCode> {
    let (first, second) = (open(&args.first)?, open(&args.second)?);
    let progress = Progress::new("comparing", args.json);
    let found = diff(&first, &second, &|done, total| progress.at(done, total));
    progress.end();
    let found = found?;
    match args.json {
        true => println!("{:#}", json!(found)),
        false => print(&found),
    }
    Ok(match found.is_none() {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    })
}

/// Opens a dataset, or one of its generations.
fn open(path: &Path) -> Result<Dataset> {
    let named = path.to_str().and_then(|text| text.rsplit_once('@'));
    let named = named.and_then(|(folder, number)| Some((folder, number.parse().ok()?)));
    Ok(match named {
        Some((folder, generation)) if !path.exists() => {
            Dataset::open_generation(Path::new(folder), generation)?
        }
        _ => Dataset::open(path)?,
    })
}

fn print(found: &Difference) {
    if found.is_none() {
        println!("no difference");
        return;
    }
    let levels: Vec<String> = found
        .pages_a_level
        .iter()
        .map(|(level, pages)| format!("{pages} at level {level}"))
        .collect();
    println!("pages       {}", levels.join(", "));
    println!("heights     {} samples differ", found.samples);
    if let Some([x, y]) = found.largest_at_m {
        println!(
            "            most by {} m, at {x:.3}, {y:.3} m",
            found.largest_m
        );
    }
    println!(
        "holes       {} samples with data in the first alone, {} in the second alone",
        found.only_in_first, found.only_in_second
    );
}
