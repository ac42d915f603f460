//! What the mesh costs a frame, cold, walking, flying and after a teleport; and once more with
//! every test made anew, in the same run.
//!
//! `cargo bench -p escarp-tests --bench mesh -- [--quick] [--error-px 1,4] DATASET...`

use escarp_client::mesh::{MeshTree, UpdateStats};
use escarp_proto::geometry::{PAGE_CELLS, PAGE_SAMPLES, PageId, Slot};
use escarp_proto::view::View;
use escarp_tests::feed::Feed;
use escarp_tests::report::clock;
use escarp_tiles::dataset::Dataset;
use std::path::{Path, PathBuf};

/// Height of the eye above the ground, metres.
const ABOVE_M: f64 = 300.0;
/// The share of the terrain's side that the long flight crosses.
const CROSSED: f64 = 0.6;
/// A frame's way at a walk and in an aeroplane at 60 frames a second, metres.
const WALK_M: f64 = 1.4 / 60.0;
const CRUISE_M: f64 = 300.0 / 60.0;

struct Arguments {
    datasets: Vec<PathBuf>,
    errors_px: Vec<f32>,
    frames: usize,
}

fn arguments() -> Result<Arguments, String> {
    let mut found = Arguments {
        datasets: Vec::new(),
        errors_px: vec![1.0, 4.0],
        frames: 400,
    };
    let mut rest = std::env::args().skip(1);
    while let Some(argument) = rest.next() {
        match argument.as_str() {
            "--bench" => {}
            "--quick" => found.frames = 60,
            "--error-px" => {
                let list = rest.next().ok_or("--error-px takes numbers")?;
                let numbers = list.split(',').map(str::parse);
                found.errors_px = numbers
                    .collect::<Result<_, _>>()
                    .map_err(|error| format!("--error-px {list}: {error}"))?;
            }
            _ => found.datasets.push(argument.into()),
        }
    }
    Ok(found)
}

/// 1280 x 720 px; one metre at one metre's distance covers 640 px.
fn view(eye_m: [f64; 3], direction: [f32; 3], error_px: f32) -> View {
    View {
        eye_m,
        direction,
        velocity_m_s: [0.0; 3],
        fov_y: 2.0 * (360.0f32 / 640.0).atan(),
        viewport_px: [1280, 720],
        max_screen_error_px: error_px,
    }
}

/// Height of the ground, metres, as exactly as the resident pages have it.
fn ground_m(feed: &Feed<'_>, dataset: &Dataset, [x_m, y_m]: [f64; 2]) -> f64 {
    let (grid, georef) = (dataset.grid(), &dataset.manifest().georef);
    let [x, y] = georef.grid(x_m, y_m).map(|at| at.max(0.0) as u32);
    let mut id = PageId::ROOT;
    let mut height = 0;
    while let Some(page) = feed.tree.page(id) {
        let (x0, y0) = grid.page_origin(id);
        let stride = grid.page_stride(id);
        let end = PAGE_CELLS as u32 - 1;
        let cell = [x - x0, y - y0].map(|along| (along / stride).min(end) as usize);
        if page.parts() == page.last_part() {
            height = page.height(cell[1] * PAGE_SAMPLES + cell[0]);
        }
        match id.child(Slot::at(cell[0], cell[1])) {
            Some(below) => id = below,
            None => break,
        }
    }
    georef.world_z(height)
}

/// Views along a line through the middle of the data, to the north-east; every page that they
/// need is resident afterwards.
fn flight(
    feed: &mut Feed<'_>,
    dataset: &Dataset,
    step_m: f64,
    frames: usize,
    error_px: f32,
) -> Vec<View> {
    let manifest = dataset.manifest();
    let georef = &manifest.georef;
    let middle = [0, 1].map(|axis| {
        georef.origin_m[axis]
            + f64::from(manifest.samples[axis]) / 2.0 * georef.sample_spacing_m[axis]
    });
    let eye =
        |frame: f64| middle.map(|at| at + (frame - frames as f64 / 2.0) * step_m / 2f64.sqrt());
    let mut height_m = f64::NAN;
    (0..frames)
        .map(|frame| {
            let at = eye(frame as f64);
            let ahead = eye(frame as f64 + 8.0);
            // From the first place on the eye only follows the ground.
            for _ in 0..if frame == 0 { 60 } else { 1 } {
                let wanted =
                    ground_m(feed, dataset, at).max(ground_m(feed, dataset, ahead)) + ABOVE_M;
                height_m = if height_m.is_nan() {
                    wanted
                } else {
                    height_m + (wanted - height_m) / 8.0
                };
                feed.converge(&view([at[0], at[1], height_m], [1.0, 1.0, -0.2], error_px));
            }
            view([at[0], at[1], height_m], [1.0, 1.0, -0.2], error_px)
        })
        .collect()
}

/// What this process has run, milliseconds: what others do on the machine is not in it.
fn cpu_ms() -> f64 {
    clock::cpu().as_secs_f64() * 1e3
}

/// What the frames of a flight took.
#[derive(Default)]
struct Cost {
    update_ms: Vec<f64>,
    emit_ms: Vec<f64>,
    squares: u64,
    changes: u64,
    triangles: u64,
    excess: f64,
}

impl Cost {
    fn frame(&mut self, tree: &mut MeshTree, view: &View) -> UpdateStats {
        let start = cpu_ms();
        let stats = tree.update(view);
        let updated = cpu_ms();
        self.triangles = tree.triangulate();
        self.update_ms.push(updated - start);
        self.emit_ms.push(cpu_ms() - updated);
        self.excess = self.excess.max(stats.excess);
        self.squares += stats.squares;
        self.changes += stats.changes;
        stats
    }

    fn print(&self, name: &str) {
        let frames = self.update_ms.len() as u64;
        println!(
            "  {name:<22} update {:8.3} ms  emit {:8.3} ms  {:8} squares  {:6} changes  {:8} triangles  at most {:.3} tolerances",
            median(&self.update_ms),
            median(&self.emit_ms),
            self.squares / frames,
            self.changes / frames,
            self.triangles,
            self.excess
        );
    }
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

/// A tree with the same pages, in which nothing is enabled.
fn anew(feed: &Feed<'_>, dataset: &Dataset) -> MeshTree {
    let manifest = dataset.manifest();
    let mut tree = MeshTree::new(manifest.grid_levels, manifest.georef.clone());
    let mut pages: Vec<_> = feed.tree.pages().cloned().collect();
    pages.sort_by_key(|page| page.id().key());
    for page in pages {
        tree.link(page).expect("it was linked before");
    }
    tree
}

fn measure(path: &Path, error_px: f32, frames: usize) -> Result<(), Box<dyn std::error::Error>> {
    let dataset = Dataset::open(path)?;
    let manifest = dataset.manifest();
    let side_m = f64::from(manifest.samples[0]) * manifest.georef.sample_spacing_m[0];
    // The long flight crosses as much, whatever the number of frames; the 100k ones would be
    // nowhere for long, and cross what the 1k ones do.
    let long_m = (side_m.min(1025.0 * manifest.georef.sample_spacing_m[0])) * CROSSED / 400.0;
    println!(
        "{} at {error_px} px, frames of {long_m:.1} m:",
        dataset.name()
    );
    for (name, step_m) in [
        ("flying", long_m),
        ("cruising", CRUISE_M),
        ("walking", WALK_M),
    ] {
        let mut feed = Feed::new(&dataset);
        let views = flight(&mut feed, &dataset, step_m, frames, error_px);
        let mut cold = Cost::default();
        let mut tree = anew(&feed, &dataset);
        cold.frame(&mut tree, &views[0]);
        let mut cost = Cost::default();
        for view in &views[1..] {
            cost.frame(&mut tree, view);
        }
        let mut all = Cost::default();
        for view in views.iter().rev() {
            tree.forget_tests();
            all.frame(&mut tree, view);
        }
        cold.print(&format!("{name}, cold"));
        cost.print(name);
        all.print(&format!("{name}, all tests"));
        println!(
            "  {:<22} update {:8.4} of all tests, {:8.4} of cold; {} pages",
            "",
            median(&cost.update_ms) / median(&all.update_ms),
            median(&cost.update_ms) / median(&cold.update_ms),
            tree.resident()
        );
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments = arguments()?;
    for path in &arguments.datasets {
        for &error_px in &arguments.errors_px {
            measure(path, error_px, arguments.frames)?;
        }
    }
    Ok(())
}
