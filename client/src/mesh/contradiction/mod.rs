//! A page held against what is known of it already: the slot and the corners in the page above,
//! and the samples that it shares with the pages beside it. An honest server never trips a check.
//!
//! What a slot says is derived from the whole page below it, and rounded up ([`Bounds::slot`]). So
//! a whole page is held against it exactly. Of a page that is not whole, each vertex lies within
//! the slot's bound of the cell's two triangles, and so does what is said of the parts to come, as
//! both are part of what the bound was derived from.

#[cfg(test)]
mod tests;

use super::surface::{Index, LinkError, Surface};
use escarp_proto::geometry::{Edge, PAGE_CELLS, PAGE_SAMPLES, PageId, Slot};
use escarp_proto::page::{
    Bounds, BoxError, ChildSlot, Kind, MAX_SPAN, PAGE_AREA, Page, Range, implied_heights,
    level_step,
};
use thiserror::Error;

/// What a page says that cannot be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum Contradiction {
    /// A corner is a sample of the page above.
    #[error("a corner has height {found}, and {expected} in the page above it")]
    Corner {
        /// Its height, quanta.
        found: i32,
        /// That in the page above, quanta.
        expected: i32,
    },
    /// Data at a corner where the page above has a hole, or the other way round.
    #[error("a corner is a hole in one of it and the page above it, and not in the other")]
    CornerHole,
    /// It is farther from the two triangles that stand for it than the page above says.
    #[error("it is {found} quanta off, and the page above it promises {promised}")]
    Error {
        /// How far it is off at least, quanta.
        found: u32,
        /// The most that it may be, quanta.
        promised: u32,
    },
    /// Its heights leave the range that the page above gives them.
    #[error("its heights are {}..={}, and the page above it promises {}..={}",
        found.lo, found.hi, promised.lo, promised.hi)]
    Range {
        /// Its range of heights, quanta.
        found: Range,
        /// The range that it may have, quanta.
        promised: Range,
    },
    /// Holes, or an outline, where there should be none, or none where there should be.
    #[error("the page above it says {promised}, and it {found}")]
    Kind {
        /// What the page above says.
        promised: &'static str,
        /// What the page has.
        found: &'static str,
    },
    /// A cell of which it says itself that there is surface everywhere has a corner without.
    #[error("it has a hole at the corner of a cell that it says is full")]
    OwnHole,
    /// A sample that it shares with a page beside it has another height there.
    #[error("it shares a sample with page {beside}: height {found}, and {expected} there")]
    Border {
        /// The page beside it.
        beside: PageId,
        /// Its height, quanta.
        found: i32,
        /// That in the page beside it, quanta.
        expected: i32,
    },
    /// A sample that it shares with a page beside it is a hole in one of the two.
    #[error("it shares a sample with page {beside} that is a hole in one of the two only")]
    BorderHole {
        /// The page beside it.
        beside: PageId,
    },
}

/// What is known of a page before it comes: from the page above, if there is one.
#[derive(Debug, Clone, Copy)]
pub(super) struct Known {
    pub(super) parent: Option<(Index, Slot)>,
    pub(super) promise: Option<BoxError>,
}

impl Surface {
    /// The bounds of a page that contradicts nothing that is known.
    ///
    /// # Errors
    /// The first contradiction.
    pub(super) fn vetted_bounds(&self, page: &Page, known: Known) -> Result<Bounds, LinkError> {
        self.vet(page, known)
            .map_err(|what| LinkError::Contradiction {
                page: page.id(),
                what,
            })
    }

    fn vet(&self, page: &Page, known: Known) -> Result<Bounds, Contradiction> {
        let (Some((parent, slot)), Some(promise)) = (known.parent, known.promise) else {
            return Ok(Bounds::derive(page, None));
        };
        let above = &self.node(parent).page;
        check_corners(page, above, slot)?;
        self.check_borders(page, known)?;
        bounds_within(page, above.slot(slot), promise)
    }

    /// The samples that neighbouring pages share are the same.
    fn check_borders(&self, page: &Page, known: Known) -> Result<(), Contradiction> {
        for edge in Edge::ALL {
            let beside = page.id().neighbour(edge);
            let Some(&index) = beside.and_then(|id| self.by_id.get(&id)) else {
                continue;
            };
            let node = self.node(index);
            // Below an empty cell nothing is stored, so that there are no samples to compare.
            let same_holes = self.is_stored(known.parent) && self.is_stored(node.parent);
            check_border(page, &node.page, edge, same_holes)?;
        }
        Ok(())
    }

    fn is_stored(&self, parent: Option<(Index, Slot)>) -> bool {
        parent.is_none_or(|(index, slot)| self.node(index).page.slot(slot).has_record())
    }
}

fn check_corners(page: &Page, above: &Page, slot: Slot) -> Result<(), Contradiction> {
    let (column, row) = slot.position();
    for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let there = (row + y) * PAGE_SAMPLES + column + x;
        let here = (y * PAGE_SAMPLES + x) * PAGE_CELLS;
        match (page.is_valid(here), above.is_valid(there)) {
            (true, true) if page.height(here) != above.height(there) => {
                return Err(Contradiction::Corner {
                    found: page.height(here),
                    expected: above.height(there),
                });
            }
            (own, other) if own != other && above.slot(slot).has_record() => {
                return Err(Contradiction::CornerHole);
            }
            _ => {}
        }
    }
    Ok(())
}

fn check_border(
    page: &Page,
    beside: &Page,
    edge: Edge,
    same_holes: bool,
) -> Result<(), Contradiction> {
    let step = level_step(page.depth()).max(level_step(beside.depth()));
    let at = |edge: Edge, i: usize| match edge {
        Edge::East => i * PAGE_SAMPLES + PAGE_CELLS,
        Edge::West => i * PAGE_SAMPLES,
        Edge::North => PAGE_AREA - PAGE_SAMPLES + i,
        Edge::South => i,
    };
    for i in (0..PAGE_SAMPLES).step_by(step) {
        let (here, there) = (at(edge, i), at(edge.opposite(), i));
        match (page.is_valid(here), beside.is_valid(there)) {
            (true, true) if page.height(here) != beside.height(there) => {
                return Err(Contradiction::Border {
                    beside: beside.id(),
                    found: page.height(here),
                    expected: beside.height(there),
                });
            }
            (own, other) if own != other && same_holes => {
                return Err(Contradiction::BorderHole {
                    beside: beside.id(),
                });
            }
            _ => {}
        }
    }
    Ok(())
}

/// The bounds of a page, which are within what the page above says of it.
fn bounds_within(page: &Page, slot: ChildSlot, promise: BoxError) -> Result<Bounds, Contradiction> {
    let whole = page.parts() == page.last_part();
    let kind = |promised, found| Err(Contradiction::Kind { promised, found });
    match slot {
        ChildSlot::Full(_) | ChildSlot::Cut(_) if page.has_holes() => {
            kind("that there is surface everywhere", "has holes")
        }
        ChildSlot::Full(error) | ChildSlot::Cut(error) if whole => {
            whole_bounds(page, error.bound(), promise)
        }
        ChildSlot::Full(error) | ChildSlot::Cut(error) => {
            check_vertices(page, error.bound())?;
            Ok(Bounds::derive(page, Some(promise)))
        }
        ChildSlot::Mixed(_) if !page.has_holes() => {
            kind("that an outline crosses it", "has no holes")
        }
        ChildSlot::Mixed(range) => {
            if whole {
                check_range(page, range)?;
            }
            Ok(Bounds::derive(page, Some(promise)))
        }
        ChildSlot::Empty => {
            let bounds = Bounds::derive(page, Some(promise));
            match bounds.box_error(0, 0, 0).kind {
                Kind::Empty => Ok(bounds),
                _ => kind("that there is no surface", "has some"),
            }
        }
    }
}

/// Of a whole page without holes. No error that is derived from it is larger than what the page
/// above says, so they are derived without that cap, and the largest is looked at.
fn whole_bounds(page: &Page, promised: u32, promise: BoxError) -> Result<Bounds, Contradiction> {
    let uncapped = BoxError {
        error: MAX_SPAN,
        ..promise
    };
    let bounds = Bounds::derive(page, Some(uncapped));
    let found = bounds.box_error(0, 0, 0).error;
    if found > promised {
        return Err(Contradiction::Error { found, promised });
    }
    // Below an outline the cap may be less than the slot's bound: the range of heights there is.
    Ok(match found > promise.error {
        true => Bounds::derive(page, Some(promise)),
        false => bounds,
    })
}

/// Of a page without holes that is not whole: its vertices, and what it says of those to come.
fn check_vertices(page: &Page, promised: u32) -> Result<(), Contradiction> {
    let rest = page.rest_bound(page.depth());
    if rest > promised {
        return Err(Contradiction::Error {
            found: rest,
            promised,
        });
    }
    let corner = |x, y| page.height((y * PAGE_SAMPLES + x) * PAGE_CELLS);
    let corners = [corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1)];
    // The heights of the cell's two triangles, rounded down: vertices below these are off by less
    // than a quantum more than what is found here, which is let pass.
    let planes = implied_heights(page.id(), corners);
    let step = level_step(page.depth());
    for y in (0..PAGE_SAMPLES).step_by(step) {
        for x in (0..PAGE_SAMPLES).step_by(step) {
            let at = y * PAGE_SAMPLES + x;
            let found = page.height(at).abs_diff(planes[at]);
            if found > promised {
                return Err(Contradiction::Error { found, promised });
            }
        }
    }
    Ok(())
}

/// Of a whole page with holes: the surface in its cells.
fn check_range(page: &Page, promised: Range) -> Result<(), Contradiction> {
    let mut found = Range::EMPTY;
    for row in 0..PAGE_CELLS {
        for column in 0..PAGE_CELLS {
            found = found.union(match page.slot(Slot::at(column, row)) {
                ChildSlot::Empty => Range::EMPTY,
                ChildSlot::Mixed(range) => range,
                ChildSlot::Full(error) | ChildSlot::Cut(error) => {
                    full_cell(page, row * PAGE_SAMPLES + column)?.widened(error.bound())
                }
            });
        }
    }
    if !promised.contains(found) {
        return Err(Contradiction::Range { found, promised });
    }
    Ok(())
}

/// Range of the corners of a cell that has surface everywhere.
fn full_cell(page: &Page, south_west: usize) -> Result<Range, Contradiction> {
    let corners = [0, 1, PAGE_SAMPLES, PAGE_SAMPLES + 1].map(|corner| south_west + corner);
    match corners.iter().all(|&corner| page.is_valid(corner)) {
        true => Ok(corners
            .iter()
            .fold(Range::EMPTY, |range, &at| range.with(page.height(at)))),
        false => Err(Contradiction::OwnHole),
    }
}
