//! How far the displayed surface jumps from frame to frame.
//!
//! What is displayed at a place of the ground is the triangle above it. It is compared, frame by
//! frame, at fixed places, which lie the closer the nearer they are to the middle of the flight:
//! between two frames it moves only because the mesh has changed.

use super::measure::histogram::Histogram;
use super::measure::judge::Judge;
use super::measure::scan::{Area, scan};
use super::measure::{Triangle, triangles};
use super::supply::Supply;
use super::variant::Variant;
use anyhow::Result;
use escarp_client::flight::Path as Flight;
use escarp_proto::manifest::Manifest;
use escarp_proto::view::View;
use escarp_tiles::dataset::Dataset;
use serde::Serialize;

/// Places on a side of a ring.
const RING: u32 = 192;
/// The flight is flown at this share of its pace.
const PACE: f64 = 0.1;
const FRAMES_A_SECOND: f64 = 60.0;

/// Jumps of the displayed surface in a slow flight.
#[derive(Debug, Clone, Serialize)]
pub struct Pops {
    /// The mesher.
    pub mesher: Variant,
    /// Whether vertices move to their places little by little.
    pub morph: bool,
    /// The tolerance, pixels.
    pub error_px: f32,
    /// Pairs of frames that were compared.
    pub steps: u64,
    /// How far the eye moves from frame to frame on average, metres.
    pub eye_step_m: f64,
    /// Places in view, summed over all steps.
    pub places: f64,
    /// Largest jump, pixels.
    pub max_px: f64,
    /// One place in a thousand jumps farther, among those that move at all, pixels.
    pub p999_px: f64,
    /// Share of the places that move at all in a step.
    pub share_moving: f64,
    /// Share of the places that jump by more than half a pixel in a step.
    pub share_above_half_px: f64,
    /// `[jump in pixels from, share of all places]`, half an octave each; the first is no jump.
    pub histogram: Vec<(f64, f64)>,
}

/// Squares of places around a point, each with twice the step of the one inside.
struct Rings {
    rings: Vec<(Area, u32)>,
}

impl Rings {
    fn around(manifest: &Manifest, eye_m: [f64; 3]) -> Rings {
        let [width, height] = manifest.samples;
        let middle = manifest.georef.grid(eye_m[0], eye_m[1]);
        let mut rings = Vec::new();
        let mut step = 1u32;
        loop {
            let ends = |middle: f64, size: u32| {
                let reach = f64::from(RING / 2) * f64::from(step);
                let end = |w: f64| w.clamp(0.0, f64::from(size - 1)) as u32;
                [end(middle - reach), end(middle + reach)]
            };
            let area = Area {
                x: ends(middle[0], width),
                y: ends(middle[1], height),
            };
            rings.push((area, step));
            let all = area.x == [0, width - 1] && area.y == [0, height - 1];
            match step.checked_mul(2) {
                Some(next) if !all => step = next,
                _ => return Rings { rings },
            }
        }
    }

    /// Heights of a mesh at the places, ring by ring; NaN where nothing is drawn.
    fn heights(&self, mesh: &[Triangle]) -> Vec<Vec<f64>> {
        let heights = |(area, step): &(Area, u32)| {
            let columns = columns(*area, *step);
            let rows = count(area.y, *step);
            let mut heights = vec![f64::NAN; columns * rows];
            for triangle in mesh.iter().filter(|triangle| triangle.drawn) {
                scan(&triangle.corners, *area, *step, |point| {
                    let column = (point.x / step - area.x[0].div_ceil(*step)) as usize;
                    let row = (point.y / step - area.y[0].div_ceil(*step)) as usize;
                    heights[row * columns + column] = point.height;
                });
            }
            heights
        };
        self.rings.iter().map(heights).collect()
    }

    /// Visits the places at which both are known: grid coordinates and heights.
    fn compare(
        &self,
        before: &[Vec<f64>],
        after: &[Vec<f64>],
        mut visit: impl FnMut(u32, u32, f64, f64),
    ) {
        for (number, (area, step)) in self.rings.iter().enumerate() {
            let columns = columns(*area, *step);
            for (i, (old, new)) in before[number].iter().zip(&after[number]).enumerate() {
                let x = (area.x[0].div_ceil(*step) + (i % columns) as u32) * step;
                let y = (area.y[0].div_ceil(*step) + (i / columns) as u32) * step;
                let inside = number.checked_sub(1).map(|inner| self.rings[inner].0);
                let known = inside.is_some_and(|a| {
                    (a.x[0]..=a.x[1]).contains(&x) && (a.y[0]..=a.y[1]).contains(&y)
                });
                if !known && !old.is_nan() && !new.is_nan() {
                    visit(x, y, *old, *new);
                }
            }
        }
    }
}

/// Multiples of a step between two ends.
fn count([from, to]: [u32; 2], step: u32) -> usize {
    (to / step + 1).saturating_sub(from.div_ceil(step)) as usize
}

fn columns(area: Area, step: u32) -> usize {
    count(area.x, step)
}

/// The views of a slow flight: from 70 % of the path on, at a tenth of its pace.
fn views(flight: &Flight, steps: u64, error_px: f32) -> Vec<View> {
    let start = flight.frame_time_s(0) + 0.7 * flight.duration_s();
    (0..=steps)
        .map(|i| View {
            max_screen_error_px: error_px,
            ..flight.view(start + i as f64 * PACE / FRAMES_A_SECOND)
        })
        .collect()
}

/// Flies slowly, and compares what is displayed.
///
/// # Errors
/// Those of [`Supply::converge`].
pub fn measure(
    dataset: &Dataset,
    flight: &Flight,
    variant: Variant,
    error_px: f32,
    steps: u64,
) -> Result<Pops> {
    let views = views(flight, steps, error_px);
    let manifest = dataset.manifest();
    let mut supply = Supply::new(dataset, variant);
    let middle = views
        .get(views.len() / 2)
        .map_or([0.0; 3], |view| view.eye_m);
    let rings = Rings::around(manifest, middle);
    let mut jumps = Histogram::default();
    let (mut max_px, mut moved_m) = (0.0f64, 0.0);
    let mut before: Option<(Vec<Vec<f64>>, View)> = None;
    for view in &views {
        supply.converge(view)?;
        let now = rings.heights(&triangles(&supply.tree));
        if let Some((before, last)) = &before {
            let judge = Judge::new(&manifest.georef, view);
            rings.compare(before, &now, |x, y, old, new| {
                if let Some(at_m) = judge.sees(x, y, new.round() as i32) {
                    let px = judge.px(at_m, (new - old) * manifest.georef.quantum_m);
                    jumps.add(px, 1.0);
                    max_px = max_px.max(px);
                }
            });
            let step = (0..3).map(|axis| view.eye_m[axis] - last.eye_m[axis]);
            moved_m += step.map(|d| d * d).sum::<f64>().sqrt();
        }
        before = Some((now, *view));
    }
    let histogram = jumps.by_half_octaves();
    let still = histogram.first().map_or(0.0, |row| row.1);
    let moving = 1.0 - still;
    Ok(Pops {
        mesher: variant,
        morph: variant.morph,
        error_px,
        steps,
        eye_step_m: moved_m / steps.max(1) as f64,
        places: jumps.total(),
        max_px,
        p999_px: jumps.quantile(still + 0.999 * moving).min(max_px),
        share_moving: moving,
        share_above_half_px: jumps.share_above(0.5),
        histogram,
    })
}
