//! What a selection takes, and how much of what it lists the mesh uses: the figures of
//! `docs/streaming.md`.
//!
//! `cargo run --release -p escarp-tests --example selection -- DATASET...`

use anyhow::{Context, Result};
use escarp_proto::select::{Scope, Selection};
use escarp_proto::view::View;
use escarp_tests::report::clock;
use escarp_tests::report::flight::{Windows, open};
use escarp_tests::report::leave_out::used_bytes;
use escarp_tests::report::supply::Supply;
use escarp_tests::selected::{AllPages, part_bytes, select, tree_of};
use escarp_tiles::dataset::Dataset;
use std::path::Path;

/// Views along a flight.
const VIEWS: u64 = 12;
/// Selections of a view, of whose times the median counts.
const TIMES: usize = 9;

fn main() -> Result<()> {
    println!(
        "| dataset, px | pages listed | looked at | bytes | over used: median, most | pulled over used: median, most | CPU ms: median, most |"
    );
    println!("|---|---|---|---|---|---|---|");
    for path in std::env::args_os().skip(1) {
        let path = Path::new(&path);
        let dataset = Dataset::open(path)?;
        let name = path.file_stem().context("a file name")?.to_string_lossy();
        for error_px in [1.0, 2.0, 4.0] {
            println!("| {name}, {error_px} {}", measure(&dataset, error_px)?);
        }
    }
    Ok(())
}

fn measure(dataset: &Dataset, error_px: f32) -> Result<String> {
    let manifest = dataset.manifest();
    let windows = Windows::over(open(None, manifest)?, VIEWS, 1);
    let mut known = AllPages::new(dataset);
    let [mut pages, mut seen, mut bytes, mut over, mut pulled, mut ms] = [const { Vec::new() }; 6];
    for frame in windows.frames() {
        let view = View {
            viewport_px: [1920, 1080],
            ..windows.view(frame.time_s, error_px)
        };
        let (needs, outcome) = select(&mut known, &view, Scope::All, 1 << 20);
        let mut tree = tree_of(dataset, &needs);
        let stats = tree.update(&view);
        anyhow::ensure!(
            stats.excess <= 1.0 && tree.wishes().is_empty(),
            "{stats:?} {:?}",
            &tree.wishes()[..tree.wishes().len().min(5)]
        );
        let sum: usize = needs
            .iter()
            .map(|need| part_bytes(dataset, need.page, need.last_part))
            .sum();
        let used = used_bytes(dataset, &tree)? as f64;
        let mut supply = Supply::new(dataset, "quadtree".parse().map_err(anyhow::Error::msg)?);
        supply.converge(&view)?;
        pages.push(needs.len() as f64);
        seen.push(outcome.pages as f64);
        bytes.push(sum as f64);
        over.push(sum as f64 / used);
        pulled.push(supply.bytes as f64 / used_bytes(dataset, &supply.tree)? as f64);
        let mut selection = Selection::default();
        let mut out = Vec::new();
        let mut times: Vec<f64> = (0..TIMES)
            .map(|_| {
                let at = (manifest.grid_levels, &manifest.georef);
                let run = || selection.select(at, &view, Scope::All, &mut known, 1 << 20, &mut out);
                clock::timed(run).1
            })
            .collect();
        ms.push(median(&mut times));
    }
    let most = |of: &[f64]| of.iter().copied().fold(0.0, f64::max);
    Ok(format!(
        "| {:.0} | {:.0} | {:.0} | {:.3}, {:.3} | {:.3}, {:.3} | {:.2}, {:.2} |",
        median(&mut pages),
        median(&mut seen),
        median(&mut bytes),
        median(&mut over),
        most(&over),
        median(&mut pulled),
        most(&pulled),
        median(&mut ms),
        most(&ms)
    ))
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values[values.len() / 2]
}
