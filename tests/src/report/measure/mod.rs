//! Deviation of a mesh from the full-resolution surface, measured fast and in full.
//!
//! Between samples the surface is the finest triangulation of the data. Mesh and surface are
//! linear between the crossings of their edges, so the largest deviation over a triangle is at a
//! sample in it or on its edges. Every sample in view is compared where the dataset fits in
//! memory; of larger ones [`sampled`] takes a share, and says which. `crate::measure` has the
//! naive way, against which this one is tested.

pub mod crossings;
pub mod histogram;
pub mod judge;
pub mod sampled;
pub mod scan;
pub mod surface;
pub mod tally;
pub mod whole;

#[cfg(test)]
mod tests;

use anyhow::Result;
use escarp_client::mesh::{MeshTree, SurfaceTriangle};
use escarp_proto::georef::Georef;
use escarp_proto::view::View;
use judge::Judge;
use scan::{Area, Corner, Corners};
use surface::FullSurface;
use tally::{Promise, Tally};

/// A triangle as it is displayed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Triangle {
    /// Its corners.
    pub corners: Corners,
    /// Whether it is drawn. Those in holes are not.
    pub drawn: bool,
    /// It has no sample but its corners, and they are at the samples: it is part of the surface.
    pub exact: bool,
}

impl Triangle {
    /// A triangle of a mesh whose corners are displayed at these heights, quanta.
    fn displayed(triangle: SurfaceTriangle, heights: [f64; 3]) -> Triangle {
        let places = triangle.corners;
        let corners = std::array::from_fn(|i| (places[i].0, places[i].1, heights[i]));
        let at_samples = places.map(|(_, _, height)| f64::from(height)) == heights;
        Triangle {
            corners,
            drawn: triangle.drawn,
            exact: at_samples && is_finest(&corners),
        }
    }
}

/// All triangles of a mesh.
pub fn triangles(tree: &MeshTree) -> Vec<Triangle> {
    let mut triangles = Vec::new();
    tree.visit_displayed(|triangle, heights| {
        triangles.push(Triangle::displayed(triangle, heights));
    });
    triangles
}

impl FullSurface<'_> {
    /// Measures a mesh from a view against what was promised of it.
    ///
    /// # Errors
    /// If the dataset is damaged.
    pub fn measure(&self, triangles: &[Triangle], view: &View, promise: Promise) -> Result<Tally> {
        let judge = Judge::new(&self.dataset.manifest().georef, view);
        let mut tally = match &self.whole {
            Some(samples) => whole::measure(samples, triangles, &judge, view, promise),
            None => sampled::measure(self.dataset, triangles, &judge, promise)?,
        };
        for triangle in triangles {
            let [a, b, c] = triangle.corners.map(|(x, y, _)| (x, y));
            let edges = [(a, b), (b, c), (c, a)];
            let crooked = edges
                .iter()
                .filter(|(from, to)| !crossings::follows_the_grid(*from, *to));
            tally.edges += 3;
            tally.crooked_edges += crooked.count() as u64;
        }
        Ok(tally)
    }
}

/// Half the longest side of a triangle, metres: as far as an outline may be off. Finest triangles
/// are the surface itself, and so of no size.
fn size_m(corners: &Corners, georef: &Georef) -> f64 {
    if is_finest(corners) {
        return 0.0;
    }
    let [a, b, c] = *corners;
    let side = |p: Corner, q: Corner| {
        let (dx, dy) = (
            f64::from(p.0) - f64::from(q.0),
            f64::from(p.1) - f64::from(q.1),
        );
        (dx * georef.sample_spacing_m[0]).hypot(dy * georef.sample_spacing_m[1])
    };
    side(a, b).max(side(b, c)).max(side(c, a)) / 2.0
}

/// Whether a triangle has no sample but its corners.
fn is_finest(corners: &Corners) -> bool {
    Area::of(corners).cells() <= 1
}
