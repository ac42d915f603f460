//! A terrain from a formula, for tests.

use super::{StepStats, TerrainClient};
use crate::mesh::{PageMesh, Vertex};
use escarp_proto::geometry::{GridLevels, PAGE_CELLS, PAGE_SAMPLES, PageId};
use escarp_proto::georef::{Georef, Plane, WorldBox};
use escarp_proto::manifest::{FORMAT, FileCheck, Manifest, VERSION};
use escarp_proto::view::View;
use std::sync::Arc;
use std::time::Duration;

const CELL_M: f64 = 30.0;
const QUANTUM_M: f64 = 0.1;
const HIGHEST_M: f64 = 3200.0;

/// Square pages of one level, all at full detail, of ridges and valleys.
#[derive(Debug)]
pub(crate) struct FakeTerrain {
    manifest: Arc<Manifest>,
    pages: Vec<PageMesh>,
    /// Pages that have arrived: they come a few at a time, as from a network.
    arrived: usize,
    a_step: usize,
}

impl FakeTerrain {
    /// `pages_per_side` pages of 16 cells of 30 m, on this plane; `a_step` of them arrive with
    /// each step, from the south.
    pub fn new(pages_per_side: u32, plane: Plane, a_step: usize) -> FakeTerrain {
        let samples = pages_per_side * PAGE_CELLS as u32 + 1;
        let grid = GridLevels::covering(samples, samples).expect("few pages");
        let georef = Georef {
            origin_m: [412_000.0, 5_096_000.0],
            sample_spacing_m: [CELL_M; 2],
            quantum_m: QUANTUM_M,
            plane,
        };
        let places = (0..pages_per_side).flat_map(|y| (0..pages_per_side).map(move |x| (x, y)));
        let pages: Vec<PageMesh> = places
            .filter_map(|(x, y)| PageId::new(grid.finest_page_level(), x, y))
            .map(|id| page(id, grid.page_origin(id), &georef))
            .collect();
        let quanta = || {
            pages
                .iter()
                .flat_map(|page| &page.vertices)
                .map(|v| v.height)
        };
        let heights = [quanta().min().unwrap_or(0), quanta().max().unwrap_or(0)];
        FakeTerrain {
            manifest: Arc::new(manifest(grid, samples, heights, georef)),
            pages,
            arrived: 0,
            a_step,
        }
    }

    /// The pages, arrived or not.
    pub fn pages(&self) -> &[PageMesh] {
        &self.pages
    }
}

impl TerrainClient for FakeTerrain {
    fn manifest(&self) -> Option<Arc<Manifest>> {
        Some(Arc::clone(&self.manifest))
    }

    fn step(&mut self, view: &View, _now: Duration) -> StepStats {
        self.arrived = (self.arrived + self.a_step).min(self.pages.len());
        let missing = (self.pages.len() - self.arrived) as u32;
        let indices: usize = self.pages[..self.arrived]
            .iter()
            .map(|p| p.indices.len())
            .sum();
        StepStats {
            triangles: indices as u64 / 3,
            bytes_received: self.arrived as u64 * 430,
            pages_wanted: missing,
            pages_in_flight: missing.min(self.a_step as u32),
            pages_resident: self.arrived as u32,
            bound_px: if missing > 0 {
                f64::INFINITY
            } else {
                f64::from(view.max_screen_error_px) * 0.8
            },
            tolerance_px: view.max_screen_error_px,
            converged: missing == 0,
            ..StepStats::default()
        }
    }

    fn visit_pages(&self, visit: &mut dyn FnMut(&PageMesh)) {
        self.pages[..self.arrived].iter().for_each(visit);
    }

    fn status(&self) -> String {
        "a terrain from a formula; nothing is connected".into()
    }
}

fn page(id: PageId, (x0, y0): (u32, u32), georef: &Georef) -> PageMesh {
    let side = PAGE_SAMPLES as u32;
    let vertices: Vec<Vertex> = (0..side * side)
        .map(|k| vertex(f64::from(x0 + k % side), f64::from(y0 + k / side)))
        .collect();
    let cells = PAGE_CELLS as u32;
    let heights = vertices.iter().map(|v| v.height);
    let (lo, hi) = (
        heights.clone().min().unwrap_or(0),
        heights.max().unwrap_or(0),
    );
    PageMesh {
        id,
        origin: [x0, y0],
        stride: 1,
        bounds: WorldBox {
            min: georef.world(x0, y0, lo),
            max: georef.world(x0 + cells, y0 + cells, hi),
        },
        vertices,
        vertex_stamp: id.key() + 1,
        offsets: None,
        offset_stamp: 0,
        indices: full_triangles(),
        index_stamp: id.key() + 1,
    }
}

/// Two triangles for each cell of a page.
pub(crate) fn full_triangles() -> Vec<u16> {
    let (cells, side) = (PAGE_CELLS as u16, PAGE_SAMPLES as u16);
    let corners = (0..cells).flat_map(|j| (0..cells).map(move |i| j * side + i));
    let two = |k: u16| [k, k + 1, k + side + 1, k, k + side + 1, k + side];
    corners.flat_map(two).collect()
}

/// The terrain at a grid position.
fn vertex(x: f64, y: f64) -> Vertex {
    let step = 1.0;
    let slope = |dx: f64, dy: f64| {
        (height_m(x + dx, y + dy) - height_m(x - dx, y - dy)) / (2.0 * step * CELL_M)
    };
    let height = (height_m(x, y) / QUANTUM_M).round() as i32;
    Vertex::on_slope(height, slope(step, 0.0), slope(0.0, step))
}

/// Ridged noise: sharp crests, wide valleys, less detail in the valleys.
fn height_m(x: f64, y: f64) -> f64 {
    let (mut sum, mut weight, mut scale, mut share) = (0.0, 1.0, 1.0 / 190.0, 0.5);
    let bend = 40.0 * noise(x / 240.0, y / 240.0, 99);
    for octave in 0..7 {
        let ridge = 1.0 - noise((x + bend) * scale, (y - bend) * scale, octave).abs() * 1.6;
        let ridge = ridge.max(0.0).powi(2) * weight;
        sum += ridge * share;
        weight = (ridge * 1.6).clamp(0.0, 1.0);
        (scale, share) = (scale * 2.03, share * 0.5);
    }
    let broad = 0.55 + 0.45 * noise(x / 420.0, y / 420.0, 7);
    HIGHEST_M * (sum * broad).clamp(0.0, 1.0)
}

/// Gradient noise, about -1 to 1.
fn noise(x: f64, y: f64, seed: u32) -> f64 {
    let (xi, yi) = (x.floor(), y.floor());
    let (fx, fy) = (x - xi, y - yi);
    let corner = |i: f64, j: f64| {
        let angle = hash(xi + i, yi + j, seed) * std::f64::consts::TAU;
        angle.cos() * (fx - i) + angle.sin() * (fy - j)
    };
    let ease = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
    let south = mix(corner(0.0, 0.0), corner(1.0, 0.0), ease(fx));
    let north = mix(corner(0.0, 1.0), corner(1.0, 1.0), ease(fx));
    mix(south, north, ease(fy)) * 1.4
}

/// 0 to 1.
fn hash(x: f64, y: f64, seed: u32) -> f64 {
    let mut h = (x as i64 as u32).wrapping_mul(0x9e37_79b1)
        ^ (y as i64 as u32).wrapping_mul(0x85eb_ca77)
        ^ seed.wrapping_mul(0xc2b2_ae3d);
    h = (h ^ h >> 15).wrapping_mul(0x2c1b_3c6d);
    h = (h ^ h >> 12).wrapping_mul(0x297a_2d39);
    f64::from(h ^ h >> 15) / f64::from(u32::MAX)
}

/// A manifest of a dataset that does not exist, with `samples` a side and this range of quanta.
pub(crate) fn manifest(
    grid_levels: GridLevels,
    samples: u32,
    height_range: [i32; 2],
    georef: Georef,
) -> Manifest {
    Manifest {
        format: FORMAT.into(),
        version: VERSION,
        generation: 1,
        grid_levels,
        samples: [samples; 2],
        valid_samples: u64::from(samples) * u64::from(samples),
        height_range: Some(height_range),
        georef,
        storage_error_m: 0.0,
        codec: 0,
        pages: 0,
        segments: Vec::new(),
        index: FileCheck {
            bytes: 0,
            crc32c: 0,
        },
        sources: vec!["a formula".into()],
        vertical: None,
        scale_error_percent: None,
        resampling: None,
        filled: None,
        tolerances: Vec::new(),
    }
}
