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

mod calendar;
mod candidate;
mod check;
mod item;
mod variance;

use super::mesher::{Found, MeshOptions, Mesher, Metric};
use super::place::{PageSquare, Role, across, border, role};
use super::sight::{Seen, Sight};
use super::standing::largest_excess;
use super::surface::{Index, Surface};
use super::vertices::VertexRef;
use calendar::{Calendar, Entry};
use candidate::{Band, Candidate};
use escarp_proto::geometry::{Edge, PageId};
use escarp_proto::view::View;
use item::{Item, Notes, Side};
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
    /// Eye of the last update, and the length of its way so far, metres.
    eye_m: Option<[f64; 3]>,
    way_m: f64,
}

/// What priorities are measured in. They are compared from update to update, so that they must not
/// change their meaning whenever the tolerance does.
#[derive(Debug, Clone, Copy)]
struct Scale {
    /// Threshold at which a priority is how many times over the tolerance an error is.
    reference: f64,
    threshold: f64,
    /// The tolerance as a priority.
    least: f64,
    /// Updates since the threshold last changed.
    steady: u32,
}

impl Scale {
    const NONE: Scale = Scale {
        reference: 0.0,
        threshold: 0.0,
        least: 1.0,
        steady: STEADY,
    };

    fn at(threshold: f64, steady: u32) -> Scale {
        Scale {
            reference: threshold,
            threshold,
            least: 1.0,
            steady,
        }
    }

    fn priority(&self, seen: &Seen) -> f64 {
        excess(seen) * self.least
    }
}

/// After so many updates with one threshold it is not expected to change.
const STEADY: u32 = 30;

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
        let sight = Sight::of(surface, view);
        let mut pass = Pass {
            surface,
            sight,
            tests: 0,
            left: self.limits.changes.map_or(u64::MAX, u64::from),
            floor: None,
        };
        self.follow(&mut pass);
        self.look_again(&mut pass);
        self.decide(&mut pass);
        self.set_band(&mut pass);
        self.tidy();
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
            eye_m: None,
            way_m: 0.0,
        }
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

    // What exists.

    /// Follows the vertices that were enabled or disabled since: triangles come to exist, or
    /// exist no more.
    fn follow(&mut self, pass: &mut Pass<'_>) {
        let mut flips = pass.surface.take_flips();
        for (vertex, enabled) in flips.drain(..) {
            self.count(pass.surface, vertex, enabled);
            pass.left = pass.left.saturating_sub(1);
            self.follow_vertex(pass, vertex);
            if let Some(mirror) = mirror(pass.surface, vertex) {
                self.follow_vertex(pass, mirror);
            }
        }
        pass.surface.give_back_flips(flips);
    }

    /// A vertex adds a triangle on each side of the edge that it splits; the root's centre, four.
    fn count(&mut self, surface: &Surface, (page, sample): VertexRef, enabled: bool) {
        let id = surface.node(page).page.id();
        let root = sample as usize == PageSquare::ROOT.centre() && id == PageId::ROOT;
        let outer = border(sample as usize).is_some_and(|edge| id.neighbour(edge).is_none());
        let more = match (root, outer) {
            (true, _) => 4,
            (_, true) => 1,
            _ => 2,
        };
        match enabled {
            true => self.triangles += more,
            false => self.triangles -= more,
        }
    }

    fn follow_vertex(&mut self, pass: &mut Pass<'_>, (page, sample): VertexRef) {
        match role(sample as usize) {
            Role::Corner => {}
            Role::Centre(square) => {
                for edge in Edge::ALL {
                    self.follow_item(pass, page, Item::edge(square, edge));
                }
            }
            Role::Edge(sides) => {
                for (square, edge) in sides.into_iter().flatten() {
                    for quadrant in edge.quadrants() {
                        self.follow_item(pass, page, Item::quadrant(square, quadrant));
                    }
                }
            }
        }
    }

    fn follow_item(&mut self, pass: &mut Pass<'_>, page: Index, item: Item) {
        let exists = item.exists(pass.surface, page);
        let place = place_of(&mut self.notes, page);
        if place.is_none() && !exists {
            return;
        }
        let notes = place.get_or_insert_with(|| {
            self.made = self.made.wrapping_add(1);
            Notes::new(self.made)
        });
        if !notes.set_exists(item, exists) {
            return;
        }
        if exists {
            self.existing += 1;
            return self.test(pass, page, item);
        }
        self.existing -= 1;
        if !notes.any_exist() {
            *place = None;
            pass.surface.touch(page);
        }
    }

    // Priorities.

    fn seen(&self, surface: &Surface, sight: &Sight, page: Index, item: Item) -> Seen {
        let node = surface.node(page);
        let seen = match item.side() {
            Side::Edge(square, edge) => sight.edge(node, square, edge),
            Side::Quadrant(square, quadrant) => sight.quadrant(node, square, quadrant),
        };
        let variances = self.variances.as_ref();
        let of_page = variances.and_then(|variances| variances.get(page as usize)?.as_ref());
        match of_page {
            Some(variances) => Seen {
                reach_m: variances.get(item) * surface.georef.quantum_m * sight.tests.threshold,
                ..seen
            },
            None => seen,
        }
    }

    /// Tests an existing item, and puts it where it belongs: into the calendar if nothing can be
    /// decided about it for a while, else into a queue.
    fn test(&mut self, pass: &mut Pass<'_>, page: Index, item: Item) {
        pass.tests += 1;
        let seen = self.seen(pass.surface, &pass.sight, page, item);
        let priority = self.scale.priority(&seen);
        let (band, scale) = (self.band, self.scale);
        let Some(notes) = self.notes_mut(page) else {
            return;
        };
        let (asked, stamp) = (notes.is_asked(item), notes.renew(item));
        let edge = if asked { band.hi } else { band.lo };
        let settled = match asked {
            true => priority > edge,
            false => priority <= edge,
        };
        if settled {
            notes.set_blocked(item, false);
            if seen.reach_m > 0.0 {
                let way_m = self.way_m + slack_m(&seen, edge / scale.least);
                self.calendar.push(Entry::new(way_m, page, item, stamp));
            }
            return;
        }
        let blocked = notes.is_blocked(item);
        let candidate = Candidate {
            priority,
            key: pass.surface.node(page).page.id().key(),
            page,
            item,
            stamp,
        };
        match (asked, blocked) {
            (true, _) => self.merges.push(Reverse(candidate)),
            (false, true) => self.blocked.push(candidate),
            (false, false) => self.splits.push(candidate),
        }
    }

    /// Tests what may have changed since the last update.
    fn look_again(&mut self, pass: &mut Pass<'_>) {
        self.go_to(pass.sight.tests.eye_m);
        self.unblock();
        if !self.rescale(pass.sight.tests.threshold) {
            self.changed.clear();
            return self.test_all(pass);
        }
        let changed = std::mem::take(&mut self.changed);
        for page in changed {
            self.test_page(pass, page);
        }
        let mut due = Vec::new();
        self.calendar.advance(self.way_m, &mut due);
        for Entry {
            page, item, stamp, ..
        } in due
        {
            let notes = self.notes(page);
            if notes.is_some_and(|notes| notes.counts(item, stamp)) {
                self.test(pass, page, item);
            }
        }
        self.test_queues(pass);
    }

    /// Takes over the tolerance. Whether what waits in the calendar may wait on.
    fn rescale(&mut self, threshold: f64) -> bool {
        let scale = &mut self.scale;
        if scale.threshold == threshold {
            scale.steady = scale.steady.saturating_add(1);
            return true;
        }
        scale.least = scale.reference / threshold;
        let first = scale.threshold == 0.0;
        scale.threshold = threshold;
        scale.steady = 0;
        if !first && self.band.has(scale.least) {
            return true;
        }
        self.scale = Scale::at(threshold, if first { STEADY } else { 0 });
        self.band = self.tolerance_band();
        false
    }

    /// The band if nothing but the tolerance decides.
    fn tolerance_band(&self) -> Band {
        match self.scale.steady < STEADY {
            true => Band::around(self.scale.least, 0.0),
            false => Band::at(self.scale.least),
        }
    }

    /// Adds to the eye's way, in the measure of
    /// [`WorldBox::distance_m`](escarp_proto::georef::WorldBox::distance_m). Never too little.
    fn go_to(&mut self, eye_m: [f64; 3]) {
        if let Some(last) = self.eye_m.replace(eye_m) {
            let step = (0..3).map(|axis| (eye_m[axis] - last[axis]).abs());
            let step_m = step.fold(0.0, f64::max);
            if step_m > 0.0 {
                self.way_m = (self.way_m + step_m.next_up()).next_up();
            }
        }
    }

    /// What was blocked in the last update may be possible in this one.
    fn unblock(&mut self) {
        let blocked = std::mem::take(&mut self.blocked);
        for candidate in blocked {
            if let Some(notes) = self.notes_mut(candidate.page) {
                notes.set_blocked(candidate.item, false);
                self.splits.push(candidate);
            }
        }
    }

    fn test_queues(&mut self, pass: &mut Pass<'_>) {
        let mut again = std::mem::take(&mut self.blocked);
        again.extend(std::mem::take(&mut self.splits));
        again.extend(self.merges.drain().map(|Reverse(merge)| merge));
        for candidate in &again {
            if self.counts(candidate) {
                self.test(pass, candidate.page, candidate.item);
            }
        }
    }

    fn test_page(&mut self, pass: &mut Pass<'_>, page: Index) {
        let existing: Vec<Item> = self
            .notes(page)
            .into_iter()
            .flat_map(Notes::existing)
            .collect();
        for item in existing {
            self.test(pass, page, item);
        }
    }

    fn test_all(&mut self, pass: &mut Pass<'_>) {
        self.calendar.clear();
        self.way_m = 0.0;
        self.splits.clear();
        self.merges.clear();
        self.blocked.clear();
        for page in 0..self.notes.len() as Index {
            self.test_page(pass, page);
        }
    }

    // Decisions.

    /// Splits from the top of the split queue and merges from the bottom of the merge queue until
    /// neither is of use any more, or this update has done enough.
    fn decide(&mut self, pass: &mut Pass<'_>) {
        loop {
            if self.is_over_limit() {
                match self.lowest_merge() {
                    Some(merge) => self.give_way(pass, merge),
                    None if self.band.hi < f64::INFINITY => self.widen(pass),
                    None => return,
                }
                continue;
            }
            if pass.left == 0 {
                return;
            }
            let least = self.scale.least;
            let split = self.highest_split().filter(|split| split.priority > least);
            if let Some(split) = split {
                if pass.floor.is_none_or(|floor| split > floor) {
                    self.splits.pop();
                    self.split(pass, split);
                    continue;
                }
            } else if pass.floor.is_none() && self.band.lo > least {
                // All in the band is split, and there is room for more.
                self.widen(pass);
                continue;
            }
            match self.lowest_merge() {
                Some(merge) if merge.priority <= least => self.merge(pass, merge),
                _ => return,
            }
        }
    }

    fn is_over_limit(&self) -> bool {
        self.limits
            .triangles
            .is_some_and(|most| self.triangles > most)
    }

    fn highest_split(&mut self) -> Option<Candidate> {
        while let Some(split) = self.splits.peek().copied() {
            if self.counts(&split) {
                return Some(split);
            }
            self.splits.pop();
        }
        None
    }

    fn lowest_merge(&mut self) -> Option<Candidate> {
        while let Some(&Reverse(merge)) = self.merges.peek() {
            if self.counts(&merge) {
                return Some(merge);
            }
            self.merges.pop();
        }
        None
    }

    /// Splits a triangle, and with it what that takes; or wants what is missing.
    fn split(&mut self, pass: &mut Pass<'_>, split: Candidate) {
        let Candidate { page, item, .. } = split;
        let excess = split.priority / self.scale.least;
        let seen = self.seen(pass.surface, &pass.sight, page, item);
        let Pass { surface, sight, .. } = pass;
        surface.wishes.in_view = sight.frustum.may_see(&seen.region);
        surface.wishes.blocked = false;
        let done = match item.vertex(surface, page) {
            Some((vertex, asker)) => {
                surface.ask(vertex, asker, true, excess);
                surface.is_enabled(vertex)
            }
            None => {
                if let Side::Quadrant(square, quadrant) = item.side() {
                    surface.want_below(page, square.child(quadrant), excess);
                }
                false
            }
        };
        if !done {
            if let Some(notes) = self.notes_mut(page) {
                notes.set_blocked(item, true);
            }
            self.blocked.push(split);
            // What it had enabled for a moment is disabled again.
            let left = pass.left;
            self.follow(pass);
            pass.left = left;
            return;
        }
        self.set_asked(pass, page, item, true);
    }

    /// Lets a triangle be merged, if nothing else needs it split, and all that only it needed.
    fn merge(&mut self, pass: &mut Pass<'_>, merge: Candidate) {
        self.merges.pop();
        let Candidate { page, item, .. } = merge;
        if let Some((vertex, asker)) = item.vertex(pass.surface, page) {
            pass.surface.ask(vertex, asker, false, 0.0);
        }
        self.set_asked(pass, page, item, false);
    }

    fn give_way(&mut self, pass: &mut Pass<'_>, merge: Candidate) {
        self.merge(pass, merge);
        pass.floor = pass.floor.max(Some(merge));
    }

    fn set_asked(&mut self, pass: &mut Pass<'_>, page: Index, item: Item, asked: bool) {
        if let Some(notes) = self.notes_mut(page) {
            notes.set_asked(item, asked);
            self.test(pass, page, item);
        }
        self.follow(pass);
    }

    // The band.

    /// What is to be decided lies beyond the band.
    fn widen(&mut self, pass: &mut Pass<'_>) {
        self.band = Band::above(self.scale.least);
        self.test_all(pass);
    }

    /// Puts the band around the priority at which the last decision fell.
    fn set_band(&mut self, pass: &mut Pass<'_>) {
        let least = self.scale.least;
        let at_limit = self
            .limits
            .triangles
            .is_some_and(|most| self.triangles >= most - most / 5);
        if !at_limit && self.scale.steady >= STEADY {
            return self.change_band(pass, self.tolerance_band());
        }
        let around = pass.floor.map_or(least, |floor| floor.priority.max(least));
        // Far from the limit, or while the tolerance changes, it may come down.
        let lowest = if self.scale.steady < STEADY {
            0.0
        } else {
            least
        };
        if !self.band.suits(around, lowest) {
            self.change_band(pass, Band::around(around, lowest));
        }
    }

    fn change_band(&mut self, pass: &mut Pass<'_>, band: Band) {
        if self.band == band {
            return;
        }
        let inside = self.band.holds(&band);
        self.band = band;
        match inside {
            // What was beyond the wider band is beyond this one.
            true => self.test_queues(pass),
            false => self.test_all(pass),
        }
    }

    /// Throws out void entries of the calendar once they are the larger part.
    fn tidy(&mut self) {
        if self.calendar.len() > 2 * self.existing + 4096 {
            let notes = &self.notes;
            self.calendar.retain(|entry| {
                let of_page = notes[entry.page as usize].as_ref();
                of_page.is_some_and(|notes| notes.counts(entry.item, entry.stamp))
            });
        }
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

/// The same vertex in the page across the border.
fn mirror(surface: &Surface, (page, sample): VertexRef) -> Option<VertexRef> {
    let edge = border(sample as usize)?;
    let neighbour = surface.node(page).neighbours[edge as usize]?;
    Some((neighbour, across(sample as usize, edge) as u16))
}

/// How many times over the tolerance an error is; above 1 exactly if its test fails.
fn excess(seen: &Seen) -> f64 {
    match seen.fails() {
        true => seen.excess().max(1.0_f64.next_up()),
        false => seen.excess().min(1.0),
    }
}

/// How far the eye may move before a priority can have come to `edge`, metres.
fn slack_m(seen: &Seen, edge: f64) -> f64 {
    let reach_m = seen.reach_m / edge;
    // Both are rounded, and will be rounded otherwise from another place.
    let doubt_m = 1e-12 * (reach_m + seen.distance_m);
    ((reach_m - seen.distance_m).abs() * (1.0 - 1e-9) - doubt_m).max(0.0)
}
