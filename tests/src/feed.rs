//! A feed of pages without a network: what the mesh tree wishes for, it gets.

use escarp_client::mesh::{MeshOptions, MeshTree, UpdateStats, Wish};
use escarp_proto::page::{Page, RecordHeader, last_part};
use escarp_proto::view::View;
use escarp_tiles::dataset::Dataset;

/// A mesh tree over a dataset.
pub struct Feed<'a> {
    /// The tree.
    pub tree: MeshTree,
    dataset: &'a Dataset,
    whole: bool,
}

impl<'a> Feed<'a> {
    /// A tree without pages, with the default mesher.
    pub fn new(dataset: &'a Dataset) -> Self {
        Feed::with_options(dataset, MeshOptions::default())
    }

    /// A tree without pages that meshes so.
    pub fn with_options(dataset: &'a Dataset, options: MeshOptions) -> Self {
        let manifest = dataset.manifest();
        let (grid, georef) = (manifest.grid_levels, manifest.georef.clone());
        Feed {
            tree: MeshTree::with_options(grid, georef, options),
            dataset,
            whole: false,
        }
    }

    /// The same with pages that come whole: no part that arrives later changes a bound.
    #[must_use]
    pub fn whole(mut self) -> Self {
        self.whole = true;
        self
    }

    /// Links what one wish is for, whether or not it was wished; `false` if it no longer fits.
    ///
    /// # Panics
    /// If the dataset has no such page: the tree must not wish for one.
    pub fn grant(&mut self, wish: &Wish) -> bool {
        let finest = self.dataset.grid().is_finest(wish.page);
        let record = self.dataset.record(wish.page).expect("checksums match");
        let record = record.unwrap_or_else(|| panic!("no record for {}", wish.page));
        let parts = if self.whole {
            last_part(finest)
        } else {
            wish.parts
        };
        let header = RecordHeader::read(wish.page, finest, record.bytes).expect("a header");
        let bytes = header.part_bytes(0, parts).expect("parts that exist");
        let page = Page::decode(wish.page, finest, parts, &record.bytes[bytes]);
        self.tree.link(page.expect("the record decodes")).is_ok()
    }

    /// Updates until nothing is wished for.
    ///
    /// # Panics
    /// If that does not come to an end.
    pub fn converge(&mut self, view: &View) -> UpdateStats {
        self.converge_within(200, view)
            .unwrap_or_else(|why| panic!("{why}"))
    }

    /// Updates until nothing is wished for, at most so many times.
    ///
    /// # Errors
    /// What is still wished for.
    pub fn converge_within(&mut self, updates: u32, view: &View) -> Result<UpdateStats, String> {
        for _ in 0..updates {
            let stats = self.tree.update(view);
            let wishes = self.tree.wishes();
            if wishes.is_empty() {
                return Ok(stats);
            }
            for wish in wishes {
                self.grant(&wish);
            }
        }
        let wishes = self.tree.wishes();
        Err(format!("the mesh wishes on without end: {wishes:?}"))
    }
}

/// A tree with the pages of another, updated for a view from nothing: what the mesh is if it follows
/// from view and pages alone.
///
/// # Panics
/// If the pages do not fit.
pub fn anew(tree: &MeshTree, dataset: &Dataset, view: &View, options: MeshOptions) -> MeshTree {
    let georef = dataset.manifest().georef.clone();
    let mut anew = MeshTree::with_options(dataset.grid(), georef, options);
    let mut pages: Vec<_> = tree.pages().cloned().collect();
    pages.sort_by_key(|page| page.id().key());
    for page in pages {
        anew.link(page).expect("a page of such a tree");
    }
    anew.update(view);
    anew
}
