//! The selection over a dataset, and a mesh tree that is given what it lists.

use escarp_client::mesh::MeshTree;
use escarp_proto::geometry::PageId;
use escarp_proto::page::{Bounds, BoxError, Page, RecordHeader};
use escarp_proto::select::{Eyes, Known, Look, Need, Outcome, Scope, Selection, Sketch};
use escarp_proto::view::View;
use escarp_tiles::dataset::Dataset;
use std::collections::HashMap;
use std::sync::Arc;

/// All pages of a dataset, made into sketches as they are asked for.
pub struct AllPages<'a> {
    dataset: &'a Dataset,
    sketches: HashMap<PageId, Option<Arc<Sketch>>>,
    pages: HashMap<PageId, (Page, Option<BoxError>)>,
}

impl<'a> AllPages<'a> {
    /// Of which none has been asked for yet.
    pub fn new(dataset: &'a Dataset) -> AllPages<'a> {
        AllPages {
            dataset,
            sketches: HashMap::new(),
            pages: HashMap::new(),
        }
    }

    /// A page, stored or implied, and what is known of it from the one above.
    fn page(&mut self, id: PageId) -> Option<&(Page, Option<BoxError>)> {
        if !self.pages.contains_key(&id) {
            let grid = self.dataset.grid();
            let stored = decoded(self.dataset, id, None);
            let found = match id.parent() {
                None => (stored?, None),
                Some((above, slot)) => {
                    let (above, told) = self.page(above)?;
                    let promise = Bounds::cell(above, slot, *told);
                    let page = stored.or_else(|| above.implied_child(slot, grid))?;
                    (page, Some(promise))
                }
            };
            self.pages.insert(id, found);
        }
        self.pages.get(&id)
    }
}

impl AllPages<'_> {
    /// All that is known of the triangles of a page; `None` if it is not there.
    pub fn bounds(&mut self, id: PageId) -> Option<Bounds> {
        let (page, promise) = self.page(id)?;
        Some(Bounds::derive(page, *promise))
    }
}

impl Known for AllPages<'_> {
    fn sketch(&mut self, id: PageId) -> Option<Arc<Sketch>> {
        if let Some(sketch) = self.sketches.get(&id) {
            return sketch.clone();
        }
        let (grid, georef) = (self.dataset.grid(), &self.dataset.manifest().georef);
        let found = self.page(id);
        let made = found.map(|(page, promise)| Sketch::of(page, *promise, grid, georef));
        let sketch = made.map(Arc::new);
        self.sketches.insert(id, sketch.clone());
        sketch
    }
}

/// A stored page, as far as a client has it with these parts; all of it with `None`. `None` if no
/// record is stored.
///
/// # Panics
/// If the dataset is damaged.
pub fn decoded(dataset: &Dataset, id: PageId, parts: Option<u8>) -> Option<Page> {
    let finest = dataset.grid().is_finest(id);
    let record = dataset.record(id).expect("checksums match")?;
    let parts = parts.unwrap_or(escarp_proto::page::last_part(finest));
    let header = RecordHeader::read(id, finest, record.bytes).expect("a header");
    let bytes = header.part_bytes(0, parts).expect("parts that exist");
    Some(Page::decode(id, finest, parts, &record.bytes[bytes]).expect("the record decodes"))
}

/// Bytes of a page's record up to a part.
///
/// # Panics
/// If the dataset is damaged, or has no such page or part.
pub fn part_bytes(dataset: &Dataset, id: PageId, last: u8) -> usize {
    let finest = dataset.grid().is_finest(id);
    let record = dataset.record(id).expect("checksums match");
    let record = record.expect("a record");
    let header = RecordHeader::read(id, finest, record.bytes).expect("a header");
    header.part_bytes(0, last).expect("parts that exist").len()
}

/// What a view needs of a dataset.
pub fn select(
    known: &mut AllPages<'_>,
    view: &View,
    scope: Scope,
    limit: usize,
) -> (Vec<Need>, Outcome) {
    let eyes = Eyes::at(view.eye_m);
    select_for(known, Look { view, eyes, scope }, limit)
}

/// What views need from wherever the eye may be.
pub fn select_for(known: &mut AllPages<'_>, look: Look<'_>, limit: usize) -> (Vec<Need>, Outcome) {
    let manifest = known.dataset.manifest();
    let at = (manifest.grid_levels, &manifest.georef);
    let mut needs = Vec::new();
    let outcome = Selection::default().select_for(at, look, known, limit, &mut needs);
    (needs, outcome)
}

/// A tree that has exactly what is listed.
///
/// # Panics
/// If something listed is not there, or comes before the page above it.
pub fn tree_of(dataset: &Dataset, needs: &[Need]) -> MeshTree {
    let manifest = dataset.manifest();
    let mut tree = MeshTree::new(manifest.grid_levels, manifest.georef.clone());
    for need in needs {
        let page = decoded(dataset, need.page, Some(need.last_part));
        let page = page.unwrap_or_else(|| panic!("no record for {}", need.page));
        link(&mut tree, page);
    }
    tree
}

/// Links a page, after the pages above it that no record is stored for.
fn link(tree: &mut MeshTree, page: Page) {
    let id = page.id();
    tree.link(page)
        .unwrap_or_else(|why| panic!("{id} does not fit: {why}"));
}
