//! The mesh tree: the pages that are resident, which of their vertices are enabled, and the
//! triangles that follow (Ulrich, "Continuous LOD Terrain Meshing Using Adaptive Quadtrees",
//! 2000).
//!
//! Invariants:
//!
//! 1. A square's centre is enabled only if the two edge vertices at its corners are; an edge
//!    vertex only if the centres on both of its sides are. So there are no cracks, at any moment.
//! 2. A vertex is enabled if its own test asks for it, or one that depends on it is enabled, and
//!    all that it depends on is resident; else not. Errors are nested (`escarp_proto::page`), so
//!    the enabled set follows from the view and the resident pages alone, not from history.
//! 3. A vertex on the border of two pages has the same enabled flag in both. Its own test and
//!    the count of its dependents are kept for each side apart.
//! 4. Pages are linked and unlinked between updates only.

mod audit;
mod contradiction;
mod distance;
mod due;
mod fans;
mod levels;
mod local;
mod mesher;
mod morph;
mod page_mesh;
mod quadtree;
mod roam;
mod sight;
mod size;
mod standing;
mod surface;
mod tree;
mod triangulate;
mod vertices;
mod wants;
mod way;

use escarp_proto::sight::{place, squares};

pub use audit::{SurfaceTriangle, VertexFlags};
pub use contradiction::Contradiction;
pub use escarp_proto::sight::frustum::Frustum;
pub(crate) use escarp_proto::sight::frustum::basis;
pub use mesher::{BLOCK_LEVELS, MeshOptions, MeshOptionsError, MesherKind, Metric, SPLIT_RATIOS};
pub use morph::{DEFAULT_MORPH, MORPH_SHARES};
pub use page_mesh::{Offset, PageMesh, Vertex};
pub use surface::LinkError;
pub use tree::{MeshTree, UpdateStats};
pub use wants::Wish;
