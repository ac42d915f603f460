//! What the selection knows of a page.

use crate::err8::Err8;
use crate::geometry::{GridLevels, PAGE_CELLS, PAGE_LEVELS, PAGE_SLOTS, Quadrant, Slot};
use crate::georef::Georef;
use crate::page::{Bounds, BoxError, ChildSlot, Kind, MAX_SPAN, Page};
use crate::sight::place::PageSquare;
use crate::sight::squares::{self, At, FIRST_FINEST, PAGE_SQUARES, PLACES, Squares, Steps};
use crate::view::error_m;

/// Place of the first square of a level, in the order of a sketch: level by level, column by
/// column from the west, each from the south.
pub(super) const fn first(level: u8) -> usize {
    ((1 << (2 * level)) - 1) / 3
}

/// The coded bounds of a page's squares, of the parts that were known, and what a client believes
/// that has only some of these. Does not change, and may be shared.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sketch {
    pub(super) parts: u8,
    pub(super) whole: bool,
    pub(super) has_holes: bool,
    /// While only parts `1..=k` have arrived: the bound of each square of level `k`, by `k`; it
    /// holds when more have arrived as well. Where outlines cross the page, it is all that is known
    /// until all have.
    pub(super) rest: [u16; PAGE_LEVELS as usize + 1],
    /// Of all parts.
    codes: Codes<PAGE_SQUARES, PAGE_SQUARES>,
    /// Of fewer, in a page without holes.
    fewer: Option<Box<Fewer>>,
    /// Of four of five.
    four: Option<Box<Codes<PAGE_SQUARES, { first(5) }>>>,
    /// Of a whole page that is not one of the finest.
    pub(super) cells: Option<Box<Cells>>,
}

/// Coded bounds of the first `S` squares of a page, and the heights of the first `R`.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Codes<const S: usize, const R: usize> {
    steps: Steps,
    /// Bounds of edge triangles, by [`Edge`](crate::geometry::Edge), then by square.
    edges: [[u16; S]; 4],
    /// Of the two halves of squares.
    halves: [u16; S],
    lo: [u8; R],
    hi: [u8; R],
}

/// What is believed while only one part has arrived, or two, or three: bounds of the squares whose
/// centres they hold, and heights of those below as well.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Fewer {
    one: Codes<{ first(1) }, { first(2) }>,
    two: Codes<{ first(2) }, { first(3) }>,
    three: Codes<{ first(3) }, { first(4) }>,
}

/// What is believed of a page's squares, by so many parts of it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Told<'a> {
    pub(super) steps: Steps,
    /// Bounds of edge triangles, by [`Edge`](crate::geometry::Edge), then by square.
    pub(super) edges: [&'a [u16]; 4],
    /// Of the two halves of squares.
    pub(super) halves: &'a [u16],
    pub(super) lo: &'a [u8],
    pub(super) hi: &'a [u8],
}

/// Cells, column by column from the west, each from the south; and what hangs below them, a bit
/// each by row and column.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Cells {
    pub(super) errors: [u16; PAGE_SLOTS],
    pub(super) lo: [u8; PAGE_SLOTS],
    pub(super) hi: [u8; PAGE_SLOTS],
    /// A page with a record.
    pub(super) stored: [u16; PAGE_CELLS],
}

impl Sketch {
    /// Of a page, as far as it is here. `promise` is what is known of it from the page above
    /// ([`Bounds::cell`] of its slot).
    pub fn of(page: &Page, promise: Option<BoxError>, grid: GridLevels, georef: &Georef) -> Sketch {
        let squares = |bounds: &Bounds| Squares::of(bounds, page.id(), grid, georef);
        let all = squares(&Bounds::derive(page, promise));
        let whole = page.parts() == page.last_part();
        let fewer = match page.has_holes() {
            true => Vec::new(),
            false => Bounds::of_fewer(page, promise),
        };
        let [one, two, three, four] = std::array::from_fn(|i| fewer.get(i).map(squares));
        let fewer = one.as_ref().map(|one| Fewer {
            one: Codes::of(one),
            // Nobody looks at what is not known.
            two: Codes::of(two.as_ref().unwrap_or(one)),
            three: Codes::of(three.as_ref().unwrap_or(one)),
        });
        Sketch {
            parts: page.parts(),
            whole,
            has_holes: page.has_holes(),
            rest: rest(page, promise, grid, georef),
            codes: Codes::of(&all),
            fewer: fewer.map(Box::new),
            four: four.as_ref().map(|four| Box::new(Codes::of(four))),
            cells: (all.has_cells() && whole).then(|| Box::new(Cells::of(page, &all))),
        }
    }

    /// Memory that it takes, bytes.
    pub fn memory_bytes(&self) -> usize {
        fn boxed<T>(held: &Option<Box<T>>) -> usize {
            held.as_ref().map_or(0, |_| size_of::<T>())
        }
        size_of::<Sketch>() + boxed(&self.fewer) + boxed(&self.four) + boxed(&self.cells)
    }

    /// Of all parts that were known.
    pub(super) fn all(&self) -> Told<'_> {
        self.codes.told()
    }

    /// What a client believes that has so many parts, which were known. Of a page with holes:
    /// what all parts say.
    pub(super) fn told(&self, parts: u8) -> Told<'_> {
        let is_all = self.whole && parts >= self.parts;
        match (parts, self.fewer.as_ref().filter(|_| !is_all), &self.four) {
            (1, Some(fewer), _) => fewer.one.told(),
            (2, Some(fewer), _) => fewer.two.told(),
            (3, Some(fewer), _) => fewer.three.told(),
            (4, Some(_), Some(four)) => four.told(),
            _ => self.all(),
        }
    }

    /// Whether a record is stored for the page below a slot. `None` before that is known.
    pub(super) fn has_record(&self, slot: Slot) -> Option<bool> {
        let (column, row) = slot.position();
        let cells = self.cells.as_ref();
        // Nothing hangs below the finest.
        let stored = cells.map(|cells| cells.stored[row] >> column & 1 != 0);
        stored.or(self.whole.then_some(false))
    }
}

impl<const S: usize, const R: usize> Codes<S, R> {
    fn of(squares: &Squares) -> Codes<S, R> {
        let mut codes = Codes {
            steps: squares.steps(),
            edges: [[0; S]; 4],
            halves: [0; S],
            lo: [0; R],
            hi: [0; R],
        };
        for (from, place) in PLACES.iter().enumerate().take(R) {
            let PageSquare { level, column, row } = place.square;
            let to = first(level) + (usize::from(column) << level) + usize::from(row);
            (codes.lo[to], codes.hi[to]) = squares.coded_range(from);
            if to >= S {
                continue;
            }
            codes.halves[to] = squares.halves(from).code();
            for (edges, error) in codes.edges.iter_mut().zip(squares.edges(from)) {
                edges[to] = error.code();
            }
        }
        if R > PAGE_SQUARES {
            for (from, quadrant, (column, row)) in cells() {
                let to = PAGE_SQUARES + column * PAGE_CELLS + row;
                (_, codes.lo[to], codes.hi[to]) = squares.coded_cell(from, quadrant);
            }
        }
        codes
    }

    fn told(&self) -> Told<'_> {
        Told {
            steps: self.steps,
            edges: self.edges.each_ref().map(|edges| &edges[..]),
            halves: &self.halves,
            lo: &self.lo,
            hi: &self.hi,
        }
    }
}

/// The cells of a page: the squares whose quadrants they are, and their columns and rows.
fn cells() -> impl Iterator<Item = (At, Quadrant, (usize, usize))> {
    let finest = PLACES.iter().enumerate().skip(FIRST_FINEST);
    finest.flat_map(|(at, place)| {
        let slots = place.slots();
        let place = |quadrant| slots[quadrant as usize].position();
        Quadrant::ALL.map(|quadrant| (at, quadrant, place(quadrant)))
    })
}

impl Cells {
    fn of(page: &Page, squares: &Squares) -> Cells {
        let mut cells = Cells {
            errors: [0; PAGE_SLOTS],
            lo: [0; PAGE_SLOTS],
            hi: [0; PAGE_SLOTS],
            stored: [0; PAGE_CELLS],
        };
        for (at, quadrant, (column, row)) in self::cells() {
            let to = column * PAGE_CELLS + row;
            let (error, lo, hi) = squares.coded_cell(at, quadrant);
            cells.errors[to] = error.code();
            (cells.lo[to], cells.hi[to]) = (lo, hi);
            let stored = page.slot(Slot::at(column, row)).has_record();
            cells.stored[row] |= u16::from(stored) << column;
        }
        cells
    }
}

/// What stands for each cell while only parts `1..=k` are here, by `k`.
fn rest(
    page: &Page,
    promise: Option<BoxError>,
    grid: GridLevels,
    georef: &Georef,
) -> [u16; PAGE_LEVELS as usize + 1] {
    std::array::from_fn(|i| {
        let part = i as u8;
        if part > page.depth() {
            return 0;
        }
        let told = match part == 0 && !page.has_holes() {
            // Before any has, there is only what the page above says.
            true => ChildSlot::Full(Err8(u8::MAX)),
            false => page.slot_until(part),
        };
        let (error, kind) = match told {
            ChildSlot::Full(error) | ChildSlot::Cut(error) => (error.bound(), Kind::Full),
            ChildSlot::Mixed(range) => (range.span(), Kind::Mixed),
            ChildSlot::Empty => (0, Kind::Empty),
        };
        let error = error.min(promise.map_or(MAX_SPAN, |promise| promise.error));
        let level = page.id().level() + part;
        if level >= grid.get() {
            return 0;
        }
        let half_diagonal_m = georef.half_diagonal_m(grid.square_cells(level));
        let error_m = error_m(error, kind, georef.quantum_m, half_diagonal_m);
        squares::ErrorCode::covering(error_m).code()
    })
}
