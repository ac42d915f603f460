//! The client's terrain: chunks in, a mesh and wishes out. No sockets, threads or clock.
//!
//! Chunks wait until the next [`update`](Terrain::update), which is the one sync point: it links
//! what has arrived, updates the mesh, unlinks what the memory cap does not allow, and
//! triangulates what changed. With a frame budget, pages for which there is no time wait on, in
//! the order in which they came.

#[cfg(test)]
mod tests;

use crate::lost::Lost;
use crate::mesh::{LinkError, MeshOptions, MeshTree, PageMesh, Wish};
use crate::stages::{Stage, StageTimes, Stages};
use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;
use escarp_proto::page::{Page, PageError, RevisionDigest};
use escarp_proto::view::View;
use escarp_proto::wire::{Chunk, Want};
use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

/// Memory for resident pages that a client takes if nobody says otherwise, bytes.
pub const DEFAULT_MEMORY_BYTES: usize = 1 << 30;
/// Chunks that a terrain takes before it has linked some of them.
const MOST_WAITING: usize = 64;
/// What is known of a page beside its place in the tree takes about this much, bytes: its digest,
/// and what the link knows of it.
const NOTES_BYTES: usize = 256;

/// Of a memory cap, what pages are let in for. The rest is for what comes in parts, for what waits,
/// and for triangles that are yet to be made.
pub const fn room_for_pages(cap_bytes: usize) -> usize {
    let reserve = cap_bytes / 8 + (64 << 10);
    let most = cap_bytes / 2;
    cap_bytes - if reserve < most { reserve } else { most }
}

/// A dataset's terrain, as far as it is here.
#[derive(Debug)]
pub struct Terrain {
    manifest: Arc<Manifest>,
    tree: MeshTree,
    memory_cap_bytes: usize,
    arrived: VecDeque<Chunk>,
    /// Pages that do not come, or do not fit what is known of them.
    lost: Lost,
    /// Of pages that are not whole yet.
    digests: HashMap<PageId, RevisionDigest>,
    wants: Vec<Want>,
    /// Pages that are worth having, and may come.
    lacking: usize,
}

/// A page as one terrain has it, for another one.
#[derive(Debug)]
pub struct Seed {
    page: Page,
    /// If it is not whole.
    digest: Option<RevisionDigest>,
}

impl Seed {
    /// Which page it is.
    pub fn id(&self) -> PageId {
        self.page.id()
    }
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
    /// Pages that are no longer here.
    pub dropped: Vec<PageId>,
    /// Pages that came for nothing: those above them are not here, or say that there are none.
    pub orphans: Vec<PageId>,
    /// Pages that were refused.
    pub refused: Vec<Refusal>,
    /// The memory cap is reached by pages that are all in use: nothing more is wanted.
    pub memory_full: bool,
    /// Chunks for which there was no time.
    pub waiting: usize,
    /// What the stages took.
    pub times: StageTimes,
}

impl TerrainStep {
    /// All pages that are not here any more, or were not let in.
    pub fn gone(&self) -> Vec<PageId> {
        let refused = self.refused.iter().map(|refusal| refusal.page);
        let gone = self.dropped.iter().chain(&self.orphans).copied();
        gone.chain(refused).collect()
    }
}

/// A page whose bytes are wrong, or contradict what is known of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Refusal {
    /// The page.
    pub page: PageId,
    /// What is wrong.
    pub why: LinkError,
    /// It is wanted once more, from its first part. If not, it counts as missing.
    pub again: bool,
}

impl Terrain {
    /// A terrain of which nothing is here yet.
    pub fn new(manifest: Arc<Manifest>, memory_cap_bytes: usize, options: MeshOptions) -> Terrain {
        let (grid, georef) = (manifest.grid_levels, manifest.georef.clone());
        Terrain {
            tree: MeshTree::with_options(grid, georef, options),
            manifest,
            memory_cap_bytes,
            arrived: VecDeque::new(),
            lost: Lost::default(),
            digests: HashMap::new(),
            wants: Vec::new(),
            lacking: 0,
        }
    }

    /// Copies of the pages that `which` names.
    pub fn seeds(&self, which: impl Fn(PageId) -> bool) -> Vec<Seed> {
        let seed = |page: &Page| Seed {
            page: page.clone(),
            digest: self.digests.get(&page.id()).cloned(),
        };
        (self.tree.pages())
            // Of a page that was refused in part nobody knows which part is wrong.
            .filter(|page| which(page.id()) && self.is_in_order(page.id()))
            .map(seed)
            .collect()
    }

    /// Takes over a page of another terrain, after those above it. Whether it fits; if not, it is
    /// noted as dropped.
    pub fn take_seed(&mut self, seed: Seed, step: &mut TerrainStep) -> bool {
        let id = seed.id();
        let has_room = id == PageId::ROOT || self.makes_room(&mut step.dropped);
        if !has_room || self.tree.link(seed.page).is_err() {
            step.dropped.push(id);
            return false;
        }
        if let Some(digest) = seed.digest {
            self.digests.insert(id, digest);
        }
        true
    }

    /// What is drawn of this terrain can be told from what is drawn of the other one.
    pub fn follow(&mut self, other: &Terrain) {
        self.tree.follow(&other.tree);
    }

    /// Lets it take this much memory from the next update on, bytes.
    pub fn set_memory_cap(&mut self, cap_bytes: usize) {
        self.memory_cap_bytes = cap_bytes;
    }

    /// Memory that it takes, bytes, near enough for a cap.
    pub fn memory_bytes(&self) -> usize {
        let waiting = self.arrived.iter().map(|chunk| chunk.bytes.len());
        let waiting = waiting.sum::<usize>() + self.arrived.len() * size_of::<Chunk>();
        let notes = self.tree.resident() * NOTES_BYTES + self.wants.len() * size_of::<Want>();
        self.tree.memory_bytes() + notes + waiting
    }

    /// Memory that the last view needs, with the pages that it lacks, bytes; or a bound of it where
    /// that is far below the cap.
    pub fn needed_bytes(&self) -> usize {
        self.used_bytes() + self.lacking * (MeshTree::PAGE_BYTES + NOTES_BYTES)
    }

    /// Whether there is no room for another page, even if all pages go that the mesh does not use.
    pub fn is_full(&self) -> bool {
        self.used_bytes() + MeshTree::PAGE_BYTES > room_for_pages(self.memory_cap_bytes)
    }

    /// Memory without the pages that the mesh does not use; or all of it far below the cap.
    fn used_bytes(&self) -> usize {
        let all = self.memory_bytes();
        match all > self.memory_cap_bytes / 4 {
            true => {
                let idle = (self.tree.memory_bytes()).saturating_sub(self.tree.used_bytes());
                all.saturating_sub(idle)
            }
            false => all,
        }
    }

    /// Keeps no more than half of its cap, or what the mesh uses.
    pub fn shrink(&mut self) {
        self.evict(self.memory_cap_bytes / 2, &mut Vec::new());
    }

    /// Whether there is room for another page, after those that are not of use have made place.
    fn makes_room(&mut self, dropped: &mut Vec<PageId>) -> bool {
        let room = room_for_pages(self.memory_cap_bytes);
        if self.memory_bytes() + MeshTree::PAGE_BYTES <= room {
            return true;
        }
        // Somewhat more, so that not each page has to look for place.
        let more = (room / 32).max(MeshTree::PAGE_BYTES);
        self.evict(room.saturating_sub(more), dropped);
        self.memory_bytes() + MeshTree::PAGE_BYTES <= room
    }

    /// Unlinks pages that the mesh does not use, until the terrain takes this much, if it can.
    fn evict(&mut self, most_bytes: usize, dropped: &mut Vec<PageId>) {
        let more = self.memory_bytes() - self.tree.memory_bytes();
        let gone = self.tree.evict(most_bytes.saturating_sub(more));
        for page in &gone {
            self.digests.remove(page);
        }
        dropped.extend(gone);
    }

    /// The dataset's manifest.
    pub fn manifest(&self) -> &Arc<Manifest> {
        &self.manifest
    }

    /// The mesh tree.
    pub fn tree(&self) -> &MeshTree {
        &self.tree
    }

    /// Meshes in another way from the next update on, with the pages that are here. Those that
    /// find no place any more, if any.
    pub fn set_options(&mut self, options: MeshOptions) -> Vec<PageId> {
        let (grid, georef) = (self.manifest.grid_levels, self.manifest.georef.clone());
        let mut tree = MeshTree::with_options(grid, georef, options);
        tree.follow(&self.tree);
        let mut pages: Vec<Page> = self.tree.pages().cloned().collect();
        // Parents first: a page is linked below one that is.
        pages.sort_by_key(|page| page.id().key());
        let mut dropped = Vec::new();
        for page in pages {
            let id = page.id();
            if tree.link(page).is_err() {
                self.digests.remove(&id);
                dropped.push(id);
            }
        }
        self.tree = tree;
        dropped
    }

    /// The triangles, by page.
    pub fn meshes(&self) -> impl Iterator<Item = &PageMesh> {
        self.tree.meshes()
    }

    /// Takes a chunk; it is linked in one of the next updates.
    pub fn receive(&mut self, chunk: Chunk) {
        self.arrived.push_back(chunk);
    }

    /// Whether so few chunks wait that more can be taken. A caller that leaves them where they are
    /// holds back the sender.
    pub fn has_room(&self) -> bool {
        self.arrived.len() < MOST_WAITING
    }

    /// Chunks that wait to be linked.
    pub fn waiting(&self) -> usize {
        self.arrived.len()
    }

    /// Notes that a page does not come. The mesh goes on without it.
    pub fn miss(&mut self, page: PageId) {
        self.lost.miss(page);
    }

    /// Forgets which pages did not come, so that they are wanted again.
    pub fn forget_misses(&mut self) {
        self.lost = Lost::default();
    }

    /// What the mesh lacks, most urgent first, as of the last update.
    pub fn wants(&self) -> &[Want] {
        &self.wants
    }

    /// Brings the mesh up to date for a view with all that has arrived.
    pub fn update(&mut self, view: &View) -> TerrainStep {
        let (mut step, mut stages) = (TerrainStep::default(), Stages::untimed());
        self.link_arrived(&mut step, &mut stages);
        self.finish(view, step, &mut stages)
    }

    /// Links what has arrived, as far as there is time. Whether none is left.
    pub fn link_arrived(&mut self, step: &mut TerrainStep, stages: &mut Stages<'_>) -> bool {
        while self.link_one(step, stages).is_some() {}
        self.arrived.is_empty()
    }

    /// Links the chunk that came first, if there is one, and time for it; gives of which page it
    /// is, the root for what is no page.
    pub fn link_one(&mut self, step: &mut TerrainStep, stages: &mut Stages<'_>) -> Option<PageId> {
        if self.arrived.is_empty() || !stages.begin_page() {
            return None;
        }
        let chunk = self.arrived.pop_front()?;
        self.link(&chunk, step, stages);
        Some(PageId::from_key(chunk.page).unwrap_or(PageId::ROOT))
    }

    /// Links all that has arrived, however long it takes. Pages that are not, or no longer, here.
    pub fn link_all(&mut self) -> Vec<PageId> {
        let mut step = TerrainStep::default();
        self.link_arrived(&mut step, &mut Stages::untimed());
        step.gone()
    }

    /// Drops all that has arrived and is not linked; gives of which pages it was.
    pub fn drop_waiting(&mut self) -> Vec<PageId> {
        let pages = self.arrived.drain(..);
        pages
            .filter_map(|chunk| PageId::from_key(chunk.page))
            .collect()
    }

    /// Brings the mesh up to date for a view, [clamped](View::clamped) if it is not in order, with
    /// the pages that are linked; `step` is what linking them came to.
    pub fn finish(
        &mut self,
        view: &View,
        mut step: TerrainStep,
        stages: &mut Stages<'_>,
    ) -> TerrainStep {
        let (view, _) = view.clamped();
        step.excess = stages
            .time(Stage::Update, || self.tree.update(&view))
            .excess;
        let cap = self.memory_cap_bytes;
        if self.memory_bytes() > cap {
            stages.time(Stage::Link, || self.evict(cap, &mut step.dropped));
        }
        step.memory_full |= self.is_full();
        step.lacking = stages.time(Stage::Update, || self.collect_wants(step.memory_full));
        step.triangles = stages.time(Stage::Triangulate, || self.tree.triangulate());
        step.waiting = self.arrived.len();
        step.times = stages.times();
        step
    }

    /// Takes over what the mesh lacks; how many pages that is.
    fn collect_wants(&mut self, memory_full: bool) -> usize {
        let wishes = self.tree.wishes();
        // There always is room for the root.
        let has_room = |wish: &Wish| !memory_full || wish.page == PageId::ROOT;
        let open = |wish: &&Wish| has_room(wish) && !self.lost.is_missing(wish.page);
        let wants = wishes.iter().filter(open).map(|wish| self.to_want(wish));
        self.wants = wants.collect();
        let lost = |wish: &&Wish| self.lost.is_missing(wish.page);
        self.lacking = wishes.len() - wishes.iter().filter(lost).count();
        wishes.len()
    }

    /// Of a page some part of which was refused all are wanted, as nobody knows which is wrong.
    fn to_want(&self, wish: &Wish) -> Want {
        let mut want = wish.to_want();
        if !self.digests.contains_key(&wish.page) {
            want.first_part = 0;
        }
        want
    }

    fn link(&mut self, chunk: &Chunk, step: &mut TerrainStep, stages: &mut Stages<'_>) {
        let Some(id) =
            PageId::from_key(chunk.page).filter(|&id| self.manifest.grid_levels.holds(id))
        else {
            return;
        };
        let here = self.tree.page(id).map(Page::parts);
        if chunk.first_part == 0
            && here.is_some_and(|parts| parts >= chunk.last_part)
            && self.is_in_order(id)
        {
            return;
        }
        // Without the root there is nothing to show.
        let is_new = here.is_none() && id != PageId::ROOT;
        if is_new && (step.memory_full || !self.makes_room(&mut step.dropped)) {
            step.memory_full = true;
            step.orphans.push(id);
            return;
        }
        let page = stages.time(Stage::Decode, || self.decode(id, chunk));
        let linked = page.and_then(|page| stages.time(Stage::Link, || self.tree.link(page)));
        match linked {
            Ok(()) => {}
            Err(LinkError::Orphan(_)) => {
                self.digests.remove(&id);
                step.orphans.push(id);
            }
            Err(why) => {
                // What else of it is waiting does not fit any more.
                self.arrived.retain(|other| other.page != chunk.page);
                self.digests.remove(&id);
                let again = self.lost.refuse(id);
                let page = id;
                step.refused.push(Refusal { page, why, again });
            }
        }
    }

    /// Whether a page is here, and nothing of it was refused: its first part is of no use.
    fn is_in_order(&self, id: PageId) -> bool {
        let is_whole = |page: &Page| page.parts() == page.last_part();
        self.tree
            .page(id)
            .is_some_and(|page| is_whole(page) || self.digests.contains_key(&id))
    }

    /// The page that results from a chunk: new, or with more parts than before. A page that is
    /// whole is held against its revision.
    fn decode(&mut self, id: PageId, chunk: &Chunk) -> Result<Page, LinkError> {
        let page = self.join(id, chunk)?;
        let digest = match chunk.first_part {
            0 => Some(RevisionDigest::new(id)),
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
        let resident = self.tree.page(id);
        if chunk.first_part == 0 {
            let page = Page::decode(id, finest, chunk.last_part, &chunk.bytes)?;
            return match resident.is_some_and(|resident| resident.parts() >= page.parts()) {
                true => Err(LinkError::Repeated(id)),
                false => Ok(page),
            };
        }
        let resident = resident.filter(|page| page.parts() + 1 == chunk.first_part);
        let mut page = resident.ok_or(LinkError::Orphan(id))?.clone();
        page.extend(chunk.last_part, &chunk.bytes)?;
        Ok(page)
    }
}
