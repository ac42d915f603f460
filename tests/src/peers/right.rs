//! Hierarchies of right triangles over a window, refined where a vertex's error is above a
//! tolerance: RTIN (Evans, Kirkpatrick, Townsend, "Right-Triangulated Irregular Networks", 2001),
//! with the errors of Martini, or with others.
//!
//! A triangle is split at the middle of its hypotenuse. A vertex is the middle of two triangles'
//! hypotenuse, one on the border; what splits one must split the other. A vertex's error is
//! propagated to the vertices that it depends on, so that a mesh without a crack follows from
//! comparing errors with the tolerance.

use super::window::{Triangle, Window};

/// An error for each vertex that some triangles' splitting adds, quanta; not less than that of any
/// vertex that depends on it.
#[derive(Debug, Clone, PartialEq)]
pub struct VertexErrors {
    cells: u32,
    errors: Vec<f64>,
}

/// The triangles that a vertex splits.
pub type Sides = [Option<Triangle>; 2];

impl VertexErrors {
    /// Errors from those of the triangles that each vertex splits, largest first; the function
    /// gets the vertex and the triangles on both sides.
    pub fn of(cells: u32, mut error: impl FnMut((u32, u32), &Sides) -> f64) -> VertexErrors {
        let side = cells as usize + 1;
        let mut found = VertexErrors {
            cells,
            errors: vec![0.0; side * side],
        };
        let mut half = 1;
        while half < cells {
            found.fill(half, true, &mut error);
            found.fill(half, false, &mut error);
            half *= 2;
        }
        found
    }

    /// RTIN's errors: the distance of a vertex from the middle of the hypotenuse that it splits.
    pub fn rtin(window: &Window) -> VertexErrors {
        VertexErrors::of(window.cells, |vertex, sides| {
            let Some([from, to, _]) = sides.iter().flatten().next() else {
                return 0.0;
            };
            let ends = window.height(*from) + window.height(*to);
            (2 * window.height(vertex) - ends).abs() as f64 / 2.0
        })
    }

    /// Exact errors: the largest deviation of any sample from the triangles that a vertex splits.
    pub fn exact(window: &Window) -> VertexErrors {
        VertexErrors::of(window.cells, |_, sides| {
            let errors = sides.iter().flatten().map(|side| largest_in(window, side));
            errors.fold(0.0, f64::max)
        })
    }

    fn at(&self, (x, y): (u32, u32)) -> usize {
        (y * (self.cells + 1) + x) as usize
    }

    /// Error of a vertex.
    pub fn error(&self, vertex: (u32, u32)) -> f64 {
        self.errors[self.at(vertex)]
    }

    /// Errors of the vertices in the middles of edges, or of the centres, of squares of twice
    /// `half` cells a side.
    fn fill(&mut self, half: u32, edges: bool, error: &mut impl FnMut((u32, u32), &Sides) -> f64) {
        let steps = self.cells / half;
        for row in 0..=steps {
            for column in 0..=steps {
                let (x, y) = (column * half, row * half);
                let sides = match (column % 2, row % 2, edges) {
                    (1, 0, true) | (0, 1, true) => {
                        self.sides_of_edge((x, y), half, column % 2 == 1)
                    }
                    (1, 1, false) => sides_of_centre((x, y), half),
                    _ => continue,
                };
                let below = self.largest_dependent((x, y), half, edges);
                let at = self.at((x, y));
                self.errors[at] = error((x, y), &sides).max(below);
            }
        }
    }

    /// Triangles that the middle of an edge splits: ends of the edge, and the centre beyond.
    fn sides_of_edge(&self, (x, y): (u32, u32), half: u32, level: bool) -> Sides {
        let (dx, dy) = if level { (half, 0) } else { (0, half) };
        let (low, high) = ((x.wrapping_sub(dx), y.wrapping_sub(dy)), (x + dx, y + dy));
        // To the left of low -> high lies the north of a level edge, the west of an upright one.
        let left = self.inside(x.wrapping_sub(dy), y.wrapping_add(dx));
        let right = self.inside(x.wrapping_add(dy), y.wrapping_sub(dx));
        [
            left.map(|centre| [low, high, centre]),
            right.map(|centre| [high, low, centre]),
        ]
    }

    fn inside(&self, x: u32, y: u32) -> Option<(u32, u32)> {
        (x <= self.cells && y <= self.cells).then_some((x, y))
    }

    /// Largest error of a vertex that depends on this one: for the middle of an edge the centres
    /// of the four squares of half the size that it is a corner of, for a centre the middles of
    /// its square's edges.
    fn largest_dependent(&self, (x, y): (u32, u32), half: u32, is_edge: bool) -> f64 {
        let step = if is_edge { half / 2 } else { half };
        if step == 0 {
            return 0.0;
        }
        let around = match is_edge {
            true => [(step, step), (0u32.wrapping_sub(step), step)],
            false => [(step, 0), (0, step)],
        };
        let both = around
            .into_iter()
            .flat_map(|(dx, dy)| [(dx, dy), (0u32.wrapping_sub(dx), 0u32.wrapping_sub(dy))]);
        let there = both.filter_map(|(dx, dy)| self.inside(x.wrapping_add(dx), y.wrapping_add(dy)));
        there.map(|vertex| self.error(vertex)).fold(0.0, f64::max)
    }

    /// The mesh in which all triangles are split whose middle has an error above the tolerance.
    pub fn mesh(&self, tolerance: f64) -> Vec<Triangle> {
        let n = self.cells;
        let mut open = vec![[(n, n), (0, 0), (n, 0)], [(0, 0), (n, n), (0, n)]];
        let mut mesh = Vec::new();
        while let Some(triangle) = open.pop() {
            let [from, to, apex] = triangle;
            let middle = (u32::midpoint(from.0, to.0), u32::midpoint(from.1, to.1));
            let can_split = from.0.abs_diff(to.0).max(from.1.abs_diff(to.1)) > 1;
            if can_split && self.error(middle) > tolerance {
                open.push([apex, from, middle]);
                open.push([to, apex, middle]);
            } else {
                mesh.push(triangle);
            }
        }
        mesh
    }
}

/// The two halves of a square, which its centre splits. Its diagonal runs from the centre of the
/// square above to the latter's corner; that of the whole window from south-west to north-east.
fn sides_of_centre((x, y): (u32, u32), half: u32) -> Sides {
    let (column, row) = (x / (2 * half), y / (2 * half));
    let (west, east, south, north) = (x - half, x + half, y - half, y + half);
    let (sw, se) = ((west, south), (east, south));
    let (nw, ne) = ((west, north), (east, north));
    match (column + row) % 2 {
        0 => [Some([ne, sw, se]), Some([sw, ne, nw])],
        _ => [Some([se, nw, sw]), Some([nw, se, ne])],
    }
}

/// Largest deviation of a sample in a triangle from its plane, quanta.
pub fn largest_in(window: &Window, triangle: &Triangle) -> f64 {
    let mut largest = (0, 1);
    window.visit(triangle, |_, off, whole| {
        largest = (off.max(largest.0), whole)
    });
    largest.0 as f64 / largest.1 as f64
}

/// A mesh of few triangles that deviates by no more than `largest`, and its tolerance.
///
/// What a mesh deviates by does not always fall with its tolerance, where errors are no bounds. So
/// tolerances are tried from above `largest` downwards, each 4 % below the last; then, in between
/// the first that does and the one before, by halving `steps` times.
pub fn tuned(
    errors: &VertexErrors,
    window: &Window,
    largest: f64,
    steps: u32,
) -> (f64, Vec<Triangle>) {
    let fitting = |tolerance: f64| {
        let mesh = errors.mesh(tolerance);
        (window.deviation(&mesh).largest <= largest).then_some(mesh)
    };
    let ladder = (0..LADDER).map(|rung| largest * TOP * STEP.powi(rung));
    let first = ladder
        .into_iter()
        .find_map(|low| fitting(low).map(|mesh| (low, mesh)));
    let (mut low, mut best) = first.unwrap_or_else(|| (0.0, errors.mesh(0.0)));
    let mut high = low / STEP;
    for _ in 0..steps {
        let tolerance = f64::midpoint(low, high);
        match fitting(tolerance) {
            Some(mesh) => (low, best) = (tolerance, mesh),
            None => high = tolerance,
        }
    }
    (low, best)
}

/// Where tolerances start, over the deviation that is looked for; how each follows from the last;
/// and how many there are: down to an eighth.
const TOP: f64 = 1.1;
const STEP: f64 = 0.96;
const LADDER: i32 = 54;
