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

/// One update's view, and a ratio of distance to size.
#[derive(Debug)]
pub(super) struct Sizes {
    pub(super) sight: Sight,
    ratio: f64,
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

    /// How many times nearer a square is than the ratio allows: it is too large if above 1. 0 if
    /// it has no surface or cannot be seen.
    ///
    /// Never more for a square than for the one above it times a half: sides halve, boxes are
    /// nested.
    pub(super) fn nearness(&mut self, node: &Node, square: PageSquare) -> f64 {
        self.squares += 1;
        let (kind, region) = self.sight.square(node, square);
        if kind == Kind::Empty || !self.sight.frustum.may_see(&region) {
            return 0.0;
        }
        let side_m = self.sides_m[usize::from(node.page.id().level() + square.level)];
        side_m * self.ratio / region.distance_m(self.sight.tests.eye_m)
    }
}
