//! ROAM: two queues that keep a mesh optimal from frame to frame (Duchaineau et al., "ROAMing
//! Terrain: Real-time Optimally Adapting Meshes", 1997; Turner, "Real-Time Dynamic Terrain
//! Rendering with ROAM", Gamasutra, 2000).
//!
//! The hierarchy that a [`Surface`] has is ROAM's binary tree of right triangles. A vertex and the
//! triangles on both sides of the edge that it splits are a *diamond*; enabling it together with
//! all that it depends on is a *forced split*; one on which nothing depends may be *merged*. What
//! is left to decide is which triangles ask to be split. Of those that exist, the *split queue*
//! holds those that do not ask, the *merge queue* those that do.
//!
//! Priorities are how many times over the tolerance the bound of a triangle's error is on the
//! screen: the wedgies of the paper, but with bounds that hold. They are nested, so that the
//! triangles that ask are all those above one priority: the mesh follows from view, pages and
//! limits alone, whatever the order of splits and merges was.
//!
//! Invariants, between updates:
//!
//! 1. A triangle exists if [`Item::exists`] says so, and each that does has one entry that counts:
//!    in the calendar, in a queue, or among the blocked. One without error has none.
//! 2. Until an entry of the calendar is due, its triangle asks and has a priority above the band,
//!    or does not ask and has one at most at the band's lower end.
//! 3. `triangles` is what the surface has, those in holes included.

mod band;
mod calendar;
mod candidate;
mod check;
mod decide;
mod exist;
mod item;
mod priority;
mod variance;

use super::mesher::{Found, MeshOptions, Mesher, Metric};
use super::sight::Sight;
use super::standing::largest_excess;
use super::surface::{Index, Surface};
use super::way::Way;
use band::Band;
use calendar::Calendar;
use candidate::Candidate;
use escarp_proto::view::View;
use item::Notes;
use priority::Scale;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use variance::Variances;

/// The state of the mesher.
#[derive(Debug)]
pub(super) struct Roam {
    limits: Limits,
    /// Of the resident pages, if they are what priorities go by.
    variances: Option<Vec<Option<Variances>>>,
    /// By page; `None` for one without existing items.
    notes: Vec<Option<Box<Notes>>>,
    existing: usize,
    /// Notes that were made so far, as far as eight bits go.
    made: u8,
    /// Pages whose bounds are new.
    changed: Vec<Index>,
    calendar: Calendar,
    splits: BinaryHeap<Candidate>,
    merges: BinaryHeap<Reverse<Candidate>>,
    /// To be split, but that needs what is not resident.
    blocked: Vec<Candidate>,
    band: Band,
    triangles: u64,
    scale: Scale,
    /// The last update, and how many vertices it might still have changed.
    update: u64,
    left: u64,
    way: Way,
}

#[derive(Debug, Clone, Copy)]
struct Limits {
    triangles: Option<u64>,
    changes: Option<u32>,
}

/// One update.
struct Pass<'a> {
    surface: &'a mut Surface,
    sight: Sight,
    tests: u64,
    /// Vertices that may still be enabled or disabled in this update.
    left: u64,
    /// The highest candidate that gave way to the limit on triangles: what is not above it stays
    /// as it is.
    floor: Option<Candidate>,
}

impl Mesher for Roam {
    fn update(&mut self, surface: &mut Surface, view: &View) -> Found {
        let mut pass = Pass {
            sight: Sight::of(surface, view),
            tests: 0,
            left: self.allowance(surface.updates),
            surface,
            floor: None,
        };
        self.follow(&mut pass);
        self.look_again(&mut pass);
        self.decide(&mut pass);
        self.set_band(&mut pass);
        self.tidy();
        self.left = pass.left;
        Found {
            excess: self.excess(&pass),
            squares: pass.tests.div_ceil(8),
        }
    }

    fn linked(&mut self, surface: &Surface, page: Index) {
        if let Some(variances) = &mut self.variances {
            // An outline's error is its square's size, whatever the heights are.
            let without_holes = Some(&surface.node(page).page).filter(|page| !page.has_holes());
            *place_of(variances, page) = without_holes.map(Variances::of);
        }
        self.changed.push(page);
    }

    fn unlinked(&mut self, page: Index) {
        // Entries of its items do not count any more, whoever takes its index.
        self.notes_mut(page).take();
        if let Some(variances) = &mut self.variances {
            place_of(variances, page).take();
        }
    }

    fn forget(&mut self) {
        // As if it were the first update: with another threshold, all is tested.
        self.scale = Scale::NONE;
    }

    fn follows_flips(&self) -> bool {
        true
    }

    fn memory_bytes(&self) -> usize {
        let candidates = self.splits.capacity() + self.merges.capacity() + self.blocked.capacity();
        let variances = self.variances.iter().flatten().flatten();
        self.calendar.memory_bytes()
            + candidates * size_of::<Candidate>()
            + self.notes.iter().flatten().count() * size_of::<Notes>()
            + variances.map(Variances::memory_bytes).sum::<usize>()
    }

    fn check(&self, surface: &Surface, view: &View) -> Result<(), String> {
        self.check_against(surface, view)
    }
}

impl Roam {
    pub(super) fn new(options: &MeshOptions) -> Roam {
        Roam {
            limits: Limits {
                triangles: options.max_triangles.map(u64::from),
                changes: options.max_changes,
            },
            variances: (options.metric == Metric::Local).then(Vec::new),
            notes: Vec::new(),
            existing: 0,
            made: 0,
            changed: Vec::new(),
            calendar: Calendar::new(),
            splits: BinaryHeap::new(),
            merges: BinaryHeap::new(),
            blocked: Vec::new(),
            band: Band::at(1.0),
            triangles: 0,
            scale: Scale::NONE,
            update: 0,
            left: 0,
            way: Way::default(),
        }
    }

    /// How many vertices this pass may change: what earlier ones of the same update have left.
    fn allowance(&mut self, update: u64) -> u64 {
        if std::mem::replace(&mut self.update, update) != update {
            self.left = self.limits.changes.map_or(u64::MAX, u64::from);
        }
        self.left
    }

    fn notes(&self, page: Index) -> Option<&Notes> {
        self.notes.get(page as usize)?.as_deref()
    }

    fn notes_mut(&mut self, page: Index) -> &mut Option<Box<Notes>> {
        place_of(&mut self.notes, page)
    }

    fn counts(&self, candidate: &Candidate) -> bool {
        let notes = self.notes(candidate.page);
        notes.is_some_and(|notes| notes.counts(candidate.item, candidate.stamp))
    }

    /// Throws out void entries of the calendar once they are many, and gives back room that was
    /// needed for once.
    fn tidy(&mut self) {
        if self.calendar.len() > self.existing + self.existing / 2 + 4096 {
            let notes = &self.notes;
            self.calendar.retain(|entry| {
                let of_page = notes[entry.page as usize].as_ref();
                of_page.is_some_and(|notes| notes.counts(entry.item, entry.stamp))
            });
        }
        self.splits.shrink_to(4 * self.splits.len() + 1024);
        self.merges.shrink_to(4 * self.merges.len() + 1024);
        self.blocked.shrink_to(4 * self.blocked.len() + 1024);
    }

    /// Largest bound of a triangle that stands and may be seen, over the tolerance.
    fn excess(&self, pass: &Pass<'_>) -> f64 {
        if self.variances.is_some() {
            // Variances bound nothing.
            return largest_excess(pass.surface, &pass.sight);
        }
        // Those in the calendar that stand are below the band.
        let mut largest = match self.calendar.len() + self.splits.len() {
            0 => 0.0,
            _ => self.band.lo.max(self.scale.least),
        };
        for split in self.splits.iter().chain(&self.blocked) {
            if split.priority > largest && self.counts(split) && self.stands(pass, split) {
                largest = split.priority;
            }
        }
        largest / self.scale.least
    }

    fn stands(&self, pass: &Pass<'_>, split: &Candidate) -> bool {
        let vertex = split.item.vertex(pass.surface, split.page);
        if vertex.is_some_and(|(vertex, _)| pass.surface.is_enabled(vertex)) {
            return false;
        }
        let seen = self.seen(pass.surface, &pass.sight, split.page, split.item);
        pass.sight.frustum.may_see(&seen.region)
    }
}

fn place_of<T>(list: &mut Vec<Option<T>>, page: Index) -> &mut Option<T> {
    let page = page as usize;
    if list.len() <= page {
        list.resize_with(page + 1, || None);
    }
    &mut list[page]
}
