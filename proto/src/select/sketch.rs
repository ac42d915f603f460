//! What the selection knows of a page.

use crate::err8::Err8;
use crate::geometry::{GridLevels, PAGE_CELLS, PAGE_LEVELS, PAGE_SLOTS, Quadrant, Slot};
use crate::georef::Georef;
use crate::page::{Bounds, BoxError, ChildSlot, Kind, MAX_SPAN, Page};
use crate::sight::place::PageSquare;
use crate::sight::squares::{self, FIRST_FINEST, PAGE_SQUARES, PLACES, Squares, Steps};
use crate::view::error_m;

/// Place of the first square of a level, in the order of a sketch: level by level, column by
/// column from the west, each from the south.
pub(super) const fn first(level: u8) -> usize {
    ((1 << (2 * level)) - 1) / 3
}

/// The coded bounds of a page's squares, of the parts that were known, and what is to be believed
/// while only some of these have arrived. Does not change, and may be shared.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sketch {
    pub(super) parts: u8,
    pub(super) whole: bool,
    pub(super) has_holes: bool,
    pub(super) steps: Steps,
    /// While only parts `1..=k` have arrived: the bound of each square of level `k`, by `k`; it
    /// holds when more have arrived as well. Where outlines cross the page, it is all that is known
    /// until all have.
    pub(super) rest: [u16; PAGE_LEVELS as usize + 1],
    /// Bounds of edge triangles, by [`Edge`](crate::geometry::Edge), then by square.
    pub(super) edges: [[u16; PAGE_SQUARES]; 4],
    /// Of the two halves of squares.
    pub(super) halves: [u16; PAGE_SQUARES],
    pub(super) lo: [u8; PAGE_SQUARES],
    pub(super) hi: [u8; PAGE_SQUARES],
    /// Of a whole page that is not one of the finest.
    pub(super) cells: Option<Box<Cells>>,
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
        let bounds = Bounds::derive(page, promise);
        let squares = Squares::of(&bounds, page.id(), grid, georef);
        let mut sketch = Sketch {
            parts: page.parts(),
            whole: page.parts() == page.last_part(),
            has_holes: page.has_holes(),
            steps: squares.steps(),
            rest: rest(page, promise, grid, georef),
            edges: [[0; PAGE_SQUARES]; 4],
            halves: [0; PAGE_SQUARES],
            lo: [0; PAGE_SQUARES],
            hi: [0; PAGE_SQUARES],
            cells: None,
        };
        for (from, place) in PLACES.iter().enumerate() {
            let PageSquare { level, column, row } = place.square;
            let to = first(level) + (usize::from(column) << level) + usize::from(row);
            for (edges, error) in sketch.edges.iter_mut().zip(squares.edges(from)) {
                edges[to] = error.code();
            }
            sketch.halves[to] = squares.halves(from).code();
            (sketch.lo[to], sketch.hi[to]) = squares.coded_range(from);
        }
        if squares.has_cells() && sketch.whole {
            sketch.cells = Some(Box::new(Cells::of(page, &squares)));
        }
        sketch
    }

    /// Memory that it takes, bytes.
    pub fn memory_bytes(&self) -> usize {
        size_of::<Sketch>() + self.cells.as_ref().map_or(0, |_| size_of::<Cells>())
    }

    /// Whether the page has no surface.
    pub(super) fn is_empty(&self) -> bool {
        self.lo[0] > self.hi[0]
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

impl Cells {
    fn of(page: &Page, squares: &Squares) -> Cells {
        let mut cells = Cells {
            errors: [0; PAGE_SLOTS],
            lo: [0; PAGE_SLOTS],
            hi: [0; PAGE_SLOTS],
            stored: [0; PAGE_CELLS],
        };
        for (at, place) in PLACES.iter().enumerate().skip(FIRST_FINEST) {
            for quadrant in Quadrant::ALL {
                let slot = place.slots()[quadrant as usize];
                let (column, row) = slot.position();
                let to = column * PAGE_CELLS + row;
                let (error, lo, hi) = squares.coded_cell(at, quadrant);
                cells.errors[to] = error.code();
                (cells.lo[to], cells.hi[to]) = (lo, hi);
                cells.stored[row] |= u16::from(page.slot(slot).has_record()) << column;
            }
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
