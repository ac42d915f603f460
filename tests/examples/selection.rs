//! What a selection takes, and how much of what it lists the mesh uses: the figures of
//! `docs/streaming.md`.
//!
//! `cargo run --release -p escarp-tests --example selection -- DATASET...`

use anyhow::{Context, Error, Result, ensure};
use escarp_proto::manifest::Manifest;
use escarp_proto::select::{Scope, Selection};
use escarp_proto::view::View;
use escarp_tests::report::clock;
use escarp_tests::report::leave_out::used_bytes;
use escarp_tests::report::supply::Supply;
use escarp_tests::selected::{AllPages, part_bytes, select, tree_of};
use escarp_tests::terrain::hash;
use escarp_tiles::dataset::Dataset;
use std::path::Path;

/// Views of a dataset.
const VIEWS: u32 = 10;
const NO_LIMIT: usize = 1 << 20;
/// Selections of a view, of whose times the median counts.
const TIMES: usize = 9;

fn main() -> Result<()> {
    println!(
        "| dataset, px | pages | bytes | over used: median, most | pulled over used: median, most | CPU ms: median, most |"
    );
    println!("|---|---|---|---|---|---|");
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

/// Views from above all of a terrain, at three heights, 1920 x 1080.
fn views(manifest: &Manifest, error_px: f32) -> impl Iterator<Item = View> {
    let extent = manifest.extent_m();
    let side_m = extent[0][1] - extent[0][0];
    (0..VIEWS).map(move |i| {
        let random = |what: u32| f64::from(hash(i, what) % 1000) / 1000.0;
        let within = |axis: usize| {
            let [low, high] = extent[axis];
            low + (0.1 + 0.8 * random(axis as u32)) * (high - low)
        };
        let above_m = [0.002, 0.01, 0.1][i as usize % 3] * side_m;
        View {
            eye_m: [within(0), within(1), extent[2][1] + above_m],
            direction: [random(5) as f32 - 0.5, random(6) as f32 - 0.5, -0.15],
            velocity_m_s: [0.0; 3],
            fov_y: 1.0,
            viewport_px: [1920, 1080],
            max_screen_error_px: error_px,
        }
    })
}

/// What was found, by view.
#[derive(Default)]
struct Columns {
    pages: Vec<f64>,
    bytes: Vec<f64>,
    over_used: Vec<f64>,
    pulled_over_used: Vec<f64>,
    ms: Vec<f64>,
}

fn measure(dataset: &Dataset, error_px: f32) -> Result<String> {
    let manifest = dataset.manifest();
    let mut known = AllPages::new(dataset);
    let mut found = Columns::default();
    for view in views(manifest, error_px) {
        let (needs, _) = select(&mut known, &view, Scope::All, NO_LIMIT);
        let mut tree = tree_of(dataset, &needs);
        let stats = tree.update(&view);
        let within = stats.excess <= 1.0 && tree.wishes().is_empty();
        ensure!(within, "what is listed is not enough: {stats:?}");
        let sizes = needs.iter();
        let sizes = sizes.map(|need| part_bytes(dataset, need.page, need.last_part));
        let bytes = sizes.sum::<usize>() as f64;
        let mut supply = Supply::new(dataset, "quadtree".parse().map_err(Error::msg)?);
        supply.converge(&view)?;
        let pulled = supply.bytes as f64 / used_bytes(dataset, &supply.tree)? as f64;
        found.pages.push(needs.len() as f64);
        found.bytes.push(bytes);
        found
            .over_used
            .push(bytes / used_bytes(dataset, &tree)? as f64);
        found.pulled_over_used.push(pulled);
        found.ms.push(time(manifest, &view, &mut known));
    }
    let Columns {
        mut pages,
        mut bytes,
        mut over_used,
        mut pulled_over_used,
        mut ms,
    } = found;
    Ok(format!(
        "| {:.0} | {:.0} | {:.3}, {:.3} | {:.3}, {:.3} | {:.2}, {:.2} |",
        median(&mut pages),
        median(&mut bytes),
        median(&mut over_used),
        most(&over_used),
        median(&mut pulled_over_used),
        most(&pulled_over_used),
        median(&mut ms),
        most(&ms)
    ))
}

/// CPU time of a selection, milliseconds, when all sketches are there.
fn time(manifest: &Manifest, view: &View, known: &mut AllPages<'_>) -> f64 {
    let at = (manifest.grid_levels, &manifest.georef);
    let mut selection = Selection::default();
    let mut needs = Vec::new();
    let mut run = || selection.select(at, view, Scope::All, known, NO_LIMIT, &mut needs);
    let mut times: Vec<f64> = (0..TIMES).map(|_| clock::timed(&mut run).1).collect();
    median(&mut times)
}

fn most(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values[values.len() / 2]
}
