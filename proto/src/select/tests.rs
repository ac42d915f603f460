//! The tests of a page, all at once and on codes, against those of the mesh, one by one.

use super::sketch::first;
use super::test::Pass;
use super::*;
use crate::geometry::{Edge, PAGE_LEVELS, Quadrant};
use crate::page::{Bounds, Codec, Page, Record, RecordHeader};
use crate::sight::Placed;
use crate::sight::squares::{PLACES, Squares};
use proptest::prelude::*;

fn georef(quantum_m: f64) -> Georef {
    Georef {
        origin_m: [-3000.0, 500.0],
        sample_spacing_m: [10.0, 12.5],
        quantum_m,
        plane: crate::georef::Plane::Local,
    }
}

/// What a client has of a page that came up to a part.
fn prefix(page: &Page, parts: u8) -> Page {
    let finest = page.is_finest();
    let record = Record::encode(page, Codec::Dense);
    let header = RecordHeader::read(page.id(), finest, record.bytes()).unwrap();
    let bytes = header.part_bytes(0, parts).unwrap();
    Page::decode(page.id(), finest, parts, &record.bytes()[bytes]).unwrap()
}

fn grid_of(page: &Page) -> GridLevels {
    GridLevels::new(if page.is_finest() { 12 } else { 16 }).unwrap()
}

/// An eye so many page's sides from the page's south-west corner.
fn view(page: &Page, georef: &Georef, at: [f64; 3], px: f32) -> View {
    let (x, y) = grid_of(page).page_origin(page.id());
    let side_m = f64::from(grid_of(page).square_cells(page.id().level())) * 10.0;
    View {
        eye_m: [
            georef.world_x(x) + at[0] * side_m,
            georef.world_y(y) + at[1] * side_m,
            at[2] * side_m,
        ],
        direction: [0.3, 0.8, -0.1],
        velocity_m_s: [0.0; 3],
        fov_y: 1.0,
        viewport_px: [1920, 1080],
        max_screen_error_px: px,
    }
}

/// What the mesh's tests say of the squares of a page that a client has so much of.
struct Plain {
    edges: [[u64; 4]; 4],
    centres: [u64; 4],
    /// A box for which the next part is wanted.
    wants_more: bool,
    cells: [u16; 16],
}

fn plain(page: &Page, sight: &Sight, georef: &Georef) -> Plain {
    let grid = grid_of(page);
    let bounds = Bounds::derive(page, None);
    let squares = Squares::of(&bounds, page.id(), grid, georef);
    let (x, y) = grid.page_origin(page.id());
    let placed = Placed {
        squares: &squares,
        origin: [x, y],
        stride: grid.page_stride(page.id()),
    };
    let mut found = Plain {
        edges: [[0; 4]; 4],
        centres: [1, 0, 0, 0],
        wants_more: false,
        cells: [0; 16],
    };
    let bit = |level: u8, column: u8, row: u8| 1u64 << ((row << level) + column);
    for place in &PLACES {
        let square = place.square;
        if square.level >= page.depth() {
            break;
        }
        for edge in Edge::ALL {
            if sight.edge(placed, square, edge).fails() {
                found.edges[usize::from(square.level)][edge as usize] |=
                    bit(square.level, square.column, square.row);
            }
        }
        for quadrant in Quadrant::ALL {
            let below = square.child(quadrant);
            if !sight.quadrant(placed, square, quadrant).fails() {
                continue;
            }
            if below.level < page.depth() {
                found.centres[usize::from(below.level)] |=
                    bit(below.level, below.column, below.row);
            } else if page.has_slots() {
                found.cells[usize::from(below.row)] |= 1 << below.column;
            } else {
                found.wants_more |= !page.is_finest() || page.depth() < PAGE_LEVELS;
            }
        }
    }
    found
}

fn contains(all: u64, some: u64) -> bool {
    all & some == some
}

proptest! {
    #[test]
    fn a_page_is_listed_up_to_the_part_that_passes_and_what_fails_then_is_marked(
        page in crate::page::oracle::whole_page(),
        at in [-3.0..3.0f64, -3.0..3.0, -2.0..2.0],
        px in prop_oneof![Just(1.0f32), 0.05f32..1024.0],
        quantum_m in prop_oneof![Just(1.0), Just(0.01), Just(1e-6)],
    ) {
        let georef = georef(quantum_m);
        let grid = grid_of(&page);
        let view = view(&page, &georef, at, px);
        let sight = Sight::new(&georef, &view);
        let sketch = Sketch::of(&page, None, grid, &georef);
        let found = Pass::new(grid, &sight, Scope::All).find_in(page.id(), &sketch);
        prop_assert!(!found.guessed);
        let held = prefix(&page, found.parts);
        let exact = plain(&held, &sight, &georef);
        prop_assert!(!exact.wants_more, "{} parts are not enough", found.parts);
        for level in 0..usize::from(held.depth()) {
            prop_assert!(contains(found.marks.centres[level], exact.centres[level]));
            for edge in 0..4 {
                prop_assert!(contains(found.marks.edges[level][edge], exact.edges[level][edge]), "{} parts, level {level} edge {edge}, {:x} {:x}", found.parts, found.marks.edges[level][edge], exact.edges[level][edge]);
            }
        }
        for row in 0..16 {
            prop_assert!(contains(found.cells[row].into(), exact.cells[row].into()));
        }
        // What is told of fewer parts is what a client derives that has them.
        for parts in 1..if page.has_holes() { 1 } else { page.last_part() } {
            let derived = Bounds::derive(&prefix(&page, parts), None);
            prop_assert_eq!(&Bounds::of_fewer(&page, None)[usize::from(parts) - 1], &derived);
        }
        // No more than with a tolerance that is a hundredth narrower, unless heights are so far
        // apart that single precision cannot tell.
        let span = sketch.all().steps.height(255) - sketch.all().steps.height(0);
        let can_tell = (span as f64) * quantum_m < 1e4;
        let narrower = View { max_screen_error_px: px * 0.99, ..view };
        let narrower = Sight::new(&georef, &narrower);
        if can_tell && (found.parts == page.last_part() || !page.has_holes()) {
            let more = plain(&held, &narrower, &georef);
            for row in 0..16 {
                prop_assert!(contains(more.cells[row].into(), found.cells[row].into()));
            }
            for level in 0..4 {
                prop_assert!(contains(more.centres[level], found.marks.centres[level]));
                for edge in 0..4 {
                    prop_assert!(contains(more.edges[level][edge], found.marks.edges[level][edge]));
                }
            }
        }
        if can_tell && found.parts > 1 && !page.has_holes() {
            let less = plain(&prefix(&page, found.parts - 1), &narrower, &georef);
            prop_assert!(less.wants_more, "{} parts are too many", found.parts);
        }
        // What a client has of it tells it that it needs more.
        for parts in 1..found.parts {
            let sketch = Sketch::of(&prefix(&page, parts), None, grid, &georef);
            let guess = Pass::new(grid, &sight, Scope::All).find_in(page.id(), &sketch);
            prop_assert!(guess.guessed && guess.parts > parts || page.has_holes());
        }
        for parts in found.parts..page.last_part() {
            let sketch = Sketch::of(&prefix(&page, parts), None, grid, &georef);
            let known = Pass::new(grid, &sight, Scope::All).find_in(page.id(), &sketch);
            prop_assert!(known.parts >= found.parts || page.has_holes());
            // Bounds of a page with holes may still grow, so that more may be asked for, on the
            // safe side.
            let is_same = !known.guessed && known.parts == found.parts;
            prop_assert!(page.has_holes() || is_same && known.marks == found.marks);
        }
    }
}

#[test]
fn corners_and_borders_of_marks_are_those_of_their_squares() {
    for level in 0..4usize {
        let n = 1usize << level;
        for column in 0..n {
            for row in 0..n {
                for edge in Edge::ALL {
                    let mut marks = Marks::default();
                    marks.edges[level][edge as usize] = 1 << (row * n + column);
                    let (dx, dy) = edge.step();
                    let (x, y) = (column as i32 + dx, row as i32 + dy);
                    let inside = (0..n as i32).contains(&x) && (0..n as i32).contains(&y);
                    let (wx, wy) = (x.rem_euclid(n as i32), y.rem_euclid(n as i32));
                    let beyond = 1u64 << (wy * n as i32 + wx);
                    prop_assert_across(&marks, level, edge, if inside { 0 } else { beyond });
                    marks.take_edges(level);
                    let own = 1u64 << (row * n + column);
                    let both = own | if inside { beyond } else { 0 };
                    assert_eq!(marks.centres[level], both);
                }
            }
        }
        for column in 0..2 * n {
            for row in 0..2 * n {
                let mut marks = Marks::default();
                match level {
                    3 => marks.cells[row] = 1 << column,
                    _ => marks.centres[level + 1] = 1 << (row * 2 * n + column),
                }
                marks.take_corners(level);
                let above = 1u64 << (row / 2 * n + column / 2);
                let mut expected = [0; 4];
                for edge in Quadrant::of(column as u32, row as u32).edges() {
                    expected[edge as usize] = above;
                }
                assert_eq!(marks.edges[level], expected);
            }
        }
    }
    assert_eq!(first(4), 85);
}

fn prop_assert_across(marks: &Marks, level: usize, edge: Edge, expected: u64) {
    assert_eq!(marks.across(level, edge), expected);
    assert_eq!(
        Edge::ALL
            .iter()
            .filter(|&&other| marks.across(level, other) != 0)
            .count(),
        usize::from(expected != 0)
    );
}
