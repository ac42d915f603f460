//! Pages against their neighbours and their parents: samples that they share are the same, and
//! each page has a record exactly if its parent says so.

use crate::dataset::{Dataset, DatasetError, FamilyId, IndexEntry, PageReader};
use escarp_proto::geometry::{Edge, PAGE_CELLS, PAGE_SAMPLES, PAGE_SLOTS, PageId, Slot};
use escarp_proto::page::{PAGE_AREA, Page};
use std::sync::Arc;

/// What a family's check found.
#[derive(Debug, Default)]
pub(super) struct Shared {
    /// Comparisons of a sample that two pages have.
    pub(super) comparisons: u64,
    pub(super) broken: Vec<String>,
}

const MOST_WORDS: usize = 8;

impl Shared {
    fn tell(&mut self, what: impl FnOnce() -> String) {
        if self.broken.len() < MOST_WORDS {
            self.broken.push(what());
        }
    }

    pub(super) fn merge(mut self, mut other: Shared) -> Shared {
        self.comparisons += other.comparisons;
        self.broken.append(&mut other.broken);
        self.broken.truncate(MOST_WORDS);
        self
    }
}

/// A page, and whether it has a record.
struct Known {
    page: Arc<Page>,
    is_stored: bool,
}

/// Checks the pages of a family, those without a record included.
pub(super) fn check_family(dataset: &Dataset, entry: &IndexEntry) -> Result<Shared, DatasetError> {
    let mut found = Shared::default();
    check_slots(dataset, entry, &mut found)?;
    if entry.family == FamilyId::ROOT {
        return Ok(found);
    }
    let mut reader = PageReader::new(dataset);
    let mut pages = Vec::with_capacity(PAGE_SLOTS);
    for slot in (0..=u8::MAX).map(Slot::from_index) {
        let Some(id) = entry.family.page(slot) else {
            continue;
        };
        pages.push(known(&mut reader, id)?);
        check_corners(&mut reader, &pages[pages.len() - 1], &mut found)?;
    }
    for (i, known) in pages.iter().enumerate() {
        for edge in Edge::ALL {
            match neighbour(i, edge) {
                // Within the family each pair is met twice, and compared once.
                Some(_) if matches!(edge, Edge::West | Edge::South) => {}
                Some(other) => compare(known, &pages[other], edge, &mut found),
                None => across(&mut reader, known, edge, &mut found)?,
            }
        }
    }
    Ok(found)
}

/// A page of the grid as it is stored or implied.
fn known(reader: &mut PageReader<'_>, id: PageId) -> Result<Known, DatasetError> {
    let is_stored = match id.parent() {
        Some((parent, slot)) => reader.page(parent)?.slot(slot).has_record(),
        None => true,
    };
    Ok(Known {
        page: reader.page(id)?,
        is_stored,
    })
}

/// Place in the family of the page across an edge, if it is of the family.
fn neighbour(i: usize, edge: Edge) -> Option<usize> {
    let (dx, dy) = edge.step();
    let column = (i % PAGE_CELLS).checked_add_signed(dx as isize)?;
    let row = (i / PAGE_CELLS).checked_add_signed(dy as isize)?;
    (column < PAGE_CELLS && row < PAGE_CELLS).then_some(row * PAGE_CELLS + column)
}

fn across(
    reader: &mut PageReader<'_>,
    page: &Known,
    edge: Edge,
    found: &mut Shared,
) -> Result<(), DatasetError> {
    if let Some(id) = page.page.id().neighbour(edge) {
        compare(page, &known(reader, id)?, edge, found);
    }
    Ok(())
}

/// Slots are those of which the parent says that they have a record.
fn check_slots(
    dataset: &Dataset,
    entry: &IndexEntry,
    found: &mut Shared,
) -> Result<(), DatasetError> {
    let mut reader = PageReader::new(dataset);
    for record in dataset.family(entry)?.records() {
        let id = record?.page;
        if let Some((parent, slot)) = id.parent()
            && !reader.page(parent)?.slot(slot).has_record()
        {
            found.tell(|| format!("page {id} has a record, but its parent says that it has none"));
        }
    }
    Ok(())
}

/// A page's corners are samples of its parent.
fn check_corners(
    reader: &mut PageReader<'_>,
    own: &Known,
    found: &mut Shared,
) -> Result<(), DatasetError> {
    let id = own.page.id();
    let Some((parent, slot)) = id.parent() else {
        return Ok(());
    };
    let above = known(reader, parent)?;
    let (column, row) = slot.position();
    for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let here = (dy * PAGE_SAMPLES + dx) * PAGE_CELLS;
        let there = (row + dy) * PAGE_SAMPLES + column + dx;
        same((own, here), (&above, there), found);
    }
    Ok(())
}

/// The samples on an edge of a page are those on the opposite edge of its neighbour.
fn compare(own: &Known, other: &Known, edge: Edge, found: &mut Shared) {
    for i in 0..PAGE_SAMPLES {
        let at = |edge| match edge {
            Edge::East => i * PAGE_SAMPLES + PAGE_CELLS,
            Edge::West => i * PAGE_SAMPLES,
            Edge::North => PAGE_AREA - PAGE_SAMPLES + i,
            Edge::South => i,
        };
        same((own, at(edge)), (other, at(edge.opposite())), found);
    }
}

/// Compares a sample that two pages share. One without a surface is not stored, and so has no
/// samples either.
fn same((a, i): (&Known, usize), (b, j): (&Known, usize), found: &mut Shared) {
    found.comparisons += 1;
    let sample = |known: &Known, at| known.page.is_valid(at).then(|| known.page.height(at));
    let (ours, theirs) = (sample(a, i), sample(b, j));
    let fits = match (ours, theirs) {
        (Some(ours), Some(theirs)) => ours == theirs,
        (None, None) => true,
        (None, Some(_)) => !a.is_stored,
        (Some(_), None) => !b.is_stored,
    };
    if !fits {
        let (a, b) = (a.page.id(), b.page.id());
        let say = |height: Option<i32>| height.map_or("a hole".into(), |h| format!("height {h}"));
        found.tell(|| {
            let (ours, theirs) = (say(ours), say(theirs));
            format!("pages {a} and {b} share a sample: {ours} in one, {theirs} in the other")
        });
    }
}
