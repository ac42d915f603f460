//! `escarp-tiles update`.

use super::progress::Progress;
use super::source::SourceArgs;
use crate::dataset::Dataset;
use crate::dem::{DemSource, expand};
use crate::update::{Edit, UpdateReport, update};
use anyhow::{Context, Result};
use clap::Args;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

#[derive(Debug, Args)]
#[command(group = clap::ArgGroup::new("change").required(true).multiple(true))]
pub(super) struct UpdateArgs {
    /// The dataset
    #[arg(value_name = "NAME.escarp")]
    dataset: PathBuf,
    /// DEM files whose heights replace those of the dataset; their holes leave it as it is. Where
    /// several overlap, --priority says which counts
    #[arg(long, num_args = 1.., value_name = "INPUT", group = "change")]
    with: Vec<PathBuf>,
    /// Make a rectangle a hole where no --with has data; in the dataset's coordinates
    #[arg(
        long,
        value_name = "W,S,E,N",
        group = "change",
        value_parser = bounds,
        allow_hyphen_values = true
    )]
    remove: Vec<Bounds>,
    /// Threads; default: one a core
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u16).range(..=1024))]
    jobs: u16,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    source: SourceArgs,
}

type Bounds = [f64; 4];

/// Four numbers, west below east, south below north.
fn bounds(text: &str) -> Result<Bounds, String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|number| {
            number
                .trim()
                .parse::<f64>()
                .map_err(|e| format!("{number:?}: {e}"))
        })
        .collect::<Result<_, _>>()?;
    match numbers[..] {
        [w, s, e, n] if w <= e && s <= n && numbers.iter().all(|v| v.is_finite()) => {
            Ok([w, s, e, n])
        }
        _ => Err("give west, south, east, north, in this order, the smaller ones first".into()),
    }
}

pub(super) fn run(args: &UpdateArgs) -> Result<ExitCode> {
    let started = Instant::now();
    rayon::ThreadPoolBuilder::new()
        .num_threads(usize::from(args.jobs))
        .build_global()
        .context("cannot start the threads")?;
    let dataset = Dataset::open(&args.dataset)?;
    // Each alone: what lies between patches that are far apart is not looked at.
    let mut sources = Vec::new();
    let mut inputs = expand(&args.with)?;
    if args.source.is_last_first() {
        inputs.reverse();
    }
    for path in inputs {
        sources.push(args.source.open(&[path])?);
    }
    let name = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    };
    let edit = Edit {
        patches: sources
            .iter_mut()
            .map(|s| &mut **s as &mut dyn DemSource)
            .collect(),
        remove: args.remove.clone(),
        sources: args.with.iter().map(name).collect(),
    };
    let progress = Progress::new("updating", args.json);
    let report = update(&dataset, edit, &|done, total| progress.at(done, total));
    progress.end();
    let (report, wall_s) = (report?, started.elapsed().as_secs_f64());
    if args.json {
        println!("{:#}", json!({ "update": report, "wall_s": wall_s }));
    } else {
        print(&report, &args.dataset, wall_s);
    }
    Ok(ExitCode::SUCCESS)
}

fn print(report: &UpdateReport, dataset: &Path, wall_s: f64) {
    let UpdateReport {
        generation,
        changed,
        added,
        removed,
        pages,
        families,
        bytes,
    } = report;
    let name = dataset.display();
    if *changed == 0 {
        println!("{name}: nothing changed; generation {generation} stays");
        return;
    }
    println!(
        "{name}: generation {generation}: {changed} samples changed, {added} of them were holes, \
         {removed} are holes now"
    );
    println!(
        "{pages} pages made anew; {families} families written, {:.3} MB; {wall_s:.2} s",
        *bytes as f64 / 1e6
    );
    println!("the generation before stays for its readers until escarp-tiles compact");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_four_numbers_in_order() {
        assert_eq!(bounds("-1.5, 2,3,4e1"), Ok([-1.5, 2.0, 3.0, 40.0]));
        for wrong in [
            "",
            "1,2,3",
            "1,2,3,4,5",
            "3,2,1,4",
            "1,4,3,2",
            "a,2,3,4",
            "nan,2,3,4",
            "1,2,inf,4",
        ] {
            assert!(bounds(wrong).is_err(), "{wrong:?}");
        }
    }
}
