//! Geomorphing: vertices come and go without a jump, and the promise still holds.
//!
//! The mesher tests by a tolerance that is `1 + r` times narrower than the one promised, so
//! vertices are enabled a little early. `phi` of a vertex is the largest `error * threshold /
//! distance` of its own tests, by the promise's threshold. Its *weight* `m` is 0 where it has only
//! just been enabled, at `phi = 1 / (1 + r)`, and 1 where the promise needs it, from `phi = 1` on;
//! and at least that of every vertex that depends on it ([`spread`]).
//!
//! What is displayed is the average, over `t` from 0 to 1, of the meshes `C(t)` of all vertices
//! with `m >= t`.
//!
//! - *It is within the tolerance, everywhere.* Weights are nested, so `C(t)` has all that its
//!   vertices depend on: it is a mesh without cracks. A triangle that stands in it has a vertex
//!   that would split it and has not `m >= t`, so `phi < 1`: it is within the tolerance at every
//!   point of it. An average of surfaces that are within the tolerance at a point is within it, too.
//! - *It takes the same triangles*, as every `C(t)` is linear on each triangle of the enabled mesh.
//!   So it is enough to move the vertices.
//! - *It is quick.* A vertex `v` adds to a mesh its surplus `s(v) = h(v) - (h(a) + h(b)) / 2`, over
//!   the two triangles that it splits; `a` and `b` are the ends of the edge or diagonal that it is
//!   the middle of. It does so in a share `m(v)` of all `C(t)`, so the displayed height is
//!   `z(v) = (z(a) + z(b)) / 2 + m(v) s(v)`: one pass from coarse to fine ([`offsets`]).
//!   `a` and `b` are corners of the squares beside `v`; all corners of a square are among what its
//!   centre depends on, or the corners of the grid: three are the centre and two edge vertices of
//!   the square above, on which it depends, the fourth is a corner of the square above.
//! - *It does not jump.* Weights are continuous in the eye's place, and a vertex is enabled and
//!   disabled where its weight is 0, so that it lies on the edge that it splits. New data may jump:
//!   a vertex that had to wait for a page has its weight at once, and new bounds change weights.
//! - *It has no crack.* Both sides of a border have the same weights ([`spread`] takes the larger)
//!   and the same integer heights, and do the same arithmetic.
//!
//! A weight is a byte, and is let be until the eye may have moved it by [`LAG`]. Where an end of
//! what a vertex splits is a hole, there is nothing to come from, and it has weight 1.

mod offsets;
mod order;
mod ramp;
mod spread;

use super::page_mesh::Offset;
use super::place::PageSquare;
use super::sight::Sight;
use super::surface::{Index, Surface};
use super::way::Way;
use escarp_proto::geometry::PAGE_LEVELS;
use escarp_proto::page::PAGE_AREA;
use escarp_proto::view::View;
use ramp::Ramp;

/// Least and largest share of the tolerance to morph over.
pub const MORPH_SHARES: [f64; 2] = [0.01, 4.0];

/// The share that is morphed over if nothing else is said.
pub const DEFAULT_MORPH: f64 = 0.1;

/// A weight may lag behind the eye by this share of the way from 0 to 1.
const LAG: f64 = 1.0 / 32.0;

/// Weights by sample: 0 for a vertex that is not enabled, else 1 to 255 for a weight of 0 to 1. The
/// last place belongs to [`order::NOWHERE`].
type Weights = [u8; PAGE_AREA + 1];

const NONE: Weights = [0; PAGE_AREA + 1];

/// The weight that a byte stands for.
fn weight(byte: u8) -> f64 {
    f64::from(byte.saturating_sub(1)) / 254.0
}

/// What is known of a page with enabled vertices.
#[derive(Debug, Clone)]
struct Known {
    /// Of each vertex by its own tests in this page, for those that it was measured for.
    own: Weights,
    /// The same with what depends on it on this page's side.
    side: Weights,
    /// The weights: on a border the larger of both sides'.
    all: Weights,
    /// Lowest and highest of the page's bounds without offsets, metres.
    span_m: [f64; 2],
}

/// A page.
#[derive(Debug, Default)]
struct Place {
    known: Option<Box<Known>>,
    /// Way that the eye may go before a weight of its own changes by more than the lag, metres.
    slack_m: f64,
    /// Way of the eye and threshold when it was measured.
    travel_m: f64,
    threshold: f64,
    /// It is in the list that is being worked off.
    listed: bool,
    /// Stamps of its vertices, its offsets, and the offsets above, when normals were turned.
    turned: [u64; 3],
}

/// The morph of a surface.
#[derive(Debug)]
pub(super) struct Morph {
    share: f64,
    places: Vec<Place>,
    /// Places with a known page.
    known: usize,
    /// Pages whose weights or offsets are to be done, by level of pages.
    lists: Vec<Vec<Index>>,
    way: Way,
    threshold: f64,
    /// Pages whose vertices are displayed beside their heights may be in view.
    seen: bool,
}

impl Morph {
    /// A morph over this share of the tolerance; `None` if that is off.
    pub(super) fn of(share: f64) -> Option<Morph> {
        let [least, most] = MORPH_SHARES;
        (share >= least).then(|| Morph {
            share: share.min(most),
            places: Vec::new(),
            known: 0,
            lists: Vec::new(),
            way: Way::default(),
            threshold: 0.0,
            seen: false,
        })
    }

    /// The view that a mesher is to test by, so that what it enables can come gradually.
    pub(super) fn tested(&self, view: &View) -> View {
        let error_px = f64::from(view.max_screen_error_px) / (1.0 + self.share);
        View {
            max_screen_error_px: error_px as f32,
            ..*view
        }
    }

    /// A bound of the displayed mesh, over the tolerance, from that of the mesh whose vertices are
    /// enabled, over the one it was tested by.
    pub(super) fn excess(&self, view: &View, tested: f64) -> f64 {
        let narrower = self.tested(view).threshold() / view.threshold();
        let standing = tested / narrower;
        match self.seen {
            true => standing.max(1.0),
            false => standing,
        }
    }

    /// Memory that it takes, bytes.
    pub(super) fn memory_bytes(&self) -> usize {
        self.known * (size_of::<Known>() + PAGE_AREA * size_of::<Offset>())
            + self.places.len() * size_of::<Place>()
    }

    /// A page is new, or has more parts than before.
    pub(super) fn linked(&mut self, page: Index) {
        let page = page as usize;
        if self.places.len() <= page {
            self.places.resize_with(page + 1, Place::default);
        }
        self.places[page].slack_m = 0.0;
    }

    /// A page has gone; none of its vertices was enabled.
    pub(super) fn unlinked(&mut self, page: Index) {
        let gone = std::mem::take(&mut self.places[page as usize]);
        self.known -= usize::from(gone.known.is_some());
    }

    /// The weight of a page's vertex, for tests and reports; `None` if it is not enabled.
    pub(super) fn weight(&self, page: Index, sample: usize) -> Option<f64> {
        let known = self.places.get(page as usize)?.known.as_ref()?;
        (known.all[sample] > 0).then(|| weight(known.all[sample]))
    }

    /// Brings weights and displayed heights up to date with the enabled vertices and a view.
    pub(super) fn update(&mut self, surface: &mut Surface, view: &View) {
        let sight = Sight::of(surface, &self.tested(view));
        let narrower = sight.tests.threshold / view.threshold();
        let ramp = Ramp::new(narrower, self.share);
        self.way.go(view.eye_m);
        self.threshold = sight.tests.threshold;
        let finest = surface.grid.finest_page_level() / PAGE_LEVELS;
        self.lists.resize_with(usize::from(finest) + 1, Vec::new);
        self.measure(surface, &sight, &ramp);
        self.spread(surface);
        self.displace(surface);
        self.seen =
            surface.nodes.iter().flatten().any(|node| {
                node.mesh.offsets.is_some() && sight.frustum.may_see(&node.mesh.bounds)
            });
    }

    /// Measures the pages whose vertices have changed, or of which the eye may have moved a weight.
    fn measure(&mut self, surface: &mut Surface, sight: &Sight, ramp: &Ramp) {
        for index in 0..surface.nodes.len() as Index {
            let Some(node) = &mut surface.nodes[index as usize] else {
                continue;
            };
            let flagged = std::mem::take(&mut node.flagged);
            let any = node.enabled > 0;
            let place = &self.places[index as usize];
            if !(flagged || any && !self.still_holds(place)) {
                continue;
            }
            let (own, slack_m) = match any {
                true => ramp::measure(surface, sight, ramp, index),
                false => (NONE, f64::INFINITY),
            };
            self.take(surface, index, own, slack_m);
        }
    }

    fn still_holds(&self, place: &Place) -> bool {
        let moved_m = self.way.since_m(place.travel_m);
        place.threshold == self.threshold && moved_m < place.slack_m
    }

    /// Takes what was measured, and lists the page if that differs from before.
    fn take(&mut self, surface: &Surface, index: Index, own: Weights, slack_m: f64) {
        let place = &mut self.places[index as usize];
        (place.slack_m, place.travel_m) = (slack_m, self.way.length_m());
        place.threshold = self.threshold;
        match &mut place.known {
            Some(known) if known.own == own => return,
            Some(known) => known.own = own,
            known @ None => {
                self.known += 1;
                let bounds = &surface.node(index).mesh.bounds;
                *known = Some(Box::new(Known {
                    own,
                    side: NONE,
                    all: NONE,
                    span_m: [bounds.min[2], bounds.max[2]],
                }));
            }
        }
        self.list(surface, index);
    }

    /// Puts a page into the list of its level, once.
    fn list(&mut self, surface: &Surface, index: Index) {
        let place = &mut self.places[index as usize];
        if !std::mem::replace(&mut place.listed, true) {
            let level = page_level(surface, index);
            self.lists[level].push(index);
        }
    }
}

/// Level of a page among pages: 0 is the root's.
fn page_level(surface: &Surface, index: Index) -> usize {
    usize::from(surface.node(index).page.id().level() / PAGE_LEVELS)
}

const ROOT_CENTRE: usize = PageSquare::ROOT.centre();
