//! One generation of a dataset after another, without a gap and without a mixture: the old one is
//! shown until the new one is as good.

use crate::mesh::MeshOptions;
use crate::stages::Stages;
use crate::terrain::{Seed, Terrain, TerrainStep};
use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;
use escarp_proto::page::Page;
use escarp_proto::view::View;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

/// The terrain that is shown, and the one that will be.
#[derive(Debug, Default)]
pub(super) struct Generations {
    shown: Option<Terrain>,
    /// What the shown one can still take over, once the pages above come.
    left: Known,
    next: Option<Next>,
}

/// A generation in the making.
#[derive(Debug)]
struct Next {
    terrain: Terrain,
    seeds: Seeds,
}

/// Pages of before that are pages of the new generation, too.
#[derive(Debug)]
enum Seeds {
    /// Nobody knows yet which: of this terrain's, or of the one that is shown, and of those that
    /// could not be taken over so far.
    Awaited(Option<Box<Terrain>>, Vec<Seed>),
    /// They are being taken over.
    Known(Known),
}

/// Pages to be taken over: those whose parent is here, and the others by their parents, as these
/// may be new and still to come.
#[derive(Debug, Default)]
struct Known {
    ready: Vec<Seed>,
    waiting: HashMap<PageId, Vec<Seed>>,
}

impl Known {
    fn new(seeds: Vec<Seed>) -> Known {
        let mut known = Known::default();
        for seed in seeds {
            match seed.id().parent() {
                None => known.ready.push(seed),
                Some((parent, _)) => known.waiting.entry(parent).or_default().push(seed),
            }
        }
        known
    }

    /// A page is here: those below it can be taken over, once it says which there are.
    fn arrived(&mut self, page: PageId, terrain: &Terrain) {
        let here = terrain.tree().page(page);
        if here.is_some_and(Page::has_slots)
            && let Some(seeds) = self.waiting.remove(&page)
        {
            self.ready.extend(seeds);
        }
    }

    /// Takes over what it can, as far as there is time. Whether that is all; pages that do not fit
    /// are noted as dropped.
    fn hand_over(
        &mut self,
        terrain: &mut Terrain,
        step: &mut TerrainStep,
        stages: &mut Stages<'_>,
    ) -> bool {
        while !self.ready.is_empty() && stages.begin_page() {
            if let Some(seed) = self.ready.pop() {
                let id = seed.id();
                if terrain.take_seed(seed, step) {
                    self.arrived(id, terrain);
                }
            }
        }
        self.ready.is_empty()
    }

    /// What was not taken over, by page, so that runs repeat.
    fn left(self) -> Vec<Seed> {
        let waiting = self.waiting.into_values().flatten();
        let mut left: Vec<Seed> = self.ready.into_iter().chain(waiting).collect();
        left.sort_unstable_by_key(Seed::id);
        left
    }
}

impl Generations {
    /// The terrain that is shown.
    pub(super) fn shown(&self) -> Option<&Terrain> {
        self.shown.as_ref()
    }

    /// The terrain that the chunks that come are of.
    pub(super) fn newest(&self) -> Option<&Terrain> {
        let next = self.next.as_ref().map(|next| &next.terrain);
        next.or(self.shown.as_ref())
    }

    /// See [`newest`](Self::newest).
    pub(super) fn newest_mut(&mut self) -> Option<&mut Terrain> {
        let next = self.next.as_mut().map(|next| &mut next.terrain);
        next.or(self.shown.as_mut())
    }

    /// Whether an older generation is shown than the newest.
    pub(super) fn is_changing(&self) -> bool {
        self.next.is_some()
    }

    /// Begins a generation. Pages that were on their way into the one before, and are lost.
    pub(super) fn begin(
        &mut self,
        manifest: Arc<Manifest>,
        cap_bytes: usize,
        mesh: MeshOptions,
    ) -> Vec<PageId> {
        let mut terrain = Terrain::new(manifest, cap_bytes, mesh);
        let Some(shown) = &mut self.shown else {
            self.shown = Some(terrain);
            return Vec::new();
        };
        let (source, spare, lost) = match self.next.take() {
            None => {
                let lost = shown.link_all();
                (None, std::mem::take(&mut self.left).left(), lost)
            }
            // What came since then may continue pages that are not there yet.
            Some(Next {
                mut terrain,
                seeds: Seeds::Awaited(source, spare),
            }) => (source, spare, terrain.drop_waiting()),
            Some(Next {
                mut terrain,
                seeds: Seeds::Known(mut known),
            }) => {
                let (mut step, mut stages) = (TerrainStep::default(), Stages::untimed());
                link_next(&mut terrain, &mut known, &mut step, &mut stages);
                (Some(Box::new(terrain)), known.left(), step.gone())
            }
        };
        terrain.follow(source.as_deref().unwrap_or(shown));
        self.next = Some(Next {
            terrain,
            seeds: Seeds::Awaited(source, spare),
        });
        lost
    }

    /// These pages of before are of the new generation, too. Gives those of them that are not here.
    pub(super) fn confirm(&mut self, same: Vec<PageId>, cap_bytes: usize) -> Vec<PageId> {
        let Some(next) = &mut self.next else {
            return Vec::new();
        };
        let Seeds::Awaited(source, spare) = &mut next.seeds else {
            return Vec::new();
        };
        let mut same: HashSet<PageId> = same.into_iter().collect();
        let mut seeds = std::mem::take(spare);
        seeds.retain(|seed| same.contains(&seed.id()));
        if let Some(source) = source.as_deref().or(self.shown.as_ref()) {
            seeds.extend(source.seeds(|page| same.contains(&page)));
        }
        for seed in &seeds {
            same.remove(&seed.id());
        }
        next.seeds = Seeds::Known(Known::new(seeds));
        // There are two of each page now; of the old ones those that are displayed are of use.
        if let Some(shown) = &mut self.shown {
            shown.shrink();
            let left = cap_bytes.saturating_sub(shown.memory_bytes());
            next.terrain.set_memory_cap(left);
        }
        same.into_iter().collect()
    }

    /// Links what has arrived, as far as there is time. Whether none is left.
    pub(super) fn link_arrived(&mut self, step: &mut TerrainStep, stages: &mut Stages<'_>) -> bool {
        let Some(next) = &mut self.next else {
            let (shown, left) = (self.shown.as_mut(), &mut self.left);
            return shown.is_none_or(|shown| link_next(shown, left, step, stages));
        };
        match &mut next.seeds {
            // What hangs below those pages has to wait for them.
            Seeds::Awaited(..) => false,
            Seeds::Known(known) => link_next(&mut next.terrain, known, step, stages),
        }
    }

    /// Brings what is shown up to date for a view, and shows the new generation as soon as it is as
    /// good. `is_all`: nothing is on its way for the new one, if it lacks nothing that may come.
    pub(super) fn finish(
        &mut self,
        view: &View,
        step: TerrainStep,
        stages: &mut Stages<'_>,
        cap_bytes: usize,
        is_all: bool,
    ) -> TerrainStep {
        let Some(shown) = &mut self.shown else {
            return step;
        };
        let Some(next) = &mut self.next else {
            shown.set_memory_cap(cap_bytes);
            let mut step = shown.finish(view, step, stages);
            if step.memory_full {
                let left = std::mem::take(&mut self.left).left();
                step.dropped.extend(left.iter().map(Seed::id));
            }
            return step;
        };
        // The old one keeps what it shows, and no more where memory is scarce.
        shown.set_memory_cap(cap_bytes.saturating_sub(next.terrain.memory_bytes()));
        let old = shown.finish(view, TerrainStep::default(), stages);
        next.terrain
            .set_memory_cap(cap_bytes.saturating_sub(shown.memory_bytes()));
        let mut step = step;
        if matches!(next.seeds, Seeds::Awaited(None, _)) {
            // Nothing that is gone can be taken over.
            step.dropped.extend_from_slice(&old.dropped);
        }
        let is_ready = matches!(&next.seeds, Seeds::Known(known) if known.ready.is_empty());
        if !is_ready {
            return shown_step(old, step);
        }
        let new = next.terrain.finish(view, step, stages);
        let as_good = new.excess <= old.excess.max(1.0);
        let done = is_all && new.waiting == 0 && next.terrain.wants().is_empty();
        let can_be_shown = next.terrain.tree().page(PageId::ROOT).is_some();
        if can_be_shown && (as_good || done || new.memory_full) {
            if let Some(Next { terrain, seeds }) = self.next.take() {
                self.shown = Some(terrain);
                if let Seeds::Known(known) = seeds {
                    self.left = known;
                }
            }
            return new;
        }
        shown_step(old, new)
    }

    /// Meshes in another way from the next update on. Pages that find no place any more.
    pub(super) fn set_options(&mut self, mesh: MeshOptions) -> Vec<PageId> {
        let next = self.next.as_mut().map(|next| &mut next.terrain);
        let mut dropped = Vec::new();
        match (self.shown.as_mut(), next) {
            (Some(shown), Some(next)) => {
                shown.set_options(mesh);
                dropped = next.set_options(mesh);
                next.follow(shown);
            }
            (Some(shown), None) => dropped = shown.set_options(mesh),
            (None, _) => {}
        }
        dropped
    }
}

/// Takes over pages, and links what has arrived, as far as there is time. Whether none is left.
fn link_next(
    terrain: &mut Terrain,
    known: &mut Known,
    step: &mut TerrainStep,
    stages: &mut Stages<'_>,
) -> bool {
    while known.hand_over(terrain, step, stages) {
        match terrain.link_one(step, stages) {
            Some(page) => known.arrived(page, terrain),
            None => return terrain.waiting() == 0,
        }
    }
    false
}

/// The old generation is shown, the new one lacks pages.
fn shown_step(old: TerrainStep, new: TerrainStep) -> TerrainStep {
    TerrainStep {
        excess: old.excess,
        triangles: old.triangles,
        times: match new.triangles {
            0 => old.times,
            _ => new.times,
        },
        ..new
    }
}
