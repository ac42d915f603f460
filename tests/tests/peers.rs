//! What our triangles are compared with is itself right.

use escarp_tests::peers::ours;
use escarp_tests::peers::right::{VertexErrors, largest_in, tuned};
use escarp_tests::peers::tin::Tin;
use escarp_tests::peers::window::{Triangle, Window};
use escarp_tests::terrain::{hash, hills};
use std::collections::{HashMap, HashSet};

fn windows(cells: u32) -> Vec<(&'static str, Window)> {
    vec![
        ("hills", Window::of(cells, |x, y| hills(x, y) as i32)),
        (
            "noise",
            Window::of(cells, |x, y| (hash(x, y) % 3000) as i32 - 900),
        ),
        (
            "spike",
            Window::of(
                cells,
                |x, y| if (x, y) == (7, 5) { i32::MAX / 2 } else { 3 },
            ),
        ),
        ("flat", Window::of(cells, |_, _| -77)),
        (
            "ramp",
            Window::of(cells, |x, y| 3 * x as i32 - 2 * y as i32),
        ),
        (
            "ridge",
            Window::of(cells, |x, y| -(x as i32 * 2 - y as i32 - 9).abs()),
        ),
    ]
}

/// Checks that triangles cover a window without gap or overlap, each counter-clockwise.
fn check_cover(window: &Window, mesh: &[Triangle], name: &str) {
    let mut edges = HashSet::new();
    let mut area = 0;
    for &[a, b, c] in mesh {
        let d = |p: u32, q: u32| i64::from(p) - i64::from(q);
        let twice = d(b.0, a.0) * d(c.1, a.1) - d(b.1, a.1) * d(c.0, a.0);
        assert!(
            twice > 0,
            "{name}: {a:?} {b:?} {c:?} is not counter-clockwise"
        );
        area += twice;
        for edge in [(a, b), (b, c), (c, a)] {
            assert!(edges.insert(edge), "{name}: {edge:?} is there twice");
        }
    }
    let n = window.cells;
    assert_eq!(area, 2 * i64::from(n) * i64::from(n), "{name}");
    for &(a, b) in &edges {
        let on_border = |w: (u32, u32)| w.0 == w.1 && (w.0 == 0 || w.0 == n);
        let on_border = on_border((a.0, b.0)) || on_border((a.1, b.1));
        assert_ne!(edges.contains(&(b, a)), on_border, "{name}: {a:?} {b:?}");
    }
}

/// Largest deviation in floating point, sample by sample over all triangles.
fn naive_largest(window: &Window, mesh: &[Triangle]) -> f64 {
    let mut largest: f64 = 0.0;
    for &[a, b, c] in mesh {
        let at = |p: (u32, u32)| (f64::from(p.0), f64::from(p.1), window.height(p) as f64);
        let (pa, pb, pc) = (at(a), at(b), at(c));
        let left = |p: (f64, f64, f64), q: (f64, f64, f64), r: (f64, f64, f64)| {
            (q.0 - p.0) * (r.1 - p.1) - (q.1 - p.1) * (r.0 - p.0)
        };
        for y in 0..=window.cells {
            for x in 0..=window.cells {
                let p = at((x, y));
                let weights = [left(pb, pc, p), left(pc, pa, p), left(pa, pb, p)];
                if weights.iter().all(|&w| w >= 0.0) {
                    let sum: f64 = weights.iter().sum();
                    let plane = (weights[0] * pa.2 + weights[1] * pb.2 + weights[2] * pc.2) / sum;
                    largest = largest.max((p.2 - plane).abs());
                }
            }
        }
    }
    largest
}

#[test]
fn a_tin_is_delaunay_covers_the_window_and_keeps_its_tolerance() {
    for (name, window) in &windows(32) {
        let mut tin = Tin::new(window);
        let mut before = 0;
        for tolerance in [1000.0, 100.0, 10.0, 1.0, 0.0] {
            tin.refine(tolerance);
            let mesh = tin.triangles();
            check_cover(window, &mesh, name);
            assert!(tin.is_delaunay(), "{name} {tolerance}");
            let deviation = window.deviation(&mesh);
            assert!(
                deviation.largest <= tolerance,
                "{name} {tolerance}: {deviation:?}"
            );
            assert!(mesh.len() >= before);
            before = mesh.len();
        }
        let flat = *name == "flat" || *name == "ramp";
        assert_eq!(before == 2, flat, "{name}: {before} triangles");
    }
}

#[test]
fn deviations_are_those_of_a_naive_comparison() {
    for (name, window) in &windows(16) {
        let mut tin = Tin::new(window);
        tin.refine(40.0);
        for mesh in [tin.triangles(), VertexErrors::rtin(window).mesh(40.0)] {
            let (found, naive) = (
                window.deviation(&mesh).largest,
                naive_largest(window, &mesh),
            );
            assert!(
                (found - naive).abs() <= 1e-9 * naive.max(1.0),
                "{name}: {found} {naive}"
            );
        }
    }
}

/// RTIN's errors by raising them until nothing changes.
fn naive_rtin(window: &Window) -> HashMap<(u32, u32), f64> {
    let mut errors: HashMap<(u32, u32), f64> = HashMap::new();
    loop {
        let before = errors.clone();
        let n = window.cells;
        let mut open = vec![[(n, n), (0, 0), (n, 0)], [(0, 0), (n, n), (0, n)]];
        while let Some([from, to, apex]) = open.pop() {
            if from.0.abs_diff(to.0).max(from.1.abs_diff(to.1)) < 2 {
                continue;
            }
            let middle = |p: (u32, u32), q: (u32, u32)| ((p.0 + q.0) / 2, (p.1 + q.1) / 2);
            let at = middle(from, to);
            let ends = (window.height(from) + window.height(to)) as f64 / 2.0;
            let mut error = (window.height(at) as f64 - ends).abs();
            if apex.0.abs_diff(from.0).max(apex.1.abs_diff(from.1)) >= 2 {
                for below in [middle(apex, from), middle(apex, to)] {
                    error = error.max(errors.get(&below).copied().unwrap_or(0.0));
                }
            }
            let known = errors.entry(at).or_insert(0.0);
            *known = known.max(error);
            open.push([apex, from, at]);
            open.push([to, apex, at]);
        }
        if errors == before {
            return errors;
        }
    }
}

#[test]
fn rtin_has_the_errors_of_a_naive_propagation_and_meshes_without_a_crack() {
    for (name, window) in &windows(16) {
        let rtin = VertexErrors::rtin(window);
        for (vertex, error) in naive_rtin(window) {
            assert_eq!(rtin.error(vertex), error, "{name} {vertex:?}");
        }
        for tolerance in [0.0, 0.5, 7.0, 300.0] {
            check_cover(window, &rtin.mesh(tolerance), name);
        }
        assert_eq!(window.deviation(&rtin.mesh(0.0)).largest, 0.0, "{name}");
    }
}

#[test]
fn a_mesh_by_exact_errors_keeps_its_tolerance_and_a_tuned_one_what_it_was_tuned_to() {
    for (name, window) in &windows(32) {
        let exact = VertexErrors::exact(window);
        for tolerance in [1.0, 30.0, 400.0] {
            let mesh = exact.mesh(tolerance);
            check_cover(window, &mesh, name);
            let largest = window.deviation(&mesh).largest;
            assert!(largest <= tolerance, "{name} {tolerance}: {largest}");
            let rtin = VertexErrors::rtin(window);
            let (_, tuned) = tuned(&rtin, window, largest, 12);
            assert!(
                window.deviation(&tuned).largest <= largest,
                "{name} {tolerance}"
            );
        }
    }
}

#[test]
fn our_mesh_of_whole_pages_is_that_of_its_bounds_and_of_fewer_parts_no_smaller() {
    // Less than the grid, whose centre is always enabled.
    for (name, window) in &windows(128) {
        let data = ours::dataset(window);
        let errors = ours::errors(&ours::bounds(&data, window.cells));
        for tolerance in [2.5, 40.5, 600.5] {
            let mut whole = ours::mesh(&data, tolerance, 4).triangles;
            let few = ours::mesh(&data, tolerance, 0).triangles;
            for mesh in [&whole, &few] {
                check_cover(window, mesh, name);
                assert!(
                    window.deviation(mesh).largest <= tolerance,
                    "{name} {tolerance}"
                );
            }
            let turned = |mut triangle: Triangle| {
                let first = (0..3).min_by_key(|&i| triangle[i]).unwrap_or(0);
                triangle.rotate_left(first);
                triangle
            };
            let mut expected = errors.mesh(tolerance);
            for mesh in [&mut whole, &mut expected] {
                mesh.iter_mut()
                    .for_each(|triangle| *triangle = turned(*triangle));
                mesh.sort_unstable();
            }
            assert_eq!(whole, expected, "{name} {tolerance}");
            assert!(few.len() >= whole.len(), "{name} {tolerance}");
        }
    }
}

#[test]
fn our_bounds_hold_and_coded_ones_lie_between_them_and_the_exact() {
    for (name, window) in &windows(256) {
        let data = ours::dataset(window);
        let bounds = ours::bounds(&data, window.cells);
        let mut triangles = 0;
        VertexErrors::of(window.cells, |vertex, sides| {
            for triangle in sides.iter().flatten() {
                let (bound, exact) = (bounds.of(triangle), largest_in(window, triangle));
                let coded = ours::coded(window, triangle, bound);
                assert!(f64::from(coded) >= exact, "{name} {vertex:?} {triangle:?}");
                assert!(bound >= coded, "{name} {vertex:?} {triangle:?}");
                triangles += 1;
            }
            0.0
        });
        // Two halves and four edge triangles a square.
        assert_eq!(
            triangles,
            (0..8).map(|level| 6 << (2 * level)).sum::<usize>()
        );
    }
}
