//! What a morph costs, and what it takes from the jumps of a slow flight.
//!
//! ```text
//! cargo run --release -p escarp-tests --example morph -- DATASET HEIGHT_M STEP_M FRAMES
//! ```
//!
//! A level flight to the north-east, so high above the ground in the middle, so far each frame.
//! Prints a line for each tolerance and share; a jump is how far the displayed surface moves on the
//! screen, between two frames, at a vertex of either mesh that is in view: the largest is that of
//! the whole surface, as it is linear between them. Those within two triangles of one that is not
//! drawn are counted apart: outlines are made of whole triangles, with or without a morph.

use escarp_client::app::GroundProbe;
use escarp_client::camera::look_at;
use escarp_client::mesh::{Frustum, MeshOptions, MeshTree};
use escarp_proto::georef::{Georef, WorldBox};
use escarp_proto::view::View;
use escarp_tests::displayed::Point;
use escarp_tests::feed::Feed;
use escarp_tiles::dataset::Dataset;
use std::collections::{HashMap, HashSet};
use std::error::Error;
use std::time::Instant;

const TOLERANCES_PX: [f32; 3] = [1.0, 2.0, 4.0];
const SHARES: [f64; 4] = [0.0, 0.1, 0.25, 0.5];
const SIZE_PX: [u32; 2] = [1280, 720];

struct Flight {
    start: [f64; 3],
    step_m: f64,
    frames: u32,
}

impl Flight {
    fn view(&self, frame: u32, error_px: f32) -> View {
        let way = f64::from(frame) * self.step_m / std::f64::consts::SQRT_2;
        let [x, y, z] = self.start;
        let eye = [x + way, y + way, z];
        let ahead = 10.0 * self.step_m.max(1000.0);
        let look = [eye[0] + ahead, eye[1] + ahead, z - ahead / 4.0];
        look_at(eye, look, std::f64::consts::FRAC_PI_3, SIZE_PX, error_px)
    }
}

/// What a flight came to.
#[derive(Default)]
struct Flown {
    triangles: u64,
    update_ms: Vec<f64>,
    triangulate_ms: Vec<f64>,
    offset_pages: u64,
    /// Of all vertices in view, of all frames, those above 0, pixels.
    jumps_px: Vec<f64>,
    /// The largest near an outline, pixels.
    outline_px: f64,
    vertices: u64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, height_m, step_m, frames] = arguments.as_slice() else {
        return Err("write DATASET HEIGHT_M STEP_M FRAMES".into());
    };
    let dataset = Dataset::open(path.as_ref())?;
    let flight = Flight {
        start: start(&dataset, height_m.parse()?)?,
        step_m: step_m.parse()?,
        frames: frames.parse()?,
    };
    println!(
        "px | share | triangles | update ms, median, mean | triangulate ms, median | pages moved a frame | \
         largest jump px | p99.9 px | above 0.1 px a frame | above 0.5 px a frame | \
         largest at an outline px"
    );
    for error_px in TOLERANCES_PX {
        for share in SHARES {
            report(
                error_px,
                share,
                flight.frames,
                fly(&dataset, &flight, error_px, share),
            );
        }
    }
    Ok(())
}

/// The middle of the data, so high above its ground.
fn start(dataset: &Dataset, height_m: f64) -> Result<[f64; 3], Box<dyn Error>> {
    let georef = &dataset.manifest().georef;
    let [x, y, z] = dataset.manifest().extent_m();
    let middle = [x, y].map(|[low, high]| (low + high) / 2.0);
    let mut feed = Feed::new(dataset);
    let eye = [middle[0], middle[1], z[1]];
    let look = [middle[0] + 1000.0, middle[1] + 1000.0, z[0]];
    feed.converge(&look_at(
        eye,
        look,
        std::f64::consts::FRAC_PI_3,
        SIZE_PX,
        1.0,
    ));
    feed.tree.triangulate();
    let mut probe = GroundProbe::new(georef, middle);
    feed.tree.meshes().for_each(|mesh| probe.visit(mesh));
    let ground_m = probe.height_m().ok_or("there is no ground in the middle")?;
    Ok([middle[0], middle[1], ground_m + height_m])
}

fn fly(dataset: &Dataset, flight: &Flight, error_px: f32, morph: f64) -> Flown {
    let options = MeshOptions {
        morph,
        ..MeshOptions::default()
    };
    let mut feed = Feed::with_options(dataset, options);
    let mut flown = Flown::default();
    // Pages that come on the way jump. So all that is needed, and more exact, is here before.
    for frame in (0..=flight.frames).step_by(8) {
        feed.converge(&flight.view(frame, error_px / 3.0));
    }
    let mut before: Option<Shown> = None;
    let mut stamps: HashMap<_, u64> = HashMap::new();
    for frame in 0..flight.frames {
        let view = flight.view(frame, error_px);
        let begin = Instant::now();
        feed.tree.update(&view);
        flown.update_ms.push(begin.elapsed().as_secs_f64() * 1e3);
        // What is missing still comes at once, beside the clock.
        feed.converge(&view);
        let begin = Instant::now();
        flown.triangles += feed.tree.triangulate();
        flown
            .triangulate_ms
            .push(begin.elapsed().as_secs_f64() * 1e3);
        for mesh in feed.tree.meshes() {
            let known = stamps.insert(mesh.id, mesh.offset_stamp);
            flown.offset_pages += u64::from(known.unwrap_or(0) != mesh.offset_stamp);
        }
        let now = Shown::of(&feed.tree);
        if let Some(before) = &before {
            compare(
                &dataset.manifest().georef,
                &view,
                [before, &now],
                &mut flown,
            );
        }
        before = Some(now);
    }
    flown
}

/// What is displayed in a frame.
struct Shown {
    heights: HashMap<Point, f64>,
    /// Vertices within two triangles of one that is not drawn.
    outline: HashSet<Point>,
}

impl Shown {
    fn of(tree: &MeshTree) -> Shown {
        let (mut heights, mut outline) = (HashMap::new(), HashSet::new());
        let mut drawn = Vec::new();
        tree.visit_displayed(|triangle, displayed| {
            let places = triangle.corners.map(|(x, y, _)| (x, y));
            if triangle.drawn {
                heights.extend(places.into_iter().zip(displayed));
                drawn.push(places);
            } else {
                outline.extend(places);
            }
        });
        for _ in 0..2 {
            let near = drawn
                .iter()
                .filter(|t| t.iter().any(|at| outline.contains(at)));
            let wider: Vec<Point> = near.flatten().copied().collect();
            outline.extend(wider);
        }
        Shown { heights, outline }
    }
}

/// Adds the jumps of the vertices in view between two frames.
fn compare(georef: &Georef, view: &View, [before, now]: [&Shown; 2], to: &mut Flown) {
    let frustum = Frustum::of(view);
    let gone = before
        .heights
        .keys()
        .filter(|at| !now.heights.contains_key(at));
    for &(x, y) in now.heights.keys().chain(gone) {
        let heights = (
            height(&before.heights, (x, y)),
            height(&now.heights, (x, y)),
        );
        let (Some(one), Some(other)) = heights else {
            continue;
        };
        let z = other * georef.quantum_m;
        let at = [georef.world_x(x), georef.world_y(y), z];
        let point = WorldBox { min: at, max: at };
        if !frustum.may_see(&point) {
            continue;
        }
        to.vertices += 1;
        let jump_m = (one - other).abs() * georef.quantum_m;
        let px = jump_m * view.px_per_slope() / point.distance_m(view.eye_m);
        if before.outline.contains(&(x, y)) || now.outline.contains(&(x, y)) {
            to.outline_px = to.outline_px.max(px);
        } else if px > 0.0 {
            to.jumps_px.push(px);
        }
    }
}

/// Height of a mesh at any grid point: of a vertex, or between the ends of what it would split.
fn height(mesh: &HashMap<Point, f64>, (x, y): Point) -> Option<f64> {
    if let Some(&height) = mesh.get(&(x, y)) {
        return Some(height);
    }
    let level = (x | y).trailing_zeros();
    if level >= 31 {
        return None;
    }
    let half = 1u32 << level;
    let odd = |w: u32| w & half != 0;
    let rises = odd(x >> 1) == odd(y >> 1);
    let ends = match (odd(x), odd(y)) {
        (true, true) if rises => [(x - half, y - half), (x + half, y + half)],
        (true, true) => [(x - half, y + half), (x + half, y - half)],
        (true, false) => [(x - half, y), (x + half, y)],
        _ => [(x, y - half), (x, y + half)],
    };
    Some((height(mesh, ends[0])? + height(mesh, ends[1])?) / 2.0)
}

fn report(error_px: f32, share: f64, frames: u32, mut flown: Flown) {
    let frames = f64::from(frames);
    let median = |times: &mut [f64]| {
        times.sort_unstable_by(f64::total_cmp);
        times[times.len() / 2]
    };
    // Of all but the slowest fifth, which others' work on the machine makes slow.
    let mean = |times: &[f64]| {
        let kept = &times[..(times.len() * 4).div_ceil(5)];
        kept.iter().sum::<f64>() / kept.len() as f64
    };
    let update = (median(&mut flown.update_ms), mean(&flown.update_ms));
    let triangulate = median(&mut flown.triangulate_ms);
    flown.jumps_px.sort_unstable_by(f64::total_cmp);
    let beyond = (flown.vertices as f64 * 0.001) as usize;
    let at = flown.jumps_px.len().checked_sub(beyond + 1);
    let above = |px: f64| flown.jumps_px.iter().filter(|&&jump| jump > px).count() as f64 / frames;
    println!(
        "{error_px} | {share} | {:.0} | {:.3}, {:.3} | {triangulate:.3} | {:.1} | {:.4} | {:.4} | {:.2} | {:.2} | {:.3}",
        flown.triangles as f64 / frames,
        update.0,
        update.1,
        flown.offset_pages as f64 / frames,
        flown.jumps_px.last().unwrap_or(&0.0),
        at.map_or(0.0, |at| flown.jumps_px[at]),
        above(0.1),
        above(0.5),
        flown.outline_px,
    );
}
