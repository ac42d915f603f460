//! Integer geometry of the grid: squares, pages, quadrants, edges, Morton keys.
//!
//! The grid is grid-registered: `2^L + 1` samples a side, `x` to the east and `y` to the north.
//! A square at level `l` has `2^(L-l)` cells a side; a page is the subtree of
//! [`PAGE_LEVELS`] levels below its root square.
//!
//! ```text
//!   nw ---- n ---- ne        A square: four corners, a centre, four edge vertices.
//!   |  \    |    /  |        Each quadrant is a child square; its diagonal runs from
//!   w ----- c ----- e        the parent's centre to the parent's corner.
//!   |  /    |    \  |
//!   sw ---- s ---- se
//! ```
//!
//! Vertices of neighbouring squares are the same integers, never merely close.

use serde::{Deserialize, Serialize};

/// Levels of squares in a page.
pub const PAGE_LEVELS: u8 = 4;
/// Cells on a page's side at full depth.
pub const PAGE_CELLS: usize = 1 << PAGE_LEVELS;
/// Samples on a page's side at full depth.
pub const PAGE_SAMPLES: usize = PAGE_CELLS + 1;
/// Child slots of a page: one a cell.
pub const PAGE_SLOTS: usize = PAGE_CELLS * PAGE_CELLS;
/// The deepest grid: `2^28` cells a side. It keeps a page's key within 64 bits.
pub const MAX_GRID_LEVELS: u8 = 28;

const _: () = assert!(MAX_GRID_LEVELS.is_multiple_of(PAGE_LEVELS));

/// One of a square's four edges, which names the edge vertex in its middle as well.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Edge {
    /// Towards larger `x`.
    East,
    /// Towards larger `y`.
    North,
    /// Towards smaller `x`.
    West,
    /// Towards smaller `y`.
    South,
}

impl Edge {
    /// All four, in the order of their discriminants.
    pub const ALL: [Edge; 4] = [Edge::East, Edge::North, Edge::West, Edge::South];

    /// Unit step `(dx, dy)` from the centre towards the edge.
    pub const fn step(self) -> (i32, i32) {
        match self {
            Edge::East => (1, 0),
            Edge::North => (0, 1),
            Edge::West => (-1, 0),
            Edge::South => (0, -1),
        }
    }

    /// The same edge as the square across it sees it.
    pub const fn opposite(self) -> Edge {
        match self {
            Edge::East => Edge::West,
            Edge::North => Edge::South,
            Edge::West => Edge::East,
            Edge::South => Edge::North,
        }
    }

    /// The two quadrants that touch this edge.
    pub const fn quadrants(self) -> [Quadrant; 2] {
        match self {
            Edge::East => [Quadrant::NorthEast, Quadrant::SouthEast],
            Edge::North => [Quadrant::NorthEast, Quadrant::NorthWest],
            Edge::West => [Quadrant::NorthWest, Quadrant::SouthWest],
            Edge::South => [Quadrant::SouthWest, Quadrant::SouthEast],
        }
    }
}

/// One of a square's four quadrants, which are its child squares.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Quadrant {
    /// Smaller `x`, smaller `y`.
    SouthWest,
    /// Larger `x`, smaller `y`.
    SouthEast,
    /// Smaller `x`, larger `y`.
    NorthWest,
    /// Larger `x`, larger `y`.
    NorthEast,
}

impl Quadrant {
    /// All four, in Morton order.
    pub const ALL: [Quadrant; 4] = [
        Quadrant::SouthWest,
        Quadrant::SouthEast,
        Quadrant::NorthWest,
        Quadrant::NorthEast,
    ];

    /// `(0 or 1, 0 or 1)`: whether the quadrant is the eastern, the northern one.
    pub const fn offset(self) -> (u32, u32) {
        match self {
            Quadrant::SouthWest => (0, 0),
            Quadrant::SouthEast => (1, 0),
            Quadrant::NorthWest => (0, 1),
            Quadrant::NorthEast => (1, 1),
        }
    }

    /// The quadrant of its parent that a square with these coordinates is.
    pub const fn of(x: u32, y: u32) -> Quadrant {
        match (x & 1, y & 1) {
            (0, 0) => Quadrant::SouthWest,
            (_, 0) => Quadrant::SouthEast,
            (0, _) => Quadrant::NorthWest,
            _ => Quadrant::NorthEast,
        }
    }

    /// The parent's edge vertices that are corners of this quadrant: `[east or west, north or south]`.
    pub const fn edges(self) -> [Edge; 2] {
        match self {
            Quadrant::SouthWest => [Edge::West, Edge::South],
            Quadrant::SouthEast => [Edge::East, Edge::South],
            Quadrant::NorthWest => [Edge::West, Edge::North],
            Quadrant::NorthEast => [Edge::East, Edge::North],
        }
    }

    /// Whether the diagonal that splits this quadrant runs from south-west to north-east.
    pub const fn rises(self) -> bool {
        matches!(self, Quadrant::SouthWest | Quadrant::NorthEast)
    }
}

/// A square of the quadtree: level 0 is the root; `x`, `y` count squares of that level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Square {
    /// Level, 0 is the root.
    pub level: u8,
    /// Column of squares, from the west.
    pub x: u32,
    /// Row of squares, from the south.
    pub y: u32,
}

/// The identity of a page: its root square, whose level is a multiple of [`PAGE_LEVELS`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct PageId(Square);

impl PageId {
    /// The page that holds the root of the tree.
    pub const ROOT: PageId = PageId(Square {
        level: 0,
        x: 0,
        y: 0,
    });

    /// A page by its root square; `None` unless the level starts a page, lies within
    /// [`MAX_GRID_LEVELS`], and holds the coordinates.
    ///
    /// ```
    /// # use escarp_proto::geometry::PageId;
    /// assert!(PageId::new(4, 15, 0).is_some());
    /// assert!(PageId::new(4, 16, 0).is_none()); // only 16 squares a side at level 4
    /// assert!(PageId::new(3, 0, 0).is_none()); // no page starts at level 3
    /// ```
    pub const fn new(level: u8, x: u32, y: u32) -> Option<PageId> {
        let side = 1u64 << if level < 32 { level } else { 32 };
        let fits = level.is_multiple_of(PAGE_LEVELS)
            && level < MAX_GRID_LEVELS
            && (x as u64) < side
            && (y as u64) < side;
        if fits {
            Some(PageId(Square { level, x, y }))
        } else {
            None
        }
    }

    /// The page's root square.
    pub const fn square(self) -> Square {
        self.0
    }

    /// Level of the root square.
    pub const fn level(self) -> u8 {
        self.0.level
    }

    /// The page that hangs below a child slot, or `None` at the depth limit.
    pub fn child(self, slot: Slot) -> Option<PageId> {
        let Square { level, x, y } = self.0;
        let (column, row) = slot.position();
        let side = PAGE_CELLS as u32;
        PageId::new(
            level + PAGE_LEVELS,
            x.checked_mul(side)? + column as u32,
            y.checked_mul(side)? + row as u32,
        )
    }

    /// The page above and the slot in which this page hangs; `None` for the root.
    pub fn parent(self) -> Option<(PageId, Slot)> {
        let Square { level, x, y } = self.0;
        let above = level.checked_sub(PAGE_LEVELS)?;
        let side = PAGE_CELLS as u32;
        let page = PageId::new(above, x / side, y / side)?;
        Some((page, Slot::at((x % side) as usize, (y % side) as usize)))
    }

    /// The page of the same level across an edge, or `None` at the border of the grid.
    pub fn neighbour(self, edge: Edge) -> Option<PageId> {
        let (dx, dy) = edge.step();
        let Square { level, x, y } = self.0;
        PageId::new(level, x.checked_add_signed(dx)?, y.checked_add_signed(dy)?)
    }

    /// Sorts pages by level, then in Morton order: `level << 56 | morton(x, y)`.
    pub fn key(self) -> u64 {
        u64::from(self.0.level) << 56 | morton(self.0.x) | morton(self.0.y) << 1
    }

    /// The page of a [`key`](Self::key); `None` if no page has it.
    pub fn from_key(key: u64) -> Option<PageId> {
        let places = key & ((1 << 56) - 1);
        PageId::new((key >> 56) as u8, unmorton(places), unmorton(places >> 1))
    }
}

impl std::fmt::Display for PageId {
    /// `level/x/y`, as in page addresses.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}/{}", self.0.level, self.0.x, self.0.y)
    }
}

/// A cell of a page at full depth, below which a child page can hang. Row-major from the south-west.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Slot(u8);

impl Slot {
    /// The slot at a column and row below [`PAGE_CELLS`].
    ///
    /// # Panics
    /// If either is out of range.
    pub fn at(column: usize, row: usize) -> Slot {
        assert!(column < PAGE_CELLS && row < PAGE_CELLS);
        Slot((row * PAGE_CELLS + column) as u8)
    }

    /// The slot with this index in row-major order.
    pub const fn from_index(index: u8) -> Slot {
        Slot(index)
    }

    /// Index in row-major order, below [`PAGE_SLOTS`].
    pub const fn index(self) -> usize {
        self.0 as usize
    }

    /// `(column, row)`.
    pub const fn position(self) -> (usize, usize) {
        (self.index() % PAGE_CELLS, self.index() / PAGE_CELLS)
    }
}

/// Depth of the grid: `2^levels` cells a side, `levels` a positive multiple of [`PAGE_LEVELS`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub struct GridLevels(u8);

impl GridLevels {
    /// A checked depth.
    ///
    /// ```
    /// # use escarp_proto::geometry::GridLevels;
    /// assert_eq!(GridLevels::new(12).unwrap().cells_per_side(), 4096);
    /// assert!(GridLevels::new(10).is_none());
    /// assert!(GridLevels::new(0).is_none());
    /// ```
    pub const fn new(levels: u8) -> Option<GridLevels> {
        if levels >= PAGE_LEVELS && levels <= MAX_GRID_LEVELS && levels.is_multiple_of(PAGE_LEVELS)
        {
            Some(GridLevels(levels))
        } else {
            None
        }
    }

    /// The smallest grid that holds this many samples in each direction.
    pub fn covering(width: u32, height: u32) -> Option<GridLevels> {
        (1..=MAX_GRID_LEVELS / PAGE_LEVELS)
            .filter_map(|pages| GridLevels::new(pages * PAGE_LEVELS))
            .find(|grid| width.max(height) <= grid.cells_per_side() + 1)
    }

    /// Levels of squares, `L`.
    pub const fn get(self) -> u8 {
        self.0
    }

    /// `2^L`.
    pub const fn cells_per_side(self) -> u32 {
        1 << self.0
    }

    /// Cells on the side of a square of this level.
    pub const fn square_cells(self, level: u8) -> u32 {
        1 << (self.0 - level)
    }

    /// Level of the finest pages.
    pub const fn finest_page_level(self) -> u8 {
        self.0 - PAGE_LEVELS
    }

    /// Whether pages of this level hold the finest samples, so that nothing hangs below them.
    pub const fn is_finest(self, page: PageId) -> bool {
        page.level() == self.finest_page_level()
    }

    /// Whether the grid has this page.
    pub const fn holds(self, page: PageId) -> bool {
        page.level() <= self.finest_page_level()
    }

    /// Grid cells between neighbouring samples of a full page of this level.
    pub const fn page_stride(self, page: PageId) -> u32 {
        1 << (self.finest_page_level() - page.level())
    }

    /// Grid coordinates of a page's south-west corner.
    pub const fn page_origin(self, page: PageId) -> (u32, u32) {
        let cells = self.square_cells(page.level());
        (page.0.x * cells, page.0.y * cells)
    }
}

impl TryFrom<u8> for GridLevels {
    type Error = String;

    fn try_from(levels: u8) -> Result<Self, String> {
        GridLevels::new(levels).ok_or_else(|| {
            format!(
                "{levels} grid levels; allowed are multiples of {PAGE_LEVELS} up to {MAX_GRID_LEVELS}"
            )
        })
    }
}

impl From<GridLevels> for u8 {
    fn from(grid: GridLevels) -> u8 {
        grid.0
    }
}

/// Spreads the lower 28 bits of `v` to the even places.
fn morton(v: u32) -> u64 {
    let mut v = u64::from(v);
    v = (v | v << 16) & 0x0000_ffff_0000_ffff;
    v = (v | v << 8) & 0x00ff_00ff_00ff_00ff;
    v = (v | v << 4) & 0x0f0f_0f0f_0f0f_0f0f;
    v = (v | v << 2) & 0x3333_3333_3333_3333;
    (v | v << 1) & 0x5555_5555_5555_5555
}

fn unmorton(v: u64) -> u32 {
    let mut v = v & 0x5555_5555_5555_5555;
    v = (v | v >> 1) & 0x3333_3333_3333_3333;
    v = (v | v >> 2) & 0x0f0f_0f0f_0f0f_0f0f;
    v = (v | v >> 4) & 0x00ff_00ff_00ff_00ff;
    v = (v | v >> 8) & 0x0000_ffff_0000_ffff;
    (v | v >> 16) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_key_names_one_page(pages in 0u8..7, x: u32, y: u32) {
            let level = pages * PAGE_LEVELS;
            let mask = (1u32 << level) - 1;
            let page = PageId::new(level, x & mask, y & mask).unwrap();
            prop_assert_eq!(PageId::from_key(page.key()), Some(page));
        }

        #[test]
        fn a_child_finds_its_parent_and_slot(x in 0u32..16, y in 0u32..16, slot: u8) {
            let page = PageId::new(4, x, y).unwrap();
            let slot = Slot::from_index(slot);
            prop_assert_eq!(page.child(slot).unwrap().parent(), Some((page, slot)));
        }

        #[test]
        fn any_key_is_a_page_or_refused(key: u64) {
            if let Some(page) = PageId::from_key(key) {
                prop_assert_eq!(page.key(), key);
            }
        }
    }

    #[test]
    fn the_smallest_covering_grid_is_chosen() {
        let levels = |w, h| GridLevels::covering(w, h).map(GridLevels::get);
        assert_eq!(levels(1, 1), Some(4));
        assert_eq!(levels(17, 17), Some(4));
        assert_eq!(levels(18, 2), Some(8));
        assert_eq!(levels(65537, 1), Some(16));
        assert_eq!(levels(u32::MAX, 1), None);
    }

    #[test]
    fn an_edge_touches_the_quadrants_that_name_it() {
        for edge in Edge::ALL {
            assert_eq!(edge.opposite().opposite(), edge);
            for quadrant in edge.quadrants() {
                assert!(quadrant.edges().contains(&edge));
            }
        }
    }
}
