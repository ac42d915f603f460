//! The queues held against a recomputation from nothing: for tests.

use super::super::sight::Sight;
use super::super::surface::{Index, Surface};
use super::item::{ITEMS, Item};
use super::{Candidate, Roam};
use escarp_proto::view::View;
use std::cmp::Reverse;
use std::collections::HashMap;

/// Where the entry of an item that counts is.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Place {
    Calendar,
    Split(f64),
    Merge(f64),
    Blocked(f64),
}

impl Roam {
    pub(super) fn check_against(&self, surface: &Surface, view: &View) -> Result<(), String> {
        let sight = Sight::of(surface, view);
        let places = self.places()?;
        let mut triangles = 0;
        let mut existing = 0;
        for page in 0..surface.nodes.len() as Index {
            if surface.nodes[page as usize].is_none() {
                continue;
            }
            surface.leaves(page, &mut |_| triangles += 1);
            for item in (0..ITEMS).map(Item::from_index) {
                let place = places.get(&(page, item.index())).copied();
                existing += usize::from(item.exists(surface, page));
                self.check_item(surface, &sight, (page, item), place)
                    .map_err(|why| format!("page {page} {:?}: {why}", item.side()))?;
            }
        }
        if (triangles, existing) != (self.triangles, self.existing) {
            return Err(format!(
                "{triangles} triangles and {existing} items, counted as {} and {}",
                self.triangles, self.existing
            ));
        }
        if places.len() > existing {
            return Err("entries count of items that do not exist".into());
        }
        self.check_decisions(&places)
    }

    /// Where each item's entry is.
    fn places(&self) -> Result<HashMap<(Index, usize), Place>, String> {
        let mut places = HashMap::new();
        let mut add =
            |page: Index, item: Item, place| match places.insert((page, item.index()), place) {
                None => Ok(()),
                Some(other) => Err(format!("{page} {item:?} is in {other:?} and {place:?}")),
            };
        for entry in self.calendar.iter() {
            let notes = self.notes(entry.page);
            if notes.is_some_and(|notes| notes.counts(entry.item, entry.stamp)) {
                add(entry.page, entry.item, Place::Calendar)?;
            }
        }
        type MakePlace = fn(f64) -> Place;
        let merges = self.merges.iter().map(|Reverse(merge)| merge);
        let all = (self.splits.iter().map(|c| (c, Place::Split as MakePlace)))
            .chain(merges.map(|c| (c, Place::Merge as MakePlace)))
            .chain(
                self.blocked
                    .iter()
                    .map(|c| (c, Place::Blocked as MakePlace)),
            );
        for (candidate, place) in all {
            if self.counts(candidate) {
                let Candidate { page, item, .. } = *candidate;
                add(page, item, place(candidate.priority))?;
            }
        }
        Ok(places)
    }

    fn check_item(
        &self,
        surface: &Surface,
        sight: &Sight,
        (page, item): (Index, Item),
        place: Option<Place>,
    ) -> Result<(), String> {
        let notes = self.notes(page);
        let exists = notes.is_some_and(|notes| notes.exists(item));
        if exists != item.exists(surface, page) {
            return Err(format!("noted as {exists}"));
        }
        let asked = notes.is_some_and(|notes| notes.is_asked(item));
        let state = |(vertex, asker)| surface.state(vertex).is_asked_by(asker);
        if asked != item.vertex(surface, page).is_some_and(state) {
            return Err(format!("noted as asked: {asked}"));
        }
        if !exists {
            return match (asked, place) {
                (false, None) => Ok(()),
                _ => Err(format!("does not exist, asked {asked}, in {place:?}")),
            };
        }
        let seen = self.seen(surface, sight, page, item);
        let found = self.scale.priority(&seen);
        let right = match place {
            None => !asked && seen.reach_m <= 0.0,
            Some(Place::Calendar) if asked => found > self.band.hi * (1.0 - 1e-9),
            Some(Place::Calendar) => found <= self.band.lo * (1.0 + 1e-9),
            Some(Place::Split(noted) | Place::Blocked(noted)) => !asked && noted == found,
            Some(Place::Merge(noted)) => asked && noted == found,
        };
        match right {
            true => Ok(()),
            false => Err(format!(
                "asked {asked}, priority {found}, in {place:?} with {:?}",
                self.band
            )),
        }
    }

    /// Without a limit on changes, no split is left to do, and no merge.
    fn check_decisions(&self, places: &HashMap<(Index, usize), Place>) -> Result<(), String> {
        if let Some(most) = self.limits.triangles
            && self.triangles > most.max(4)
        {
            return Err(format!("{} triangles of {most}", self.triangles));
        }
        if self.limits.changes.is_some() {
            return Ok(());
        }
        let (mut split, mut merge) = (0.0f64, f64::INFINITY);
        for place in places.values() {
            match *place {
                Place::Split(excess) => split = split.max(excess),
                Place::Merge(excess) => merge = merge.min(excess),
                Place::Blocked(_) | Place::Calendar => {}
            }
        }
        let limited = self.limits.triangles.is_some();
        let least = self.scale.least;
        let right = merge > least && split <= if limited { least.max(merge) } else { least };
        match right {
            true => Ok(()),
            false => Err(format!(
                "the split queue's top is {split}, the merge queue's bottom {merge}"
            )),
        }
    }
}
