//! Which pages are stored, and the heights that they have: what follows from the pages that are
//! known so far, and nothing else. No network, no files.

use super::PullError;
use super::frame::{Frame, Overlap};
use super::spool::Records;
use escarp_proto::geometry::{Edge, PAGE_CELLS, PAGE_SAMPLES, PAGE_SLOTS, PageId, Slot};
use escarp_proto::page::{ChildSlot, PAGE_AREA, Page, implied_heights, last_part};
use std::collections::HashMap;

/// What becomes of a page of the old grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fate {
    /// There is no surface, or it is not in the region.
    Empty,
    /// What its corners imply, at most so many quanta from the server's surface.
    Implied(u32),
    /// It is stored, and its record has to come from the server.
    Fetched,
    /// It is stored, and follows from the page above.
    Made,
}

impl Fate {
    pub(super) const fn is_stored(self) -> bool {
        matches!(self, Fate::Fetched | Fate::Made)
    }
}

/// A page that is stored.
#[derive(Debug)]
pub(super) struct Node {
    /// As the server has it.
    pub(super) page: Page,
    /// As it is stored.
    pub(super) heights: Box<[i32; PAGE_AREA]>,
}

impl Node {
    /// How far a sample was moved, in quanta.
    fn moved(&self, sample: usize) -> u32 {
        match self.page.is_valid(sample) {
            true => self.heights[sample].abs_diff(self.page.height(sample)),
            false => 0,
        }
    }

    /// The largest of all samples.
    pub(super) fn most_moved(&self) -> u32 {
        let moved = (0..PAGE_AREA).map(|sample| self.moved(sample));
        moved.max().unwrap_or(0)
    }
}

/// What is known of the pages of the region.
#[derive(Debug)]
pub(super) struct Plan {
    pub(super) frame: Frame,
    /// The allowed error, in quanta.
    pub(super) most: u32,
    /// Pages above the base, as the server has them.
    pub(super) above: HashMap<PageId, Page>,
    /// Pages from the base down.
    pub(super) nodes: HashMap<PageId, Node>,
}

/// Corner samples of a page: south-west, south-east, north-west, north-east.
pub(super) const CORNERS: [usize; 4] = [0, PAGE_CELLS, PAGE_AREA - PAGE_SAMPLES, PAGE_AREA - 1];

/// The samples of a parent at the corners of a slot.
pub(super) fn slot_corners(slot: Slot) -> [usize; 4] {
    let (column, row) = slot.position();
    let south_west = row * PAGE_SAMPLES + column;
    [0, 1, PAGE_SAMPLES, PAGE_SAMPLES + 1].map(|corner| south_west + corner)
}

/// The samples on a side of a page, corners left out.
fn side(edge: Edge) -> impl Iterator<Item = usize> {
    (1..PAGE_CELLS).map(move |i| match edge {
        Edge::East => i * PAGE_SAMPLES + PAGE_CELLS,
        Edge::West => i * PAGE_SAMPLES,
        Edge::North => PAGE_AREA - PAGE_SAMPLES + i,
        Edge::South => i,
    })
}

impl Plan {
    pub(super) fn new(frame: Frame, most: u32) -> Plan {
        Plan {
            frame,
            most,
            above: HashMap::new(),
            nodes: HashMap::new(),
        }
    }

    /// What becomes of a page, as far as its parent is known: without, nothing.
    pub(super) fn fate(&self, page: PageId) -> Fate {
        let overlap = self.frame.region.overlap(page, self.frame.old);
        if overlap == Overlap::None {
            return Fate::Empty;
        }
        let Some((parent, slot)) = page.parent() else {
            return Fate::Fetched;
        };
        if page.level() <= self.frame.base {
            let is_cut = page.level() == self.frame.base && overlap == Overlap::Part;
            return match self.fate_above(parent, slot) {
                Fate::Implied(_) if is_cut => Fate::Made,
                fate => fate,
            };
        }
        match self.fate(parent) {
            Fate::Empty => Fate::Empty,
            Fate::Implied(error) => Fate::Implied(error),
            Fate::Fetched | Fate::Made => match self.nodes.get(&parent) {
                Some(node) => self.fate_below(node, page, slot, overlap),
                None => Fate::Empty,
            },
        }
    }

    /// Down to the base, all pages are stored that the server has.
    fn fate_above(&self, parent: PageId, slot: Slot) -> Fate {
        match self.above.get(&parent).map(|page| page.slot(slot)) {
            None | Some(ChildSlot::Empty) => Fate::Empty,
            Some(told) if told.has_record() => Fate::Fetched,
            Some(_) => Fate::Implied(0),
        }
    }

    fn fate_below(&self, node: &Node, page: PageId, slot: Slot, overlap: Overlap) -> Fate {
        let told = node.page.slot(slot);
        let stored = match told.has_record() {
            true => Fate::Fetched,
            false => Fate::Made,
        };
        let error = match told {
            ChildSlot::Empty => return Fate::Empty,
            ChildSlot::Mixed(_) => return stored,
            // Its outline is not what corners can imply.
            _ if overlap == Overlap::Part => return stored,
            ChildSlot::Full(error) | ChildSlot::Cut(error) => error.bound(),
        };
        let moved = slot_corners(slot).map(|corner| node.moved(corner));
        let moved = moved.into_iter().max().unwrap_or(0);
        if stored == Fate::Made && moved == 0 {
            return Fate::Implied(0);
        }
        let rounded = u32::from(self.frame.levels_from(page.level()));
        let error = error.saturating_add(moved).saturating_add(rounded);
        match error <= self.most {
            true => Fate::Implied(error),
            false => stored,
        }
    }

    /// A page that is stored, from what the server has; its neighbours' parents are known.
    ///
    /// # Errors
    /// [`PullError::Contradiction`] if a corner is not the sample of its parent.
    pub(super) fn node(&self, page: Page) -> Result<Node, PullError> {
        let id = page.id();
        let mut heights: Box<[i32; PAGE_AREA]> =
            Box::new(std::array::from_fn(|sample| page.height(sample)));
        if id.level() > self.frame.base
            && let Some((parent, slot)) = id.parent()
            && let Some(above) = self.nodes.get(&parent)
        {
            for (here, there) in CORNERS.into_iter().zip(slot_corners(slot)) {
                check_corner(&page, here, &above.page, there)?;
                heights[here] = above.heights[there];
            }
        }
        let corners = CORNERS.map(|corner| heights[corner]);
        let implied = implied_heights(id, corners);
        for edge in Edge::ALL {
            let beside = id.neighbour(edge).map(|beside| self.fate(beside));
            if let Some(Fate::Implied(_)) = beside {
                side(edge).for_each(|sample| heights[sample] = implied[sample]);
            }
        }
        Ok(Node { page, heights })
    }
}

impl Plan {
    /// A page from its record.
    ///
    /// # Errors
    /// [`PullError`] if it is not there, or damaged.
    pub(super) fn decode(&self, id: PageId, records: &Records) -> Result<Page, PullError> {
        let finest = self.frame.old.is_finest(id);
        let record = records
            .get(&id)
            .ok_or_else(|| PullError::Contradiction(format!("page {id} did not come")))?;
        Ok(Page::decode(id, finest, last_part(finest), record)?)
    }

    /// A page that is to be stored, as planned; `None` for others.
    ///
    /// # Errors
    /// As [`decode`](Self::decode) and [`node`](Self::node).
    pub(super) fn planned(&self, id: PageId, records: &Records) -> Result<Option<Node>, PullError> {
        let page = match (self.fate(id), id.parent()) {
            (Fate::Fetched, _) => self.decode(id, records)?,
            (Fate::Made, Some((parent, slot))) => {
                let node = self.nodes.get(&parent).map(|node| &node.page);
                let above = node.or_else(|| self.above.get(&parent));
                let page = above.and_then(|page| page.implied_child(slot, self.frame.old));
                page.ok_or_else(|| PullError::Contradiction(format!("page {id} has no parent")))?
            }
            _ => return Ok(None),
        };
        self.node(page).map(Some)
    }
}

/// All pages that can hang below a page.
pub(super) fn children(page: PageId) -> impl Iterator<Item = PageId> {
    (0..PAGE_SLOTS).filter_map(move |slot| page.child(Slot::from_index(slot as u8)))
}

/// Holds a page's corner against the sample of its parent.
fn check_corner(page: &Page, here: usize, above: &Page, there: usize) -> Result<(), PullError> {
    let known = |page: &Page, at| page.is_valid(at).then(|| page.height(at));
    match (known(page, here), known(above, there)) {
        (Some(ours), Some(theirs)) if ours != theirs => Err(PullError::Contradiction(format!(
            "page {} has height {ours} at a corner, page {} has {theirs} there",
            page.id(),
            above.id()
        ))),
        _ => Ok(()),
    }
}
