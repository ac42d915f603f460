//! The default mesher: Ulrich's Update(), from the last state onwards (Ulrich, "Continuous LOD
//! Terrain Meshing Using Adaptive Quadtrees", 2000), with bounds that hold.
//!
//! Only what is due is tested ([`super::due`]): of the pages those whose squares, or pages below,
//! are due, and of their squares those that are. What comes into the mesh for another's sake
//! needs no test before that above it comes out differently: errors and boxes are nested, so the
//! test above has passed by the smaller difference. What stands beyond the tolerance for want of
//! data is due always.

use super::due::{Due, Odometer, PageDue, slack};
use super::mesher::{Found, MeshOptions, Mesher};
use super::sight::{Lines, Seen, Sides, Sight};
use super::squares::{At, FIRST_FINEST, PLACES, ROOT};
use super::surface::{Index, Surface};
use super::vertices::{Asker, VertexRef};
use escarp_proto::geometry::{Edge, PageId, Quadrant};
use escarp_proto::sight::frustum::Frustum;
use escarp_proto::view::View;

/// The state of the mesher.
#[derive(Debug, Default)]
pub(super) struct Quadtree {
    odometer: Odometer,
    /// When the squares of a page are due, by page.
    pages: Vec<PageDue>,
    /// When anything of a page, or below it, is due, by page.
    all: Vec<Due>,
    /// Whether triangles that cannot be seen stay as they are, and the pyramid of the last view.
    culls: bool,
    frustum: Option<Frustum>,
}

impl Mesher for Quadtree {
    fn update(&mut self, surface: &mut Surface, view: &View) -> Found {
        let sight = Sight::of(surface, view);
        let goes_on = self.odometer.go(&sight.tests);
        // The odometer knows nothing of what comes into view.
        let same_view = self.frustum.replace(sight.frustum) == Some(sight.frustum);
        if !goes_on || self.culls && !same_view {
            self.forget();
        }
        let mut pass = Pass {
            sight,
            culls: self.culls,
            odometer: self.odometer,
            found: Found::default(),
        };
        if let Some(&root) = surface.by_id.get(&PageId::ROOT) {
            self.visit_page(surface, &mut pass, root);
        }
        pass.found
    }

    fn linked(&mut self, surface: &Surface, page: Index) {
        let pages = surface.nodes.len();
        self.pages.resize(pages.max(self.pages.len()), PageDue::NOW);
        self.all.resize(pages.max(self.all.len()), Due::NOW);
        self.pages[page as usize] = PageDue::NOW;
        let mut above = Some(page);
        while let Some(page) = above {
            self.all[page as usize] = Due::NOW;
            above = surface.node(page).parent.map(|(parent, _)| parent);
        }
    }

    fn unlinked(&mut self, page: Index) {
        self.pages[page as usize] = PageDue::NOW;
        self.all[page as usize] = Due::NOW;
    }

    fn forget(&mut self) {
        self.pages.fill(PageDue::NOW);
        self.all.fill(Due::NOW);
    }
}

impl Quadtree {
    pub(super) fn new(options: &MeshOptions) -> Quadtree {
        Quadtree {
            culls: options.cull,
            ..Quadtree::default()
        }
    }

    /// Visits a page whose centre is enabled, and those below it, as far as they are due.
    fn visit_page(&mut self, surface: &mut Surface, pass: &mut Pass, index: Index) {
        let place = index as usize;
        if !self.all[place].is_now(&pass.odometer) {
            pass.pass_over(surface, index);
            return;
        }
        let mut all = self.pages[place].due();
        if all.is_now(&pass.odometer) {
            pass.visit_squares(surface, index, &mut self.pages[place]);
            all = self.pages[place].due();
        } else {
            pass.pass_over(surface, index);
        }
        for child in 0..surface.node(index).children.len() {
            let node = surface.node(index);
            let (slot, child) = node.children[child];
            if node.children_enabled.has(slot) {
                self.visit_page(surface, pass, child);
                all = all.or(self.all[child as usize], &pass.odometer);
            }
        }
        self.all[place] = all;
    }
}

/// One update's view.
struct Pass {
    sight: Sight,
    culls: bool,
    odometer: Odometer,
    found: Found,
}

/// A square that is being tested.
struct Tested<'a> {
    index: Index,
    at: At,
    sides: &'a Sides,
    /// A triangle of it stands beyond the tolerance.
    beyond: bool,
}

impl Pass {
    /// What is not due is within the tolerance; how far below does not matter.
    fn pass_over(&mut self, surface: &Surface, index: Index) {
        if self.found.excess >= 1.0 {
            return;
        }
        let node = surface.node(index);
        if node.squares.is_rough() && self.sight.frustum.may_see(&node.mesh.bounds) {
            self.found.excess = 1.0;
        }
    }

    /// Tests the enabled squares of a page that are due.
    fn visit_squares(&mut self, surface: &mut Surface, index: Index, due: &mut PageDue) {
        let node = surface.node(index);
        let lines = self.sight.lines(node);
        let mut visit = due.visit(&self.odometer, &self.sight.tests, &node.mesh.bounds);
        let mut passed_over = false;
        let mut left = node.centres;
        while left != 0 {
            let at = left.trailing_zeros() as At;
            left &= left - 1;
            if due.is_due(at, &visit) {
                let slack = self.test(surface, index, at, &lines);
                due.tested(at, slack, &mut visit);
                // What it enabled or disabled comes after it.
                left = surface.node(index).centres & (u128::MAX << at << 1);
            } else {
                due.passed(at, &mut visit);
                passed_over = true;
            }
        }
        due.end(&visit);
        if passed_over {
            self.pass_over(surface, index);
        }
    }

    /// Tests the triangles of a square. How much it takes until one comes out differently, metres
    /// of error.
    fn test(&mut self, surface: &mut Surface, index: Index, at: At, lines: &Lines) -> f64 {
        self.found.squares += 1;
        let sides = self.sight.sides(surface.node(index), lines, at);
        let mut tested = Tested {
            index,
            at,
            sides: &sides,
            beyond: false,
        };
        for edge in Edge::ALL {
            self.test_edge(surface, &mut tested, edge);
        }
        let mut tests = 4;
        if at < FIRST_FINEST || surface.node(index).squares.has_cells() {
            tests = 8;
            for quadrant in Quadrant::ALL {
                self.test_quadrant(surface, &mut tested, quadrant);
            }
        }
        match tested.beyond {
            true => 0.0,
            false => slack(&self.sight.tests, &sides, 0..tests),
        }
    }

    fn test_edge(&mut self, surface: &mut Surface, tested: &mut Tested<'_>, edge: Edge) {
        let Tested {
            index, at, sides, ..
        } = *tested;
        let vertex = (index, PLACES[at].edges[edge as usize]);
        let seen = |sight: &Sight, surface: &Surface| {
            sight.edge(surface.node(index), PLACES[at].square, edge)
        };
        let fails = sides.fails(edge as usize) && self.counts(|sight| seen(sight, surface));
        let asker = Asker::from(edge);
        if fails != surface.state(vertex).is_asked_by(asker) {
            let seen = seen(&self.sight, surface);
            self.ask(surface, (vertex, asker), fails, &seen);
        }
        if !surface.is_enabled(vertex) {
            self.stands(tested, edge as usize, fails, |sight| seen(sight, surface));
        }
    }

    fn test_quadrant(
        &mut self,
        surface: &mut Surface,
        tested: &mut Tested<'_>,
        quadrant: Quadrant,
    ) {
        let Tested {
            index, at, sides, ..
        } = *tested;
        let place = &PLACES[at];
        let mut corners = quadrant
            .edges()
            .map(|edge| place.edges[edge as usize])
            .into_iter();
        if !corners.any(|corner| surface.is_enabled((index, corner))) {
            return;
        }
        let test = 4 + quadrant as usize;
        let seen = |sight: &Sight, surface: &Surface| {
            sight.quadrant(surface.node(index), place.square, quadrant)
        };
        let centre = match at < FIRST_FINEST {
            true => Some((index, PLACES[4 * at + 1 + quadrant as usize].centre)),
            false => {
                let page = surface.child(index, place.slots()[quadrant as usize]);
                page.map(|page| (page, PLACES[ROOT].centre))
            }
        };
        let fails = sides.fails(test) && self.counts(|sight| seen(sight, surface));
        match centre {
            Some(centre) if fails != surface.state(centre).is_asked_by(Asker::First) => {
                let seen = seen(&self.sight, surface);
                self.ask(surface, (centre, Asker::First), fails, &seen);
            }
            None if fails => {
                let seen = seen(&self.sight, surface);
                self.face(surface, &seen);
                surface.want_below(index, place.square.child(quadrant), seen.excess());
            }
            _ => {}
        }
        if !centre.is_some_and(|centre| surface.is_enabled(centre)) {
            self.stands(tested, test, fails, |sight| seen(sight, surface));
        }
    }

    /// Whether a triangle that is beyond the tolerance is to be split: not if it cannot be seen,
    /// where such are left out. Boxes are nested, so none below it is, either.
    fn counts(&self, seen: impl FnOnce(&Sight) -> Seen) -> bool {
        !self.culls || self.sight.frustum.may_see(&seen(&self.sight).region)
    }

    fn ask(
        &mut self,
        surface: &mut Surface,
        (vertex, asker): (VertexRef, Asker),
        fails: bool,
        seen: &Seen,
    ) {
        if fails {
            self.face(surface, seen);
        }
        surface.ask(vertex, asker, fails, seen.excess());
    }

    /// What is wanted from here on is wanted for this triangle.
    fn face(&mut self, surface: &mut Surface, seen: &Seen) {
        surface.wishes.in_view = self.sight.frustum.may_see(&seen.region);
        surface.wishes.blocked = false;
    }

    /// A triangle stands as it is.
    fn stands(
        &mut self,
        tested: &mut Tested<'_>,
        test: usize,
        fails: bool,
        seen: impl FnOnce(&Sight) -> Seen,
    ) {
        tested.beyond |= fails;
        // First without a division.
        if tested.sides.reach_m[test] > self.found.excess * tested.sides.distance_m[test] {
            let seen = seen(&self.sight);
            if seen.excess() > self.found.excess && self.sight.frustum.may_see(&seen.region) {
                self.found.excess = seen.excess();
            }
        }
    }
}

#[cfg(test)]
pub(super) mod tests;
