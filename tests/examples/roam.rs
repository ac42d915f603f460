//! ROAM with and without limits, along windows of a flight: what `docs/mesh.md` says of it.
//!
//! `cargo run --release -p escarp-tests --example roam -- DATASET...`

use anyhow::{Context, Result};
use escarp_client::mesh::{MeshOptions, MesherKind};
use escarp_tests::feed::Feed;
use escarp_tests::report::clock::timed;
use escarp_tests::report::flight::{Windows, open};
use escarp_tiles::dataset::Dataset;
use std::path::Path;

/// The pages of a view are complete before its frame is measured, but for those that never come.
const ROUNDS: usize = 50;

/// What the frames of a run came to, leaps apart.
#[derive(Default)]
struct Frames {
    update_ms: Vec<f64>,
    changes: Vec<f64>,
    triangles: Vec<f64>,
    bound_px: Vec<f64>,
    leap_ms: Vec<f64>,
}

fn main() -> Result<()> {
    println!(
        "| dataset, px | mesher, limit | triangles: mean, most | splits and merges a frame: mean, most | \
         update ms: median, p99, most | of a leap, most | bound px: median, most |"
    );
    for path in std::env::args_os().skip(1) {
        let path = Path::new(&path);
        let dataset = Dataset::open(path)?;
        let name = path.file_stem().context("a file name")?.to_string_lossy();
        for error_px in [1.0, 4.0] {
            for (label, options) in runs() {
                let frames = fly(&dataset, options, error_px)?;
                frames.print(&format!("{name}, {error_px}"), &label);
            }
        }
    }
    Ok(())
}

fn runs() -> Vec<(String, MeshOptions)> {
    let of = |mesher, max_triangles| MeshOptions {
        mesher,
        max_triangles,
        ..MeshOptions::default()
    };
    let mut runs = vec![
        ("quadtree".to_string(), of(MesherKind::Quadtree, None)),
        ("roam".to_string(), of(MesherKind::Roam, None)),
    ];
    runs.extend(
        [100_000, 20_000].map(|most| (format!("roam, {most}"), of(MesherKind::Roam, Some(most)))),
    );
    runs
}

fn fly(dataset: &Dataset, options: MeshOptions, error_px: f32) -> Result<Frames> {
    let windows = Windows::over(open(None, dataset.manifest())?, 5, 60);
    let mut feed = Feed::with_options(dataset, options);
    let mut frames = Frames::default();
    for frame in windows.frames() {
        let view = windows.view(frame.time_s, error_px);
        let (stats, update_ms) = timed(|| feed.tree.update(&view));
        let mut bound = stats.excess;
        for _ in 0..ROUNDS {
            let wishes = feed.tree.wishes();
            if wishes.is_empty() {
                break;
            }
            for wish in wishes {
                feed.grant(&wish);
            }
            bound = feed.tree.update(&view).excess;
        }
        let triangles = feed.tree.triangulate();
        if frame.leap {
            frames.leap_ms.push(update_ms);
            continue;
        }
        frames.update_ms.push(update_ms);
        frames.changes.push(stats.changes as f64);
        frames.triangles.push(triangles as f64);
        frames.bound_px.push(bound * f64::from(error_px));
    }
    Ok(frames)
}

impl Frames {
    fn print(mut self, dataset: &str, label: &str) {
        println!(
            "| {dataset} px | {label} | {:.0}, {:.0} | {:.0}, {:.0} | {:.2}, {:.2}, {:.2} | {:.0} | {:.2}, {:.2} |",
            mean(&self.triangles),
            at(&mut self.triangles, 1.0),
            mean(&self.changes),
            at(&mut self.changes, 1.0),
            at(&mut self.update_ms, 0.5),
            at(&mut self.update_ms, 0.99),
            at(&mut self.update_ms, 1.0),
            at(&mut self.leap_ms, 1.0),
            at(&mut self.bound_px, 0.5),
            at(&mut self.bound_px, 1.0),
        );
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

fn at(values: &mut [f64], share: f64) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let rank = (values.len() as f64 * share).ceil() as usize;
    values.get(rank.max(1) - 1).copied().unwrap_or(0.0)
}
