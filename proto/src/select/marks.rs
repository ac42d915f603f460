//! Enabled vertices of a page, level by level, a bit a square: those of a level row by row from
//! the south-west.

use crate::geometry::{Edge, PAGE_CELLS, PAGE_LEVELS};

const LEVELS: usize = PAGE_LEVELS as usize;

/// Vertices that are enabled.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Marks {
    /// Edge vertices, by level of their squares, by [`Edge`]. Of squares on both sides of an edge,
    /// one may have it or both.
    pub(super) edges: [[u64; 4]; LEVELS],
    /// Centres, by level of their squares.
    pub(super) centres: [u64; LEVELS],
    /// Centres of the pages below, by row of cells.
    pub(super) cells: [u16; PAGE_CELLS],
}

/// Squares of a level on a page's side.
const fn side(level: usize) -> usize {
    1 << level
}

/// The squares of the western column.
const fn west(level: usize) -> u64 {
    match level {
        0 => 0x1,
        1 => 0x5,
        2 => 0x1111,
        _ => 0x0101_0101_0101_0101,
    }
}

const fn east(level: usize) -> u64 {
    west(level) << (side(level) - 1)
}

const fn south(level: usize) -> u64 {
    (1 << side(level)) - 1
}

const fn north(level: usize) -> u64 {
    south(level) << (side(level) * (side(level) - 1))
}

impl Marks {
    /// Enables the edge vertices that the squares, or pages, of the next level need.
    pub(super) fn take_corners(&mut self, level: usize) {
        let found = match level {
            3 => corners_of_cells(&self.cells),
            _ => corners(level, self.centres[level + 1]),
        };
        for (edge, found) in self.edges[level].iter_mut().zip(found) {
            *edge |= found;
        }
    }

    /// Enables the centres on both sides of the edge vertices of a level.
    pub(super) fn take_edges(&mut self, level: usize) {
        let [east_of, north_of, west_of, south_of] = self.edges[level];
        let own = east_of | north_of | west_of | south_of;
        let n = side(level);
        let across = (east_of & !east(level)) << 1
            | (west_of & !west(level)) >> 1
            | (north_of & !north(level)) << n
            | (south_of & !south(level)) >> n;
        self.centres[level] |= own | across;
    }

    /// The edge vertices of a level on a border, as the page across it has them.
    pub(super) fn across(&self, level: usize, edge: Edge) -> u64 {
        let marks = self.edges[level][edge as usize];
        let n = side(level);
        match edge {
            Edge::East => (marks & east(level)) >> (n - 1),
            Edge::West => (marks & west(level)) << (n - 1),
            Edge::North => (marks & north(level)) >> (n * (n - 1)),
            Edge::South => (marks & south(level)) << (n * (n - 1)),
        }
    }

    /// Parts that hold what is enabled.
    pub(super) fn parts(&self) -> u8 {
        if self.cells != [0; PAGE_CELLS] {
            return PAGE_LEVELS + 1;
        }
        let finest = (0..LEVELS).rev().find(|&level| self.centres[level] != 0);
        finest.map_or(0, |level| level as u8 + 1)
    }
}

/// The edge vertices of a level, by [`Edge`], that are corners of squares of the next one.
fn corners(level: usize, below: u64) -> [u64; 4] {
    let n = 2 * side(level);
    let columns = below | below >> n;
    let rows = below | below >> 1;
    [columns >> 1, rows >> n, columns, rows].map(|marks| every_second(level + 1, marks))
}

/// Of a level, every second column and row, moved together.
const fn every_second(level: usize, marks: u64) -> u64 {
    let mut marks = marks;
    match level {
        1 => marks & 1,
        2 => {
            marks &= 0x0505;
            marks = (marks | marks >> 1) & 0x0303;
            (marks | marks >> 6) & 0xf
        }
        _ => {
            marks &= 0x0055_0055_0055_0055;
            marks = (marks | marks >> 1) & 0x0033_0033_0033_0033;
            marks = (marks | marks >> 2) & 0x000f_000f_000f_000f;
            marks = (marks | marks >> 12) & 0x0000_00ff_0000_00ff;
            (marks | marks >> 24) & 0xffff
        }
    }
}

fn corners_of_cells(cells: &[u16; PAGE_CELLS]) -> [u64; 4] {
    let mut found = [0; 4];
    for (row, pair) in cells.chunks_exact(2).enumerate() {
        let (south, north) = (pair[0], pair[1]);
        let columns = south | north;
        let lower = |marks: u16| (marks | marks >> 1) & 0x5555;
        let rows = [columns >> 1, lower(north), columns, lower(south)];
        for (edge, marks) in found.iter_mut().zip(rows) {
            *edge |= together(marks) << (8 * row);
        }
    }
    found
}

/// Every second bit, moved together.
const fn together(marks: u16) -> u64 {
    let mut marks = marks as u64 & 0x5555;
    marks = (marks | marks >> 1) & 0x3333;
    marks = (marks | marks >> 2) & 0x0f0f;
    (marks | marks >> 4) & 0xff
}
