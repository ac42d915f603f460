//! `escarp-tiles export`.

use super::build::rounded_up;
use super::grid::GridArgs;
use crate::dataset::Dataset;
use crate::dem::{DemSource, MAX_SIDE_SAMPLES, write_geotiff_as};
use crate::export::{DatasetSource, encoding_for, range_m};
use anyhow::{Result, bail};
use clap::Args;
use serde_json::json;
use std::fs;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Debug, Args)]
pub(super) struct ExportArgs {
    /// The dataset
    #[arg(value_name = "NAME.escarp")]
    dataset: PathBuf,
    /// GeoTIFF to write
    #[arg(short, long, value_name = "FILE.tif")]
    output: PathBuf,
    /// Distance of samples, in the units of the CRS (metres, feet, degrees). A multiple of the
    /// dataset's takes exact samples
    #[arg(long, value_name = "DISTANCE", allow_negative_numbers = true)]
    spacing: Option<f64>,
    /// Replace a file of this name
    #[arg(long)]
    overwrite: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    grid: GridArgs,
}

pub(super) fn run(args: &ExportArgs) -> Result<ExitCode> {
    if fs::symlink_metadata(&args.output).is_ok_and(|found| !found.is_file()) {
        bail!(
            "{}: it is no plain file; name another output",
            args.output.display()
        );
    }
    if args.output.exists() && !args.overwrite {
        let output = args.output.display();
        bail!("{output} exists; give --overwrite to replace it");
    }
    let dataset = Dataset::open(&args.dataset)?;
    if let Some(side) = dataset
        .manifest()
        .samples
        .into_iter()
        .find(|&n| n > MAX_SIDE_SAMPLES)
    {
        let name = args.dataset.display();
        bail!("{name}: {side} samples on a side, allowed are {MAX_SIDE_SAMPLES}");
    }
    let dataset = DatasetSource::new(dataset);
    let mut placed = args.grid.place(Box::new(dataset.clone()), args.spacing)?;
    let encoding = encoding_for(placed.info(), range_m(&dataset, &*placed));
    write_geotiff_as(&args.output, &mut *placed, encoding)?;
    print(args, &*placed, encoding.name());
    Ok(ExitCode::SUCCESS)
}

fn print(args: &ExportArgs, placed: &dyn DemSource, encoding: &str) {
    let (info, resampling) = (placed.info(), placed.resampling());
    if args.json {
        let summary = json!({
            "width": info.width, "height": info.height, "type": encoding, "crs": info.crs.name(),
            "resampling": resampling,
        });
        println!("{summary:#}");
        return;
    }
    println!(
        "{}: {} x {} samples, {encoding}, {}",
        args.output.display(),
        info.width,
        info.height,
        info.crs
    );
    match resampling {
        None => println!("each height is the dataset's"),
        Some(found) => println!(
            "{} samples of the dataset differ from the file's surface by at most {} m, {:.3} m root \
             mean square; {} lie beside its holes and borders",
            found.compared,
            rounded_up(found.largest_difference_m),
            found.rms_difference_m,
            found.uncovered
        ),
    }
}
