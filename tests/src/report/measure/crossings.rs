//! Where the edges of a mesh cross those of the finest triangulation.
//!
//! Mesh and surface are both linear between such crossings, so the largest deviation over a
//! triangle is at a sample in it, or at a crossing of its edges. A triangle whose edges follow the
//! axes, or the diagonals of the cells, crosses at samples only.

/// A grid point.
pub type Place = (u32, u32);

/// Whether all that an edge crosses is samples.
pub fn follows_the_grid((x0, y0): Place, (x1, y1): Place) -> bool {
    let (dx, dy) = (x0.abs_diff(x1), y0.abs_diff(y1));
    dx == 0 || dy == 0 || (dx == dy && (u64::from(x0) + u64::from(y0)).is_multiple_of(2))
}

/// Visits the shares of an edge, between 0 and 1, at which it crosses a line of the finest
/// triangulation: columns, rows, and diagonals of both directions. Some may come twice.
pub fn crossings((x0, y0): Place, (x1, y1): Place, mut visit: impl FnMut(f64)) {
    let [x0, y0, x1, y1] = [x0, y0, x1, y1].map(i64::from);
    // Diagonals join samples whose coordinates add up to an even number.
    let lines = [
        (x0, x1, 1),
        (y0, y1, 1),
        (x0 + y0, x1 + y1, 2),
        (x0 - y0, x1 - y1, 2),
    ];
    for (from, to, step) in lines {
        let (low, high) = (from.min(to), from.max(to));
        let mut line = low + (-low).rem_euclid(step);
        while line <= high {
            if low < high {
                visit((line - from) as f64 / (to - from) as f64);
            }
            line += step;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_of_right_triangles_cross_at_samples_only() {
        for (from, to) in [
            ((4, 4), (8, 8)),
            ((4, 8), (8, 4)),
            ((3, 7), (3, 90)),
            ((5, 6), (1, 6)),
        ] {
            assert!(follows_the_grid(from, to));
            crossings(from, to, |share| {
                let at = |a: u32, b: u32| f64::from(a) + share * (f64::from(b) - f64::from(a));
                let (x, y) = (at(from.0, to.0), at(from.1, to.1));
                let whole = |v: f64| (v - v.round()).abs() < 1e-9;
                assert!(whole(x) && whole(y), "{from:?} {to:?}: {x} {y}");
            });
        }
        assert!(!follows_the_grid((4, 5), (8, 9)));
        assert!(!follows_the_grid((0, 0), (4, 2)));
    }

    #[test]
    fn an_edge_crosses_every_line_between_its_ends() {
        let mut found = Vec::new();
        crossings((0, 0), (4, 2), |share| found.push(share));
        found.sort_by(f64::total_cmp);
        found.dedup();
        // Columns 0, 1, 2, 3, 4; rows 0, 1, 2; sums 0, 2, 4, 6; differences 0, 2.
        let expected = [0.0, 0.25, 1.0 / 3.0, 0.5, 2.0 / 3.0, 0.75, 1.0];
        assert_eq!(found, expected);
    }
}
