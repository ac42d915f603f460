//! Squares as a view sees them, by size and distance alone: what the meshers test that do not go
//! by error.

use super::mesher::{MeshOptions, SPLIT_RATIOS};
use super::place::PageSquare;
use super::sight::Sight;
use super::surface::{Node, Surface};
use escarp_proto::page::Kind;
use escarp_proto::view::View;

/// A square is split while its side is seen larger than this many times the tolerance.
///
/// With it about nine tenths of the samples of Everest and of Puget Sound are within the tolerance,
/// from low and high (`docs/mesh.md`); no number makes all of them be.
const SIDE_TOLERANCES: f64 = 8.0;

/// The ratio of distance to size within which squares are split: as the options have it, or so
/// that a side is seen as `SIDE_TOLERANCES` times the tolerance; always within [`SPLIT_RATIOS`].
pub(super) fn split_ratio(options: &MeshOptions, view: &View) -> f64 {
    let [least, most] = SPLIT_RATIOS;
    let following = view.threshold() / SIDE_TOLERANCES;
    let ratio = options.split_ratio.filter(|ratio| !ratio.is_nan());
    ratio.unwrap_or(following).clamp(least, most)
}

/// How near a square is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Near {
    /// It is too large within this distance, metres; 0 if it has no surface or cannot be seen.
    reach_m: f64,
    distance_m: f64,
}

impl Near {
    /// Of a square that is not to be split from anywhere.
    pub(super) const NOT: Near = Near {
        reach_m: 0.0,
        distance_m: 1.0,
    };

    pub(super) fn is_too_large(&self) -> bool {
        self.reach_m > self.distance_m
    }

    /// How many times too large it is; allowed is 1.
    pub(super) fn times(&self) -> f64 {
        match self.reach_m > 0.0 {
            true => self.reach_m / self.distance_m,
            false => 0.0,
        }
    }

    /// How far the eye may move until it is too large, or no longer, metres.
    pub(super) fn slack_m(&self) -> f64 {
        match self.reach_m > 0.0 {
            true => (self.reach_m - self.distance_m).abs(),
            false => f64::INFINITY,
        }
    }
}

/// One update's view, and a ratio of distance to size.
#[derive(Debug)]
pub(super) struct Sizes {
    pub(super) sight: Sight,
    pub(super) ratio: f64,
    /// Side of a square, metres, by level.
    sides_m: Vec<f64>,
    /// Squares that were tested.
    pub(super) squares: u64,
}

impl Sizes {
    pub(super) fn of(surface: &Surface, view: &View, ratio: f64) -> Sizes {
        let [dx, dy] = surface.georef.sample_spacing_m;
        let side_m = |level| dx.max(dy) * f64::from(surface.grid.square_cells(level));
        Sizes {
            sight: Sight::of(surface, view),
            ratio,
            sides_m: (0..=surface.grid.get()).map(side_m).collect(),
            squares: 0,
        }
    }

    /// How near a square is. Sides halve and boxes are nested, so it is at most half as many times
    /// too large as the square above it.
    pub(super) fn near(&mut self, node: &Node, square: PageSquare) -> Near {
        self.squares += 1;
        let (kind, region) = self.sight.square(node, square);
        if kind == Kind::Empty || !self.sight.frustum.may_see(&region) {
            return Near::NOT;
        }
        let side_m = self.sides_m[usize::from(node.page.id().level() + square.level)];
        Near {
            reach_m: side_m * self.ratio,
            distance_m: region.distance_m(self.sight.tests.eye_m),
        }
    }
}
