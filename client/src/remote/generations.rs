//! One generation of a dataset after another, without a gap and without a mixture: the old one is
//! shown until the new one is as good.

use crate::mesh::MeshOptions;
use crate::stages::Stages;
use crate::terrain::{Seed, Terrain, TerrainStep};
use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;
use escarp_proto::view::View;
use std::collections::HashSet;
use std::sync::Arc;

/// The terrain that is shown, and the one that will be.
#[derive(Debug, Default)]
pub(super) struct Generations {
    shown: Option<Terrain>,
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
    /// Nobody knows yet which; they will be this terrain's, or those of the one that is shown.
    Awaited(Option<Box<Terrain>>),
    /// They are being taken over, those at the end first.
    Waiting(Vec<Seed>),
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
        let (source, lost) = match self.next.take() {
            None => {
                let lost = shown.link_all();
                (None, lost)
            }
            // What came since then may continue pages that are not there yet.
            Some(Next {
                mut terrain,
                seeds: Seeds::Awaited(source),
            }) => (source, terrain.drop_waiting()),
            Some(Next {
                mut terrain,
                seeds: Seeds::Waiting(seeds),
            }) => {
                let mut lost = take_all(&mut terrain, seeds);
                lost.extend(terrain.link_all());
                (Some(Box::new(terrain)), lost)
            }
        };
        terrain.follow(source.as_deref().unwrap_or(shown));
        self.next = Some(Next {
            terrain,
            seeds: Seeds::Awaited(source),
        });
        lost
    }

    /// These pages of before are of the new generation, too. Gives those of them that are not here.
    pub(super) fn confirm(&mut self, same: Vec<PageId>, cap_bytes: usize) -> Vec<PageId> {
        let Some(next) = &mut self.next else {
            return Vec::new();
        };
        let Seeds::Awaited(source) = &next.seeds else {
            return Vec::new();
        };
        let mut same: HashSet<PageId> = same.into_iter().collect();
        let source = source.as_deref().or(self.shown.as_ref());
        let seeds =
            source.map_or_else(Vec::new, |source| source.seeds(|page| same.contains(&page)));
        for seed in &seeds {
            same.remove(&seed.id());
        }
        next.seeds = Seeds::Waiting(seeds);
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
            let shown = self.shown.as_mut();
            return shown.is_none_or(|shown| shown.link_arrived(step, stages));
        };
        let Seeds::Waiting(seeds) = &mut next.seeds else {
            // What hangs below those pages has to wait for them.
            return false;
        };
        let is_all = take_ready(&mut next.terrain, seeds, step, stages);
        is_all && next.terrain.link_arrived(step, stages)
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
            return shown.finish(view, step, stages);
        };
        // The old one keeps what it shows, and no more where memory is scarce.
        shown.set_memory_cap(cap_bytes.saturating_sub(next.terrain.memory_bytes()));
        let old = shown.finish(view, TerrainStep::default(), stages);
        next.terrain
            .set_memory_cap(cap_bytes.saturating_sub(shown.memory_bytes()));
        let mut step = step;
        if matches!(next.seeds, Seeds::Awaited(None)) {
            // Nothing that is gone can be taken over.
            step.dropped.extend_from_slice(&old.dropped);
        }
        let Seeds::Waiting(seeds) = &mut next.seeds else {
            return shown_step(old, step);
        };
        let mut new = next.terrain.finish(view, step, stages);
        let as_good = new.excess <= old.excess.max(1.0);
        let done = is_all && new.waiting == 0 && next.terrain.wants().is_empty();
        let can_be_shown = new.triangles > 0 && new.excess.is_finite();
        if as_good || can_be_shown && (done || new.memory_full) {
            // Pages that are not above anything in the new mesh found no place until now.
            new.dropped.extend(seeds.iter().map(Seed::id));
            self.shown = self.next.take().map(|next| next.terrain);
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

/// Takes over those pages whose pages above are here, as far as there is time; the others wait, as
/// what is above them has changed, and is on its way. Whether no page is left that could be taken.
fn take_ready(
    terrain: &mut Terrain,
    seeds: &mut Vec<Seed>,
    step: &mut TerrainStep,
    stages: &mut Stages<'_>,
) -> bool {
    let mut waiting = Vec::new();
    while let Some(seed) = seeds.pop() {
        let id = seed.id();
        if !terrain.has_place_for(id) {
            waiting.push(seed);
        } else if !stages.begin_page() {
            seeds.push(seed);
            break;
        } else if !terrain.take_seed(seed) {
            step.dropped.push(id);
        }
    }
    let is_all = seeds.is_empty();
    // In their order: those above at the end.
    seeds.extend(waiting.into_iter().rev());
    is_all
}

/// Takes over all that is left, as far as it fits; the pages that do not.
fn take_all(terrain: &mut Terrain, mut seeds: Vec<Seed>) -> Vec<PageId> {
    let mut lost = Vec::new();
    while let Some(seed) = seeds.pop() {
        let id = seed.id();
        if !terrain.take_seed(seed) {
            lost.push(id);
        }
    }
    lost
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
