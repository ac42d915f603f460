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
    /// `x` and `y` of the unit normal as signed normalised 16-bit numbers; `z` follows, as the
    /// ground faces up.
    pub normal: [i16; 2],
}

impl Vertex {
    /// A vertex on ground that rises this many metres a metre to the east and to the north.
    pub fn on_slope(height: i32, east: f64, north: f64) -> Vertex {
        let length = (east * east + north * north + 1.0).sqrt();
        let part = |slope: f64| (-slope / length * f64::from(i16::MAX)).round() as i16;
        Vertex {
            height,
            normal: [part(east), part(north)],
        }
    }
}

impl PageMesh {
    /// Height at which a vertex is displayed, quanta.
    pub fn displayed(&self, sample: usize) -> f64 {
        f64::from(self.vertices[sample].height) + self.rise(sample)
    }

    /// How far a vertex is displayed above its height, quanta.
    pub(super) fn rise(&self, sample: usize) -> f64 {
        let offset = self.offsets.as_ref().map(|offsets| offsets[sample].rise);
        f64::from(offset.unwrap_or(0.0))
    }
}

const _: () = assert!(size_of::<Vertex>() == 8);

/// How a vertex that is on its way is displayed; as the GPU reads it.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
pub struct Offset {
    /// Above its height, quanta.
    pub rise: f32,
    /// What half its normal lacks, as signed normalised 16-bit numbers.
    pub half_turn: [i16; 2],
}

const _: () = assert!(size_of::<Offset>() == 8);

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
    /// How each vertex differs from what is displayed; `None` if all are displayed as they are.
    pub offsets: Option<Vec<Offset>>,
    /// Changes whenever `offsets` does; never the same for two pages, but 0 if there were none.
    pub offset_stamp: u64,
    /// Three a triangle, counter-clockwise seen from above.
    pub indices: Vec<u16>,
    /// Changes whenever `indices` does; never the same for two pages.
    pub index_stamp: u64,
}
