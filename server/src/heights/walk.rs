//! A straight line over the surface: where it comes nearest, and whether it is blocked.
//!
//! The surface's triangles are cut by four families of lines: `x` and `y` a whole number, `x - y`
//! and `x + y` even. Between two of them the surface below the line is straight, so that the ends
//! of such stretches suffice. Squares that the line passes high above are left out by the highest
//! height in them, as in a maximum mipmap (Tevs, Ihrke, Seidel, "Maximum Mipmaps for Fast,
//! Accurate, and Scalable Dynamic Height Field Rendering", 2008); what is left is visited from the
//! line's beginning to its end.
//!
//! Lengths are in cells, heights in quanta, places on the line from 0 to 1.

use super::HeightError;
use super::surface::Cell;

/// What is known of a square.
#[derive(Debug, Clone, Copy)]
pub(super) struct Top {
    /// No height in it is above; negative infinity where there is none.
    pub highest: f64,
    /// Whether it is surface everywhere.
    pub whole: bool,
}

/// A surface that is a quadtree of squares over cells.
pub(super) trait Relief {
    /// Levels of squares above the cells.
    fn levels(&self) -> u8;

    /// The square at a column and row of squares, so many levels above the cells.
    fn top(&mut self, above: u8, square: [u32; 2]) -> Result<Top, HeightError>;

    /// A cell.
    fn cell(&mut self, cell: [u32; 2]) -> Result<Cell, HeightError>;

    /// One square more is visited.
    fn step(&mut self) -> Result<(), HeightError>;
}

/// A straight line.
#[derive(Debug, Clone, Copy)]
pub(super) struct Line {
    /// Place of its beginning and its end.
    pub ends: [[f64; 2]; 2],
    /// Heights of its two ends.
    pub heights: [f64; 2],
    /// How far the height of its end may be off.
    pub end_bound: f64,
    /// How far the ground between rises above the plane, at most, for the body's curvature: in the
    /// middle a quarter of this.
    pub bulge: f64,
}

impl Line {
    pub fn place(&self, t: f64) -> [f64; 2] {
        let [a, b] = self.ends;
        // Exact at both ends.
        [0, 1].map(|axis: usize| a[axis] * (1.0 - t) + b[axis] * t)
    }

    /// Height above the plane on which the surface is laid out.
    pub fn height(&self, t: f64) -> f64 {
        let [a, b] = self.heights;
        a * (1.0 - t) + b * t - self.bulge * t * (1.0 - t)
    }

    /// Its lowest height between two places.
    fn lowest(&self, [from, to]: [f64; 2]) -> f64 {
        let ends = self.height(from).min(self.height(to));
        if self.bulge <= 0.0 {
            return ends;
        }
        let [a, b] = self.heights;
        let bottom = (self.bulge - (b - a)) / (2.0 * self.bulge);
        match from < bottom && bottom < to {
            true => ends.min(self.height(bottom)),
            false => ends,
        }
    }
}

/// What is looked for along a line.
#[derive(Debug, Clone, Copy)]
pub(super) enum Goal {
    /// The least clearance, and the first place that blocks.
    Least,
    /// Whether the line is clear by more than this, or blocked by more.
    Decide(f64),
}

/// A line's clearance: its height less the surface's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Clearance {
    /// The least where the line crosses the triangles' sides, its two ends not counted; infinite
    /// if it crosses none.
    pub least: f64,
    /// Where that is.
    pub at: f64,
    /// The clearance is nowhere less than this, as far as the cells' bounds say.
    pub lower: f64,
    /// Somewhere it is no more than this.
    pub upper: f64,
    /// Where the line first meets the surface.
    pub blocked: Option<f64>,
    /// Whether there is no surface under a part of it.
    pub over_hole: bool,
}

/// Follows a line over a surface. Its ends lie within the surface's squares.
pub(super) fn follow(
    relief: &mut impl Relief,
    line: &Line,
    goal: Goal,
) -> Result<Clearance, HeightError> {
    let [a, b] = line.ends;
    let step = [b[0] - a[0], b[1] - a[1]];
    let levels = relief.levels();
    let mut walk = Walk {
        relief,
        line,
        goal,
        inverse: step.map(|step| 1.0 / step),
        turned: step.map(|step| u32::from(step < 0.0)),
        found: Clearance {
            least: f64::INFINITY,
            at: 0.0,
            lower: f64::INFINITY,
            upper: f64::INFINITY,
            blocked: None,
            over_hole: false,
        },
    };
    walk.square(levels, [0, 0], [0.0, 1.0])?;
    Ok(walk.found)
}

struct Walk<'a, R> {
    relief: &'a mut R,
    line: &'a Line,
    goal: Goal,
    inverse: [f64; 2],
    /// 1 on the axes along which the line runs backwards.
    turned: [u32; 2],
    found: Clearance,
}

impl<R: Relief> Walk<'_, R> {
    /// Visits a square that the line is in between two places. True when all is decided.
    fn square(&mut self, above: u8, square: [u32; 2], span: [f64; 2]) -> Result<bool, HeightError> {
        self.relief.step()?;
        let top = self.relief.top(above, square)?;
        if top.highest == f64::NEG_INFINITY {
            self.found.over_hole = true;
            return Ok(false);
        }
        let room = self.line.lowest(span) - self.line.end_bound * span[1] - top.highest;
        if self.is_clear(room) && (top.whole || self.found.over_hole) {
            return Ok(false);
        }
        if above == 0 {
            return self.cell(square, span);
        }
        let side = f64::from(1u32 << (above - 1));
        // The two in the middle are never both passed: the order is that of the line.
        for place in [[0, 0], [1, 0], [0, 1], [1, 1]] {
            let child = [0, 1].map(|axis: usize| {
                let place: u32 = place[axis];
                2 * square[axis] + (place ^ self.turned[axis])
            });
            if let Some(inside) = self.clipped(child, side, span)
                && self.square(above - 1, child, inside)?
            {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Whether what has this much room below the line can be left out.
    fn is_clear(&self, room: f64) -> bool {
        match self.goal {
            Goal::Least => {
                room >= self.found.least && (room >= 0.0 || self.found.blocked.is_some())
            }
            Goal::Decide(need) => room > need,
        }
    }

    /// The part of a stretch that lies in a square; `None` if that has no length. Neighbours share
    /// the places at which they are cut, so that nothing is left out between them.
    fn clipped(
        &self,
        square: [u32; 2],
        side: f64,
        [mut from, mut to]: [f64; 2],
    ) -> Option<[f64; 2]> {
        for (axis, column_or_row) in square.into_iter().enumerate() {
            let start = self.line.ends[0][axis];
            let low = f64::from(column_or_row) * side;
            let high = low + side;
            if self.inverse[axis].is_infinite() {
                if !(low..high).contains(&start) {
                    return None;
                }
                continue;
            }
            let crossed = [low, high].map(|border| (border - start) * self.inverse[axis]);
            from = from.max(crossed[0].min(crossed[1]));
            to = to.min(crossed[0].max(crossed[1]));
        }
        (from < to).then_some([from, to])
    }

    fn cell(&mut self, square: [u32; 2], [from, to]: [f64; 2]) -> Result<bool, HeightError> {
        let cell = self.relief.cell(square)?;
        match self.diagonal(&cell, square).filter(|&t| from < t && t < to) {
            Some(middle) => {
                self.stretch(&cell, square, [from, middle]);
                self.stretch(&cell, square, [middle, to]);
            }
            None => self.stretch(&cell, square, [from, to]),
        }
        Ok(match self.goal {
            Goal::Least => false,
            Goal::Decide(need) => self.found.upper < -need,
        })
    }

    /// Where the line crosses a cell's diagonal.
    fn diagonal(&self, cell: &Cell, square: [u32; 2]) -> Option<f64> {
        let [x, y] = square.map(f64::from);
        let [a, b] = self.line.ends;
        // Zero on the diagonal.
        let side = |place: [f64; 2]| match cell.rises {
            true => (place[0] - x) - (place[1] - y),
            false => (place[0] - x) + (place[1] - y) - 1.0,
        };
        let (at_start, at_end) = (side(a), side(b));
        (at_start != at_end).then(|| at_start / (at_start - at_end))
    }

    /// A stretch over one triangle.
    fn stretch(&mut self, cell: &Cell, square: [u32; 2], [from, to]: [f64; 2]) {
        let inside = |t: f64| {
            let place = self.line.place(t);
            [0, 1].map(|axis: usize| (place[axis] - f64::from(square[axis])).clamp(0.0, 1.0))
        };
        // The middle says which triangle it is; its plane holds for both ends.
        let Some(plane) = cell.plane(inside(f64::midpoint(from, to))) else {
            self.found.over_hole = true;
            return;
        };
        let clearance = |t: f64| self.line.height(t) - plane(inside(t));
        let ends = [clearance(from), clearance(to)];
        // A stretch hangs below its ends by what the curvature makes of it.
        let sag = self.line.bulge * (to - from) * (to - from) / 4.0;
        for (t, clearance) in [from, to].into_iter().zip(ends) {
            let bound = cell.bound + self.line.end_bound * t;
            let is_end = t <= 0.0 || t >= 1.0;
            // What is given exactly at an end says nothing of what is between.
            if is_end && bound == 0.0 {
                continue;
            }
            self.found.lower = self.found.lower.min(clearance - bound - sag);
            if is_end {
                continue;
            }
            self.found.upper = self.found.upper.min(clearance + bound);
            if clearance < self.found.least {
                (self.found.least, self.found.at) = (clearance, t);
            }
        }
        self.meet([from, to], ends);
    }

    /// Notes where the line first meets the surface, if it is on this stretch.
    fn meet(&mut self, [from, to]: [f64; 2], [a, b]: [f64; 2]) {
        let meets = [(from, a), (to, b)]
            .into_iter()
            .any(|(t, clearance)| clearance < 0.0 && t > 0.0 && t < 1.0);
        if meets && self.found.blocked.is_none() {
            let part = if a > 0.0 { a / (a - b) } else { 0.0 };
            self.found.blocked = Some(from + (to - from) * part);
        }
    }
}
