//! How high the drawn ground is at one place.

use crate::mesh::PageMesh;
use escarp_proto::geometry::PAGE_SAMPLES;
use escarp_proto::georef::Georef;

/// Finds the mesh's height below, or above, a place, from the pages it is shown.
#[derive(Debug, Clone)]
pub struct GroundProbe {
    place_m: [f64; 2],
    grid: [f64; 2],
    quantum_m: f64,
    height_m: Option<f64>,
}

impl GroundProbe {
    /// A probe at a place in the world, metres.
    pub fn new(georef: &Georef, place_m: [f64; 2]) -> GroundProbe {
        GroundProbe {
            place_m,
            grid: georef.grid(place_m[0], place_m[1]),
            quantum_m: georef.quantum_m,
            height_m: None,
        }
    }

    /// Looks at a page.
    pub fn visit(&mut self, mesh: &PageMesh) {
        let inside = |axis: usize| {
            let at = self.place_m[axis];
            mesh.bounds.min[axis] <= at && at <= mesh.bounds.max[axis]
        };
        if self.height_m.is_some() || !inside(0) || !inside(1) {
            return;
        }
        let stride = f64::from(mesh.stride);
        let place = [0, 1].map(|axis| (self.grid[axis] - f64::from(mesh.origin[axis])) / stride);
        let triangles = mesh.indices.chunks_exact(3);
        let quanta = triangles
            .filter_map(|t| height_in(mesh, [t[0], t[1], t[2]], place))
            .next();
        self.height_m = quanta.map(|quanta| quanta * self.quantum_m);
    }

    /// Height of the ground, metres; `None` where no triangle was.
    pub fn height_m(&self) -> Option<f64> {
        self.height_m
    }
}

/// Height of a triangle at a place in page coordinates, quanta; `None` beside the triangle.
fn height_in(mesh: &PageMesh, triangle: [u16; 3], place: [f64; 2]) -> Option<f64> {
    let side = PAGE_SAMPLES as u16;
    let corners = triangle.map(|k| [f64::from(k % side), f64::from(k / side)]);
    let area = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| {
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    };
    let [a, b, c] = corners;
    let whole = area(a, b, c);
    let shares = [area(place, b, c), area(a, place, c), area(a, b, place)].map(|part| part / whole);
    if !shares.iter().all(|&share| share >= 0.0) {
        return None;
    }
    let height = |corner: usize| mesh.displayed(usize::from(triangle[corner]));
    Some((0..3).map(|corner| shares[corner] * height(corner)).sum())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Vertex;
    use escarp_proto::geometry::PageId;
    use escarp_proto::georef::{Plane, WorldBox};

    #[test]
    fn on_a_slope_the_height_is_the_slopes() {
        let georef = Georef {
            origin_m: [100.0, 200.0],
            sample_spacing_m: [2.0, 2.0],
            quantum_m: 0.5,
            plane: Plane::Local,
        };
        let vertex = |k: i32| Vertex {
            height: 10 * (k % 17) + 3 * (k / 17),
            normal: [0; 2],
        };
        let mesh = PageMesh {
            id: PageId::ROOT,
            origin: [0, 0],
            stride: 4,
            bounds: WorldBox {
                min: [100.0, 200.0, 0.0],
                max: [228.0, 328.0, 1e3],
            },
            vertices: (0..289).map(vertex).collect(),
            vertex_stamp: 1,
            offsets: None,
            offset_stamp: 0,
            indices: vec![0, 16, 288, 0, 288, 272],
            index_stamp: 1,
        };
        let at = |x: f64, y: f64| {
            let mut probe = GroundProbe::new(&georef, [x, y]);
            probe.visit(&mesh);
            probe.height_m()
        };
        // 8 metres are one step of the page, and so 5 or 1.5 metres of height.
        assert_eq!(at(108.0, 200.0), Some(5.0));
        assert_eq!(at(104.0, 212.0), Some(4.75));
        assert_eq!(at(228.0, 328.0), Some(104.0));
        assert_eq!(at(99.0, 200.0), None);
    }
}
