//! The mesh tree: pages that are resident, which of their vertices are enabled, and the triangles.

mod page_mesh;

pub use page_mesh::{PageMesh, Vertex};
