//! What a page's squares are tested by, in few bytes.
//!
//! Squares lie in the order of a quaternary heap: those of one level together and in Morton
//! order, so that square `i` splits into squares `4 i + 1 ..= 4 i + 4`, by [`Quadrant`]. A page
//! has 85; those of level 3 have 256 cells for quadrants, below which child pages can hang.
//!
//! Errors and ranges are rounded outwards, by functions that grow. So what is nested before
//! (`crate::page`) is nested after.

use super::place::PageSquare;
use crate::geometry::{Edge, GridLevels, PAGE_LEVELS, PAGE_SLOTS, PageId, Quadrant, Slot};
use crate::georef::Georef;
use crate::page::{Bounds, BoxError, PAGE_AREA, Range};
use crate::view::error_m;

/// Squares of a page, its cells apart.
pub const PAGE_SQUARES: usize = 85;
/// The first square of level 3, whose quadrants are cells.
pub const FIRST_FINEST: usize = 21;

/// A place among a page's squares.
pub type At = usize;
/// The whole page.
pub const ROOT: At = 0;

/// An error in metres, rounded up to 8 bits of fraction: a 32-bit float without its sign and its
/// last 15 bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct ErrorCode(u16);

impl ErrorCode {
    const CUT_BITS: u32 = 15;

    /// The smallest code of at least this error, which is finite and not negative.
    pub fn covering(error_m: f64) -> ErrorCode {
        let near = error_m as f32;
        let above = match f64::from(near) < error_m {
            true => near.next_up(),
            false => near,
        };
        let rounded = above.to_bits() + ((1 << Self::CUT_BITS) - 1);
        ErrorCode((rounded >> Self::CUT_BITS) as u16)
    }

    /// The code, as a number that grows with the error.
    #[inline]
    pub(crate) const fn code(self) -> u16 {
        self.0
    }

    /// The error of a code.
    #[inline]
    pub(crate) const fn from_code(code: u16) -> ErrorCode {
        ErrorCode(code)
    }

    /// The error, metres.
    #[inline]
    pub fn metres(self) -> f64 {
        f64::from(f32::from_bits(u32::from(self.0) << Self::CUT_BITS))
    }
}

/// Lowest and highest height of a square, in the steps of its page.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct RangeCode {
    lo: u8,
    hi: u8,
}

/// The steps of a page's ranges: powers of two, and counted from zero height, so that the steps
/// of a page are steps of the pages below as well.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Steps {
    shift: u8,
    /// The lowest height of the page.
    base: i32,
}

impl Steps {
    /// The smallest steps that reach over a range.
    fn over(range: Range) -> Steps {
        let mut steps = Steps { shift: 0, base: 0 };
        if range.is_empty() {
            return steps;
        }
        while steps.above(range.hi) - (i64::from(range.lo) >> steps.shift) > i64::from(u8::MAX) {
            steps.shift += 1;
        }
        steps.base = range.lo >> steps.shift;
        steps
    }

    fn above(self, height: i32) -> i64 {
        let below = (1i64 << self.shift) - 1;
        (i64::from(height) + below) >> self.shift
    }

    fn code(self, range: Range) -> RangeCode {
        let from_base = |step: i64| (step - i64::from(self.base)).clamp(0, 255) as u8;
        RangeCode {
            lo: from_base(i64::from(range.lo) >> self.shift),
            hi: from_base(self.above(range.hi)),
        }
    }

    /// The height of a code, quanta.
    #[inline]
    pub(crate) fn height(self, code: u8) -> i64 {
        (i64::from(self.base) + i64::from(code)) << self.shift
    }
}

/// What is known of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Cell {
    error: ErrorCode,
    range: RangeCode,
}

/// What the squares of a page are tested by.
#[derive(Debug)]
pub struct Squares {
    steps: Steps,
    edges: [[ErrorCode; 4]; PAGE_SQUARES],
    /// Of the two halves of a square.
    halves: [ErrorCode; PAGE_SQUARES],
    ranges: [RangeCode; PAGE_SQUARES],
    /// By slot, of a page whose cells are squares.
    cells: Option<Box<[Cell; PAGE_SLOTS]>>,
}

impl Squares {
    /// From all that is known of a page, whatever of it has arrived.
    pub fn of(bounds: &Bounds, page: PageId, grid: GridLevels, georef: &Georef) -> Squares {
        let mut squares = Squares {
            steps: Steps::over(bounds.box_error(0, 0, 0).range),
            edges: [[ErrorCode::default(); 4]; PAGE_SQUARES],
            halves: [ErrorCode::default(); PAGE_SQUARES],
            ranges: [RangeCode::default(); PAGE_SQUARES],
            cells: None,
        };
        let code = |error, kind, level: u8| {
            let level = page.level() + level;
            // The finest squares are the surface itself.
            if level >= grid.get() {
                return ErrorCode::default();
            }
            let half_diagonal_m = georef.half_diagonal_m(grid.square_cells(level));
            ErrorCode::covering(error_m(error, kind, georef.quantum_m, half_diagonal_m))
        };
        let cell = |steps: Steps, known: BoxError, level| Cell {
            error: code(known.error, known.kind, level),
            range: steps.code(known.range),
        };
        for (at, place) in PLACES.iter().enumerate() {
            let PageSquare { level, column, row } = place.square;
            if level > bounds.depth() {
                break;
            }
            let (column, row) = (column as usize, row as usize);
            let known = cell(squares.steps, bounds.box_error(level, column, row), level);
            squares.halves[at] = known.error;
            squares.ranges[at] = known.range;
            if level < bounds.depth() {
                let errors = bounds.square(level, column, row);
                for edge in Edge::ALL.map(|edge| edge as usize) {
                    squares.edges[at][edge] = code(errors.edges[edge], errors.kinds[edge], level);
                }
            }
        }
        if bounds.depth() == PAGE_LEVELS && !grid.is_finest(page) {
            squares.cells = Some(Box::new(std::array::from_fn(|slot| {
                let (column, row) = Slot::from_index(slot as u8).position();
                let known = bounds.box_error(PAGE_LEVELS, column, row);
                cell(squares.steps, known, PAGE_LEVELS)
            })));
        }
        squares
    }

    /// Bounds of a square's edge triangles, by [`Edge`].
    #[inline]
    pub fn edges(&self, at: At) -> &[ErrorCode; 4] {
        &self.edges[at]
    }

    /// Bound of a square's two halves.
    #[inline]
    pub fn halves(&self, at: At) -> ErrorCode {
        self.halves[at]
    }

    /// Lowest and highest height of a square, in quanta.
    #[inline]
    pub fn range(&self, at: At) -> [i64; 2] {
        self.heights(self.ranges[at])
    }

    /// As [`range`](Self::range), of a square or a cell.
    #[inline]
    pub fn range_of(&self, square: PageSquare) -> [i64; 2] {
        match square.parent() {
            Some((above, quadrant)) => self.quadrant(at(above), quadrant).1,
            None => self.range(ROOT),
        }
    }

    /// Bound and heights of a square's quadrant.
    #[inline]
    pub fn quadrant(&self, at: At, quadrant: Quadrant) -> (ErrorCode, [i64; 2]) {
        if at < FIRST_FINEST {
            let below = 4 * at + 1 + quadrant as usize;
            return (self.halves[below], self.range(below));
        }
        match &self.cells {
            Some(cells) => {
                let cell = cells[PLACES[at].slots()[quadrant as usize].index()];
                (cell.error, self.heights(cell.range))
            }
            None => (ErrorCode::default(), self.range(at)),
        }
    }

    /// The steps of all ranges.
    pub(crate) fn steps(&self) -> Steps {
        self.steps
    }

    /// The range of a square, coded: its lower end, and its upper.
    pub(crate) fn coded_range(&self, at: At) -> (u8, u8) {
        (self.ranges[at].lo, self.ranges[at].hi)
    }

    /// Bound and coded range of a cell, a quadrant of a square of level 3.
    pub(crate) fn coded_cell(&self, at: At, quadrant: Quadrant) -> (ErrorCode, u8, u8) {
        let cells = self.cells.as_ref();
        let cell = cells.map(|cells| cells[PLACES[at].slots()[quadrant as usize].index()]);
        let cell = cell.unwrap_or_default();
        (cell.error, cell.range.lo, cell.range.hi)
    }

    /// Whether any triangle has an error.
    #[inline]
    pub fn is_rough(&self) -> bool {
        self.halves[ROOT] > ErrorCode::default()
    }

    /// Whether any quadrant of its squares of level 3 has a bound: else these need no test.
    #[inline]
    pub fn has_cells(&self) -> bool {
        self.cells.is_some()
    }

    #[inline]
    fn heights(&self, code: RangeCode) -> [i64; 2] {
        [self.steps.height(code.lo), self.steps.height(code.hi)]
    }

    /// Memory beside its own size, bytes.
    pub fn more_bytes(&self) -> usize {
        self.cells.as_ref().map_or(0, |cells| size_of_val(&**cells))
    }
}

/// Where a square is, worked out once for all pages.
#[derive(Debug, Clone, Copy)]
pub struct Place {
    /// The square.
    pub square: PageSquare,
    /// Sample of its centre.
    pub centre: u16,
    /// Samples of its edge vertices, by [`Edge`].
    pub edges: [u16; 4],
}

impl Place {
    const fn of(at: At) -> Place {
        let mut level = 0;
        let mut first = 0;
        while at > 4 * first {
            first = 4 * first + 1;
            level += 1;
        }
        let morton = at - first;
        let (mut column, mut row) = (0, 0);
        let mut bit = 0;
        while bit < PAGE_LEVELS {
            column |= ((morton >> (2 * bit)) & 1) << bit;
            row |= ((morton >> (2 * bit + 1)) & 1) << bit;
            bit += 1;
        }
        let square = PageSquare {
            level,
            column: column as u8,
            row: row as u8,
        };
        let mut edges = [0; 4];
        let mut edge = 0;
        while edge < 4 {
            edges[edge] = square.edge(Edge::ALL[edge]) as u16;
            edge += 1;
        }
        Place {
            square,
            centre: square.centre() as u16,
            edges,
        }
    }

    /// The cells that are the quadrants of a square of level 3.
    pub fn slots(&self) -> [Slot; 4] {
        Quadrant::ALL.map(|quadrant| {
            let cell = self.square.child(quadrant);
            Slot::at(cell.column as usize, cell.row as usize)
        })
    }
}

/// [`PLACES`], for tables that are made from it.
pub const PLACES_OF: [Place; PAGE_SQUARES] = {
    let mut places = [Place::of(0); PAGE_SQUARES];
    let mut at = 0;
    while at < PAGE_SQUARES {
        places[at] = Place::of(at);
        at += 1;
    }
    places
};
/// All squares of a page.
pub static PLACES: [Place; PAGE_SQUARES] = PLACES_OF;

/// The square whose centre a sample is.
pub fn at_centre(sample: u16) -> Option<At> {
    static CENTRES: [u8; PAGE_AREA] = {
        let mut centres = [u8::MAX; PAGE_AREA];
        let mut at = 0;
        while at < PAGE_SQUARES {
            centres[PLACES_OF[at].centre as usize] = at as u8;
            at += 1;
        }
        centres
    };
    let at = CENTRES[sample as usize];
    (at != u8::MAX).then_some(at.into())
}

/// Where a square of a page is.
pub const fn at(square: PageSquare) -> At {
    let mut morton = 0;
    let mut bit = 0;
    while bit < PAGE_LEVELS {
        morton |= ((square.column as usize >> bit) & 1) << (2 * bit);
        morton |= ((square.row as usize >> bit) & 1) << (2 * bit + 1);
        bit += 1;
    }
    ((1 << (2 * square.level)) - 1) / 3 + morton
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_code_is_never_below_the_error_and_at_most_a_256th_above(error in 1e-30f64..1e19) {
            let coded = ErrorCode::covering(error).metres();
            prop_assert!(coded >= error);
            prop_assert!(coded <= error * (1.0 + 1.0 / 256.0) * (1.0 + 1e-6));
        }

        #[test]
        fn codes_grow_with_errors(a in 0f64..1e19, b in 0f64..1e19) {
            let (low, high) = (a.min(b), a.max(b));
            prop_assert!(ErrorCode::covering(low) <= ErrorCode::covering(high));
        }

        #[test]
        fn coded_ranges_hold_what_they_code_and_stay_nested_from_page_to_page(
            mut ends in prop::array::uniform6(-(1i32 << 30)..=1 << 30)
        ) {
            ends.sort_unstable();
            let [a, b, c, d, e, f] = ends;
            let heights = |of: Range, inner: Range| {
                let steps = Steps::over(of);
                let code = steps.code(inner);
                [steps.height(code.lo), steps.height(code.hi)]
            };
            let range = |lo, hi| Range { lo, hi };
            // A cell of a page, and a square of the page below that cell.
            let cell = heights(range(a, f), range(b, e));
            let below = heights(range(b, e), range(c, d));
            prop_assert!(below[0] <= i64::from(c) && below[1] >= i64::from(d));
            prop_assert!(cell[0] <= below[0] && below[1] <= cell[1]);
        }
    }

    #[test]
    fn zero_stays_zero_and_no_range_is_too_wide() {
        assert_eq!(ErrorCode::covering(0.0).metres(), 0.0);
        let all = Range {
            lo: i32::MIN,
            hi: i32::MAX,
        };
        let steps = Steps::over(all);
        let code = steps.code(all);
        assert!(steps.height(code.lo) <= i64::from(i32::MIN));
        assert!(steps.height(code.hi) >= i64::from(i32::MAX));
        assert_eq!(
            Steps::over(Range::EMPTY).code(Range::EMPTY),
            RangeCode { lo: 255, hi: 0 }
        );
    }

    #[test]
    fn every_square_has_its_own_place_below_the_square_above() {
        for (index, place) in PLACES.iter().enumerate() {
            assert_eq!(at(place.square), index);
            assert_eq!(at_centre(place.centre), Some(index));
            if let Some((above, quadrant)) = place.square.parent() {
                assert_eq!(4 * at(above) + 1 + quadrant as usize, index);
            }
        }
    }
}
