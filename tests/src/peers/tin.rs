//! A free TIN: a Delaunay triangulation to which the sample is added, again and again, that is
//! farthest from it (Garland and Heckbert, "Fast Polygonal Approximation of Terrains and Height
//! Fields", 1995, algorithm III), by splitting triangles and flipping edges (Guibas and Stolfi,
//! "Primitives for the Manipulation of General Subdivisions", 1985).
//!
//! All predicates are exact: places are integers, and their determinants fit 64 bits for windows
//! of up to `2^14` cells.

use super::window::{Triangle, Window};
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Stands for no half-edge.
const NONE: usize = usize::MAX;

/// Ends of a half-edge, and the half-edge across.
type Border = ((u32, u32), (u32, u32), usize);

/// A Delaunay triangulation of some of a window's samples.
#[derive(Debug)]
pub struct Tin<'a> {
    window: &'a Window,
    /// Three a triangle, counter-clockwise; half-edge `e` leaves `corners[e]`.
    corners: Vec<(u32, u32)>,
    /// The half-edge on the other side, by half-edge.
    twins: Vec<usize>,
    /// Which change a triangle had last, by triangle.
    changed: Vec<u64>,
    changes: u64,
    worst: BinaryHeap<Worst>,
    /// Triangles that changed and have not been searched since.
    stale: Vec<usize>,
}

/// The sample in a triangle that is farthest from it.
#[derive(Debug, Clone, Copy)]
struct Worst {
    deviation: f64,
    place: (u32, u32),
    triangle: usize,
    changed: u64,
}

impl<'a> Tin<'a> {
    /// The window's corners, in two triangles.
    pub fn new(window: &'a Window) -> Tin<'a> {
        let n = window.cells;
        let (sw, se, ne, nw) = ((0, 0), (n, 0), (n, n), (0, n));
        let mut tin = Tin {
            window,
            corners: vec![sw, se, ne, sw, ne, nw],
            twins: vec![NONE, NONE, 3, 2, NONE, NONE],
            changed: vec![0; 2],
            changes: 0,
            worst: BinaryHeap::new(),
            stale: vec![0, 1],
        };
        tin.search_stale();
        tin
    }

    /// Adds samples until none is farther away than the tolerance, quanta.
    pub fn refine(&mut self, tolerance: f64) {
        while let Some(worst) = self.worst.peek().copied() {
            if worst.changed != self.changed[worst.triangle] {
                self.worst.pop();
            } else if worst.deviation <= tolerance {
                break;
            } else {
                self.worst.pop();
                self.insert(worst.place, worst.triangle);
                self.search_stale();
            }
        }
    }

    /// Its triangles.
    pub fn triangles(&self) -> Vec<Triangle> {
        let corners = self.corners.chunks_exact(3);
        corners
            .map(|corners| [corners[0], corners[1], corners[2]])
            .collect()
    }

    /// Whether no triangle's circle holds the corner across one of its edges.
    pub fn is_delaunay(&self) -> bool {
        (0..self.corners.len()).all(|edge| {
            let twin = self.twins[edge];
            twin == NONE || !self.must_flip(edge, twin)
        })
    }

    /// Adds a sample that is no corner, in a triangle or on one of its edges.
    fn insert(&mut self, place: (u32, u32), triangle: usize) {
        let [e0, e1, e2] = [0, 1, 2].map(|i| 3 * triangle + i);
        let on = [e0, e1, e2].into_iter().find(|&edge| {
            let to = self.corners[next(edge)];
            left_of(self.corners[edge], to, place) == 0
        });
        let Some(edge) = on else {
            let border = [e0, e1, e2].map(|edge| self.border(edge));
            let (t1, t2) = (self.add_triangle(), self.add_triangle());
            return self.fan(place, &border, &[triangle, t1, t2], true);
        };
        let twin = self.twins[edge];
        let near = [next(edge), next(next(edge))].map(|edge| self.border(edge));
        if twin == NONE {
            let t1 = self.add_triangle();
            return self.fan(place, &near, &[triangle, t1], false);
        }
        let far = [next(twin), next(next(twin))].map(|edge| self.border(edge));
        let (t2, t3) = (self.add_triangle(), self.add_triangle());
        let border = [near[0], near[1], far[0], far[1]];
        self.fan(place, &border, &[triangle, t2, twin / 3, t3], true);
    }

    fn border(&self, edge: usize) -> Border {
        (
            self.corners[edge],
            self.corners[next(edge)],
            self.twins[edge],
        )
    }

    fn add_triangle(&mut self) -> usize {
        self.corners.extend([(0, 0); 3]);
        self.twins.extend([NONE; 3]);
        self.changed.push(0);
        self.corners.len() / 3 - 1
    }

    /// Makes triangles of a place and the edges around it, which follow one another, all the way
    /// around or not; then flips edges until all is Delaunay again.
    fn fan(&mut self, place: (u32, u32), border: &[Border], triangles: &[usize], closed: bool) {
        for (i, (&(from, to, twin), &triangle)) in border.iter().zip(triangles).enumerate() {
            let base = 3 * triangle;
            self.corners[base..base + 3].copy_from_slice(&[from, to, place]);
            self.link(base, twin);
            let last = i + 1 == triangles.len();
            match (last, closed) {
                (true, false) => self.twins[base + 1] = NONE,
                _ => self.link(base + 1, 3 * triangles[(i + 1) % triangles.len()] + 2),
            }
            if i == 0 && !closed {
                self.twins[base + 2] = NONE;
            }
            self.touch(triangle);
        }
        self.flip_around(triangles.iter().map(|triangle| 3 * triangle).collect());
    }

    fn link(&mut self, edge: usize, twin: usize) {
        self.twins[edge] = twin;
        if twin != NONE {
            self.twins[twin] = edge;
        }
    }

    fn touch(&mut self, triangle: usize) {
        self.changes += 1;
        self.changed[triangle] = self.changes;
        self.stale.push(triangle);
    }

    /// Flips edges, each the first of its triangle and across from the new corner, where the
    /// triangle's circle holds the corner beyond.
    fn flip_around(&mut self, mut edges: Vec<usize>) {
        while let Some(edge) = edges.pop() {
            let twin = self.twins[edge];
            if twin == NONE || !self.must_flip(edge, twin) {
                continue;
            }
            let (from, to) = (self.corners[edge], self.corners[next(edge)]);
            let place = self.corners[next(next(edge))];
            let beyond = self.corners[next(next(twin))];
            let (to_place, from_place) = (self.twins[next(edge)], self.twins[next(next(edge))]);
            let (from_beyond, beyond_to) = (self.twins[next(twin)], self.twins[next(next(twin))]);
            let (a, b) = (edge / 3 * 3, twin / 3 * 3);
            self.corners[a..a + 3].copy_from_slice(&[from, beyond, place]);
            self.corners[b..b + 3].copy_from_slice(&[beyond, to, place]);
            self.link(a, from_beyond);
            self.link(a + 1, b + 2);
            self.link(a + 2, from_place);
            self.link(b, beyond_to);
            self.link(b + 1, to_place);
            self.touch(a / 3);
            self.touch(b / 3);
            edges.extend([a, b]);
        }
    }

    /// Whether the corner across an edge lies in the circle through the edge's triangle.
    fn must_flip(&self, edge: usize, twin: usize) -> bool {
        let corners = [edge, next(edge), next(next(edge))].map(|edge| self.corners[edge]);
        in_circle(corners, self.corners[next(next(twin))])
    }

    /// Finds the worst samples of the triangles that have changed.
    fn search_stale(&mut self) {
        let mut stale = std::mem::take(&mut self.stale);
        stale.sort_unstable();
        stale.dedup();
        for triangle in stale.drain(..) {
            let base = 3 * triangle;
            let corners = [0, 1, 2].map(|i| self.corners[base + i]);
            let (mut most, mut place, mut whole) = (0, (0, 0), 1);
            self.window.visit(&corners, |at, off, area| {
                whole = area;
                if off > most {
                    (most, place) = (off, at);
                }
            });
            if most > 0 {
                self.worst.push(Worst {
                    deviation: most as f64 / whole as f64,
                    place,
                    triangle,
                    changed: self.changed[triangle],
                });
            }
        }
        self.stale = stale;
    }
}

/// The half-edge that follows in its triangle.
const fn next(edge: usize) -> usize {
    if edge % 3 == 2 { edge - 2 } else { edge + 1 }
}

/// Twice the area of a triangle, positive if it is counter-clockwise.
fn left_of(a: (u32, u32), b: (u32, u32), c: (u32, u32)) -> i64 {
    let d = |p: u32, q: u32| i64::from(p) - i64::from(q);
    d(b.0, a.0) * d(c.1, a.1) - d(b.1, a.1) * d(c.0, a.0)
}

/// Whether a place lies inside the circle through the corners of a counter-clockwise triangle.
fn in_circle(corners: [(u32, u32); 3], place: (u32, u32)) -> bool {
    let [a, b, c] = corners.map(|(x, y)| {
        let (dx, dy) = (
            i64::from(x) - i64::from(place.0),
            i64::from(y) - i64::from(place.1),
        );
        (dx, dy, dx * dx + dy * dy)
    });
    let minor = |p: (i64, i64, i64), q: (i64, i64, i64)| p.0 * q.1 - p.1 * q.0;
    a.2 * minor(b, c) + b.2 * minor(c, a) + c.2 * minor(a, b) > 0
}

impl Ord for Worst {
    fn cmp(&self, other: &Worst) -> Ordering {
        let deviation = self.deviation.total_cmp(&other.deviation);
        // Equal ones in an order that does not change.
        deviation.then(other.place.cmp(&self.place))
    }
}

impl PartialOrd for Worst {
    fn partial_cmp(&self, other: &Worst) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Worst {
    fn eq(&self, other: &Worst) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Worst {}
