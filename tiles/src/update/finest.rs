//! The finest pages of an update: family by family, what is stored, what a patch says instead, and
//! which pages that reaches.

use super::mend::{Mended, mend, pages_at};
use super::old::{self, Pages};
use super::place::Rectangle;
use crate::build::{Band, BuildError, FAMILY_CELLS, HOLE, Level, Rows, SourceRows};
use crate::dataset::{Dataset, FilledRuns, PageReader};
use escarp_proto::geometry::{PAGE_CELLS, PageId};
use escarp_proto::page::Range;
use std::collections::HashSet;
use std::sync::Arc;

/// A source at its place in the grid.
pub(super) struct Patch<'a> {
    pub(super) place: Rectangle,
    pub(super) rows: SourceRows<'a>,
    /// Which of its samples are fill.
    pub(super) fills: Arc<FilledRuns>,
}

/// A patch's rows within a row of families, southern row first.
pub(super) struct PatchBand {
    place: Rectangle,
    heights: Vec<i32>,
    fills: Arc<FilledRuns>,
}

impl PatchBand {
    /// Columns and heights of a row of the grid, holes included.
    pub(super) fn row(&self, y: u32) -> impl Iterator<Item = (u32, i32)> {
        let width = (self.place.x[1] - self.place.x[0] + 1) as usize;
        let is_in = self.place.y[0] <= y && y <= self.place.y[1];
        let start = if is_in {
            (y - self.place.y[0]) as usize * width
        } else {
            0
        };
        let row = &self.heights[start..start + if is_in { width } else { 0 }];
        (self.place.x[0]..).zip(row.iter().copied())
    }

    /// Which samples of the patch are fill.
    pub(super) fn fills(&self) -> &FilledRuns {
        &self.fills
    }
}

impl Patch<'_> {
    /// Reads the rows that a row of families needs; `None` if the patch has none of them.
    pub(super) fn band(&mut self, row: usize) -> Result<Option<PatchBand>, BuildError> {
        let south = self.place.y[0].max((row * FAMILY_CELLS) as u32);
        let north = self.place.y[1].min(((row + 1) * FAMILY_CELLS) as u32);
        if south > north {
            return Ok(None);
        }
        let (width, n) = (self.place.x[1] - self.place.x[0] + 1, north - south + 1);
        let mut heights = vec![HOLE; width as usize * n as usize];
        let stride = width as usize;
        self.rows
            .read(south - self.place.y[0], n, stride, &mut heights)?;
        let place = Rectangle {
            x: self.place.x,
            y: [south, north],
        };
        Ok(Some(PatchBand {
            place,
            heights,
            fills: self.fills.clone(),
        }))
    }
}

/// What there is to change in a row of families.
pub(super) struct Wish<'a> {
    /// The one named first counts.
    pub(super) patches: &'a [PatchBand],
    /// Rectangles that become holes, where no patch has data.
    pub(super) removed: &'a [Rectangle],
    /// All of them together, in the whole grid.
    pub(super) reach: &'a [Rectangle],
    /// The dataset's heights.
    pub(super) range: Range,
}

/// A family of finest pages after the change.
pub(super) struct Finest {
    /// `None` if nothing changed.
    pub(super) mended: Option<Mended>,
    /// Changed samples at corners of pages, in page columns and rows, with their heights.
    pub(super) corners: Vec<((u32, u32), i32)>,
    pub(super) sums: Sums,
}

/// What changed, in figures.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sums {
    pub(super) changed: u64,
    pub(super) added: u64,
    pub(super) removed: u64,
    /// Heights within reach of the change, as they are now.
    pub(super) range: Range,
    /// Whether a sample with the lowest, the highest height of all changed.
    pub(super) extremes: [bool; 2],
}

impl Sums {
    pub(super) const NOTHING: Sums = Sums {
        changed: 0,
        added: 0,
        removed: 0,
        range: Range::EMPTY,
        extremes: [false; 2],
    };

    pub(super) fn merge(self, other: Sums) -> Sums {
        Sums {
            changed: self.changed + other.changed,
            added: self.added + other.added,
            removed: self.removed + other.removed,
            range: self.range.union(other.range),
            extremes: [0, 1].map(|i| self.extremes[i] || other.extremes[i]),
        }
    }
}

/// Columns or rows of families that samples `first..=last` reach.
pub(super) fn families([first, last]: [u32; 2], pages: usize) -> std::ops::Range<usize> {
    let families = pages.div_ceil(PAGE_CELLS);
    let first = (first as usize).saturating_sub(1) / FAMILY_CELLS;
    first..((last as usize + 1) / FAMILY_CELLS + 1).min(families)
}

/// Makes anew the pages of a family that a wish changes; `None` if it reaches none.
pub(super) fn mend_finest(
    dataset: &Dataset,
    level: &Level,
    at: (usize, usize),
    wish: &Wish<'_>,
) -> Result<Option<Finest>, BuildError> {
    let Some(pages) = reached(level, at, wish.reach) else {
        return Ok(None);
    };
    let mut reader = PageReader::new(dataset);
    let before = old::samples(&mut reader, level, at, pages)?;
    let mut after = Band {
        samples: before.samples.clone(),
        ..before
    };
    apply(wish, at, &mut after);
    let (mut dirty, mut corners) = (HashSet::new(), Vec::new());
    let mut sums = Sums::NOTHING;
    for (i, (&old, &new)) in before.samples.iter().zip(&after.samples).enumerate() {
        let x = before.west + i % before.stride;
        let y = at.1 * FAMILY_CELLS + i / before.stride;
        let is_own = is_own(level, at, (x, y));
        let in_reach = |r: &Rectangle| r.contains(x as u32, y as u32);
        if new != HOLE && is_own && wish.reach.iter().any(in_reach) {
            sums.range = sums.range.with(new);
        }
        if old == new {
            continue;
        }
        mark(level, (x, y), &mut dirty);
        if x.is_multiple_of(PAGE_CELLS) && y.is_multiple_of(PAGE_CELLS) {
            let corner = ((x / PAGE_CELLS) as u32, (y / PAGE_CELLS) as u32);
            corners.push((corner, new));
        }
        if is_own {
            sums.changed += 1;
            sums.added += u64::from(old == HOLE);
            sums.removed += u64::from(new == HOLE);
            sums.extremes[0] |= old == wish.range.lo;
            sums.extremes[1] |= old == wish.range.hi;
        }
    }
    let is_dirty = |page: PageId| dirty.contains(&page);
    let mended = match dirty.is_empty() {
        true => None,
        false => Some(mend(
            dataset,
            &mut reader,
            level,
            at,
            (&after, None),
            is_dirty,
        )?),
    };
    Ok(Some(Finest {
        mended,
        corners,
        sums,
    }))
}

/// The pages of a family within one sample of a rectangle, at least; `None` if there are none.
fn reached(level: &Level, (column, row): (usize, usize), reach: &[Rectangle]) -> Option<Pages> {
    let (columns, rows) = level.pages();
    let span = |[first, last]: [u32; 2], family: usize, count: usize| {
        let low = pages_at((first as usize).saturating_sub(1), count).start;
        let high = pages_at(last as usize + 1, count).end;
        let own = family * PAGE_CELLS..((family + 1) * PAGE_CELLS).min(count);
        let (low, high) = (low.max(own.start), high.min(own.end));
        (low < high).then_some([low, high])
    };
    let spans = reach
        .iter()
        .filter_map(|r| Some((span(r.x, column, columns)?, span(r.y, row, rows)?)));
    let union = |a: [usize; 2], b: [usize; 2]| [a[0].min(b[0]), a[1].max(b[1])];
    let (x, y) = spans.reduce(|a, b| (union(a.0, b.0), union(a.1, b.1)))?;
    Some(Pages { x, y })
}

/// Makes the samples of a band what they are to be.
fn apply(wish: &Wish<'_>, (_, row): (usize, usize), band: &mut Band) {
    let south = row * FAMILY_CELLS;
    let east = band.west + band.stride - 1;
    let within = |place: &Rectangle| {
        let x = (place.x[0] as usize).max(band.west)..=(place.x[1] as usize).min(east);
        let y = (place.y[0] as usize).max(south)..=(place.y[1] as usize).min(south + FAMILY_CELLS);
        (x, y)
    };
    for place in wish.removed {
        let (x, y) = within(place);
        for y in y.filter(|_| !x.is_empty()) {
            let start = (y - south) * band.stride + x.start() - band.west;
            band.samples[start..][..x.end() - x.start() + 1].fill(HOLE);
        }
    }
    for patch in wish.patches.iter().rev() {
        let (x, y) = within(&patch.place);
        let width = (patch.place.x[1] - patch.place.x[0] + 1) as usize;
        for y in y {
            let from = (y - patch.place.y[0] as usize) * width;
            for x in x.clone() {
                let height = patch.heights[from + x - patch.place.x[0] as usize];
                if height != HOLE {
                    band.samples[(y - south) * band.stride + x - band.west] = height;
                }
            }
        }
    }
}

/// Whether a sample counts as this family's: of those that share it, the one to the north-east.
fn is_own(level: &Level, (column, row): (usize, usize), (x, y): (usize, usize)) -> bool {
    let (columns, rows) = level.pages();
    let owner = |at: usize, pages: usize| (at / FAMILY_CELLS).min((pages - 1) / PAGE_CELLS);
    (owner(x, columns), owner(y, rows)) == (column, row)
}

/// Notes the pages that a changed sample reaches: those that have it, and those for which it may
/// decide whether a sample is on a surface.
fn mark(level: &Level, (x, y): (usize, usize), dirty: &mut HashSet<PageId>) {
    let (columns, rows) = level.pages();
    let near = |at: usize, count: usize| {
        let last = pages_at(at + 1, count).end;
        pages_at(at.saturating_sub(1), count).start..last
    };
    for row in near(y, rows) {
        for column in near(x, columns) {
            dirty.extend(PageId::new(level.level(), column as u32, row as u32));
        }
    }
}
