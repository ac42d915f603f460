//! `escarp-tiles verify`.

use super::progress::Progress;
use super::source::SourceArgs;
use crate::dataset::Dataset;
use crate::verify::{Against, Share, VerifyReport, compare, verify};
use anyhow::Result;
use clap::Args;
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Debug, Args)]
pub(super) struct VerifyArgs {
    /// The dataset
    #[arg(value_name = "NAME.escarp")]
    dataset: PathBuf,
    /// Compare every sample with these inputs
    #[arg(long, num_args = 1.., value_name = "INPUT")]
    against: Vec<PathBuf>,
    /// Recompute the bounds of this many pages a level, chosen by --seed
    #[arg(long, default_value_t = 16, value_name = "N")]
    pages: usize,
    /// Chooses the pages
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Recompute the bounds of all pages
    #[arg(long)]
    full: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    source: SourceArgs,
}

pub(super) fn run(args: &VerifyArgs) -> Result<ExitCode> {
    let dataset = Dataset::open(&args.dataset)?;
    let share = match args.full {
        true => Share::Full,
        false => Share::PagesALevel(args.pages, args.seed),
    };
    let progress = Progress::new("checking", args.json);
    let report = verify(&dataset, share, &|done, total| progress.at(done, total))?;
    progress.end();
    let against = match args.against.is_empty() {
        true => None,
        false => Some(against(args, &dataset)?),
    };
    let allowed_m = dataset.manifest().storage_error_m;
    let exact = against
        .is_none_or(|a| a.largest_difference_m <= allowed_m && a.invented == 0 && a.missing == 0);
    let holds = report.broken.is_empty() && exact;
    if args.json {
        let all = json!({ "bounds": report, "against": against, "storage_error_m": allowed_m });
        println!("{all:#}");
    } else {
        print(&report, against, allowed_m);
        println!("{}", if holds { "OK" } else { "FAILED" });
        if !exact {
            println!(
                "it is compared as built: give the options of the build that change heights or place, too"
            );
        }
    }
    Ok(if holds {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

fn against(args: &VerifyArgs, dataset: &Dataset) -> Result<Against> {
    let mut source = args
        .source
        .open_like(&args.against, &dataset.manifest().georef)?;
    let progress = Progress::new("comparing", args.json);
    let found = compare(dataset, &mut *source, &|done, total| {
        progress.at(done, total)
    })?;
    progress.end();
    Ok(found)
}

fn print(report: &VerifyReport, against: Option<Against>, allowed_m: f64) {
    println!("checksums   {} records, all match", report.records);
    println!(
        "borders     {} comparisons of a sample that two pages share",
        report.shared
    );
    let levels: Vec<String> = report
        .pages_a_level
        .iter()
        .map(|(level, pages)| format!("{pages} at level {level}"))
        .collect();
    println!("bounds      recomputed for pages: {}", levels.join(", "));
    println!(
        "            {} comparisons of a sample with a triangle; largest deviation / bound {:.4}",
        report.comparisons, report.largest_ratio
    );
    for broken in &report.broken {
        println!("BROKEN      {broken}");
    }
    if let Some(found) = against {
        println!(
            "inputs      {} samples; largest difference {} m, promised {allowed_m} m",
            found.samples, found.largest_difference_m
        );
        println!(
            "            {} samples missing, {} filled, {} invented",
            found.missing, found.filled, found.invented
        );
    }
}
