//! The grid points of a triangle, row by row, in integers.

/// Columns and rows of the grid, ends included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Area {
    /// First and last column.
    pub x: [u32; 2],
    /// First and last row.
    pub y: [u32; 2],
}

/// A corner: `x`, `y` in the grid, and height in quanta.
pub type Corner = (u32, u32, f64);

/// A triangle over the grid, counter-clockwise.
pub type Corners = [Corner; 3];

impl Area {
    /// The smallest that holds a triangle.
    pub fn of(corners: &Corners) -> Area {
        let ends = |v: [u32; 3]| [v[0].min(v[1]).min(v[2]), v[0].max(v[1]).max(v[2])];
        Area {
            x: ends(corners.map(|c| c.0)),
            y: ends(corners.map(|c| c.1)),
        }
    }

    /// What lies in both; `None` if nothing does.
    pub fn and(self, other: Area) -> Option<Area> {
        let both = |a: [u32; 2], b: [u32; 2]| [a[0].max(b[0]), a[1].min(b[1])];
        let (x, y) = (both(self.x, other.x), both(self.y, other.y));
        (x[0] <= x[1] && y[0] <= y[1]).then_some(Area { x, y })
    }

    /// Cells on its longer side.
    pub fn cells(self) -> u32 {
        (self.x[1] - self.x[0]).max(self.y[1] - self.y[0])
    }
}

/// A grid point of a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Column.
    pub x: u32,
    /// Row.
    pub y: u32,
    /// Height of the triangle's plane, quanta.
    pub height: f64,
    /// It lies on an edge of the triangle, so that other triangles have it, too.
    pub shared: bool,
}

/// One edge as `a x + b y + c >= 0` for what lies on its left.
#[derive(Debug, Clone, Copy)]
struct Side {
    a: i64,
    b: i64,
    c: i64,
}

impl Side {
    fn between((x0, y0, _): Corner, (x1, y1, _): Corner) -> Side {
        let [x0, y0, x1, y1] = [x0, y0, x1, y1].map(i64::from);
        let (a, b) = (y0 - y1, x1 - x0);
        Side {
            a,
            b,
            c: -(a * x0 + b * y0),
        }
    }

    /// Narrows a row's columns; gives the one that lies on the edge, or all.
    fn narrow(self, y: i64, columns: &mut [i64; 2]) -> OnEdge {
        let rest = self.b * y + self.c;
        match self.a {
            0 if rest < 0 => {
                *columns = [1, 0];
                OnEdge::None
            }
            0 if rest == 0 => OnEdge::All,
            0 => OnEdge::None,
            a => {
                if a > 0 {
                    // `-rest / a`, rounded up.
                    columns[0] = columns[0].max(-rest.div_euclid(a));
                } else {
                    // `rest / -a`, rounded down.
                    columns[1] = columns[1].min(rest.div_euclid(-a));
                }
                match rest.rem_euclid(a) {
                    0 => OnEdge::At(-rest / a),
                    _ => OnEdge::None,
                }
            }
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum OnEdge {
    None,
    At(i64),
    All,
}

/// The plane through a triangle.
#[derive(Debug, Clone, Copy)]
struct Plane {
    origin: (f64, f64, f64),
    east: f64,
    north: f64,
}

impl Plane {
    /// Exact where the triangle's doubled area is a power of two and heights have few enough bits,
    /// as those of a mesh of right triangles are.
    fn through(corners: &Corners) -> Option<Plane> {
        let [a, b, c] = corners.map(|(x, y, z)| (i64::from(x), i64::from(y), z));
        let (u, v) = (
            (b.0 - a.0, b.1 - a.1, b.2 - a.2),
            (c.0 - a.0, c.1 - a.1, c.2 - a.2),
        );
        let north = |p: (i64, i64, f64)| p.1 as f64;
        let east = |p: (i64, i64, f64)| p.0 as f64;
        let twice = u.0 * v.1 - u.1 * v.0;
        (twice > 0).then(|| Plane {
            origin: (east(a), north(a), a.2),
            east: (u.2 * north(v) - north(u) * v.2) / twice as f64,
            north: (east(u) * v.2 - u.2 * east(v)) / twice as f64,
        })
    }

    fn at(&self, x: f64, y: f64) -> f64 {
        let (x0, y0, z0) = self.origin;
        z0 + self.east * (x - x0) + self.north * (y - y0)
    }
}

/// Visits the grid points of a triangle that lie in an area and whose coordinates are multiples of
/// a step. A triangle that is not counter-clockwise has none.
pub fn scan(corners: &Corners, area: Area, step: u32, mut visit: impl FnMut(Point)) {
    let Some(area) = Area::of(corners).and(area) else {
        return;
    };
    let Some(plane) = Plane::through(corners) else {
        return;
    };
    let [a, b, c] = *corners;
    let sides = [(a, b), (b, c), (c, a)].map(|(from, to)| Side::between(from, to));
    let step = step.max(1);
    let ends = area.x.map(i64::from);
    let mut y = area.y[0].next_multiple_of(step);
    while y <= area.y[1] {
        let mut columns = ends;
        let on = sides.map(|side| side.narrow(i64::from(y), &mut columns));
        let stride = i64::from(step);
        let mut x = columns[0] + (-columns[0]).rem_euclid(stride);
        while x <= columns[1] {
            let shared = on.contains(&OnEdge::All) || on.contains(&OnEdge::At(x));
            visit(Point {
                x: x as u32,
                y,
                height: plane.at(x as f64, f64::from(y)),
                shared,
            });
            x += stride;
        }
        let Some(next) = y.checked_add(step) else {
            return;
        };
        y = next;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Every point of the box by three determinants.
    fn naive(corners: &Corners, step: u32) -> Vec<(u32, u32, bool)> {
        let area = Area::of(corners);
        let mut found = Vec::new();
        for y in area.y[0]..=area.y[1] {
            for x in area.x[0]..=area.x[1] {
                let det = |p: Corner, q: Corner| {
                    let [px, py, qx, qy, x, y] = [p.0, p.1, q.0, q.1, x, y].map(i64::from);
                    (qx - px) * (y - py) - (qy - py) * (x - px)
                };
                let [a, b, c] = *corners;
                let dets = [det(a, b), det(b, c), det(c, a)];
                if dets.iter().all(|&d| d >= 0) && x % step == 0 && y % step == 0 {
                    found.push((x, y, dets.contains(&0)));
                }
            }
        }
        found
    }

    proptest! {
        #[test]
        fn the_points_are_those_that_three_determinants_say(
            x in prop::array::uniform3(0u32..40), y in prop::array::uniform3(0u32..40),
            step in 1u32..5,
        ) {
            let mut corners: Corners = std::array::from_fn(|i| (x[i], y[i], 2.0 * f64::from(x[i]) - 3.0 * f64::from(y[i])));
            let turn = |c: &Corners| {
                let d = |i: usize| (i64::from(c[i].0) - i64::from(c[0].0), i64::from(c[i].1) - i64::from(c[0].1));
                d(1).0 * d(2).1 - d(1).1 * d(2).0
            };
            if turn(&corners) < 0 {
                corners.swap(1, 2);
            }
            prop_assume!(turn(&corners) > 0);
            let mut found = Vec::new();
            scan(&corners, Area { x: [0, 100], y: [0, 100] }, step, |point| {
                let plane = 2.0 * f64::from(point.x) - 3.0 * f64::from(point.y);
                assert!((point.height - plane).abs() < 1e-9);
                found.push((point.x, point.y, point.shared));
            });
            prop_assert_eq!(found, naive(&corners, step));
        }
    }
}
