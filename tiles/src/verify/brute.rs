//! Bounds of one page against every finest sample below it, with no help from the code that
//! derived them.

use crate::dataset::{Dataset, DatasetError, PageReader};
use escarp_proto::geometry::{Edge, PAGE_CELLS, PAGE_LEVELS, PAGE_SAMPLES, PageId, Quadrant};
use escarp_proto::page::{Bounds, Kind, PAGE_AREA, Page};

const MOST_WORDS: usize = 8;

/// What a page's check found.
#[derive(Debug, Default)]
pub(super) struct Finding {
    pub(super) comparisons: u64,
    pub(super) largest_ratio: f64,
    pub(super) broken: Vec<String>,
}

impl Finding {
    pub(super) fn merge(mut self, mut other: Finding) -> Finding {
        self.comparisons += other.comparisons;
        self.largest_ratio = self.largest_ratio.max(other.largest_ratio);
        self.broken.append(&mut other.broken);
        self.broken.truncate(MOST_WORDS);
        self
    }

    /// Notes that a deviation of `scaled / scale` was promised to be at most `bound`.
    fn note(&mut self, scaled: i64, scale: i64, bound: u32, what: impl Fn() -> String) {
        self.comparisons += 1;
        let deviation = scaled.unsigned_abs() as f64 / scale as f64;
        if scaled.unsigned_abs() > u64::from(bound) * scale as u64 {
            if self.broken.len() < MOST_WORDS {
                self.broken
                    .push(format!("{}: {deviation} quanta, promised {bound}", what()));
            }
            self.largest_ratio = self.largest_ratio.max(if bound == 0 {
                f64::INFINITY
            } else {
                deviation / f64::from(bound)
            });
        } else if bound > 0 {
            self.largest_ratio = self.largest_ratio.max(deviation / f64::from(bound));
        }
    }
}

/// Holds every finest sample below a page against every triangle of the page that contains it.
pub(super) fn check_page(dataset: &Dataset, id: PageId) -> Result<Finding, DatasetError> {
    let mut reader = PageReader::new(dataset);
    let page = reader.page(id)?;
    let check = Check {
        id,
        bounds: Bounds::derive(&page, None),
        stride: i64::from(dataset.grid().page_stride(id)),
        page: &page,
    };
    let mut finding = Finding::default();
    check.below(&mut reader, id, &mut finding)?;
    Ok(finding)
}

/// Whether a sample is a corner of a valid triangle of its finest page.
fn is_on_surface(finest: &Page, i: usize) -> bool {
    let (x, y) = ((i % PAGE_SAMPLES) as isize, (i / PAGE_SAMPLES) as isize);
    let side = PAGE_SAMPLES as isize;
    let valid = |x: isize, y: isize| {
        (0..side).contains(&x) && (0..side).contains(&y) && finest.is_valid((y * side + x) as usize)
    };
    let cells = [(1, 1), (-1, 1), (-1, -1), (1, -1)];
    valid(x, y)
        && cells.into_iter().any(|(dx, dy)| match (x + y) % 2 {
            0 => valid(x + dx, y + dy) && (valid(x + dx, y) || valid(x, y + dy)),
            _ => valid(x + dx, y) && valid(x, y + dy),
        })
}

struct Check<'a> {
    id: PageId,
    page: &'a Page,
    bounds: Bounds,
    stride: i64,
}

impl Check<'_> {
    /// Walks down to the finest pages, leaving out what is empty or exact.
    fn below(
        &self,
        reader: &mut PageReader<'_>,
        id: PageId,
        finding: &mut Finding,
    ) -> Result<(), DatasetError> {
        let page = reader.page(id)?;
        if page.is_finest() {
            self.samples(&page, finding);
            return Ok(());
        }
        for i in 0..=u8::MAX {
            let slot = escarp_proto::geometry::Slot::from_index(i);
            if page.slot(slot).kind() != Kind::Empty
                && let Some(child) = id.child(slot)
            {
                self.below(reader, child, finding)?;
            }
        }
        Ok(())
    }

    fn samples(&self, finest: &Page, finding: &mut Finding) {
        let place = |id: PageId| (i64::from(id.square().x), i64::from(id.square().y));
        let (fx, fy) = place(finest.id());
        let (px, py) = place(self.id);
        let side = PAGE_CELLS as i64;
        let origin = (
            fx * side - px * side * self.stride,
            fy * side - py * side * self.stride,
        );
        for i in (0..PAGE_AREA).filter(|&i| is_on_surface(finest, i)) {
            let u = origin.0 + (i % PAGE_SAMPLES) as i64;
            let v = origin.1 + (i / PAGE_SAMPLES) as i64;
            for level in 0..=PAGE_LEVELS {
                self.sample(level, (u, v), i64::from(finest.height(i)), finding);
            }
        }
    }

    /// All squares of a level that hold a sample, at most four.
    fn sample(&self, level: u8, (u, v): (i64, i64), height: i64, finding: &mut Finding) {
        let side = (PAGE_CELLS as i64 >> level) * self.stride;
        let squares = |w: i64| {
            let at = w / side;
            let first = if w % side == 0 { at - 1 } else { at };
            first.max(0)..=at.min((1 << level) - 1)
        };
        for row in squares(v) {
            for column in squares(u) {
                let inside = (u - column * side, v - row * side);
                let square = (level, column as usize, row as usize);
                self.halves(square, side, inside, height, finding);
                if level < PAGE_LEVELS {
                    self.edges(square, side, inside, height, finding);
                }
            }
        }
    }

    /// Height of a corner, `(0 or 2, 0 or 2)`, or of the centre, `(1, 1)`, of a square.
    fn vertex(&self, (level, column, row): (u8, usize, usize), x: usize, y: usize) -> i64 {
        let side = PAGE_CELLS >> level;
        let at = |place: usize, i: usize| (2 * place + i) * side / 2;
        i64::from(self.page.height(at(row, y) * PAGE_SAMPLES + at(column, x)))
    }

    /// The square as two triangles.
    fn halves(
        &self,
        square: (u8, usize, usize),
        side: i64,
        (u, v): (i64, i64),
        height: i64,
        finding: &mut Finding,
    ) {
        let (level, column, row) = square;
        let told = self.bounds.box_error(level, column, row);
        let what = || format!("page {} level {level} square {column}, {row}", self.id);
        match told.kind {
            Kind::Empty => return,
            // On its border a sample may be on the surface of the next square alone.
            Kind::Mixed if u == 0 || u == side || v == 0 || v == side => return,
            Kind::Mixed => {
                let outside =
                    (i64::from(told.range.lo) - height).max(height - i64::from(told.range.hi));
                return finding.note(outside.max(0), 1, 0, what);
            }
            Kind::Full => {}
        }
        let rises = match level {
            0 => Quadrant::of(self.id.square().x, self.id.square().y).rises(),
            _ => (column + row) % 2 == 0,
        };
        let corner = |x, y| self.vertex(square, x, y);
        let (sw, se, nw, ne) = (corner(0, 0), corner(2, 0), corner(0, 2), corner(2, 2));
        // From the corner at the right angle, along both legs.
        let plane = if rises {
            if u >= v {
                side * se + (side - u) * (sw - se) + v * (ne - se)
            } else {
                side * nw + u * (ne - nw) + (side - v) * (sw - nw)
            }
        } else if u + v <= side {
            side * sw + u * (se - sw) + v * (nw - sw)
        } else {
            side * ne + (side - u) * (nw - ne) + (side - v) * (se - ne)
        };
        finding.note(side * height - plane, side, told.error, what);
        if level > 0 {
            let rest = self.page.rest_bound(level);
            if !self.page.has_holes() {
                finding.note(side * height - plane, side, rest, what);
            }
        }
    }

    /// The edge triangles that hold the sample.
    fn edges(
        &self,
        square: (u8, usize, usize),
        side: i64,
        (u, v): (i64, i64),
        height: i64,
        finding: &mut Finding,
    ) {
        let (level, column, row) = square;
        let told = self.bounds.square(level, column, row);
        let half = side / 2;
        let (u, v) = (u - half, v - half);
        let corner = |x, y| self.vertex(square, x, y);
        let centre = corner(1, 1);
        for edge in Edge::ALL {
            // Outwards to the edge, and along it; the corners at its two ends.
            let (out, along, from, to) = match edge {
                Edge::East => (u, v, corner(2, 0), corner(2, 2)),
                Edge::North => (v, u, corner(0, 2), corner(2, 2)),
                Edge::West => (-u, v, corner(0, 0), corner(0, 2)),
                Edge::South => (-v, u, corner(0, 0), corner(2, 0)),
            };
            if along.abs() > out || told.kinds[edge as usize] != Kind::Full {
                continue;
            }
            let plane = side * centre + out * (from + to - 2 * centre) + along * (to - from);
            let bound = told.edges[edge as usize];
            finding.note(side * height - plane, side, bound, || {
                format!(
                    "page {} level {level} square {column}, {row} {edge:?}",
                    self.id
                )
            });
        }
    }
}
