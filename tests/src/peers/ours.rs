//! Our mesh of a window with the same tolerance everywhere, and the bounds that it rests on.

use super::right::{VertexErrors, largest_in};
use super::window::{Triangle, Window};
use crate::feed::Feed;
use crate::measure::triangles;
use crate::terrain::TempDataset;
use escarp_proto::err8::Err8;
use escarp_proto::geometry::{Edge, PAGE_LEVELS, PageId, Quadrant, Slot};
use escarp_proto::page::{Bounds, BoxError, Page, RecordHeader, last_part};
use escarp_proto::view::{FARTHEST_EYE_M, View};
use escarp_tiles::dataset::PageReader;
use escarp_tiles::process::thread_cpu;
use std::time::Duration;

/// What a tolerance is seen as, pixels: so little that the eye is so far that its distance is the
/// same everywhere, but for less than a thousandth.
const TOLERANCE_PX: f32 = 0.1;

/// What meshing came to.
#[derive(Debug)]
pub struct Meshed {
    /// The triangles over the window.
    pub triangles: Vec<Triangle>,
    /// CPU time, that of decoding and linking pages included.
    pub cpu: Duration,
    /// Bytes of the records' parts that are resident.
    pub bytes: usize,
}

/// A dataset of a window: a quantum is a metre.
pub fn dataset(window: &Window) -> TempDataset {
    let side = window.cells + 1;
    TempDataset::of(side, side, |column, row| {
        window.height((column, window.cells - row)) as f64
    })
}

/// The quadtree mesher's mesh with a tolerance, in quanta, that is the same everywhere: seen
/// straight from above, from so far that distances do not differ. Pages come with so many parts
/// more than are wished for; without their last parts bounds are less tight.
///
/// # Panics
/// If the view is refused, or the mesh does not converge.
pub fn mesh(data: &TempDataset, tolerance: f64, more_parts: u8) -> Meshed {
    let view = from_far_above(data, tolerance);
    let start = thread_cpu();
    let mut feed = Feed::new(&data.dataset);
    let stats = loop {
        let stats = feed.tree.update(&view);
        let wishes = feed.tree.wishes();
        if wishes.is_empty() {
            break stats;
        }
        for mut wish in wishes {
            let last = last_part(data.dataset.grid().is_finest(wish.page));
            wish.parts = (wish.parts + more_parts).min(last);
            feed.grant(&wish);
        }
    };
    feed.tree.triangulate();
    let cpu = thread_cpu() - start;
    assert!(stats.excess <= 1.0, "{stats:?}");
    let drawn = triangles(&feed.tree)
        .into_iter()
        .filter(|triangle| triangle.drawn);
    Meshed {
        triangles: drawn.map(|t| t.corners.map(|(x, y, _)| (x, y))).collect(),
        cpu,
        bytes: feed
            .tree
            .pages()
            .map(|page| resident_bytes(data, page))
            .sum(),
    }
}

fn resident_bytes(data: &TempDataset, page: &Page) -> usize {
    let finest = page.is_finest();
    let record = data.dataset.record(page.id()).expect("a sound record");
    record.map_or(0, |record| {
        let header = RecordHeader::read(page.id(), finest, record.bytes).expect("a header");
        header.part_bytes(0, page.parts()).expect("its parts").len()
    })
}

fn from_far_above(data: &TempDataset, tolerance: f64) -> View {
    let [x, y, _] = data
        .dataset
        .manifest()
        .extent_m()
        .map(|[lo, hi]| f64::midpoint(lo, hi));
    let mut view = View {
        eye_m: [x, y, 0.0],
        direction: [0.0, 0.0, -1.0],
        velocity_m_s: [0.0; 3],
        fov_y: 0.001,
        viewport_px: [32768; 2],
        max_screen_error_px: TOLERANCE_PX,
    };
    let height_m = view.px_per_slope() * tolerance / f64::from(TOLERANCE_PX);
    view.eye_m[2] = height_m.min(FARTHEST_EYE_M);
    view.max_screen_error_px = (view.px_per_slope() * tolerance / view.eye_m[2]) as f32;
    view.check().expect("a tolerance that can be seen");
    view
}

/// Bounds of the triangles of a window's hierarchy, quanta.
#[derive(Debug, Clone)]
pub struct TriangleBounds {
    cells: u32,
    /// Of the triangles that a vertex splits, by vertex.
    bounds: Vec<[u32; 2]>,
}

impl TriangleBounds {
    /// Vertex that splits a triangle, and which of the two that it splits this is.
    fn place(&self, [from, to, _]: &Triangle) -> (usize, usize) {
        let (x, y) = (u32::midpoint(from.0, to.0), u32::midpoint(from.1, to.1));
        let vertex = y as usize * (self.cells as usize + 1) + x as usize;
        (vertex, usize::from(from > to))
    }

    /// Bound of a triangle, its hypotenuse first.
    pub fn of(&self, triangle: &Triangle) -> u32 {
        let (vertex, side) = self.place(triangle);
        self.bounds[vertex][side]
    }

    fn insert(&mut self, triangle: &Triangle, bound: u32) {
        let (vertex, side) = self.place(triangle);
        self.bounds[vertex][side] = bound;
    }
}

/// The bounds of all triangles of a window, as client and server derive them.
///
/// # Panics
/// If pages cannot be read.
pub fn bounds(data: &TempDataset, cells: u32) -> TriangleBounds {
    let side = cells as usize + 1;
    let mut found = TriangleBounds {
        cells,
        bounds: vec![[0; 2]; side * side],
    };
    let mut reader = PageReader::new(&data.dataset);
    let mut open: Vec<(PageId, Option<BoxError>)> = vec![(PageId::ROOT, None)];
    let grid = data.dataset.grid();
    while let Some((id, promise)) = open.pop() {
        let page = reader.page(id).expect("a sound page");
        let derived = Bounds::derive(&page, promise);
        let place = (grid.page_origin(id), grid.page_stride(id));
        collect(&mut found, (id, &derived), place);
        for slot in (0..=u8::MAX).map(Slot::from_index) {
            let (column, row) = slot.position();
            let Some(child) = id.child(slot).filter(|&child| grid.holds(child)) else {
                continue;
            };
            let (x, y) = grid.page_origin(child);
            if x < cells && y < cells {
                open.push((child, Some(derived.box_error(PAGE_LEVELS, column, row))));
            }
        }
    }
    found
}

fn collect(
    found: &mut TriangleBounds,
    (id, bounds): (PageId, &Bounds),
    ((x, y), stride): ((u32, u32), u32),
) {
    let cells = found.cells;
    for level in 0..PAGE_LEVELS {
        let half = stride << (PAGE_LEVELS - 1 - level);
        for (column, row) in squares(level) {
            let centre = (
                x + (2 * column as u32 + 1) * half,
                y + (2 * row as u32 + 1) * half,
            );
            if centre.0 + half > cells || centre.1 + half > cells {
                continue;
            }
            let errors = bounds.square(level, column, row);
            let [sw, se, nw, ne] = [(0, 0), (2, 0), (0, 2), (2, 2)]
                .map(|(dx, dy)| (centre.0 - half + dx * half, centre.1 - half + dy * half));
            for (edge, [from, to]) in [
                (Edge::East, [se, ne]),
                (Edge::North, [ne, nw]),
                (Edge::West, [nw, sw]),
                (Edge::South, [sw, se]),
            ] {
                found.insert(&[from, to, centre], errors.edges[edge as usize]);
            }
            let root = id.square();
            let rises = match level {
                0 => Quadrant::of(root.x, root.y),
                _ => Quadrant::of(column as u32, row as u32),
            }
            .rises();
            let halves = match rises {
                true => [[ne, sw, se], [sw, ne, nw]],
                false => [[se, nw, sw], [nw, se, ne]],
            };
            // A square is tested as a whole.
            let whole = bounds.box_error(level, column, row).error;
            for half in &halves {
                found.insert(half, whole);
            }
        }
    }
}

fn squares(level: u8) -> impl Iterator<Item = (usize, usize)> {
    (0..1 << level).flat_map(move |row| (0..1 << level).map(move |column| (column, row)))
}

/// Errors of vertices by these bounds: with them, [`VertexErrors::mesh`] is our mesh of whole
/// pages.
pub fn errors(bounds: &TriangleBounds) -> VertexErrors {
    errors_of(bounds.cells, |side| bounds.of(side))
}

/// Errors as they would be if pages above the finest had, for each triangle, a code of its exact
/// largest deviation, as slots have of the page below.
pub fn coded_errors(window: &Window, bounds: &TriangleBounds) -> VertexErrors {
    errors_of(bounds.cells, |side| coded(window, side, bounds.of(side)))
}

fn errors_of(cells: u32, bound: impl Fn(&Triangle) -> u32) -> VertexErrors {
    VertexErrors::of(cells, |_, sides| {
        let bounds = sides.iter().flatten().map(&bound);
        f64::from(bounds.max().unwrap_or(0))
    })
}

/// The lesser of a triangle's derived bound and the code of its exact largest deviation; within
/// the finest pages the derived one, which is exact.
pub fn coded(window: &Window, triangle: &Triangle, derived: u32) -> u32 {
    let [from, to, _] = triangle;
    let side = from.0.abs_diff(to.0).max(from.1.abs_diff(to.1));
    if side <= 1 << PAGE_LEVELS {
        return derived;
    }
    let exact = largest_in(window, triangle).ceil() as u32;
    derived.min(Err8::covering(exact).map_or(derived, Err8::bound))
}
