//! Naive measurements of a mesh: cracks, and the deviation at every sample and crossing.
//!
//! The full-resolution surface is linear on each finest triangle. These lie between four families
//! of lines: `x = k`, `y = k`, `x - y = 2k` and `x + y = 2k`, which meet in samples alone. A mesh
//! triangle's plane deviates most from the surface at a sample, then, if its own edges are on such
//! lines; else it may at a [crossing](crossings) of its edges with them.

use crate::terrain::TempDataset;
use escarp_client::mesh::{Frustum, MeshTree, SurfaceTriangle};
use escarp_proto::georef::{Georef, WorldBox};
use escarp_proto::view::View;

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
    let triangles = triangles(tree);
    let drawn = triangles.iter().filter(|triangle| triangle.drawn);
    let mut corners: Vec<(u32, u32, i32)> = drawn.flat_map(|triangle| triangle.corners).collect();
    corners.sort_unstable();
    for pair in corners.windows(2) {
        let [(x, y, low), (x1, y1, high)] = [pair[0], pair[1]];
        if (x, y) == (x1, y1) && low != high {
            return Err(format!("vertex {x}, {y} has two heights"));
        }
    }
    covers(&triangles, cells_per_side)
}

/// Checks that the triangles cover the grid without gap or overlap: every edge that is not on the
/// border of the grid lies in exactly two triangles, in opposite directions, and the areas add up.
///
/// # Errors
/// What is wrong, and where.
pub fn check_cover(tree: &MeshTree, cells_per_side: u32) -> Result<usize, String> {
    covers(&triangles(tree), cells_per_side)
}

/// An edge by its ends, the smaller one first, and which way a triangle goes along it.
type DirectedEdge = ([(u32, u32); 2], bool);

fn covers(triangles: &[SurfaceTriangle], cells_per_side: u32) -> Result<usize, String> {
    let mut edges: Vec<DirectedEdge> = Vec::with_capacity(triangles.len() * 3);
    let mut area: i128 = 0;
    for triangle in triangles {
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
            edges.push((if forward { [p, q] } else { [q, p] }, forward));
        }
    }
    let side = i128::from(cells_per_side);
    if !triangles.is_empty() && area != 2 * side * side {
        return Err(format!(
            "the triangles cover {area} half cells of {}",
            2 * side * side
        ));
    }
    edges.sort_unstable();
    for same in edges.chunk_by(|a, b| a.0 == b.0) {
        let [p, q] = same[0].0;
        let border = |w: u32| w == 0 || w == cells_per_side;
        let on_border = (p.0 == q.0 && border(p.0)) || (p.1 == q.1 && border(p.1));
        let right = match same {
            [_] => on_border,
            [(_, back), (_, forth)] => !on_border && back != forth,
            _ => false,
        };
        if !right {
            return Err(format!(
                "edge {p:?} to {q:?} is in {} triangles",
                same.len()
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
    /// Crossings of triangles' edges with those of finest triangles, other than at samples, that
    /// were compared.
    pub crossings: u64,
    /// Samples with data that no triangle is drawn over, but farther than the tolerance from
    /// anything that may leave them out.
    pub left_out: u64,
    /// Samples without data that a triangle larger than the tolerance covers.
    pub covered: u64,
}

/// What triangles that are not drawn say of a sample with data.
#[derive(Debug, Clone, Copy, Default)]
struct Outline {
    /// One that is larger than the tolerance leaves it out.
    left_out: bool,
    /// Another draws it, or may leave it out.
    excused: bool,
}

/// Measures every sample of the grid, or only those in view.
pub fn measure(tree: &MeshTree, data: &TempDataset, view: &View, in_view: bool) -> Deviation {
    let georef = &data.dataset.manifest().georef;
    let [width, height] = data.dataset.manifest().samples;
    let frustum = Frustum::of(view);
    let mut found = Deviation::default();
    // Samples in an undrawn triangle that is too large to leave them out, and those that another
    // one, on whose border they lie, draws, or may leave out.
    let mut outlines = vec![Outline::default(); width as usize * height as usize];
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
                // A hole has no height but that of what covers it.
                let height = sample.map_or(plane, f64::from);
                let at = [
                    georef.world_x(x),
                    georef.world_y(y),
                    height * georef.quantum_m,
                ];
                let point = WorldBox { min: at, max: at };
                if in_view && !frustum.may_see(&point) {
                    continue;
                }
                let tolerance_m = point.distance_m(view.eye_m) / view.threshold();
                let coarse = size_m(&triangle, georef) > tolerance_m;
                match (sample, triangle.drawn) {
                    (Some(sample), true) => {
                        outlines[y as usize * width as usize + x as usize].excused = true;
                        let deviation_m = (f64::from(sample) - plane).abs() * georef.quantum_m;
                        found.samples += 1;
                        if deviation_m > 0.0 && deviation_m / tolerance_m > found.largest {
                            found.largest = deviation_m / tolerance_m;
                            found.worst = Some((triangle, x, y));
                        }
                    }
                    (Some(_), false) if !coarse => {
                        outlines[y as usize * width as usize + x as usize].excused = true;
                    }
                    (Some(_), false) if is_on_surface(data, x, y) => {
                        outlines[y as usize * width as usize + x as usize].left_out = true;
                    }
                    (None, true) if coarse => found.covered += 1,
                    _ => {}
                }
            }
        }
        if triangle.drawn {
            measure_crossings(&triangle, data, view, in_view, &mut found);
        }
    }
    let left_out = |outline: &&Outline| outline.left_out && !outline.excused;
    found.left_out = outlines.iter().filter(left_out).count() as u64;
    found
}

/// Measures what is in view against the bound that an update stated, if it did.
///
/// # Panics
/// If it is exceeded.
pub fn check_stated(tree: &MeshTree, data: &TempDataset, view: &View, excess: f64, case: &str) {
    if excess.is_finite() {
        let found = measure(tree, data, view, true);
        assert!(
            found.largest <= excess.max(1.0) + 1e-9,
            "{case}: {found:?}, stated {excess}, {:?}",
            tree.options()
        );
    }
}

/// Measures where a triangle's edges cross those of finest triangles.
fn measure_crossings(
    triangle: &SurfaceTriangle,
    data: &TempDataset,
    view: &View,
    in_view: bool,
    found: &mut Deviation,
) {
    let georef = &data.dataset.manifest().georef;
    let frustum = Frustum::of(view);
    let [a, b, c] = triangle.corners;
    for (from, to) in [(a, b), (b, c), (c, a)] {
        for crossing in crossings(from, to, &|x, y| data.sample(x, y)) {
            let [x, y] = crossing.at;
            let at = [
                georef.origin_m[0] + x * georef.sample_spacing_m[0],
                georef.origin_m[1] + y * georef.sample_spacing_m[1],
                crossing.surface * georef.quantum_m,
            ];
            let point = WorldBox { min: at, max: at };
            if in_view && !frustum.may_see(&point) {
                continue;
            }
            let tolerance_m = point.distance_m(view.eye_m) / view.threshold();
            found.crossings += 1;
            let deviation_m = crossing.deviation * georef.quantum_m;
            if deviation_m > 0.0 && deviation_m / tolerance_m > found.largest {
                found.largest = deviation_m / tolerance_m;
                found.worst = Some((*triangle, x as u32, y as u32));
            }
        }
    }
}

/// Where an edge of a mesh crosses one of a finest triangle between samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Crossing {
    /// Grid column and row, with fractions.
    pub at: [f64; 2],
    /// Height of the surface there, quanta.
    pub surface: f64,
    /// How far the mesh's edge is from it, quanta; from exact integers.
    pub deviation: f64,
}

/// Whether an edge lies on a line that finest triangles lie between.
pub fn is_grid_line(from: (u32, u32, i32), to: (u32, u32, i32)) -> bool {
    let (dx, dy) = (from.0.abs_diff(to.0), from.1.abs_diff(to.1));
    dx == 0 || dy == 0 || (dx == dy && (from.0 + from.1).is_multiple_of(2))
}

/// All crossings of an edge with edges of finest triangles, other than at samples. None for an
/// edge that is on a [grid line](is_grid_line).
pub fn crossings(
    from: (u32, u32, i32),
    to: (u32, u32, i32),
    sample: &dyn Fn(u32, u32) -> Option<i32>,
) -> Vec<Crossing> {
    if is_grid_line(from, to) {
        return Vec::new();
    }
    let wide = |v: (u32, u32, i32)| (i128::from(v.0), i128::from(v.1), i128::from(v.2));
    let (from, to) = (wide(from), wide(to));
    let mut found = Vec::new();
    // A family of lines: `a x + b y = k * every`, and the step from sample to sample along one.
    for (a, b, every, along) in [
        (1, 0, 1, (0, 1)),
        (0, 1, 1, (1, 0)),
        (1, -1, 2, (1, 1)),
        (1, 1, 2, (1, -1)),
    ] {
        let value = |v: (i128, i128, i128)| a * v.0 + b * v.1;
        let (start, end) = (value(from), value(to));
        let (low, high) = (start.min(end), start.max(end));
        let first = (low + 1).div_euclid(every) + i128::from((low + 1).rem_euclid(every) > 0);
        let lines = (first..).map(|k| k * every).take_while(|line| *line < high);
        found.extend(lines.filter_map(|line| {
            // The edge is crossed at the share `part / whole` of its way.
            let (part, whole) = match end > start {
                true => (line - start, end - start),
                false => (start - line, start - end),
            };
            crossing(from, to, (part, whole), along, sample)
        }));
    }
    found
}

/// The crossing at a share of an edge's way with a line of finest edges, which step from sample
/// to sample by `along`; `None` at a sample, or where the surface has a hole.
fn crossing(
    from: (i128, i128, i128),
    to: (i128, i128, i128),
    (part, whole): (i128, i128),
    along: (i128, i128),
    sample: &dyn Fn(u32, u32) -> Option<i32>,
) -> Option<Crossing> {
    // All times `whole`.
    let x = from.0 * whole + (to.0 - from.0) * part;
    let y = from.1 * whole + (to.1 - from.1) * part;
    let mesh = from.2 * whole + (to.2 - from.2) * part;
    let beyond = if along.0 > 0 { x } else { y }.rem_euclid(whole);
    if beyond == 0 {
        return None;
    }
    let before = (
        (x - along.0 * beyond) / whole,
        (y - along.1 * beyond) / whole,
    );
    let after = (before.0 + along.0, before.1 + along.1);
    let height = |at: (i128, i128)| {
        let (x, y) = (u32::try_from(at.0).ok()?, u32::try_from(at.1).ok()?);
        sample(x, y).map(i128::from)
    };
    let surface = height(before)? * (whole - beyond) + height(after)? * beyond;
    let share = |v: i128| v as f64 / whole as f64;
    Some(Crossing {
        at: [share(x), share(y)],
        surface: share(surface),
        deviation: share((surface - mesh).abs()),
    })
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
pub fn plane_height(triangle: &SurfaceTriangle, x: u32, y: u32) -> Option<f64> {
    let [a, b, c] = triangle
        .corners
        .map(|(x, y, _)| (i64::from(x), i64::from(y)));
    let p = (i64::from(x), i64::from(y));
    // Below 2^58: coordinates are below 2^28.
    let area = |a: (i64, i64), b: (i64, i64), c: (i64, i64)| {
        (b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0)
    };
    let weights = [area(b, c, p), area(c, a, p), area(a, b, p)];
    if weights.iter().any(|weight| *weight < 0) {
        return None;
    }
    let whole: i64 = weights.iter().sum();
    let heights = triangle.corners.map(|corner| corner.2);
    let terms = (0..3).map(|i| i128::from(weights[i]) * i128::from(heights[i]));
    let sum: i128 = terms.sum();
    Some(sum as f64 / whole as f64)
}

fn min(v: [u32; 3]) -> u32 {
    v[0].min(v[1]).min(v[2])
}

fn max(v: [u32; 3]) -> u32 {
    v[0].max(v[1]).max(v[2])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Height of the full-resolution surface anywhere, from the finest triangle that holds it.
    fn surface(x: f64, y: f64, sample: &dyn Fn(u32, u32) -> Option<i32>) -> f64 {
        let (column, row) = (x.floor(), y.floor());
        let (u, v) = (x - column, y - row);
        let at =
            |dx: u32, dy: u32| f64::from(sample(column as u32 + dx, row as u32 + dy).unwrap_or(0));
        let (sw, se, nw, ne) = (at(0, 0), at(1, 0), at(0, 1), at(1, 1));
        match (column as u32 + row as u32).is_multiple_of(2) {
            // The diagonal rises.
            true if u >= v => sw + (se - sw) * u + (ne - se) * v,
            true => sw + (nw - sw) * v + (ne - nw) * u,
            false if u + v <= 1.0 => sw + (se - sw) * u + (nw - sw) * v,
            false => ne + (nw - ne) * (1.0 - u) + (se - ne) * (1.0 - v),
        }
    }

    fn noise(x: u32, y: u32) -> Option<i32> {
        Some((crate::terrain::hash(x, y) % 1000) as i32)
    }

    proptest! {
        #[test]
        fn no_point_of_an_edge_deviates_more_than_its_ends_and_crossings(
            from in (0u32..20, 0u32..20, -500i32..500), to in (0u32..20, 0u32..20, -500i32..500),
        ) {
            prop_assume!((from.0, from.1) != (to.0, to.1));
            let found = crossings(from, to, &noise);
            let wide = |v: (u32, u32, i32)| [f64::from(v.0), f64::from(v.1), f64::from(v.2)];
            let (a, b) = (wide(from), wide(to));
            let deviation = |share: f64| {
                let [x, y, z] = [0, 1, 2].map(|i| a[i] + (b[i] - a[i]) * share);
                (surface(x, y, &noise) - z).abs()
            };
            // Samples on the way are no crossings; with whole steps they are where shares are so.
            let steps = from.0.abs_diff(to.0).max(from.1.abs_diff(to.1));
            let samples = (0..=steps).map(|k| deviation(f64::from(k) / f64::from(steps)));
            let crossed = found.iter().map(|crossing| crossing.deviation);
            let largest = samples.chain(crossed).fold(0.0, f64::max);
            for k in 0..=2000 {
                prop_assert!(deviation(f64::from(k) / 2000.0) <= largest + 1e-6);
            }
            for crossing in found {
                let [x, y] = crossing.at;
                prop_assert!((surface(x, y, &noise) - crossing.surface).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn an_edge_along_finest_edges_has_no_crossing_and_one_across_a_diagonal_has() {
        assert!(crossings((0, 0, 0), (8, 8, 9), &noise).is_empty());
        assert!(crossings((3, 5, 0), (3, 9, 9), &noise).is_empty());
        assert!(crossings((4, 0, 0), (0, 4, 9), &noise).is_empty());
        let ridge = |x, y| {
            Some(if (x, y) == (0, 0) || (x, y) == (1, 1) {
                10
            } else {
                0
            })
        };
        let found = crossings((1, 0, 0), (0, 1, 0), &ridge);
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].at, found[0].deviation), ([0.5, 0.5], 10.0));
    }
}
