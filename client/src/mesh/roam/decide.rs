//! Splits and merges, from the queues.

use super::super::surface::Index;
use super::candidate::Candidate;
use super::item::{Item, Side};
use super::{Pass, Roam};
use std::cmp::Reverse;

impl Roam {
    /// Splits from the top of the split queue and merges from the bottom of the merge queue until
    /// neither is of use any more, or this update has done enough.
    pub(super) fn decide(&mut self, pass: &mut Pass<'_>) {
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
            } else if self.band.lo > least && self.is_below_band(pass) {
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

    /// Whether something below the band may have to be split: nothing has given way, or something
    /// that is lower. That was asked for before bounds, or the view, made it fall below the band;
    /// what was not asked for, and is above it now, still waits in the calendar.
    fn is_below_band(&self, pass: &Pass<'_>) -> bool {
        pass.floor.is_none_or(|floor| floor.priority < self.band.lo)
    }

    pub(super) fn is_over_limit(&self) -> bool {
        self.limits
            .triangles
            .is_some_and(|most| self.triangles > most)
    }

    pub(super) fn highest_split(&mut self) -> Option<Candidate> {
        while let Some(split) = self.splits.peek().copied() {
            if self.counts(&split) {
                return Some(split);
            }
            self.splits.pop();
        }
        None
    }

    pub(super) fn lowest_merge(&mut self) -> Option<Candidate> {
        while let Some(&Reverse(merge)) = self.merges.peek() {
            if self.counts(&merge) {
                return Some(merge);
            }
            self.merges.pop();
        }
        None
    }

    /// Splits a triangle, and with it what that takes; or wants what is missing.
    pub(super) fn split(&mut self, pass: &mut Pass<'_>, split: Candidate) {
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
    pub(super) fn merge(&mut self, pass: &mut Pass<'_>, merge: Candidate) {
        self.merges.pop();
        let Candidate { page, item, .. } = merge;
        if let Some((vertex, asker)) = item.vertex(pass.surface, page) {
            pass.surface.ask(vertex, asker, false, 0.0);
        }
        self.set_asked(pass, page, item, false);
    }

    pub(super) fn give_way(&mut self, pass: &mut Pass<'_>, merge: Candidate) {
        self.merge(pass, merge);
        pass.floor = pass.floor.max(Some(merge));
    }

    pub(super) fn set_asked(&mut self, pass: &mut Pass<'_>, page: Index, item: Item, asked: bool) {
        if let Some(notes) = self.notes_mut(page) {
            notes.set_asked(item, asked);
            self.test(pass, page, item);
        }
        self.follow(pass);
    }
}
