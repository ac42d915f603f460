//! Weights of a page's vertices by their own tests.

use super::super::place::PageSquare;
use super::super::sight::{Seen, Sight};
use super::super::surface::{Index, Node, Surface};
use super::order::diagonal;
use super::{LAG, NONE, ROOT_CENTRE, Weights};
use escarp_proto::geometry::{Edge, PAGE_LEVELS, Quadrant};

const FULL: u8 = u8::MAX;

/// Displayed heights are rounded to 24 bits a level of vertices, of which there are fewer than 64.
/// So much less than the tolerance is what the exact ones keep to.
const ROUNDING: f64 = 1.0 / (1 << 16) as f64;

/// From the two sides of a test to a weight.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ramp {
    /// `error * threshold / distance`, by the narrower threshold, up to which the weight is 0, and
    /// from which it is 1.
    bottom: f64,
    top: f64,
    /// Share of a distance that the eye may move before weights are measured again.
    lag: f64,
}

impl Ramp {
    /// A ramp for tests whose threshold is `narrower` times that of the promise. It is shorter at
    /// both ends by what a lag can come to: so the promise is kept with weights that lag, and a
    /// vertex that goes has weight 0.
    pub(super) fn new(narrower: f64, share: f64) -> Ramp {
        let lag = LAG * share / (1.0 + share);
        Ramp {
            bottom: 1.0 + 2.0 * lag,
            top: narrower * (1.0 - lag) * (1.0 - ROUNDING),
            lag,
        }
    }

    /// The weight's byte.
    fn byte(&self, seen: &Seen) -> u8 {
        let phi = seen.excess();
        let weight = (phi - self.bottom) / (self.top - self.bottom);
        // Casts round down, and saturate.
        (1.0 + weight.clamp(0.0, 1.0) * 254.0) as u8
    }

    /// How far the eye may move until the weight is off by more than the lag, metres.
    fn slack_m(&self, seen: &Seen) -> f64 {
        if seen.reach_m <= 0.0 {
            return f64::INFINITY;
        }
        let stays_full = seen.reach_m / self.top - seen.distance_m;
        let stays_none = seen.distance_m - seen.reach_m / self.bottom;
        let lags = self.lag * seen.distance_m;
        stays_full.max(stays_none).max(lags)
    }
}

/// Weights of a page's vertices by this page's tests, and how far the eye may move until one is off
/// by more than the lag, metres.
pub(super) fn measure(
    surface: &Surface,
    sight: &Sight,
    ramp: &Ramp,
    index: Index,
) -> (Weights, f64) {
    let mut page = Measuring {
        surface,
        sight,
        ramp,
        index,
        node: surface.node(index),
        own: NONE,
        slack_m: f64::INFINITY,
    };
    if page.is_enabled(ROOT_CENTRE) {
        page.root();
        page.visit(PageSquare::ROOT);
    }
    (page.own, page.slack_m)
}

struct Measuring<'a> {
    surface: &'a Surface,
    sight: &'a Sight,
    ramp: &'a Ramp,
    index: Index,
    node: &'a Node,
    own: Weights,
    slack_m: f64,
}

impl Measuring<'_> {
    fn is_enabled(&self, sample: usize) -> bool {
        self.surface.is_enabled((self.index, sample as u16))
    }

    fn take(&mut self, vertex: usize, ends: [usize; 2], seen: &Seen) {
        let page = &self.node.page;
        if page.has_holes() && ends.iter().any(|&end| !page.is_valid(end)) {
            self.own[vertex] = FULL;
            return;
        }
        self.own[vertex] = self.own[vertex].max(self.ramp.byte(seen));
        self.slack_m = self.slack_m.min(self.ramp.slack_m(seen));
    }

    /// The page's own centre, which the page above has the test of. The grid's is always there.
    fn root(&mut self) {
        let Some((parent, slot)) = self.node.parent else {
            self.own[ROOT_CENTRE] = FULL;
            return;
        };
        let (column, row) = slot.position();
        let cell = PageSquare {
            level: PAGE_LEVELS,
            column: column as u8,
            row: row as u8,
        };
        if let Some((square, quadrant)) = cell.parent() {
            let above = self.surface.node(parent);
            let seen = self.sight.quadrant(above, square, quadrant);
            let ends = diagonal(PageSquare::ROOT, quadrant).map(usize::from);
            self.take(ROOT_CENTRE, ends, &seen);
        }
    }

    /// The vertices of a square whose centre is enabled, and of those below it in the page.
    fn visit(&mut self, square: PageSquare) {
        for edge in Edge::ALL {
            let vertex = square.edge(edge);
            if self.is_enabled(vertex) {
                let seen = self.sight.edge(self.node, square, edge);
                self.take(vertex, square.ends(edge), &seen);
            }
        }
        if square.level + 1 == PAGE_LEVELS {
            return;
        }
        for quadrant in Quadrant::ALL {
            let child = square.child(quadrant);
            if self.is_enabled(child.centre()) {
                let seen = self.sight.quadrant(self.node, square, quadrant);
                let ends = diagonal(child, quadrant).map(usize::from);
                self.take(child.centre(), ends, &seen);
                self.visit(child);
            }
        }
    }
}
