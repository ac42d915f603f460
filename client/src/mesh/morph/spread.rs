//! From weights by a vertex's own tests to weights that are nested: from fine to coarse, and across
//! the borders of pages.
//!
//! Only listed pages are done. Within a level of pages all go in step, tier by tier, since an edge
//! vertex on a border has dependents on both sides; where a weight there has changed, the page
//! across is listed, too, and goes on from that tier.

use super::super::place::{PageSquare, across};
use super::super::surface::{Index, Surface};
use super::order::{Step, TIERS, Tier};
use super::{Known, Morph, ROOT_CENTRE};
use escarp_proto::geometry::{Edge, PAGE_LEVELS};

impl Morph {
    /// Brings the weights of listed pages, and of all that follows from them, up to date. Pages
    /// whose weights may have changed remain in the lists.
    pub(super) fn spread(&mut self, surface: &Surface) {
        for level in (0..self.lists.len()).rev() {
            let mut list = std::mem::take(&mut self.lists[level]);
            let before: Vec<u8> = list.iter().map(|&page| self.centre_of(page)).collect();
            for tier in (0..TIERS.len()).rev() {
                self.spread_tier(surface, &mut list, tier);
            }
            for (i, &page) in list.iter().enumerate() {
                // Pages that came later are compared with nothing, and so taken for changed.
                let same = before.get(i) == Some(&self.centre_of(page));
                if let (false, Some((parent, _))) = (same, surface.node(page).parent) {
                    self.list(surface, parent);
                }
            }
            self.lists[level] = list;
        }
    }

    fn centre_of(&self, page: Index) -> u8 {
        let known = &self.places[page as usize].known;
        known.as_ref().map_or(0, |known| known.all[ROOT_CENTRE])
    }

    fn spread_tier(&mut self, surface: &Surface, list: &mut Vec<Index>, number: usize) {
        let tier = &TIERS[number];
        for &page in list.iter() {
            let below = match number + 1 == TIERS.len() {
                true => self.below(surface, page),
                false => Vec::new(),
            };
            if let Some(known) = &mut self.places[page as usize].known {
                known.edges(tier, &below);
            }
        }
        // Those that are added have nothing new on their own side.
        for i in 0..list.len() {
            self.meet(surface, list, i, tier);
        }
        for &page in list.iter() {
            if let Some(known) = &mut self.places[page as usize].known {
                tier.centres.iter().for_each(|step| {
                    let weight = known.gather(step, &known.own);
                    known.all[step.vertex as usize] = weight;
                });
            }
        }
    }

    /// The vertices that the centres of pages below depend on, and those centres' weights.
    fn below(&self, surface: &Surface, page: Index) -> Vec<(u16, u8)> {
        let mut below = Vec::new();
        for &(slot, child) in &surface.node(page).children {
            let weight = self.centre_of(child);
            let (column, row) = slot.position();
            let cell = PageSquare {
                level: PAGE_LEVELS,
                column: column as u8,
                row: row as u8,
            };
            if let (1.., Some((square, quadrant))) = (weight, cell.parent()) {
                let needed = quadrant.edges().map(|edge| square.edge(edge) as u16);
                below.extend(needed.map(|vertex| (vertex, weight)));
            }
        }
        below
    }

    /// Gives the vertices on a page's borders the larger weight of both sides.
    fn meet(&mut self, surface: &Surface, list: &mut Vec<Index>, i: usize, tier: &Tier) {
        let page = list[i];
        let neighbours = surface.node(page).neighbours;
        for &(edge, step) in &tier.border {
            let Some(known) = &self.places[page as usize].known else {
                return;
            };
            let own = known.side[step.vertex as usize];
            let weight = match neighbours[edge as usize] {
                Some(other) => own.max(self.meet_across(list, other, edge, step.vertex, own)),
                None => own,
            };
            if let Some(known) = &mut self.places[page as usize].known {
                known.all[step.vertex as usize] = weight;
            }
        }
    }

    /// Gives the page across the larger weight; what that is on its side.
    fn meet_across(
        &mut self,
        list: &mut Vec<Index>,
        other: Index,
        edge: Edge,
        vertex: u16,
        own: u8,
    ) -> u8 {
        let place = &mut self.places[other as usize];
        let Some(known) = &mut place.known else {
            return 0;
        };
        let vertex = across(vertex as usize, edge);
        let side = known.side[vertex];
        if known.all[vertex] != side.max(own) {
            known.all[vertex] = side.max(own);
            if !std::mem::replace(&mut place.listed, true) {
                list.push(other);
            }
        }
        side
    }
}

impl Known {
    /// The largest weight of a vertex itself and of what depends on it in the page.
    fn gather(&self, step: &Step, own: &super::Weights) -> u8 {
        let dependents = step.dependents.map(|vertex| self.all[vertex as usize]);
        let most = dependents.into_iter().fold(0, u8::max);
        own[step.vertex as usize].max(most)
    }

    /// The edge vertices of a tier, as far as this page's side goes.
    fn edges(&mut self, tier: &Tier, below: &[(u16, u8)]) {
        let steps = || {
            tier.inner
                .iter()
                .chain(tier.border.iter().map(|(_, step)| step))
        };
        for step in steps() {
            self.side[step.vertex as usize] = self.gather(step, &self.own);
        }
        for &(vertex, weight) in below {
            let side = &mut self.side[vertex as usize];
            *side = (*side).max(weight);
        }
        for step in &tier.inner {
            self.all[step.vertex as usize] = self.side[step.vertex as usize];
        }
    }
}
