//! The mesh tree: a surface, and the mesher that works on it.

use super::audit::{SurfaceTriangle, VertexFlags};
use super::mesher::{Found, MeshOptions, Mesher};
use super::morph::Morph;
use super::page_mesh::PageMesh;
use super::surface::{LinkError, NODE_BYTES, Surface};
use super::wants::Wish;
use escarp_proto::geometry::{GridLevels, PageId};
use escarp_proto::georef::Georef;
use escarp_proto::page::{PAGE_AREA, Page};
use escarp_proto::view::View;

/// More stamps than a tree gives while another one follows it: 100 million updates of 10,000 pages.
const FAR: u64 = 1 << 40;

/// What an update found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UpdateStats {
    /// Largest bound of a triangle that may be seen, over the tolerance. For the meshers that keep
    /// the tolerance at most 1 if nothing in view is wanted; infinite if there is no bound yet.
    pub excess: f64,
    /// Squares whose triangles were tested.
    pub squares: u64,
    /// Vertices that were enabled or disabled, pages that were linked or unlinked.
    pub changes: u64,
    /// Vertices that were enabled.
    pub splits: u64,
    /// Vertices that were disabled.
    pub merges: u64,
    /// Pages that the mesh would use and that are not resident.
    pub wanted: usize,
}

/// The mesh tree.
#[derive(Debug)]
pub struct MeshTree {
    surface: Surface,
    options: MeshOptions,
    mesher: Box<dyn Mesher>,
    morph: Option<Morph>,
}

impl MeshTree {
    /// A tree without pages, with the default mesher.
    pub fn new(grid: GridLevels, georef: Georef) -> MeshTree {
        MeshTree::with_options(grid, georef, MeshOptions::default())
    }

    /// A tree without pages.
    pub fn with_options(grid: GridLevels, georef: Georef, options: MeshOptions) -> MeshTree {
        let mesher = options.mesher();
        let mut surface = Surface::new(grid, georef);
        surface.flips = mesher.follows_flips().then(Vec::new);
        MeshTree {
            surface,
            morph: options.morph(),
            options,
            mesher,
        }
    }

    /// How it meshes.
    pub fn options(&self) -> &MeshOptions {
        &self.options
    }

    /// Pages that are resident, those that no record is stored for included.
    pub fn resident(&self) -> usize {
        self.surface.resident()
    }

    /// A resident page.
    pub fn page(&self, id: PageId) -> Option<&Page> {
        self.surface.page(id)
    }

    /// All resident pages.
    pub fn pages(&self) -> impl Iterator<Item = &Page> {
        self.surface.pages()
    }

    /// The triangles of all pages that have any.
    pub fn meshes(&self) -> impl Iterator<Item = &PageMesh> {
        self.surface.meshes()
    }

    /// Memory that the pages take, bytes, near enough for a cap.
    pub fn memory_bytes(&self) -> usize {
        let morph = self.morph.as_ref().map_or(0, Morph::memory_bytes);
        self.surface.memory_bytes() + self.mesher.memory_bytes() + morph
    }

    /// What a page takes at least, bytes.
    pub const PAGE_BYTES: usize = NODE_BYTES;

    /// Memory of the pages that the mesh uses, bytes; the others can be evicted.
    pub fn used_bytes(&self) -> usize {
        let morph = self.morph.as_ref().map_or(0, Morph::memory_bytes);
        self.surface.used_bytes() + self.mesher.memory_bytes() + morph
    }

    /// Memory of the meshes, bytes: as much as the GPU has of them.
    pub fn mesh_bytes(&self) -> usize {
        let bytes = |mesh: &PageMesh| {
            let offsets = mesh
                .offsets
                .as_ref()
                .map_or(0, |offsets| size_of_val(&offsets[..]));
            size_of_val(&mesh.vertices[..]) + offsets + size_of_val(&mesh.indices[..])
        };
        self.meshes().map(bytes).sum()
    }

    /// Lets no stamp be one that this other tree has given, or will have given by the next update:
    /// what is drawn of that one can be told from what is drawn of this.
    pub fn follow(&mut self, other: &MeshTree) {
        self.surface.stamps = self.surface.stamps.max(other.surface.stamps) + FAR;
    }

    /// Links a page whose parent is resident, or more parts of one that is linked.
    ///
    /// # Errors
    /// [`LinkError`]; the tree is then as it was.
    pub fn link(&mut self, page: Page) -> Result<(), LinkError> {
        let index = self.surface.link(page)?;
        self.mesher.linked(&self.surface, index);
        if let Some(morph) = &mut self.morph {
            morph.linked(index);
        }
        Ok(())
    }

    /// Unlinks pages that nothing on the screen needs, the longest unused first, until the rest
    /// fits. Gives what was unlinked.
    pub fn evict(&mut self, most_bytes: usize) -> Vec<PageId> {
        let mut gone = Vec::new();
        while self.memory_bytes() > most_bytes {
            let idle = self.surface.idle();
            // A sixteenth at a time: parents become idle when their children go.
            let some = idle.len().div_ceil(16);
            if some == 0 {
                break;
            }
            for id in idle.into_iter().take(some) {
                if let Some(index) = self.surface.unlink(id) {
                    self.mesher.unlinked(index);
                    if let Some(morph) = &mut self.morph {
                        morph.unlinked(index);
                    }
                    gone.push(id);
                }
            }
        }
        gone
    }

    /// Enables and disables vertices for a view, which must be checked, and collects what is
    /// wanted.
    pub fn update(&mut self, view: &View) -> UpdateStats {
        let before = self.surface.counts();
        self.surface.updates += 1;
        let morph = self.morph.as_ref();
        let tested = morph.map_or(*view, |morph| morph.tested(view));
        let mut found = self.mesh(&tested);
        if let Some(morph) = &mut self.morph {
            morph.update(&mut self.surface, view);
            found.excess = morph.excess(view, found.excess);
        }
        self.stats(found, before)
    }

    fn mesh(&mut self, view: &View) -> Found {
        let mut squares = 0;
        loop {
            self.surface.wishes.clear();
            if !self.surface.enable_root() {
                self.surface.want_root();
                let excess = f64::INFINITY;
                return Found { excess, squares };
            }
            let found = self.mesher.update(&mut self.surface, view);
            squares += found.squares;
            if !self.link_implied() {
                return Found { squares, ..found };
            }
        }
    }

    /// Makes the next update test every triangle anew, whether or not it can have changed: the
    /// mesh does not change by that, only the cost of the update. For measurements.
    pub fn forget_tests(&mut self) {
        self.mesher.forget();
    }

    fn stats(&self, found: Found, before: [u64; 3]) -> UpdateStats {
        let now = self.surface.counts();
        let [changes, splits, merges] = std::array::from_fn(|i| now[i] - before[i]);
        UpdateStats {
            excess: found.excess,
            squares: found.squares,
            changes,
            splits,
            merges,
            wanted: self.surface.wishes.len(),
        }
    }

    /// Links wanted pages that need no record. Whether there were any.
    fn link_implied(&mut self) -> bool {
        let mut linked = false;
        for id in self.surface.wishes.take_implied() {
            if let Some(page) = self.surface.implied(id) {
                linked |= self.link(page).is_ok();
            }
        }
        linked
    }

    /// What the last update wished for, most urgent first.
    pub fn wishes(&self) -> Vec<Wish> {
        self.surface.wishes.sorted()
    }

    /// Triangulates what changed since the last time. Triangles of the whole mesh.
    pub fn triangulate(&mut self) -> u64 {
        let triangles = self.surface.triangulate();
        if let Some(morph) = &mut self.morph {
            morph.turn(&mut self.surface);
        }
        triangles
    }

    /// All vertices with any state, sorted.
    pub fn flags(&self) -> Vec<VertexFlags> {
        self.surface.flags()
    }

    /// Holds what the mesher keeps from update to update against a recomputation, after an update
    /// for this view: for tests.
    ///
    /// # Errors
    /// What differs.
    pub fn check(&self, view: &View) -> Result<(), String> {
        self.mesher.check(&self.surface, view)
    }

    /// Visits every triangle of the mesh, those in holes included: together they cover the grid.
    pub fn visit_triangles(&self, visit: impl FnMut(SurfaceTriangle)) {
        self.surface.visit_triangles(visit);
    }

    /// As [`visit_triangles`](Self::visit_triangles), with the heights at which the corners are
    /// displayed, quanta.
    pub fn visit_displayed(&self, visit: impl FnMut(SurfaceTriangle, [f64; 3])) {
        self.surface.visit_displayed(visit);
    }

    /// How far each enabled vertex has come from the edge that it splits, 0, to its height, 1: page
    /// by page with its samples. Nothing if there is no morph.
    pub fn weights(&self) -> Vec<(PageId, u16, f64)> {
        let Some(morph) = &self.morph else {
            return Vec::new();
        };
        let nodes = (0..).zip(&self.surface.nodes);
        let pages = nodes.filter_map(|(index, node)| Some((index, node.as_ref()?.page.id())));
        let weights = pages.flat_map(|(index, id)| {
            let sample = 0..PAGE_AREA as u16;
            sample.filter_map(move |sample| {
                let weight = morph.weight(index, sample.into())?;
                Some((id, sample, weight))
            })
        });
        weights.collect()
    }
}
