//! Squares split by distance over size alone, as in quadtree terrains for Direct3D: whatever the
//! surface is like, near squares are small and far ones large.
//!
//! A square that is split has its centre and its four edge vertices enabled: four squares of two
//! triangles each. What else is needed so that no crack opens is enabled by the surface. It
//! promises no error; what its mesh comes to is found afterwards, and stated.
//!
//! Pages in which no test can have changed since they were visited are passed over.

use super::mesher::{Found, MeshOptions, Mesher};
use super::place::PageSquare;
use super::size::{Near, Sizes, split_ratio};
use super::standing::largest_excess;
use super::surface::{Index, Surface};
use super::vertices::Asker;
use super::way::Way;
use escarp_proto::geometry::{Edge, PAGE_LEVELS, PageId, Quadrant, Slot};
use escarp_proto::view::View;

/// What a page's tests came to, and for how long that stays so.
///
/// A test compares a fixed length with a distance from the eye, which changes by no more than the
/// eye moves; and whether a square may be seen, which all of a page's squares may while all of the
/// page is in view.
#[derive(Debug, Clone, Copy)]
struct Findings {
    /// Smallest difference of the two sides of a test, metres; negative where not all that was
    /// asked for was possible, or not all of the page is in view.
    slack_m: f64,
    /// Way of the eye until then, metres, and the ratio then.
    travel_m: f64,
    ratio: f64,
}

impl Findings {
    /// Of a page that has not been visited, or has changed since.
    const NONE: Findings = Findings {
        slack_m: -1.0,
        travel_m: 0.0,
        ratio: 0.0,
    };
}

/// The mesher.
#[derive(Debug)]
pub(super) struct Distance {
    options: MeshOptions,
    /// By page.
    findings: Vec<Findings>,
    way: Way,
}

impl Mesher for Distance {
    fn update(&mut self, surface: &mut Surface, view: &View) -> Found {
        self.way.go(view.eye_m);
        let ratio = split_ratio(&self.options, view);
        let mut sizes = Sizes::of(surface, view, ratio);
        let mut pages = Vec::new();
        if let Some(&root) = surface.by_id.get(&PageId::ROOT) {
            pages.push((root, sizes.near(surface.node(root), PageSquare::ROOT)));
        }
        while let Some((page, near)) = pages.pop() {
            self.visit_page(surface, &mut sizes, page, near);
            for i in 0..surface.node(page).children.len() {
                let (slot, child) = surface.node(page).children[i];
                let near = near_below(surface, &mut sizes, page, PageSquare::cell(slot));
                let is_meshed = surface.is_enabled((child, PageSquare::ROOT.centre() as u16));
                if near.is_too_large() || is_meshed {
                    pages.push((child, near));
                }
            }
        }
        Found {
            excess: largest_excess(surface, &sizes.sight),
            squares: sizes.squares,
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

impl Distance {
    pub(super) fn new(options: &MeshOptions) -> Distance {
        Distance {
            options: *options,
            findings: Vec::new(),
            way: Way::default(),
        }
    }

    /// Visits the squares of a page, or passes it over.
    fn visit_page(&mut self, surface: &mut Surface, sizes: &mut Sizes, page: Index, near: Near) {
        surface.node_mut(page).last_use = surface.updates;
        let findings = &mut self.findings[page as usize];
        let moved_m = self.way.since_m(findings.travel_m);
        let all_in_view = sizes
            .sight
            .frustum
            .sees_all(&surface.node(page).mesh.bounds);
        if all_in_view && findings.ratio == sizes.ratio && moved_m < findings.slack_m {
            return;
        }
        let mut pass = Pass {
            sizes,
            page,
            slack_m: near.slack_m(),
            is_done: all_in_view,
        };
        pass.visit(surface, PageSquare::ROOT, near);
        *findings = Findings {
            slack_m: if pass.is_done { pass.slack_m } else { -1.0 },
            travel_m: self.way.length_m(),
            ratio: sizes.ratio,
        };
    }
}

/// One visit of a page.
struct Pass<'a> {
    sizes: &'a mut Sizes,
    page: Index,
    slack_m: f64,
    is_done: bool,
}

impl Pass<'_> {
    /// Splits a square, or no longer, and all below it in its page. Below a square that is not too
    /// large none is, as sizes and boxes are nested.
    fn visit(&mut self, surface: &mut Surface, square: PageSquare, near: Near) {
        let split = near.is_too_large();
        let centre = (self.page, square.centre() as u16);
        surface.wishes.in_view = true;
        surface.wishes.blocked = false;
        surface.ask(centre, Asker::First, split, near.times());
        if !surface.is_enabled(centre) {
            self.is_done &= !split;
            return;
        }
        for edge in Edge::ALL {
            let vertex = (self.page, square.edge(edge) as u16);
            surface.ask(vertex, edge.into(), split, near.times());
            self.is_done &= !split || surface.is_enabled(vertex);
        }
        for quadrant in Quadrant::ALL {
            let child = square.child(quadrant);
            if child.level < PAGE_LEVELS {
                let near = match split {
                    true => self.sizes.near(surface.node(self.page), child),
                    false => Near::NOT,
                };
                self.slack_m = self.slack_m.min(near.slack_m());
                let centre = (self.page, child.centre() as u16);
                if near.is_too_large() || surface.is_enabled(centre) {
                    self.visit(surface, child, near);
                }
            } else if split {
                self.want_below(surface, child);
            }
        }
    }

    /// Wants the page below a cell, if it is missing. One that is resident is visited by itself,
    /// but may be gone when it is needed next.
    fn want_below(&mut self, surface: &mut Surface, cell: PageSquare) {
        let near = near_below(surface, self.sizes, self.page, cell);
        self.slack_m = self.slack_m.min(near.slack_m());
        let is_missing = surface.square_below(self.page, cell).is_none();
        if is_missing && near.is_too_large() {
            self.is_done = false;
            surface.want_below(self.page, cell, near.times());
        }
    }
}

/// The page below a cell, as a square. Pages without a record are what the page above says of
/// them: no triangle of theirs would show more than its.
fn near_below(surface: &Surface, sizes: &mut Sizes, page: Index, cell: PageSquare) -> Near {
    let node = surface.node(page);
    let slot = Slot::at(cell.column as usize, cell.row as usize);
    match !node.page.is_finest() && node.page.slot(slot).has_record() {
        true => sizes.near(node, cell),
        false => Near::NOT,
    }
}
