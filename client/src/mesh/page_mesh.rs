//! What leaves the mesh tree for the GPU: one vertex array and one indexed triangle list a page.

use bytemuck::{Pod, Zeroable};
use escarp_proto::geometry::PageId;
use escarp_proto::georef::WorldBox;

/// A vertex as the GPU reads it. Its place in the array, row-major in the page's 17 x 17 samples,
/// says where in the grid it is, so that a vertex shared by pages is the same integers in each.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct Vertex {
    /// Height, in quanta.
    pub height: i32,
    /// Unit normal `x, y, z` as signed normalised bytes; the fourth is 0.
    pub normal: [i8; 4],
}

const _: () = assert!(size_of::<Vertex>() == 8);

/// The triangles of one page.
#[derive(Debug, Clone, PartialEq)]
pub struct PageMesh {
    /// The page.
    pub id: PageId,
    /// Grid coordinates of its south-west sample.
    pub origin: [u32; 2],
    /// Grid cells between neighbouring samples.
    pub stride: u32,
    /// Holds all its triangles, metres.
    pub bounds: WorldBox,
    /// 17 x 17 vertices, row-major from the south-west. Those that no index names are undefined.
    pub vertices: Vec<Vertex>,
    /// Changes whenever `vertices` does; never the same for two pages.
    pub vertex_stamp: u64,
    /// Three a triangle, counter-clockwise seen from above.
    pub indices: Vec<u16>,
    /// Changes whenever `indices` does; never the same for two pages.
    pub index_stamp: u64,
}
