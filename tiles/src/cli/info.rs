//! `escarp-tiles info`.

use super::survey::{on_disk, print_disk, print_survey};
use crate::crs::{extent, title};
use crate::dataset::{Dataset, Figures};
use crate::verify::survey;
use anyhow::Result;
use clap::Args;
use escarp_proto::georef::Plane;
use escarp_proto::manifest::Tolerance;
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Debug, Args)]
pub(super) struct InfoArgs {
    /// The dataset
    #[arg(value_name = "NAME.escarp")]
    dataset: PathBuf,
    /// Leave out what takes reading all records: bits by part, errors
    #[arg(long)]
    brief: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &InfoArgs) -> Result<ExitCode> {
    let dataset = Dataset::open(&args.dataset)?;
    let manifest = dataset.manifest();
    let bytes = dataset.total_bytes();
    let [width, height] = manifest.samples;
    let samples = u64::from(width) * u64::from(height);
    let bits = bytes as f64 * 8.0 / samples as f64;
    let extent = manifest.extent_m();
    let coverage = manifest.valid_samples as f64 / samples as f64;
    let on_disk = on_disk(&dataset)?;
    let survey = match args.brief {
        true => None,
        false => Some(survey(&dataset)?),
    };
    if args.json {
        let info = json!({
            "name": dataset.name(), "bytes": bytes, "bits_a_sample": bits,
            "extent_m": extent, "extent_degrees": extent::of(manifest), "manifest": manifest,
            "coverage": coverage, "survey": survey, "disk": on_disk.json(),
            "build": Figures::of(&dataset),
        });
        println!("{info:#}");
        return Ok(ExitCode::SUCCESS);
    }
    let georef = &manifest.georef;
    println!(
        "name        {}, generation {}",
        dataset.name(),
        manifest.generation
    );
    println!(
        "samples     {width} x {height}, {} with data ({:.2} %)",
        manifest.valid_samples,
        100.0 * coverage
    );
    if let Some(filled) = &manifest.filled {
        let share = 100.0 * filled.samples as f64 / manifest.valid_samples as f64;
        println!(
            "filled      {} of these samples, {share:.2} %",
            filled.samples
        );
    }
    let [dx, dy] = georef.sample_spacing_m;
    println!("spacing     {dx:.4} m east, {dy:.4} m north");
    println!("plane       {}", describe(&georef.plane));
    for (axis, [from, to]) in ["x", "y", "z"].iter().zip(extent) {
        println!("{axis}           {from:.2} .. {to:.2} m");
    }
    super::place::print(manifest);
    println!(
        "quantum     {} m; largest difference from the sources {} m",
        georef.quantum_m,
        super::build::rounded_up(manifest.storage_error_m)
    );
    for tolerance in &manifest.tolerances {
        println!("{}", describe_tolerance(tolerance));
    }
    println!(
        "grid        {} levels, {} pages",
        manifest.grid_levels.get(),
        manifest.pages
    );
    println!(
        "size        {:.1} MB in {} segments, {bits:.2} bits a sample",
        bytes as f64 / 1e6,
        manifest.segments.len()
    );
    println!("sources     {}", manifest.sources.join(", "));
    if let Some(figures) = Figures::of(&dataset) {
        println!("build       {figures}");
    }
    if let Some(survey) = &survey {
        print_survey(&dataset, survey);
    }
    print_disk(&on_disk);
    Ok(ExitCode::SUCCESS)
}

/// What a region was allowed, and what was made of it.
pub(super) fn describe_tolerance(tolerance: &Tolerance) -> String {
    let Tolerance {
        tolerance_m,
        region,
        largest_error_m,
    } = tolerance;
    let largest_m = super::build::rounded_up(*largest_error_m);
    let place = match region {
        Some(file) => format!("inside {file}"),
        None => "elsewhere".into(),
    };
    format!("tolerance   {tolerance_m} m {place}; largest difference {largest_m} m")
}

fn describe(plane: &Plane) -> String {
    match plane {
        Plane::Projected { crs, .. } => format!("{}, in metres", title(crs)),
        Plane::Geographic {
            crs,
            radius_m,
            middle_longitude_deg,
            middle_latitude_deg,
        } => format!(
            "{} laid out in metres on a sphere of {radius_m} m, around longitude \
             {middle_longitude_deg:.5}, latitude {middle_latitude_deg:.5}",
            title(crs)
        ),
        Plane::Local => "no georeference; metres from the south-west sample".into(),
    }
}
