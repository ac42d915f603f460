//! How urgent it is to split a triangle, and for how long nothing about it can change.

use super::super::sight::{Seen, Sight};
use super::super::surface::{Index, Surface};
use super::band::Band;
use super::calendar::Entry;
use super::candidate::Candidate;
use super::item::{Item, Notes, Side};
use super::{Pass, Roam};
use std::cmp::Reverse;

/// What priorities are measured in. They are compared from update to update, so that they must not
/// change their meaning whenever the tolerance does.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scale {
    /// Threshold at which a priority is how many times over the tolerance an error is.
    pub(super) reference: f64,
    pub(super) threshold: f64,
    /// The tolerance as a priority.
    pub(super) least: f64,
    /// Updates since the threshold last changed.
    pub(super) steady: u32,
}

impl Scale {
    pub(super) const NONE: Scale = Scale {
        reference: 0.0,
        threshold: 0.0,
        least: 1.0,
        steady: STEADY,
    };

    pub(super) fn at(threshold: f64, steady: u32) -> Scale {
        Scale {
            reference: threshold,
            threshold,
            least: 1.0,
            steady,
        }
    }

    pub(super) fn priority(&self, seen: &Seen) -> f64 {
        excess(seen) * self.least
    }
}

/// After so many updates with one threshold it is not expected to change.
pub(super) const STEADY: u32 = 30;

impl Roam {
    pub(super) fn seen(&self, surface: &Surface, sight: &Sight, page: Index, item: Item) -> Seen {
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
    pub(super) fn test(&mut self, pass: &mut Pass<'_>, page: Index, item: Item) {
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
                let way_m = self.way.length_m() + slack_m(&seen, edge / scale.least);
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
    pub(super) fn look_again(&mut self, pass: &mut Pass<'_>) {
        self.way.go(pass.sight.tests.eye_m);
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
        self.calendar.advance(self.way.length_m(), &mut due);
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
    pub(super) fn rescale(&mut self, threshold: f64) -> bool {
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
    pub(super) fn tolerance_band(&self) -> Band {
        match self.scale.steady < STEADY {
            true => Band::around(self.scale.least, 0.0),
            false => Band::at(self.scale.least),
        }
    }

    /// What was blocked in the last update may be possible in this one.
    pub(super) fn unblock(&mut self) {
        let blocked = std::mem::take(&mut self.blocked);
        for candidate in blocked {
            if let Some(notes) = self.notes_mut(candidate.page) {
                notes.set_blocked(candidate.item, false);
                self.splits.push(candidate);
            }
        }
    }

    pub(super) fn test_queues(&mut self, pass: &mut Pass<'_>) {
        let mut again = std::mem::take(&mut self.blocked);
        again.extend(std::mem::take(&mut self.splits));
        again.extend(self.merges.drain().map(|Reverse(merge)| merge));
        for candidate in &again {
            if self.counts(candidate) {
                self.test(pass, candidate.page, candidate.item);
            }
        }
    }

    pub(super) fn test_page(&mut self, pass: &mut Pass<'_>, page: Index) {
        let existing: Vec<Item> = self
            .notes(page)
            .into_iter()
            .flat_map(Notes::existing)
            .collect();
        for item in existing {
            self.test(pass, page, item);
        }
    }

    pub(super) fn test_all(&mut self, pass: &mut Pass<'_>) {
        self.calendar.clear();
        self.way.restart();
        self.splits.clear();
        self.merges.clear();
        self.blocked.clear();
        for page in 0..self.notes.len() as Index {
            self.test_page(pass, page);
        }
    }
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
