//! The new dataset's pages, bottom-up: heights as planned, slots by what was made of the pages
//! below, bounds derived from both.

use super::PullError;
use super::frame::Frame;
use super::plan::{CORNERS, Fate, Node, Plan, children, slot_corners};
use super::spool::Records;
use escarp_dataset::{FamilyBytes, FamilyId};
use escarp_proto::geometry::{GridLevels, PAGE_CELLS, PAGE_SAMPLES, PAGE_SLOTS, PageId, Slot};
use escarp_proto::page::{
    ChildSlot, Codec, PAGE_AREA, Page, Range, Record, implied_cell, implied_slot,
};
use std::collections::HashMap;

/// What was made of a page.
#[derive(Debug, Clone)]
pub(super) struct Made {
    /// What the page above says of it.
    pub(super) slot: ChildSlot,
    /// Its record, if one is stored.
    pub(super) record: Option<Vec<u8>>,
}

/// What is known of all that was made.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tally {
    /// The largest distance from the server's surface, in quanta.
    pub(super) error: u32,
    /// All heights.
    pub(super) heights: Range,
    /// Samples with data, each counted where it is not on the page's north or east side.
    pub(super) samples: u64,
}

impl Tally {
    pub(super) const NOTHING: Tally = Tally {
        error: 0,
        heights: Range::EMPTY,
        samples: 0,
    };

    pub(super) fn and(self, other: Tally) -> Tally {
        Tally {
            error: self.error.max(other.error),
            heights: self.heights.union(other.heights),
            samples: self.samples + other.samples,
        }
    }
}

/// Pages of the new grid by name.
pub(super) type MadePages = HashMap<PageId, Made>;

/// A page with the records of those below it.
pub(super) struct Built {
    pub(super) made: Made,
    pub(super) family: Option<FamilyBytes>,
    pub(super) tally: Tally,
}

impl Plan {
    /// Makes a page that is stored, from what was made of the stored pages below it.
    ///
    /// # Errors
    /// [`PullError`] if heights or slots are out of range, which takes a lying server.
    pub(super) fn build(
        &self,
        node: &Node,
        codec: Codec,
        below: impl Fn(PageId) -> Option<Made>,
    ) -> Result<Built, PullError> {
        let old = node.page.id();
        let new = self.frame.renamed(old).ok_or_else(|| {
            PullError::Contradiction(format!("page {old} is not in the new grid"))
        })?;
        let mut tally = self.tally_of(node);
        let mut records = Vec::new();
        let mut slots = None;
        if !node.page.is_finest() {
            let mut told = Box::new([ChildSlot::Empty; PAGE_SLOTS]);
            for slot in (0..=u8::MAX).map(Slot::from_index) {
                let Some(child) = old.child(slot) else {
                    continue;
                };
                told[slot.index()] = match self.fate(child) {
                    Fate::Empty => ChildSlot::Empty,
                    Fate::Implied(error) => {
                        tally.error = tally.error.max(error);
                        tally.samples += self.owned(child);
                        let corners = slot_corners(slot).map(|corner| node.heights[corner]);
                        implied_cell(corners, self.frame.levels_from(child.level()))
                    }
                    Fate::Fetched | Fate::Made => {
                        let made = below(child).ok_or_else(|| {
                            PullError::Contradiction(format!("nothing was made of page {child}"))
                        })?;
                        records.extend(made.record.map(|record| (slot, record)));
                        made.slot
                    }
                };
            }
            slots = Some(told);
        }
        let valid = self.valid(node);
        let made = make(
            new,
            self.frame.new,
            codec,
            (node.heights.clone(), valid),
            slots,
        )?;
        Ok(Built {
            made,
            family: FamilyBytes::encode(FamilyId::below(new), &records),
            tally,
        })
    }

    /// Makes a parent of finest pages, with these.
    pub(super) fn build_parent(
        &self,
        parent: PageId,
        records: &Records,
        codec: Codec,
    ) -> Result<Built, PullError> {
        let missing = || PullError::Contradiction(format!("page {parent} is not known"));
        let own = self.nodes.get(&parent).ok_or_else(missing)?;
        let mut below = HashMap::new();
        let mut tally = Tally::NOTHING;
        for child in children(parent) {
            if let Some(node) = self.planned(child, records)? {
                let built = self.build(&node, codec, |_| None)?;
                tally = tally.and(built.tally);
                below.insert(child, built.made);
            }
        }
        let mut built = self.build(own, codec, |child| below.get(&child).cloned())?;
        built.tally = built.tally.and(tally);
        Ok(built)
    }

    /// Which samples have data in the region; `None` if all have.
    fn valid(&self, node: &Node) -> Option<Box<[bool; PAGE_AREA]>> {
        let valid: Box<[bool; PAGE_AREA]> = Box::new(std::array::from_fn(|sample| {
            node.page.is_valid(sample) && self.is_inside(node.page.id(), sample)
        }));
        valid.iter().any(|&valid| !valid).then_some(valid)
    }

    fn is_inside(&self, page: PageId, sample: usize) -> bool {
        let (x, y) = self.frame.old.page_origin(page);
        let stride = self.frame.old.page_stride(page);
        let at = |from: u32, i: usize| from + i as u32 * stride;
        let (column, row) = (sample % PAGE_SAMPLES, sample / PAGE_SAMPLES);
        self.frame.region.holds(at(x, column), at(y, row))
    }

    fn tally_of(&self, node: &Node) -> Tally {
        let id = node.page.id();
        let inside = |&sample: &usize| node.page.is_valid(sample) && self.is_inside(id, sample);
        let heights = (0..PAGE_AREA).filter(inside);
        let samples = match node.page.is_finest() {
            true => (0..PAGE_AREA)
                .filter(|&sample| self.is_owned(id, sample))
                .filter(inside)
                .count() as u64,
            false => 0,
        };
        Tally {
            error: node.most_moved(),
            heights: heights.fold(Range::EMPTY, |range, i| range.with(node.heights[i])),
            samples,
        }
    }

    /// Whether a sample of a finest page is counted there: not on its north or east side, but where
    /// the data ends.
    fn is_owned(&self, page: PageId, sample: usize) -> bool {
        let (x, y) = self.frame.old.page_origin(page);
        let (column, row) = (sample % PAGE_SAMPLES, sample / PAGE_SAMPLES);
        let [last_x, last_y] = self.frame.last();
        (column < PAGE_CELLS || x + PAGE_CELLS as u32 == last_x)
            && (row < PAGE_CELLS || y + PAGE_CELLS as u32 == last_y)
    }

    /// Samples that are counted in a page of which nothing is stored.
    pub(super) fn owned(&self, page: PageId) -> u64 {
        let (x, y) = self.frame.old.page_origin(page);
        let cells = self.frame.old.square_cells(page.level());
        let [last_x, last_y] = self.frame.last();
        let along = |from: u32, last: u32| u64::from(cells) + u64::from(from + cells == last);
        along(x, last_x) * along(y, last_y)
    }
}

impl Frame {
    /// The last column and row of the old grid that the new dataset has.
    fn last(&self) -> [u32; 2] {
        [0, 1].map(|axis| self.shift[axis] + self.samples[axis] - 1)
    }
}

/// A page of the new grid as a build makes it: stored unless the page above says it all.
pub(super) fn make(
    id: PageId,
    grid: GridLevels,
    codec: Codec,
    (heights, valid): (Box<[i32; PAGE_AREA]>, Option<Box<[bool; PAGE_AREA]>>),
    slots: Option<Box<[ChildSlot; PAGE_SLOTS]>>,
) -> Result<Made, PullError> {
    if id != PageId::ROOT
        && valid.is_none()
        && let Some(slot) = implied_slot(id, grid, &heights, slots.as_deref())
    {
        return Ok(Made { slot, record: None });
    }
    let lone = match (&slots, &valid) {
        // Samples without a triangle are kept, too.
        (None, Some(valid)) => (0..PAGE_AREA)
            .filter(|&sample| valid[sample])
            .fold(Range::EMPTY, |range, i| range.with(heights[i])),
        _ => Range::EMPTY,
    };
    let (page, slot) = Page::with_slot(id, heights, valid, slots)?;
    let slot = match slot {
        ChildSlot::Empty if !lone.is_empty() => ChildSlot::Mixed(lone),
        slot => slot,
    };
    let is_stored = slot.has_record() || id == PageId::ROOT;
    let record = is_stored.then(|| Record::encode(&page, codec).bytes().to_vec());
    Ok(Made { slot, record })
}

/// The pages above the base, made anew from the corners of what is below, level by level up to the
/// root; `append` takes the families.
pub(super) fn build_above(
    plan: &Plan,
    codec: Codec,
    mut below: MadePages,
    append: &mut dyn FnMut(&FamilyBytes) -> Result<(), PullError>,
) -> Result<MadePages, PullError> {
    let frame = &plan.frame;
    let corners = base_corners(plan);
    let mut level = frame.new_base();
    while level > 0 {
        level -= escarp_proto::geometry::PAGE_LEVELS;
        let mut families: HashMap<PageId, Vec<(Slot, Made)>> = HashMap::new();
        for (child, made) in below {
            if let Some((parent, slot)) = child.parent() {
                families.entry(parent).or_default().push((slot, made));
            }
        }
        below = MadePages::new();
        for (parent, mut children) in families {
            children.sort_by_key(|(slot, _)| *slot);
            let mut slots = Box::new([ChildSlot::Empty; PAGE_SLOTS]);
            let mut records = Vec::new();
            for (slot, made) in children {
                slots[slot.index()] = made.slot;
                records.extend(made.record.map(|record| (slot, record)));
            }
            if let Some(family) = FamilyBytes::encode(FamilyId::below(parent), &records) {
                append(&family)?;
            }
            let samples = samples_above(frame, parent, &corners);
            let made = make(parent, frame.new, codec, samples, Some(slots))?;
            below.insert(parent, made);
        }
    }
    Ok(below)
}

/// Heights at the corners of the base pages, by column and row of the old grid.
fn base_corners(plan: &Plan) -> HashMap<(u32, u32), i32> {
    let mut corners = HashMap::new();
    let frame = &plan.frame;
    let cells = frame.old.square_cells(frame.base);
    for id in frame.pages(frame.base) {
        let (x, y) = frame.old.page_origin(id);
        let places = [(0, 0), (cells, 0), (0, cells), (cells, cells)];
        let known: [Option<i32>; 4] = match (plan.nodes.get(&id), id.parent()) {
            (Some(node), _) => CORNERS.map(|at| node.page.is_valid(at).then(|| node.heights[at])),
            (None, Some((parent, slot))) => slot_corners(slot).map(|at| {
                let above = plan.above.get(&parent)?;
                above.is_valid(at).then(|| above.height(at))
            }),
            (None, None) => [None; 4],
        };
        for ((dx, dy), height) in places.into_iter().zip(known) {
            let place = (x + dx, y + dy);
            if let Some(height) = height.filter(|_| frame.region.holds(place.0, place.1)) {
                corners.insert(place, height);
            }
        }
    }
    corners
}

fn samples_above(
    frame: &Frame,
    page: PageId,
    corners: &HashMap<(u32, u32), i32>,
) -> (Box<[i32; PAGE_AREA]>, Option<Box<[bool; PAGE_AREA]>>) {
    let (x, y) = frame.new.page_origin(page);
    let stride = frame.new.page_stride(page);
    let at = |sample: usize| {
        let along = |from: u32, shift: u32, i: usize| from + shift + i as u32 * stride;
        let column = along(x, frame.shift[0], sample % PAGE_SAMPLES);
        let row = along(y, frame.shift[1], sample / PAGE_SAMPLES);
        corners.get(&(column, row)).copied()
    };
    let samples: Box<[Option<i32>; PAGE_AREA]> = Box::new(std::array::from_fn(at));
    let holes = samples.iter().any(Option::is_none);
    let valid = holes.then(|| Box::new(samples.map(|sample| sample.is_some())));
    (Box::new(samples.map(|sample| sample.unwrap_or(0))), valid)
}
