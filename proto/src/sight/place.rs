//! Where the vertices of a page lie in it, and which depend on which.
//!
//! A vertex is a sample of the page's 17 x 17, row-major from the south-west. It is the centre of
//! one square, or the middle of an edge between two. The page's corners belong to coarser pages.

use crate::geometry::{Edge, PAGE_CELLS, PAGE_LEVELS, PAGE_SAMPLES, Quadrant, Slot};

/// A square of a page: its level in the page, column and row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct PageSquare {
    /// Its level in the page, 0 is the page's root.
    pub level: u8,
    /// Column of squares of that level, from the west.
    pub column: u8,
    /// Row of squares of that level, from the south.
    pub row: u8,
}

/// What a vertex is in its page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// The centre of a square.
    Centre(PageSquare),
    /// The middle of an edge: the squares of the page beside it, and which of their edges it is.
    /// One alone on the page's border.
    Edge([Option<(PageSquare, Edge)>; 2]),
    /// A corner of the page.
    Corner,
}

impl PageSquare {
    /// All of the page.
    pub const ROOT: PageSquare = PageSquare {
        level: 0,
        column: 0,
        row: 0,
    };

    /// A cell of the page, below which another page can hang.
    pub fn cell(slot: Slot) -> PageSquare {
        let (column, row) = slot.position();
        PageSquare {
            level: PAGE_LEVELS,
            column: column as u8,
            row: row as u8,
        }
    }

    /// Samples on its side, one end not counted.
    pub const fn side(self) -> usize {
        PAGE_CELLS >> self.level
    }

    /// Sample at `(0, 1 or 2, 0, 1 or 2)` halves of the side from the south-west corner.
    pub const fn sample(self, x: usize, y: usize) -> usize {
        let half = self.side() / 2;
        let column = self.column as usize * self.side() + x * half;
        let row = self.row as usize * self.side() + y * half;
        row * PAGE_SAMPLES + column
    }

    /// Sample of its centre.
    pub const fn centre(self) -> usize {
        self.sample(1, 1)
    }

    /// Sample of the vertex in the middle of an edge.
    pub const fn edge(self, edge: Edge) -> usize {
        match edge {
            Edge::East => self.sample(2, 1),
            Edge::North => self.sample(1, 2),
            Edge::West => self.sample(0, 1),
            Edge::South => self.sample(1, 0),
        }
    }

    /// The ends of an edge, counter-clockwise around the centre.
    pub const fn ends(self, edge: Edge) -> [usize; 2] {
        let (sw, se) = (self.sample(0, 0), self.sample(2, 0));
        let (nw, ne) = (self.sample(0, 2), self.sample(2, 2));
        match edge {
            Edge::East => [se, ne],
            Edge::North => [ne, nw],
            Edge::West => [nw, sw],
            Edge::South => [sw, se],
        }
    }

    /// The quadrants at the [`ends`](Self::ends) of an edge.
    pub const fn end_quadrants(edge: Edge) -> [Quadrant; 2] {
        match edge {
            Edge::East => [Quadrant::SouthEast, Quadrant::NorthEast],
            Edge::North => [Quadrant::NorthEast, Quadrant::NorthWest],
            Edge::West => [Quadrant::NorthWest, Quadrant::SouthWest],
            Edge::South => [Quadrant::SouthWest, Quadrant::SouthEast],
        }
    }

    /// A child square; at level 4 it is a cell of the page.
    pub const fn child(self, quadrant: Quadrant) -> PageSquare {
        let (x, y) = quadrant.offset();
        PageSquare {
            level: self.level + 1,
            column: self.column * 2 + x as u8,
            row: self.row * 2 + y as u8,
        }
    }

    /// The square above in the page, and the quadrant of it that this one is.
    pub const fn parent(self) -> Option<(PageSquare, Quadrant)> {
        if self.level == 0 {
            return None;
        }
        let above = PageSquare {
            level: self.level - 1,
            column: self.column / 2,
            row: self.row / 2,
        };
        Some((above, Quadrant::of(self.column as u32, self.row as u32)))
    }
}

/// Part of a record that holds a vertex.
pub const fn part_of(sample: usize) -> u8 {
    PAGE_LEVELS - fineness(sample)
}

/// How often both coordinates can be halved.
const fn fineness(sample: usize) -> u8 {
    let both = (sample % PAGE_SAMPLES) | (sample / PAGE_SAMPLES) | PAGE_CELLS;
    both.trailing_zeros() as u8
}

/// The page's edge on which a vertex that is no corner lies.
pub const fn border(sample: usize) -> Option<Edge> {
    let (x, y) = (sample % PAGE_SAMPLES, sample / PAGE_SAMPLES);
    match (x, y) {
        (PAGE_CELLS, _) => Some(Edge::East),
        (_, PAGE_CELLS) => Some(Edge::North),
        (0, _) => Some(Edge::West),
        (_, 0) => Some(Edge::South),
        _ => None,
    }
}

/// The same vertex in the page across an edge.
pub const fn across(sample: usize, edge: Edge) -> usize {
    match edge {
        Edge::East => sample - PAGE_CELLS,
        Edge::West => sample + PAGE_CELLS,
        Edge::North => sample - PAGE_CELLS * PAGE_SAMPLES,
        Edge::South => sample + PAGE_CELLS * PAGE_SAMPLES,
    }
}

/// What a vertex is.
pub fn role(sample: usize) -> Role {
    let (x, y) = (sample % PAGE_SAMPLES, sample / PAGE_SAMPLES);
    let fineness = fineness(sample);
    if fineness >= PAGE_LEVELS {
        return Role::Corner;
    }
    let half = 1usize << fineness;
    let level = PAGE_LEVELS - 1 - fineness;
    let square = |x: usize, y: usize| PageSquare {
        level,
        column: (x / (2 * half)) as u8,
        row: (y / (2 * half)) as u8,
    };
    let odd = |w: usize| w & half != 0;
    match (odd(x), odd(y)) {
        (true, true) => Role::Centre(square(x, y)),
        (false, _) => Role::Edge([
            (x > 0).then(|| (square(x.wrapping_sub(half), y), Edge::East)),
            (x < PAGE_CELLS).then(|| (square(x, y), Edge::West)),
        ]),
        (true, false) => Role::Edge([
            (y > 0).then(|| (square(x, y.wrapping_sub(half)), Edge::North)),
            (y < PAGE_CELLS).then(|| (square(x, y), Edge::South)),
        ]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_vertex_is_what_its_squares_say() {
        let mut corners = 0;
        for sample in 0..PAGE_SAMPLES * PAGE_SAMPLES {
            match role(sample) {
                Role::Corner => corners += 1,
                Role::Centre(square) => {
                    assert_eq!(square.centre(), sample);
                    assert_eq!(part_of(sample), square.level + 1);
                    assert_eq!(border(sample), None);
                }
                Role::Edge(sides) => {
                    assert_eq!(
                        sides.iter().flatten().count() == 1,
                        border(sample).is_some()
                    );
                    for (square, edge) in sides.into_iter().flatten() {
                        assert_eq!(square.edge(edge), sample);
                        assert_eq!(part_of(sample), square.level + 1);
                    }
                    if let Some(edge) = border(sample) {
                        assert_eq!(across(across(sample, edge), edge.opposite()), sample);
                        assert_eq!(border(across(sample, edge)), Some(edge.opposite()));
                    }
                }
            }
        }
        assert_eq!(corners, 4);
    }
}
