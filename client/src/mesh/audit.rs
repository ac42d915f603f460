//! The state of the mesh tree laid open, for tests and reports.

use super::surface::{Index, Surface};
use super::vertices::VertexState;
use escarp_proto::geometry::{PAGE_SAMPLES, PageId};

/// State of a vertex in one page.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct VertexFlags {
    /// The page.
    pub page: PageId,
    /// Sample of the page, row-major from the south-west.
    pub sample: u16,
    /// Part of the mesh.
    pub enabled: bool,
    /// Which triangles of this page ask for it: bit 0 for the square to its west or south, or for
    /// its own square if it is a centre; bit 1 for the square to its east or north.
    pub asked: u8,
    /// Enabled vertices that depend on it on this page's side.
    pub dependents: u8,
}

/// A triangle of the mesh in grid coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SurfaceTriangle {
    /// Grid `x`, `y`, and height in quanta, counter-clockwise seen from above.
    pub corners: [(u32, u32, i32); 3],
    /// Whether it is drawn. Those in holes are not.
    pub drawn: bool,
}

impl Surface {
    /// All vertices with any state, sorted.
    pub(super) fn flags(&self) -> Vec<VertexFlags> {
        let mut flags = Vec::new();
        for node in self.nodes.iter().flatten() {
            for (sample, state) in node.vertices.iter().enumerate() {
                if *state != VertexState::default() {
                    flags.push(VertexFlags {
                        page: node.page.id(),
                        sample: sample as u16,
                        enabled: state.is_enabled(),
                        asked: state.asked(),
                        dependents: state.dependents(),
                    });
                }
            }
        }
        flags.sort_unstable();
        flags
    }

    /// Visits every triangle of the mesh, those in holes included: together they cover the grid.
    pub(super) fn visit_triangles(&self, mut visit: impl FnMut(SurfaceTriangle)) {
        self.visit_displayed(|triangle, _| visit(triangle));
    }

    /// The same with displayed heights, quanta.
    pub(super) fn visit_displayed(&self, mut visit: impl FnMut(SurfaceTriangle, [f64; 3])) {
        for index in 0..self.nodes.len() as Index {
            let Some(node) = &self.nodes[index as usize] else {
                continue;
            };
            let [x, y] = node.mesh.origin;
            self.leaves(index, &mut |leaf| {
                let corners = leaf.corners.map(|corner| {
                    let (column, row) = (
                        corner as usize % PAGE_SAMPLES,
                        corner as usize / PAGE_SAMPLES,
                    );
                    (
                        x + column as u32 * node.mesh.stride,
                        y + row as u32 * node.mesh.stride,
                        node.page.height(corner as usize),
                    )
                });
                let valid = leaf
                    .corners
                    .iter()
                    .all(|&corner| node.page.is_valid(corner as usize));
                let drawn = valid && leaf.kind != escarp_proto::page::Kind::Empty;
                let displayed = leaf.corners.map(|corner| {
                    let corner = corner as usize;
                    f64::from(node.page.height(corner)) + node.mesh.rise(corner)
                });
                visit(SurfaceTriangle { corners, drawn }, displayed);
            });
        }
    }
}
