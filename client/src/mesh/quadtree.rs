//! The default mesher: Ulrich's Update(), from the last state onwards (Ulrich, "Continuous LOD
//! Terrain Meshing Using Adaptive Quadtrees", 2000), with bounds that hold.
//!
//! Pages in which no test can have changed since they were visited are passed over.

use super::mesher::{Found, MeshOptions, Mesher};
use super::place::PageSquare;
use super::sight::{Seen, Sight};
use super::surface::{Index, Surface};
use super::vertices::Asker;
use escarp_proto::geometry::{Edge, PageId, Quadrant, Slot};
use escarp_proto::view::View;

/// One update's view.
struct Pass {
    sight: Sight,
    excess: f64,
    squares: u64,
    /// What the page that is being visited has come to.
    page: Findings,
}

/// What the tests of one page's squares came to, and for how long that stays so.
///
/// All tests compare a fixed length with a distance from the eye, and a distance changes by no
/// more than the eye moves. So until the eye has moved by the smallest difference, every test of
/// the page comes out as it did; and where no test failed, the bound stays within the tolerance.
#[derive(Debug, Clone, Copy)]
struct Findings {
    /// Smallest difference of the two sides of a test, metres.
    slack_m: f64,
    /// Largest bound of a triangle that stands, seen or not, over the tolerance.
    excess: f64,
    /// Way of the eye until then, metres, and threshold then.
    travel_m: f64,
    threshold: f64,
}

impl Findings {
    /// Of a page that has not been visited, or has changed since.
    const NONE: Findings = Findings {
        slack_m: 0.0,
        excess: f64::INFINITY,
        travel_m: 0.0,
        threshold: 0.0,
    };

    fn still_hold(&self, travel_m: f64, threshold: f64) -> bool {
        // The way is a sum of rounded steps: hold back more than their rounding.
        let moved_m = (travel_m - self.travel_m) * (1.0 + 1e-9);
        self.excess <= 1.0 && self.threshold == threshold && moved_m < self.slack_m
    }
}

/// The state of the mesher.
#[derive(Debug, Default)]
pub(super) struct Quadtree {
    /// By page.
    findings: Vec<Findings>,
    /// Eye of the last update, and the length of its way so far, metres.
    eye_m: Option<[f64; 3]>,
    travel_m: f64,
}

impl Mesher for Quadtree {
    fn update(&mut self, surface: &mut Surface, view: &View) -> Found {
        self.travel(view.eye_m);
        let mut pass = Pass {
            sight: Sight::of(surface, view),
            excess: 0.0,
            squares: 0,
            page: Findings::NONE,
        };
        self.run(surface, &mut pass);
        Found {
            excess: pass.excess,
            squares: pass.squares,
        }
    }

    fn linked(&mut self, _: &Surface, page: Index) {
        let page = page as usize;
        if self.findings.len() <= page {
            self.findings.resize(page + 1, Findings::NONE);
        }
        self.findings[page] = Findings::NONE;
    }

    fn unlinked(&mut self, page: Index) {
        self.findings[page as usize] = Findings::NONE;
    }
}

impl Quadtree {
    pub(super) fn new(_: &MeshOptions) -> Quadtree {
        Quadtree::default()
    }

    /// Adds to the eye's way, in the measure of
    /// [`WorldBox::distance_m`](escarp_proto::georef::WorldBox::distance_m).
    fn travel(&mut self, eye_m: [f64; 3]) {
        if let Some(last) = self.eye_m {
            let step = (0..3).map(|axis| (eye_m[axis] - last[axis]).abs());
            self.travel_m += step.fold(0.0, f64::max);
        }
        self.eye_m = Some(eye_m);
    }

    fn run(&mut self, surface: &mut Surface, pass: &mut Pass) {
        // Squares that are enabled for others' sake need no visit in this update: errors and boxes
        // are nested, so no test of theirs can fail where the test above them has passed.
        let mut pages: Vec<Index> = surface
            .by_id
            .get(&PageId::ROOT)
            .copied()
            .into_iter()
            .collect();
        while let Some(index) = pages.pop() {
            self.visit_page(surface, pass, index);
            let enabled = |&(_, child): &(Slot, Index)| {
                let centre = (child, PageSquare::ROOT.centre() as u16);
                surface.is_enabled(centre).then_some(child)
            };
            pages.extend(surface.node(index).children.iter().filter_map(enabled));
        }
    }

    /// Visits the squares of a page, or passes it over.
    fn visit_page(&mut self, surface: &mut Surface, pass: &mut Pass, index: Index) {
        let threshold = pass.sight.tests.threshold;
        let now = surface.updates;
        let node = surface.node_mut(index);
        node.last_use = now;
        let findings = &mut self.findings[index as usize];
        if findings.still_hold(self.travel_m, threshold) {
            // No triangle of it is beyond the tolerance; how far below does not matter.
            let any = findings.excess > 0.0;
            if any && pass.excess < 1.0 && pass.sight.frustum.may_see(&node.mesh.bounds) {
                pass.excess = 1.0;
            }
            return;
        }
        pass.page = Findings {
            slack_m: f64::INFINITY,
            excess: 0.0,
            travel_m: self.travel_m,
            threshold,
        };
        pass.visit(surface, index, PageSquare::ROOT);
        *findings = pass.page;
    }
}

impl Pass {
    /// Tests the triangles of a square whose centre is enabled, and of all below it in its page.
    fn visit(&mut self, surface: &mut Surface, index: Index, square: PageSquare) {
        self.squares += 1;
        for edge in Edge::ALL {
            let seen = self.sight.edge(surface.node(index), square, edge);
            let vertex = (index, square.edge(edge) as u16);
            self.test(surface, &seen);
            surface.ask(vertex, edge.into(), seen.fails(), seen.excess());
            if !surface.is_enabled(vertex) {
                self.stands(&seen);
            }
        }
        for quadrant in Quadrant::ALL {
            self.visit_quadrant(surface, index, square, quadrant);
        }
    }

    /// Notes how far the eye may move until a test comes out differently.
    fn test(&mut self, surface: &mut Surface, seen: &Seen) {
        if seen.reach_m <= 0.0 {
            return;
        }
        let slack_m = (seen.reach_m - seen.distance_m).abs();
        self.page.slack_m = self.page.slack_m.min(slack_m);
        if seen.fails() {
            surface.wishes.in_view = self.sight.frustum.may_see(&seen.region);
            surface.wishes.blocked = false;
        }
    }

    fn visit_quadrant(
        &mut self,
        surface: &mut Surface,
        index: Index,
        square: PageSquare,
        quadrant: Quadrant,
    ) {
        let corners = quadrant
            .edges()
            .map(|edge| (index, square.edge(edge) as u16));
        if !corners.into_iter().any(|corner| surface.is_enabled(corner)) {
            return;
        }
        let seen = self.sight.quadrant(surface.node(index), square, quadrant);
        self.test(surface, &seen);
        let child = square.child(quadrant);
        match surface.square_below(index, child) {
            Some((page, square)) => {
                let centre = (page, square.centre() as u16);
                surface.ask(centre, Asker::First, seen.fails(), seen.excess());
                if surface.is_enabled(centre) {
                    // A page below is visited by itself.
                    if page == index {
                        self.visit(surface, page, square);
                    }
                    return;
                }
            }
            None if seen.fails() => surface.want_below(index, child, seen.excess()),
            None => {}
        }
        self.stands(&seen);
    }

    /// A triangle stands as it is.
    fn stands(&mut self, seen: &Seen) {
        let excess = seen.excess();
        self.page.excess = self.page.excess.max(excess);
        if excess > self.excess && self.sight.frustum.may_see(&seen.region) {
            self.excess = excess;
        }
    }
}
