//! What was found of the deviations of meshes.

use super::histogram::Histogram;
use super::judge::Seen;

/// What a mesh is held against, pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Promise {
    /// The tolerance that was asked for.
    pub asked_px: f64,
    /// The bound that was stated: the tolerance, unless the mesh cannot keep it, or not yet.
    pub stated_px: f64,
}

impl Promise {
    /// That of a mesh whose bound is so many times the tolerance.
    pub fn of(asked_px: f64, excess: f64) -> Promise {
        Promise {
            asked_px,
            stated_px: asked_px * excess.max(1.0),
        }
    }
}

/// Deviations of the samples in view, of one picture or many.
#[derive(Debug, Clone, Default)]
pub struct Tally {
    /// Samples in view. Where not all were measured, an estimate.
    pub samples: f64,
    /// Samples that were compared.
    pub compared: u64,
    /// Deviations, pixels.
    pub px: Histogram,
    /// Deviations over the bound that was stated.
    pub ratio: Histogram,
    /// Sum of the squares of the deviations, square pixels.
    square_px: f64,
    /// Largest deviation, pixels.
    pub max_px: f64,
    /// Largest deviation over the bound that was stated.
    pub max_ratio: f64,
    /// Largest deviation over the tolerance that was asked for.
    pub max_over_asked: f64,
    /// Samples, or an estimate of them, beyond the bound that was stated.
    above_stated: f64,
    /// And beyond the tolerance that was asked for.
    above_asked: f64,
    /// As `square_px` and `max_px`, but apart in the picture.
    square_projected_px: f64,
    /// Largest distance of mesh and surface in the picture, pixels.
    pub max_projected_px: f64,
    /// Samples of the surface that no triangle is drawn over, though nothing may leave them out.
    /// Known only where all samples are measured.
    pub left_out: u64,
    /// Samples without data that a triangle larger than the tolerance covers.
    pub covered: u64,
    /// Edges of the mesh, and those that cross the surface's edges elsewhere than at samples.
    pub edges: u64,
    /// See `edges`.
    pub crooked_edges: u64,
    /// Finest pages that were read, and that would have been to measure every sample.
    pub tiles: [u64; 2],
}

/// A rounding error more than a bound is not beyond it.
const SLACK: f64 = 1.0 + 1e-9;

impl Tally {
    /// Adds a sample in view.
    pub fn add(&mut self, seen: Seen, promise: Promise, weight: f64) {
        self.samples += weight;
        self.compared += 1;
        self.square_px += seen.px * seen.px * weight;
        self.px.add(seen.px, weight);
        self.worst(seen.px, promise, weight);
        if let Some(px) = seen.projected_px {
            self.square_projected_px += px * px * weight;
            self.max_projected_px = self.max_projected_px.max(px);
        }
    }

    /// Adds samples in view that the mesh meets exactly.
    pub fn add_exact(&mut self, compared: u64, weight: f64) {
        self.samples += weight;
        self.compared += compared;
        self.px.add_zeros(weight);
        self.ratio.add_zeros(weight);
    }

    /// Adds a point between samples: it counts for the largest deviation alone.
    pub fn add_between(&mut self, px: f64, promise: Promise) {
        self.worst(px, promise, 0.0);
    }

    fn worst(&mut self, px: f64, promise: Promise, weight: f64) {
        let (stated, asked) = (px / promise.stated_px, px / promise.asked_px);
        self.ratio.add(stated, weight);
        self.max_px = self.max_px.max(px);
        self.max_ratio = self.max_ratio.max(stated);
        self.max_over_asked = self.max_over_asked.max(asked);
        if stated > SLACK {
            self.above_stated += weight;
        }
        if asked > SLACK {
            self.above_asked += weight;
        }
    }

    /// Joins two.
    pub fn merge(mut self, other: &Tally) -> Tally {
        self.samples += other.samples;
        self.compared += other.compared;
        self.px.merge(&other.px);
        self.ratio.merge(&other.ratio);
        self.square_px += other.square_px;
        self.max_px = self.max_px.max(other.max_px);
        self.max_ratio = self.max_ratio.max(other.max_ratio);
        self.max_over_asked = self.max_over_asked.max(other.max_over_asked);
        self.above_stated += other.above_stated;
        self.above_asked += other.above_asked;
        self.square_projected_px += other.square_projected_px;
        self.max_projected_px = self.max_projected_px.max(other.max_projected_px);
        self.left_out += other.left_out;
        self.covered += other.covered;
        self.edges += other.edges;
        self.crooked_edges += other.crooked_edges;
        self.tiles = [
            self.tiles[0] + other.tiles[0],
            self.tiles[1] + other.tiles[1],
        ];
        self
    }

    /// Root of the mean square of the deviations, pixels.
    pub fn rms_px(&self) -> f64 {
        (self.square_px / self.samples.max(f64::MIN_POSITIVE)).sqrt()
    }

    /// Root of the mean square of the distances in the picture, pixels.
    pub fn rms_projected_px(&self) -> f64 {
        (self.square_projected_px / self.samples.max(f64::MIN_POSITIVE)).sqrt()
    }

    /// Deviation that this share of the samples does not exceed, pixels, rounded up.
    pub fn quantile_px(&self, share: f64) -> f64 {
        self.px.quantile(share).min(self.max_px)
    }

    /// Share of the samples beyond the bound that was stated.
    pub fn share_above_stated(&self) -> f64 {
        self.above_stated / self.samples.max(f64::MIN_POSITIVE)
    }

    /// Share of the samples beyond the tolerance that was asked for.
    pub fn share_above_asked(&self) -> f64 {
        self.above_asked / self.samples.max(f64::MIN_POSITIVE)
    }
}
