//! The client's terrain: chunks in, a mesh and wishes out. No sockets, threads or clock.
//!
//! Chunks wait until the next [`update`](Terrain::update), which is the one sync point: it links
//! what has arrived, updates the mesh, unlinks what the memory cap does not allow, and
//! triangulates what changed.

use crate::mesh::{LinkError, MeshTree, PageMesh, Wish};
use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;
use escarp_proto::page::{Page, PageError, RevisionDigest};
use escarp_proto::view::View;
use escarp_proto::wire::{Chunk, Want};
use std::collections::{HashMap, HashSet, VecDeque};
use std::sync::Arc;

/// Memory for resident pages that a client takes if nobody says otherwise, bytes.
pub const DEFAULT_MEMORY_BYTES: usize = 1 << 30;

/// A dataset's terrain, as far as it is here.
#[derive(Debug)]
pub struct Terrain {
    manifest: Arc<Manifest>,
    tree: MeshTree,
    memory_cap_bytes: usize,
    arrived: VecDeque<Chunk>,
    /// Pages that do not come, or do not fit what is above them.
    missing: HashSet<PageId>,
    /// Of pages that are not whole yet.
    digests: HashMap<PageId, RevisionDigest>,
    wants: Vec<Want>,
}

/// What an update came to.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TerrainStep {
    /// Largest bound of a triangle that may be seen, over the tolerance; infinite without a bound.
    pub excess: f64,
    /// Pages that the mesh would use and has not, those that do not come included.
    pub lacking: usize,
    /// Triangles of the mesh.
    pub triangles: u64,
    /// Pages that are no longer here, or came too late to be of use.
    pub dropped: Vec<PageId>,
    /// Pages whose bytes are wrong, and why. They are not wanted again.
    pub rejected: Vec<(PageId, LinkError)>,
    /// The memory cap is reached by pages that are all in use: nothing more is wanted.
    pub memory_full: bool,
}

impl Terrain {
    /// A terrain of which nothing is here yet.
    pub fn new(manifest: Arc<Manifest>, memory_cap_bytes: usize) -> Terrain {
        Terrain {
            tree: MeshTree::new(manifest.grid_levels, manifest.georef.clone()),
            manifest,
            memory_cap_bytes,
            arrived: VecDeque::new(),
            missing: HashSet::new(),
            digests: HashMap::new(),
            wants: Vec::new(),
        }
    }

    /// The dataset's manifest.
    pub fn manifest(&self) -> &Arc<Manifest> {
        &self.manifest
    }

    /// The mesh tree.
    pub fn tree(&self) -> &MeshTree {
        &self.tree
    }

    /// The triangles, by page.
    pub fn meshes(&self) -> impl Iterator<Item = &PageMesh> {
        self.tree.meshes()
    }

    /// Takes a chunk; it is linked in the next update.
    pub fn receive(&mut self, chunk: Chunk) {
        self.arrived.push_back(chunk);
    }

    /// Notes that a page does not come. The mesh goes on without it.
    pub fn miss(&mut self, page: PageId) {
        self.missing.insert(page);
    }

    /// Forgets which pages did not come, so that they are wanted again.
    pub fn forget_misses(&mut self) {
        self.missing.clear();
    }

    /// What the mesh lacks, most urgent first, as of the last update.
    pub fn wants(&self) -> &[Want] {
        &self.wants
    }

    /// Brings the mesh up to date for a view, which must be checked.
    pub fn update(&mut self, view: &View) -> TerrainStep {
        let mut step = TerrainStep::default();
        while let Some(chunk) = self.arrived.pop_front() {
            self.link(&chunk, &mut step);
        }
        step.excess = self.tree.update(view).excess;
        step.dropped.extend(self.tree.evict(self.memory_cap_bytes));
        for page in &step.dropped {
            self.digests.remove(page);
        }
        step.memory_full = self.tree.memory_bytes() > self.memory_cap_bytes;
        let wishes = self.tree.wishes();
        step.lacking = wishes.len();
        self.wants.clear();
        if !step.memory_full {
            let open = wishes
                .iter()
                .filter(|wish| !self.missing.contains(&wish.page));
            self.wants.extend(open.map(Wish::to_want));
        }
        step.triangles = self.tree.triangulate();
        step
    }

    fn link(&mut self, chunk: &Chunk, step: &mut TerrainStep) {
        let Some(id) =
            PageId::from_key(chunk.page).filter(|&id| self.manifest.grid_levels.holds(id))
        else {
            return;
        };
        match self.decode(id, chunk).and_then(|page| self.tree.link(page)) {
            Ok(()) => {}
            Err(LinkError::Orphan(_)) => step.dropped.push(id),
            Err(error) => {
                self.missing.insert(id);
                step.rejected.push((id, error));
            }
        }
    }

    /// The page that results from a chunk: new, or with more parts than before. A page that is
    /// whole is held against its revision.
    fn decode(&mut self, id: PageId, chunk: &Chunk) -> Result<Page, LinkError> {
        let page = self.join(id, chunk)?;
        let new = || RevisionDigest::new(id);
        let digest = match chunk.first_part {
            0 => Some(new()),
            // Parts that no digest is kept of are parts of a page that was dropped meanwhile.
            _ => self.digests.remove(&id),
        };
        let mut digest = digest.ok_or(LinkError::Orphan(id))?;
        digest.update(&chunk.bytes);
        if page.parts() < page.last_part() {
            self.digests.insert(id, digest);
        } else if digest.revision() != chunk.revision {
            return Err(LinkError::Page(PageError::Checksum {
                page: id,
                found: digest.revision(),
                expected: chunk.revision,
            }));
        }
        Ok(page)
    }

    fn join(&self, id: PageId, chunk: &Chunk) -> Result<Page, LinkError> {
        let finest = self.manifest.grid_levels.is_finest(id);
        if chunk.first_part == 0 {
            return Ok(Page::decode(id, finest, chunk.last_part, &chunk.bytes)?);
        }
        let resident = self
            .tree
            .page(id)
            .filter(|page| page.parts() + 1 == chunk.first_part);
        let mut page = resident.ok_or(LinkError::Orphan(id))?.clone();
        page.extend(chunk.last_part, &chunk.bytes)?;
        Ok(page)
    }
}
