//! Naive measurements of the mesh as it is displayed, with vertices on their way.

use crate::terrain::TempDataset;
use escarp_client::mesh::{Frustum, MeshTree, SurfaceTriangle};
use escarp_proto::geometry::{GridLevels, PAGE_SAMPLES};
use escarp_proto::georef::WorldBox;
use escarp_proto::view::View;
use std::collections::HashMap;

/// A grid point.
pub type Point = (u32, u32);

/// A drawn triangle and its displayed heights, quanta.
pub type Displayed = (SurfaceTriangle, [f64; 3]);

/// All drawn triangles.
pub fn displayed(tree: &MeshTree) -> Vec<Displayed> {
    let mut triangles = Vec::new();
    tree.visit_displayed(|triangle, heights| {
        if triangle.drawn {
            triangles.push((triangle, heights));
        }
    });
    triangles
}

/// Checks that triangles agree to the bit on the displayed height of each vertex.
///
/// # Errors
/// Where they do not.
pub fn check_displayed(tree: &MeshTree) -> Result<usize, String> {
    let mut heights: HashMap<Point, f64> = HashMap::new();
    for (triangle, displayed) in displayed(tree) {
        for ((x, y, _), height) in triangle.corners.into_iter().zip(displayed) {
            let known = *heights.entry((x, y)).or_insert(height);
            if known.to_bits() != height.to_bits() {
                return Err(format!(
                    "vertex {x}, {y} is displayed at {known} and {height}"
                ));
            }
        }
    }
    Ok(heights.len())
}

/// Visits the samples that a triangle covers, with its displayed height there, quanta.
pub fn visit_samples(
    (triangle, heights): &Displayed,
    [width, height]: [u32; 2],
    mut visit: impl FnMut(u32, u32, f64),
) {
    let [a, b, c] = triangle
        .corners
        .map(|(x, y, _)| (f64::from(x), f64::from(y)));
    let area = |a: (f64, f64), b: (f64, f64), p: (f64, f64)| {
        (b.0 - a.0) * (p.1 - a.1) - (b.1 - a.1) * (p.0 - a.0)
    };
    let whole = area(a, b, c);
    let span = |of: fn(&(u32, u32, i32)) -> u32, end: u32| {
        let all = || triangle.corners.iter().map(of);
        let (low, high) = (all().min().unwrap_or(0), all().max().unwrap_or(0));
        low..high.saturating_add(1).min(end)
    };
    for y in span(|c| c.1, height) {
        for x in span(|c| c.0, width) {
            let p = (f64::from(x), f64::from(y));
            let shares = [area(b, c, p), area(c, a, p), area(a, b, p)];
            if shares.iter().all(|&share| share >= 0.0) {
                let z: f64 = (0..3).map(|i| shares[i] * heights[i]).sum();
                visit(x, y, z / whole);
            }
        }
    }
}

/// Displayed heights at all samples, row by row from the south, quanta; NaN where nothing is drawn.
pub fn displayed_heights(tree: &MeshTree, [width, height]: [u32; 2]) -> Vec<f64> {
    let mut heights = vec![f64::NAN; width as usize * height as usize];
    for triangle in displayed(tree) {
        visit_samples(&triangle, [width, height], |x, y, z| {
            heights[y as usize * width as usize + x as usize] = z;
        });
    }
    heights
}

/// The largest deviation of the displayed mesh from a sample, in tolerances, and where it is.
pub fn displayed_deviation(
    tree: &MeshTree,
    data: &TempDataset,
    view: &View,
    in_view: bool,
) -> (f64, Point) {
    let georef = &data.dataset.manifest().georef;
    let frustum = Frustum::of(view);
    let mut found = (0.0, (0, 0));
    for triangle in displayed(tree) {
        visit_samples(&triangle, data.dataset.manifest().samples, |x, y, z| {
            let Some(sample) = data.sample(x, y) else {
                return;
            };
            let at = georef.world(x, y, sample);
            let point = WorldBox { min: at, max: at };
            if in_view && !frustum.may_see(&point) {
                return;
            }
            let tolerance_m = point.distance_m(view.eye_m) / view.threshold();
            let deviation_m = (f64::from(sample) - z).abs() * georef.quantum_m;
            if deviation_m > found.0 * tolerance_m {
                found = (deviation_m / tolerance_m, (x, y));
            }
        });
    }
    found
}

/// An enabled vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weighted {
    /// 0 on the edge that it splits, 1 at its height.
    pub weight: f64,
    /// Its height, quanta; none in a hole.
    pub height: Option<i32>,
}

/// All enabled vertices of a tree with morph.
///
/// # Errors
/// Where two pages do not agree.
pub fn weighted(tree: &MeshTree, grid: GridLevels) -> Result<HashMap<Point, Weighted>, String> {
    let mut vertices: HashMap<Point, Weighted> = HashMap::new();
    for (id, sample, weight) in tree.weights() {
        let page = tree.page(id).ok_or("a page that is not resident")?;
        let (stride, [x, y]) = (grid.page_stride(id), grid.page_origin(id).into());
        let (column, row) = (
            u32::from(sample) % PAGE_SAMPLES as u32,
            u32::from(sample) / PAGE_SAMPLES as u32,
        );
        let at = (x + column * stride, y + row * stride);
        let valid = page.is_valid(sample.into());
        let height = valid.then(|| page.height(sample.into()));
        let found = Weighted { weight, height };
        let known = *vertices.entry(at).or_insert(found);
        if known != found {
            return Err(format!("{at:?} has {known:?} and {found:?}"));
        }
    }
    Ok(vertices)
}

/// The meshes of which the displayed one is the average, made one by one from triangles that are
/// halved where the middle of their longest side is in the mesh.
pub struct Average<'a> {
    vertices: &'a HashMap<Point, Weighted>,
    corners: HashMap<Point, i32>,
    cells: u32,
}

impl<'a> Average<'a> {
    /// The enabled vertices of a tree.
    pub fn of(tree: &MeshTree, vertices: &'a HashMap<Point, Weighted>, cells: u32) -> Average<'a> {
        let root = tree.page(escarp_proto::geometry::PageId::ROOT);
        let height = |sample| root.map_or(0, |page| page.height(sample));
        let corners = [
            (0, 0, 0),
            (cells, 0, 16),
            (0, cells, 272),
            (cells, cells, 288),
        ];
        Average {
            vertices,
            corners: corners
                .map(|(x, y, sample)| ((x, y), height(sample)))
                .into(),
            cells,
        }
    }

    fn height(&self, at: Point) -> f64 {
        let known = self.vertices.get(&at).and_then(|vertex| vertex.height);
        f64::from(known.or(self.corners.get(&at).copied()).unwrap_or(i32::MIN))
    }

    /// Height at a grid point of the mesh of all vertices of at least this weight, quanta.
    fn height_of(&self, least: f64, at: Point) -> f64 {
        let end = self.cells;
        let centre = (end / 2, end / 2);
        let corners = [(0, 0), (end, 0), (end, end), (0, end)];
        let mut triangle = (0..4)
            .map(|i| [centre, corners[i], corners[(i + 1) % 4]])
            .find(|&triangle| shares(triangle, at).is_some())
            .unwrap_or([centre, corners[0], corners[1]]);
        loop {
            let [apex, a, b] = triangle;
            let sum = (a.0 + b.0, a.1 + b.1);
            let middle = (sum.0 / 2, sum.1 / 2);
            let splits = sum.0.is_multiple_of(2) && sum.1.is_multiple_of(2);
            let vertex = self.vertices.get(&middle).filter(|_| splits);
            if vertex.is_none_or(|vertex| vertex.weight < least) {
                let shares = shares(triangle, at).unwrap_or_default();
                let parts = shares.into_iter().zip(triangle);
                return parts
                    .map(|(share, corner)| share * self.height(corner))
                    .sum();
            }
            triangle = match shares([middle, apex, a], at) {
                Some(_) => [middle, apex, a],
                None => [middle, b, apex],
            };
        }
    }

    /// The average at a grid point over all weights, quanta.
    pub fn at(&self, at: Point) -> f64 {
        let mut steps: Vec<f64> = self.vertices.values().map(|vertex| vertex.weight).collect();
        steps.extend([0.0, 1.0]);
        steps.sort_unstable_by(f64::total_cmp);
        steps.dedup();
        let parts = steps.windows(2);
        parts
            .map(|ends| (ends[1] - ends[0]) * self.height_of(ends[1], at))
            .sum()
    }
}

/// Barycentric coordinates; `None` outside.
fn shares([a, b, c]: [Point; 3], p: Point) -> Option<[f64; 3]> {
    let area = |a: Point, b: Point, p: Point| {
        let d = |p: u32, q: u32| i64::from(p) - i64::from(q);
        d(b.0, a.0) * d(p.1, a.1) - d(b.1, a.1) * d(p.0, a.0)
    };
    let (whole, parts) = (area(a, b, c), [area(b, c, p), area(c, a, p), area(a, b, p)]);
    let inside = parts.iter().all(|&part| part * whole.signum() >= 0);
    inside.then(|| parts.map(|part| part as f64 / whole as f64))
}
