//! Naive measurements of a mesh: cracks, and the deviation at every sample.

use crate::terrain::TempDataset;
use escarp_client::mesh::{Frustum, MeshTree, SurfaceTriangle};
use escarp_proto::georef::{Georef, WorldBox};
use escarp_proto::view::View;
use std::collections::{HashMap, HashSet};

/// All triangles of a mesh.
pub fn triangles(tree: &MeshTree) -> Vec<SurfaceTriangle> {
    let mut triangles = Vec::new();
    tree.visit_triangles(|triangle| triangles.push(triangle));
    triangles
}

/// Checks that there is no crack: that the triangles [cover](check_cover) the grid, and that drawn
/// ones agree on the height of each vertex.
///
/// # Errors
/// What is wrong, and where.
pub fn check_cracks(tree: &MeshTree, cells_per_side: u32) -> Result<usize, String> {
    let mut heights: HashMap<(u32, u32), i32> = HashMap::new();
    for triangle in triangles(tree).iter().filter(|triangle| triangle.drawn) {
        for (x, y, height) in triangle.corners {
            if *heights.entry((x, y)).or_insert(height) != height {
                return Err(format!("vertex {x}, {y} has two heights"));
            }
        }
    }
    check_cover(tree, cells_per_side)
}

/// Checks that the triangles cover the grid without gap or overlap: every edge that is not on the
/// border of the grid lies in exactly two triangles, in opposite directions, and the areas add up.
///
/// # Errors
/// What is wrong, and where.
pub fn check_cover(tree: &MeshTree, cells_per_side: u32) -> Result<usize, String> {
    let triangles = triangles(tree);
    let mut edges: HashMap<[(u32, u32); 2], i32> = HashMap::new();
    let mut area: i128 = 0;
    for triangle in &triangles {
        let [a, b, c] = triangle.corners.map(|(x, y, _)| (x, y));
        let d = |p: (u32, u32), q: (u32, u32)| {
            (
                i128::from(q.0) - i128::from(p.0),
                i128::from(q.1) - i128::from(p.1),
            )
        };
        let (u, v) = (d(a, b), d(a, c));
        let twice = u.0 * v.1 - u.1 * v.0;
        if twice <= 0 {
            return Err(format!("{triangle:?} is not counter-clockwise"));
        }
        area += twice;
        for (p, q) in [(a, b), (b, c), (c, a)] {
            let forward = p < q;
            let key = if forward { [p, q] } else { [q, p] };
            let seen = edges.entry(key).or_insert(0);
            let direction = if forward { 1 } else { 16 };
            *seen += direction;
        }
    }
    let side = i128::from(cells_per_side);
    if !triangles.is_empty() && area != 2 * side * side {
        return Err(format!(
            "the triangles cover {area} half cells of {}",
            2 * side * side
        ));
    }
    for ([p, q], seen) in edges {
        let border = |w: u32| w == 0 || w == cells_per_side;
        let on_border = (p.0 == q.0 && border(p.0)) || (p.1 == q.1 && border(p.1));
        let right = if on_border {
            seen == 1 || seen == 16
        } else {
            seen == 17
        };
        if !right {
            return Err(format!(
                "edge {p:?} to {q:?} is seen {seen} (1 forward, 16 backward)"
            ));
        }
    }
    Ok(triangles.len())
}

/// Deviation of a mesh from the samples, over what was promised.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Deviation {
    /// Largest deviation, times the threshold, over the distance: in tolerances. At most 1 is
    /// promised of a converged mesh.
    pub largest: f64,
    /// Where that is: the triangle, and the sample's column and row.
    pub worst: Option<(SurfaceTriangle, u32, u32)>,
    /// Samples that were compared.
    pub samples: u64,
    /// Samples with data that no triangle is drawn over, but farther than the tolerance from
    /// anything that may leave them out.
    pub left_out: u64,
    /// Samples without data that a triangle larger than the tolerance covers.
    pub covered: u64,
}

/// Measures every sample of the grid, or only those in view.
pub fn measure(tree: &MeshTree, data: &TempDataset, view: &View, in_view: bool) -> Deviation {
    let georef = &data.dataset.manifest().georef;
    let [width, height] = data.dataset.manifest().samples;
    let frustum = Frustum::of(view);
    let mut found = Deviation::default();
    // Samples in an undrawn triangle that is too large to leave them out, and those that another
    // one, on whose border they lie, draws, or may leave out.
    let mut left_out = HashSet::new();
    let mut excused = HashSet::new();
    for triangle in triangles(tree) {
        let xs = triangle.corners.map(|c| c.0);
        let ys = triangle.corners.map(|c| c.1);
        let (x0, x1) = (min(xs), max(xs).min(width - 1));
        let (y0, y1) = (min(ys), max(ys).min(height - 1));
        for y in y0..=y1 {
            for x in x0..=x1 {
                let Some(plane) = plane_height(&triangle, x, y) else {
                    continue;
                };
                let sample = data.sample(x, y);
                // In a hole it is the triangle that is there.
                let at = georef.world(x, y, sample.unwrap_or(plane.round() as i32));
                let point = WorldBox { min: at, max: at };
                if in_view && !frustum.may_see(&point) {
                    continue;
                }
                let tolerance_m = point.distance_m(view.eye_m) / view.threshold();
                let coarse = size_m(&triangle, georef) > tolerance_m;
                match (sample, triangle.drawn) {
                    (Some(sample), true) => {
                        excused.insert((x, y));
                        let deviation_m = (f64::from(sample) - plane).abs() * georef.quantum_m;
                        found.samples += 1;
                        if deviation_m > 0.0 && deviation_m / tolerance_m > found.largest {
                            found.largest = deviation_m / tolerance_m;
                            found.worst = Some((triangle, x, y));
                        }
                    }
                    (Some(_), false) if !coarse => {
                        excused.insert((x, y));
                    }
                    (Some(_), false) if is_on_surface(data, x, y) => {
                        left_out.insert((x, y));
                    }
                    (None, true) if coarse => found.covered += 1,
                    _ => {}
                }
            }
        }
    }
    found.left_out = left_out.difference(&excused).count() as u64;
    found
}

/// Whether a sample is a corner of a valid finest triangle. Others are part of no surface.
fn is_on_surface(data: &TempDataset, x: u32, y: u32) -> bool {
    let valid = |dx: i32, dy: i32| {
        let place = (x.checked_add_signed(dx), y.checked_add_signed(dy));
        matches!(place, (Some(x), Some(y)) if data.sample(x, y).is_some())
    };
    [(1, 1), (-1, 1), (-1, -1), (1, -1)]
        .into_iter()
        .any(|(dx, dy)| match (x + y) % 2 {
            0 => valid(dx, dy) && (valid(dx, 0) || valid(0, dy)),
            _ => valid(dx, 0) && valid(0, dy),
        })
}

/// Half the diagonal of the square that a triangle comes from, at least: half its longest side.
/// Finest triangles are the surface itself, and so of no size.
fn size_m(triangle: &SurfaceTriangle, georef: &Georef) -> f64 {
    let [a, b, c] = triangle.corners;
    let side = |p: (u32, u32, i32), q: (u32, u32, i32)| {
        let (dx, dy) = (
            f64::from(p.0) - f64::from(q.0),
            f64::from(p.1) - f64::from(q.1),
        );
        (dx * georef.sample_spacing_m[0]).hypot(dy * georef.sample_spacing_m[1])
    };
    let cells = |p: (u32, u32, i32), q: (u32, u32, i32)| p.0.abs_diff(q.0).max(p.1.abs_diff(q.1));
    if cells(a, b).max(cells(b, c)).max(cells(c, a)) <= 1 {
        return 0.0;
    }
    side(a, b).max(side(b, c)).max(side(c, a)) / 2.0
}

/// Height of a triangle's plane at a grid point; `None` outside.
fn plane_height(triangle: &SurfaceTriangle, x: u32, y: u32) -> Option<f64> {
    let [a, b, c] = triangle
        .corners
        .map(|(x, y, z)| (i128::from(x), i128::from(y), i128::from(z)));
    let p = (i128::from(x), i128::from(y));
    let area = |a: (i128, i128), b: (i128, i128), c: (i128, i128)| {
        (b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0)
    };
    let at = |v: (i128, i128, i128)| (v.0, v.1);
    let (wa, wb, wc) = (
        area(at(b), at(c), p),
        area(at(c), at(a), p),
        area(at(a), at(b), p),
    );
    if wa < 0 || wb < 0 || wc < 0 {
        return None;
    }
    let whole = wa + wb + wc;
    Some((wa * a.2 + wb * b.2 + wc * c.2) as f64 / whole as f64)
}

fn min(v: [u32; 3]) -> u32 {
    v[0].min(v[1]).min(v[2])
}

fn max(v: [u32; 3]) -> u32 {
    v[0].max(v[1]).max(v[2])
}
