//! The quick way for pages without holes whose cells all have one bound: the finest pages, which
//! are nearly all of a dataset's, and pages whose slots have not arrived.
//!
//! The bound of a triangle is then its largest deviation over the page's own vertices, rounded
//! up, plus the cells' bound. Planes are walked by adding: with heights 16 times their size, the
//! step of a plane from one vertex to the next is a whole number in every triangle of the page.
//! Results are those of the plain derivation, bit by bit (`page::oracle`).

use super::{BoxError, capped};
use crate::geometry::{PAGE_CELLS, PAGE_LEVELS, PAGE_SAMPLES, Quadrant};
use crate::page::{Kind, PAGE_AREA, Page, Range, level_step};
use std::ops::{Add, Shr, Sub};

/// Heights are scaled by this power of two, the cells on a page's side.
const SCALE: u32 = PAGE_LEVELS as u32;
/// Heights that differ by less than this can be scaled, and added, within 32 bits.
const SMALL_SPAN: i64 = 1 << (30 - SCALE);
/// Places from one row to the next.
const ROW: usize = PAGE_SAMPLES;

/// Numbers that deviations are computed in.
trait Whole:
    Copy + Ord + Default + Into<i64> + Add<Output = Self> + Sub<Output = Self> + Shr<u32, Output = Self>
{
}
impl Whole for i32 {}
impl Whole for i64 {}

/// Largest deviations in a square, in quanta, rounded up.
#[derive(Debug, Clone, Copy)]
pub(super) struct Own {
    /// Of the edge triangles, by `Edge`.
    pub(super) edges: [u64; 4],
    /// Of the southern half, of the northern.
    pub(super) halves: [u64; 2],
}

fn round_up<T: Whole>(scaled: T) -> u64 {
    (scaled.into() as u64).div_ceil(1 << SCALE)
}

impl Own {
    fn of<T: Whole>((edges, halves): ([T; 4], [T; 2])) -> Own {
        Own {
            edges: edges.map(round_up),
            halves: halves.map(round_up),
        }
    }
}

/// Calls `each` with the place of every square, whether its diagonal rises, and its deviations;
/// finest level first.
pub(super) fn squares(page: &Page, mut each: impl FnMut((u8, usize, usize), bool, Own)) {
    let heights = together(page);
    let root = page.id().square();
    let rises = Quadrant::of(root.x, root.y).rises();
    let depth = page.depth();
    let (lo, hi) = range(&heights);
    let lower = |height: i32| i64::from(height) - i64::from(lo);
    if lower(hi) < SMALL_SPAN {
        let scaled = heights.map(|height| height.wrapping_sub(lo) << SCALE);
        levels(&scaled, depth, rises, &mut each);
    } else {
        let scaled = heights.map(|height| lower(height) << SCALE);
        levels(&scaled, depth, rises, &mut each);
    }
}

/// What is known of the cells: their corners, and the bound of all of them.
pub(super) fn cells(page: &Page, below: u32, promise: Option<BoxError>) -> Vec<BoxError> {
    let heights = together(page);
    let side = 1 << page.depth();
    let mut cells = Vec::with_capacity(side * side);
    for (south, north) in heights
        .chunks_exact(ROW)
        .zip(heights[ROW..].chunks_exact(ROW))
        .take(side)
    {
        for (south, north) in south.windows(2).zip(north.windows(2)).take(side) {
            let range = Range {
                lo: south[0].min(south[1]).min(north[0].min(north[1])),
                hi: south[0].max(south[1]).max(north[0].max(north[1])),
            };
            let told = BoxError {
                error: below,
                kind: Kind::Full,
                range: range.widened(below),
            };
            cells.push(promise.map_or(told, |promise| capped(told, promise)));
        }
    }
    cells
}

/// The vertices that have arrived, moved together, [`ROW`] apart; beyond them the first again.
fn together(page: &Page) -> [i32; PAGE_AREA] {
    let step = level_step(page.depth());
    if step == 1 {
        return *page.heights;
    }
    let mut out = [page.heights[0]; PAGE_AREA];
    let rows = page.heights.chunks_exact(ROW).step_by(step);
    for (to, from) in out.chunks_exact_mut(ROW).zip(rows) {
        for (to, &from) in to.iter_mut().zip(from.iter().step_by(step)) {
            *to = from;
        }
    }
    out
}

fn range(heights: &[i32; PAGE_AREA]) -> (i32, i32) {
    let all = |(lo, hi): (i32, i32), &height: &i32| (lo.min(height), hi.max(height));
    heights.iter().fold((i32::MAX, i32::MIN), all)
}

fn levels<T: Whole>(
    heights: &[T; PAGE_AREA],
    depth: u8,
    root_rises: bool,
    each: &mut impl FnMut((u8, usize, usize), bool, Own),
) {
    for level in (0..depth).rev() {
        let side = 1 << (depth - level);
        for row in 0..1 << level {
            for column in 0..1 << level {
                let south_west = row * side * ROW + column * side;
                let rises = match level {
                    0 => root_rises,
                    _ => Quadrant::of(column as u32, row as u32).rises(),
                };
                let own = match side {
                    2 => smallest(heights, south_west, rises),
                    4 => square::<T, 4>(heights, south_west, rises),
                    8 => square::<T, 8>(heights, south_west, rises),
                    _ => square::<T, 16>(heights, south_west, rises),
                };
                each((level, column, row), rises, Own::of(own));
            }
        }
    }
}

/// The largest deviation of each level's two meshes, in quanta, rounded up: of the mesh of its
/// squares' edge triangles, and of that of their halves.
pub(super) fn largest(page: &Page) -> [u64; PAGE_LEVELS as usize] {
    let root = page.id().square();
    let rises = Quadrant::of(root.x, root.y).rises();
    let (lo, hi) = range(&page.heights);
    let lower = |height: i32| i64::from(height) - i64::from(lo);
    if lower(hi) < SMALL_SPAN {
        let scaled = page.heights.map(|height| height.wrapping_sub(lo) << SCALE);
        largest_of(&scaled, rises)
    } else {
        largest_of(&page.heights.map(|height| lower(height) << SCALE), rises)
    }
}

fn largest_of<T: Whole>(heights: &[T; PAGE_AREA], rises: bool) -> [u64; PAGE_LEVELS as usize] {
    let mut scaled = [
        largest_of_level::<T, 16>(heights, rises),
        largest_of_level::<T, 8>(heights, rises),
        largest_of_level::<T, 4>(heights, rises),
        T::default(),
    ];
    let pairs = || (0..PAGE_CELLS).step_by(2);
    for (row, column) in pairs().flat_map(|row| pairs().map(move |column| (row, column))) {
        let rises = (row / 2 + column / 2).is_multiple_of(2);
        let (_, [south, north]) = smallest(heights, row * ROW + column, rises);
        scaled[3] = scaled[3].max(south).max(north);
    }
    scaled.map(round_up)
}

/// Both meshes of a level whose squares are `SIDE` cells a side, row by row: each row of a mesh is
/// made of straight pieces.
fn largest_of_level<T: Whole, const SIDE: usize>(heights: &[T; PAGE_AREA], root_rises: bool) -> T {
    let shift = SIDE.ilog2();
    let mut largest = [T::default(); ROW];
    let (mut edges, mut halves) = ([T::default(); ROW], [T::default(); ROW]);
    for south in (0..PAGE_CELLS).step_by(SIDE) {
        // Between two rows of squares both have the same mesh.
        let last = if south + SIDE == PAGE_CELLS {
            SIDE
        } else {
            SIDE - 1
        };
        for v in 0..=last {
            for west in (0..PAGE_CELLS).step_by(SIDE) {
                let sw = south * ROW + west;
                let corners = [sw, sw + SIDE, sw + SIDE * ROW, sw + SIDE * ROW + SIDE];
                let [sw, se, nw, ne] = corners.map(|at| heights[at]);
                let middle = heights[(south + SIDE / 2) * ROW + west + SIDE / 2];
                let up = (nw - sw) >> shift;
                let start = sw + times(up, v);
                let (below, above) = ((se - sw) >> shift, (ne - nw) >> shift);
                let inwards = ((middle - sw) + (middle - nw)) >> shift;
                let outwards = ((se - middle) + (ne - middle)) >> shift;
                let cut = v.min(SIDE - v);
                let along = if 2 * v <= SIDE { below } else { above };
                let pieces = [(cut, inwards), (SIDE - 2 * cut, along), (cut, outwards)];
                straight(&mut edges[west..=west + SIDE], start, pieces);
                let rises = match SIDE {
                    PAGE_CELLS => root_rises,
                    _ => (south / SIDE + west / SIDE).is_multiple_of(2),
                };
                let pieces = match rises {
                    true => [(v, above), (SIDE - v, below), (0, below)],
                    false => [(SIDE - v, below), (v, above), (0, below)],
                };
                straight(&mut halves[west..=west + SIDE], start, pieces);
            }
            let row = &heights[(south + v) * ROW..][..ROW];
            for (((largest, &height), &a), &b) in
                largest.iter_mut().zip(row).zip(&edges).zip(&halves)
            {
                *largest = (*largest).max(apart(height, a)).max(apart(height, b));
            }
        }
    }
    largest.into_iter().fold(T::default(), T::max)
}

/// Fills a row with pieces of so many cells, each with a step from sample to sample.
fn straight<T: Whole>(out: &mut [T], start: T, pieces: [(usize, T); 3]) {
    let mut at = start;
    let mut samples = out.iter_mut();
    for (cells, step) in pieces {
        for sample in samples.by_ref().take(cells) {
            *sample = at;
            at = at + step;
        }
    }
    for sample in samples {
        *sample = at;
    }
}

/// `step * times`, for a few times.
fn times<T: Whole>(step: T, times: usize) -> T {
    (0..times).fold(T::default(), |sum, _| sum + step)
}

fn apart<T: Whole>(a: T, b: T) -> T {
    (a - b).max(b - a)
}

/// Distance of a vertex from the middle of a line, both ends of which are scaled.
fn off_middle<T: Whole>(heights: &[T; PAGE_AREA], at: usize, reach: usize) -> T {
    apart(
        heights[at],
        (heights[at - reach] + heights[at + reach]) >> 1,
    )
}

/// A square of two cells a side: each edge triangle has one vertex between its corners, each half
/// three, of which two are those of its edge triangles.
fn smallest<T: Whole>(heights: &[T; PAGE_AREA], sw: usize, rises: bool) -> ([T; 4], [T; 2]) {
    let centre = sw + ROW + 1;
    let [east, north, west, south] = [
        off_middle(heights, centre + 1, ROW),
        off_middle(heights, centre + ROW, 1),
        off_middle(heights, centre - 1, ROW),
        off_middle(heights, centre - ROW, 1),
    ];
    let middle = off_middle(heights, centre, if rises { ROW + 1 } else { ROW - 1 });
    let halves = if rises {
        [south.max(east), north.max(west)]
    } else {
        [south.max(west), north.max(east)]
    };
    (
        [east, north, west, south],
        halves.map(|half| half.max(middle)),
    )
}

fn square<T: Whole, const SIDE: usize>(
    heights: &[T; PAGE_AREA],
    sw: usize,
    rises: bool,
) -> ([T; 4], [T; 2]) {
    let centre = sw + SIDE / 2 * ROW + SIDE / 2;
    // Each half from its right angle: its legs run along a row and along a column.
    let (se, nw) = (sw + SIDE, sw + SIDE * ROW);
    let halves = if rises {
        halves::<T, SIDE>(
            heights,
            [se, nw],
            [(-1, ROW as isize), (1, -(ROW as isize))],
        )
    } else {
        let ne = nw + SIDE;
        halves::<T, SIDE>(
            heights,
            [sw, ne],
            [(1, ROW as isize), (-1, -(ROW as isize))],
        )
    };
    (edge_triangles::<T, SIDE>(heights, centre), halves)
}

/// The triangles of a centre and each edge. In a triangle's own directions, `u` along the edge and
/// `v` out to it, it is `|u| <= v <= SIDE / 2`. The four are walked together, as none waits for
/// another.
fn edge_triangles<T: Whole, const SIDE: usize>(heights: &[T; PAGE_AREA], centre: usize) -> [T; 4] {
    /// Outwards and along, by `Edge`.
    const WAYS: [(isize, isize); 4] = [
        (1, ROW as isize),
        (ROW as isize, 1),
        (-1, ROW as isize),
        (-(ROW as isize), 1),
    ];
    let half = (SIDE / 2) as isize;
    let at = |i: usize, u: isize, v: isize| {
        let (out, along) = WAYS[i];
        heights[centre.wrapping_add_signed(u * along + v * out)]
    };
    let shift = SIDE.ilog2();
    let (left, right) = (
        [0, 1, 2, 3].map(|i| at(i, -half, half)),
        [0, 1, 2, 3].map(|i| at(i, half, half)),
    );
    let mut starts = [heights[centre]; 4];
    let mut largest = [T::default(); 4];
    for v in 1..=half {
        let mut planes = starts;
        for i in 0..4 {
            starts[i] = starts[i] + ((left[i] - heights[centre]) >> (shift - 1));
            planes[i] = starts[i];
        }
        for u in -v..=v {
            for i in 0..4 {
                largest[i] = largest[i].max(apart(at(i, u, v), planes[i]));
                planes[i] = planes[i] + ((right[i] - left[i]) >> shift);
            }
        }
    }
    largest
}

/// The halves of a square with their right angles at `corners`: `u + v <= SIDE` along their legs.
fn halves<T: Whole, const SIDE: usize>(
    heights: &[T; PAGE_AREA],
    corners: [usize; 2],
    ways: [(isize, isize); 2],
) -> [T; 2] {
    let side = SIDE as isize;
    let at = |i: usize, u: isize, v: isize| {
        let (along, up) = ways[i];
        heights[corners[i].wrapping_add_signed(u * along + v * up)]
    };
    let shift = SIDE.ilog2();
    let mut starts = [0, 1].map(|i| at(i, 0, 0));
    let steps = [0, 1].map(|i| (at(i, side, 0) - starts[i]) >> shift);
    let rises = [0, 1].map(|i| (at(i, 0, side) - starts[i]) >> shift);
    let mut largest = [T::default(); 2];
    for v in 0..=side {
        let mut planes = starts;
        for u in 0..=side - v {
            for i in 0..2 {
                largest[i] = largest[i].max(apart(at(i, u, v), planes[i]));
                planes[i] = planes[i] + steps[i];
            }
        }
        for i in 0..2 {
            starts[i] = starts[i] + rises[i];
        }
    }
    largest
}
