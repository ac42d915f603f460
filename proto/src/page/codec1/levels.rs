//! Predictions, and how large their residuals are expected to be.
//!
//! A level's vertices come in three phases. Centres are predicted from the coarser vertices alone.
//! Vertices on the page's border follow, each from the vertices of its own edge, so that both
//! pages that share it do the same. The other edge vertices have four neighbours at one step: two
//! coarser vertices and two centres.
//!
//! ```text
//! C . C . C    C: coarser vertices     centre: from 4 C, and 8 C around them
//! . m . m .    m: centres              edge:   from 2 C and 2 m, and 8 of both around them
//! C . C . C
//! ```
//!
//! The filter is the fourth-order one on the quincunx lattice (Kovacevic and Sweldens, "Wavelet
//! families of increasing order in arbitrary dimensions", 2000): `(10 * near - far) / 32`. What it
//! needs beyond the page is extrapolated. All sums wrap: they are the same on every machine, and
//! where heights are so large that they do wrap, only the prediction is bad. Rows are computed
//! eight lanes at a time, whether or not there are so many vertices.

use crate::geometry::PAGE_SAMPLES;
use crate::page::PAGE_AREA;

/// Of a plane, which has a ring of extrapolated samples around up to 9 x 9 known ones.
const ROWS: usize = 11;
/// The same, and one more for alignment.
const COLUMNS: usize = 12;
/// Vertices of a row that are computed together.
pub(super) const LANES: usize = 8;
/// No feature counts for more, so that their weighted sum stays below `2^32`.
const MOST: i32 = 1 << 20;
/// Steeper ground is not more so as far as rounding goes.
const STEEP: i32 = 4;

type Plane = [[i32; COLUMNS]; ROWS];

const BLANK: Plane = [[0; COLUMNS]; ROWS];

/// Predictions of up to eight vertices, and the expected magnitudes of their residuals in 64ths.
#[derive(Clone, Copy, Default)]
pub(super) struct Row {
    pub(super) predicted: [i32; LANES],
    pub(super) expected: [u32; LANES],
}

/// Vertices of a line, once they are known.
#[derive(Default)]
pub(super) struct Line {
    pub(super) heights: [i32; LANES],
    pub(super) residuals: [i32; LANES],
}

impl Line {
    /// The largest magnitude of a residual, and of one before.
    #[inline(always)]
    pub(super) fn largest(&self, before: u32) -> u32 {
        let sizes = self.residuals.map(i32::unsigned_abs);
        sizes.into_iter().fold(before, u32::max)
    }
}

/// What a residual's magnitude is expected from.
struct Features {
    /// How far the near vertices are from a plane.
    flat: i32,
    /// How far the prediction is from their mean.
    bent: i32,
    /// How large residuals near by are.
    sizes: i32,
    /// How steep the ground is.
    steep: i32,
}

/// Weights of the features, of steepness up to [`STEEP`], which is what rounding depends on, and
/// of one, in 256ths; a row a level. They were found by relative least squares, on mountains,
/// hills and lidar at several steps of height, and rounded to what suits all of them.
type Weights = [[i32; 6]; 4];

const CENTRE_WEIGHTS: Weights = [
    [28, 0, 6, 12, 8, 16],
    [22, 0, 6, 6, 8, 6],
    [20, 1, 8, 3, 10, 2],
    [18, 1, 8, 3, 12, 1],
];

/// Flat is the bend along the border, bent the residual of the centre beside.
const BORDER_WEIGHTS: Weights = [
    [0, 56, 4, 18, 8, 16],
    [7, 62, 8, 8, 8, 8],
    [6, 62, 8, 5, 10, 2],
    [6, 56, 8, 5, 12, 1],
];

/// There is no such vertex at the first level.
const EDGE_WEIGHTS: Weights = [
    [0; 6],
    [18, 1, 16, 6, 8, 8],
    [15, 1, 20, 3, 10, 2],
    [13, 1, 18, 3, 14, 1],
];

/// The state between levels: known samples, and the magnitudes of their residuals.
pub(super) struct Levels {
    /// Cells on a side of the coarser grid.
    cells: usize,
    coarse: Plane,
    coarse_sizes: Plane,
    centres: Plane,
    centre_sizes: Plane,
    /// Vertices between western and eastern neighbours, and between southern and northern ones.
    rows: Plane,
    row_sizes: Plane,
    columns: Plane,
    column_sizes: Plane,
}

/// The vertices of a level that are coded together, in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Phase {
    Centres,
    South,
    North,
    West,
    East,
    Rows,
    Columns,
}

impl Phase {
    pub(super) const ALL: [Phase; 7] = [
        Phase::Centres,
        Phase::South,
        Phase::North,
        Phase::West,
        Phase::East,
        Phase::Rows,
        Phase::Columns,
    ];

    /// Lines of this phase at a level of so many cells, and vertices of each.
    pub(super) const fn lines(self, cells: usize) -> (usize, usize) {
        match self {
            Phase::Centres => (cells, cells),
            Phase::South | Phase::North | Phase::West | Phase::East => (1, cells),
            Phase::Rows => (cells - 1, cells),
            Phase::Columns => (cells, cells - 1),
        }
    }

    /// The page's sample that is the first of a line, and how far apart they are.
    pub(super) const fn samples(self, cells: usize, line: usize, step: usize) -> (usize, usize) {
        let (x, y) = self.place(cells, line, 0);
        let first = (y * PAGE_SAMPLES + x) * step;
        match self {
            Phase::West | Phase::East => (first, 2 * step * PAGE_SAMPLES),
            _ => (first, 2 * step),
        }
    }

    /// Column and row of a vertex, in steps of the level.
    pub(super) const fn place(self, cells: usize, line: usize, i: usize) -> (usize, usize) {
        match self {
            Phase::Centres => (2 * i + 1, 2 * line + 1),
            Phase::South => (2 * i + 1, 0),
            Phase::North => (2 * i + 1, 2 * cells),
            Phase::West => (0, 2 * i + 1),
            Phase::East => (2 * cells, 2 * i + 1),
            Phase::Rows => (2 * i + 1, 2 * line + 2),
            Phase::Columns => (2 * i + 2, 2 * line + 1),
        }
    }
}

#[inline(always)]
fn size(v: i32) -> i32 {
    v.wrapping_abs() & i32::MAX
}

/// The expected magnitude, in 64ths.
#[inline(always)]
fn expect(weights: &[i32; 6], features: &Features) -> u32 {
    let Features {
        flat,
        bent,
        sizes,
        steep,
    } = features;
    let features = [*flat, *bent, *sizes, *steep, (*steep).min(STEEP), 1];
    let mut sum: u32 = 0;
    for (feature, weight) in features.into_iter().zip(weights) {
        sum += (feature.min(MOST) * weight) as u32;
    }
    sum >> 2
}

/// The prediction from the sums of 4 near and 8 far vertices, and twice its distance from the
/// near ones' mean in 16ths.
#[inline(always)]
fn filter(near: i32, far: i32) -> (i32, i32) {
    let bent = near.wrapping_mul(2).wrapping_sub(far);
    let sum = near.wrapping_mul(8).wrapping_add(bent).wrapping_add(16);
    (sum >> 5, size(bent))
}

macro_rules! sum {
    ($first:expr $(, $next:expr)* $(,)?) => { $first$(.wrapping_add($next))* };
}

impl Levels {
    /// Before anything is known.
    pub(super) fn new() -> Levels {
        Levels {
            cells: 1,
            coarse: BLANK,
            coarse_sizes: BLANK,
            centres: BLANK,
            centre_sizes: BLANK,
            rows: BLANK,
            row_sizes: BLANK,
            columns: BLANK,
            column_sizes: BLANK,
        }
    }

    /// Starts from the corners: south-west, south-east, north-west, north-east.
    pub(super) fn start(&mut self, [sw, se, nw, ne]: [i32; 4]) {
        self.coarse[1][1..3].copy_from_slice(&[sw, se]);
        self.coarse[2][1..3].copy_from_slice(&[nw, ne]);
        let rises = [(sw, se), (nw, ne), (sw, nw), (se, ne)]
            .map(|(a, b)| size(a.wrapping_sub(b)).min(MOST));
        for row in &mut self.coarse_sizes[1..3] {
            row[1..3].fill(rises.into_iter().sum::<i32>() / 4);
        }
    }

    /// Cells on a side of the coarser grid: 1 at level 1, 8 at level 4.
    pub(super) const fn cells(&self) -> usize {
        self.cells
    }

    /// To be called before a level: extrapolates the coarser samples by one beyond the page.
    pub(super) fn open(&mut self) {
        let last = self.cells + 1;
        let beyond = |edge: i32, inner: i32| edge.wrapping_mul(2).wrapping_sub(inner);
        for row in &mut self.coarse[1..=last] {
            row[0] = beyond(row[1], row[2]);
            row[last + 1] = beyond(row[last], row[last - 1]);
        }
        for i in 0..=last + 1 {
            self.coarse[0][i] = beyond(self.coarse[1][i], self.coarse[2][i]);
            self.coarse[last + 1][i] = beyond(self.coarse[last][i], self.coarse[last - 1][i]);
        }
    }

    /// To be called after the border: extrapolates the centres through it.
    fn reflect(&mut self) {
        let last = self.cells;
        let through = |edge: i32, inner: i32| edge.wrapping_mul(2).wrapping_sub(inner);
        for i in 1..=last {
            self.centres[0][i] = through(self.rows[0][i], self.centres[1][i]);
            self.centres[last + 1][i] = through(self.rows[last][i], self.centres[last][i]);
            self.centres[i][0] = through(self.columns[i][0], self.centres[i][1]);
            self.centres[i][last + 1] = through(self.columns[i][last], self.centres[i][last]);
        }
    }

    /// Predictions of a line's vertices. Those of the phases before must have been put.
    pub(super) fn predict(&mut self, phase: Phase, line: usize) -> Row {
        if phase == Phase::Rows && line == 0 {
            self.reflect();
        }
        match self.cells {
            1 => self.predict_level::<0, 4>(phase, line),
            2 => self.predict_level::<1, 4>(phase, line),
            4 => self.predict_level::<2, 4>(phase, line),
            _ => self.predict_level::<3, LANES>(phase, line),
        }
    }

    /// With the level known at compile time, weights are shifts and sums.
    fn predict_level<const L: usize, const N: usize>(&self, phase: Phase, line: usize) -> Row {
        match phase {
            Phase::Centres => self.predict_centres::<L, N>(line),
            Phase::Rows => self.predict_row::<L, N>(line + 1),
            Phase::Columns => self.predict_column::<L, N>(line),
            _ => self.predict_border::<L, N>(phase),
        }
    }

    fn predict_centres<const L: usize, const N: usize>(&self, line: usize) -> Row {
        let [south, a, b, north] = [0, 1, 2, 3].map(|i| &self.coarse[line + i]);
        let (sizes_a, sizes_b) = (&self.coarse_sizes[line + 1], &self.coarse_sizes[line + 2]);
        let weights = const { &CENTRE_WEIGHTS[L] };
        lanes::<N>(|i| {
            let near = sum!(a[i + 1], a[i + 2], b[i + 1], b[i + 2]);
            let beside = sum!(a[i], a[i + 3], b[i], b[i + 3]);
            let far = sum!(
                beside,
                south[i + 1],
                south[i + 2],
                north[i + 1],
                north[i + 2]
            );
            let (predicted, bent) = filter(near, far);
            let flat = sum!(a[i + 1], b[i + 2]).wrapping_sub(sum!(a[i + 2], b[i + 1]));
            let sizes = sizes_a[i + 1] + sizes_a[i + 2] + sizes_b[i + 1] + sizes_b[i + 2];
            let steep = size(a[i + 1].wrapping_sub(b[i + 2])).min(MOST)
                + size(a[i + 2].wrapping_sub(b[i + 1])).min(MOST);
            let features = Features {
                flat: size(flat),
                bent,
                sizes,
                steep,
            };
            (predicted, expect(weights, &features))
        })
    }

    fn predict_row<const L: usize, const N: usize>(&self, row: usize) -> Row {
        let [south, own, north] = [0, 1, 2].map(|i| &self.coarse[row + i]);
        let [below, above] = [0, 1].map(|i| &self.centres[row + i]);
        let [sizes_below, sizes_above] = [0, 1].map(|i| &self.centre_sizes[row + i]);
        let sizes = &self.coarse_sizes[row + 1];
        let weights = const { &EDGE_WEIGHTS[L] };
        lanes::<N>(|i| {
            let ends = sum!(own[i + 1], own[i + 2]);
            let across = sum!(below[i + 1], above[i + 1]);
            let far = sum!(
                south[i + 1],
                south[i + 2],
                north[i + 1],
                north[i + 2],
                below[i],
                below[i + 2],
                above[i],
                above[i + 2],
            );
            let (predicted, bent) = filter(sum!(ends, across), far);
            let around =
                sizes_below[i + 1] + sizes_above[i + 1] + ((sizes[i + 1] + sizes[i + 2]) >> 1);
            let flat = size(ends.wrapping_sub(across));
            let steep = size(own[i + 1].wrapping_sub(own[i + 2])).min(MOST)
                + size(below[i + 1].wrapping_sub(above[i + 1])).min(MOST);
            let features = Features {
                flat,
                bent,
                sizes: around,
                steep,
            };
            (predicted, expect(weights, &features))
        })
    }

    fn predict_column<const L: usize, const N: usize>(&self, line: usize) -> Row {
        let [below, above] = [1, 2].map(|i| &self.coarse[line + i]);
        let [south, own, north] = [0, 1, 2].map(|i| &self.centres[line + i]);
        let own_sizes = &self.centre_sizes[line + 1];
        let [sizes_below, sizes_above] = [1, 2].map(|i| &self.coarse_sizes[line + i]);
        let weights = const { &EDGE_WEIGHTS[L] };
        lanes::<N>(|i| {
            let ends = sum!(below[i + 2], above[i + 2]);
            let across = sum!(own[i + 1], own[i + 2]);
            let far = sum!(
                below[i + 1],
                below[i + 3],
                above[i + 1],
                above[i + 3],
                south[i + 1],
                south[i + 2],
                north[i + 1],
                north[i + 2],
            );
            let (predicted, bent) = filter(sum!(ends, across), far);
            let parents = sizes_below[i + 2] + sizes_above[i + 2];
            let around = own_sizes[i + 1] + own_sizes[i + 2] + (parents >> 1);
            let flat = size(ends.wrapping_sub(across));
            let steep = size(below[i + 2].wrapping_sub(above[i + 2])).min(MOST)
                + size(own[i + 1].wrapping_sub(own[i + 2])).min(MOST);
            let features = Features {
                flat,
                bent,
                sizes: around,
                steep,
            };
            (predicted, expect(weights, &features))
        })
    }

    /// Cubic along the border.
    fn predict_border<const L: usize, const N: usize>(&self, phase: Phase) -> Row {
        let cells = 1 << L;
        type Border = [i32; ROWS];
        let row = |plane: &Plane, at: usize| std::array::from_fn(|i| plane[at][i]);
        let column = |plane: &Plane, at: usize| std::array::from_fn(|i| plane[i][at]);
        let (coarse, sizes, beside): (Border, Border, Border) = match phase {
            Phase::South => (
                row(&self.coarse, 1),
                row(&self.coarse_sizes, 1),
                row(&self.centre_sizes, 1),
            ),
            Phase::North => (
                row(&self.coarse, cells + 1),
                row(&self.coarse_sizes, cells + 1),
                row(&self.centre_sizes, cells),
            ),
            Phase::West => (
                column(&self.coarse, 1),
                column(&self.coarse_sizes, 1),
                column(&self.centre_sizes, 1),
            ),
            _ => (
                column(&self.coarse, cells + 1),
                column(&self.coarse_sizes, cells + 1),
                column(&self.centre_sizes, cells),
            ),
        };
        let weights = const { &BORDER_WEIGHTS[L] };
        lanes::<N>(|i| {
            let near = sum!(coarse[i + 1], coarse[i + 2]);
            let bent = near.wrapping_sub(sum!(coarse[i], coarse[i + 3]));
            let predicted = sum!(near.wrapping_mul(8), bent, 8) >> 4;
            let parents = sizes[i + 1] + sizes[i + 2];
            let features = Features {
                flat: size(bent),
                bent: beside[i + 1],
                sizes: parents,
                steep: size(coarse[i + 1].wrapping_sub(coarse[i + 2])),
            };
            (predicted, expect(weights, &features))
        })
    }

    /// Puts a line's vertices in their places, with the magnitudes of their residuals.
    #[inline]
    pub(super) fn put(&mut self, phase: Phase, line: usize, vertices: usize, of: &Line) {
        let cells = self.cells;
        let sizes = of.residuals.map(|residual| size(residual).min(MOST));
        let (plane, size_plane, row) = match phase {
            Phase::Centres => (&mut self.centres, &mut self.centre_sizes, line + 1),
            Phase::South => (&mut self.rows, &mut self.row_sizes, 0),
            Phase::North => (&mut self.rows, &mut self.row_sizes, cells),
            Phase::Rows => (&mut self.rows, &mut self.row_sizes, line + 1),
            Phase::Columns => (&mut self.columns, &mut self.column_sizes, line + 1),
            Phase::West | Phase::East => {
                let column = if phase == Phase::West { 0 } else { cells };
                let known = of.heights.iter().zip(&sizes).take(vertices);
                for (i, (&height, &residual)) in known.enumerate() {
                    self.columns[i + 1][column] = height;
                    self.column_sizes[i + 1][column] = residual;
                }
                return;
            }
        };
        put_lanes(&mut plane[row], vertices, &of.heights);
        put_lanes(&mut size_plane[row], vertices, &sizes);
    }

    /// Puts the known samples, which are `step` apart in the page, and `base` besides.
    pub(super) fn give(&self, heights: &mut [i32; PAGE_AREA], step: usize, base: i32) {
        if step > 1 {
            return self.give_coarse(heights, step, base);
        }
        let (rows, _) = heights.as_chunks_mut::<PAGE_SAMPLES>();
        for (y, row) in rows.iter_mut().enumerate() {
            let (even, odd) = match y % 2 {
                0 => (&self.coarse[y / 2 + 1][1..], &self.rows[y / 2]),
                _ => (&self.columns[y / 2 + 1][..], &self.centres[y / 2 + 1]),
            };
            for i in 0..LANES {
                row[2 * i] = even[i].wrapping_add(base);
                row[2 * i + 1] = odd[i + 1].wrapping_add(base);
            }
            row[2 * LANES] = even[LANES].wrapping_add(base);
        }
    }

    /// The same after a level that is closed.
    fn give_coarse(&self, heights: &mut [i32; PAGE_AREA], step: usize, base: i32) {
        for y in 0..=self.cells {
            for x in 0..=self.cells {
                let at = (y * PAGE_SAMPLES + x) * step;
                heights[at] = self.coarse[y + 1][x + 1].wrapping_add(base);
            }
        }
    }

    /// To be called after a level but the last: its vertices become coarser ones.
    pub(super) fn close(&mut self) {
        let cells = self.cells;
        // From the end, so that nothing is put where something has still to be taken.
        for j in (0..=cells).rev() {
            for i in (0..=cells).rev() {
                let (y, x) = (2 * j + 1, 2 * i + 1);
                self.coarse[y][x] = self.coarse[j + 1][i + 1];
                // Residuals shrink by half or more from one level to the next.
                self.coarse_sizes[y][x] = (self.coarse_sizes[j + 1][i + 1] + 1) >> 1;
                if i < cells {
                    self.coarse[y][x + 1] = self.rows[j][i + 1];
                    self.coarse_sizes[y][x + 1] = self.row_sizes[j][i + 1];
                }
                if j < cells {
                    self.coarse[y + 1][x] = self.columns[j + 1][i];
                    self.coarse_sizes[y + 1][x] = self.column_sizes[j + 1][i];
                }
                if i < cells && j < cells {
                    self.coarse[y + 1][x + 1] = self.centres[j + 1][i + 1];
                    self.coarse_sizes[y + 1][x + 1] = self.centre_sizes[j + 1][i + 1];
                }
            }
        }
        self.cells = 2 * cells;
    }
}

/// Puts eight numbers in a row, however many there are, but leaves what follows them: that is the
/// eastern border. What lies further is never asked for.
#[inline(always)]
fn put_lanes(row: &mut [i32; COLUMNS], vertices: usize, from: &[i32; LANES]) {
    let after = row[vertices + 1];
    row[1..=LANES].copy_from_slice(from);
    row[vertices + 1] = after;
}

#[inline(always)]
fn lanes<const N: usize>(vertex: impl Fn(usize) -> (i32, u32)) -> Row {
    let mut row = Row {
        predicted: [0; LANES],
        expected: [0; LANES],
    };
    for i in 0..N {
        (row.predicted[i], row.expected[i]) = vertex(i);
    }
    row
}
