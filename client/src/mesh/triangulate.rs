//! From enabled vertices to indexed triangles, page by page, and only for pages that changed.

use super::fans;
use super::page_mesh::Vertex;
use super::place::PageSquare;
use super::squares::{At, FIRST_FINEST, PLACES};
use super::surface::{Index, Node, Stale, Surface};
use escarp_proto::geometry::{Edge, PAGE_CELLS, PAGE_SAMPLES};
use escarp_proto::page::{Kind, PAGE_AREA, level_step};

/// A triangle of the mesh, and whether there is surface to draw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Leaf {
    /// Samples of the page, counter-clockwise seen from above.
    pub(super) corners: [u16; 3],
    pub(super) kind: Kind,
}

impl Surface {
    /// Triangulates what changed since the last time. Triangles of the whole mesh.
    pub(super) fn triangulate(&mut self) -> u64 {
        for index in self.take_stale() {
            if self.node(index).stale_triangles {
                self.triangulate_page(index);
            }
            let node = self.node(index);
            // Without triangles nothing is placed; when there are some, it is listed anew.
            if node.stale_vertices != Stale::NONE && !node.mesh.indices.is_empty() {
                self.place_vertices(index);
            }
        }
        self.triangles
    }

    fn triangulate_page(&mut self, index: Index) {
        let node = self.node_mut(index);
        let mut indices = std::mem::take(&mut node.mesh.indices);
        let (triangles, capacity) = (indices.len() as u64 / 3, indices.capacity());
        indices.clear();
        match &self.node(index).outlines {
            None => self.fans(index, &mut indices),
            Some(_) => self.drawn(index, &mut indices),
        }
        self.triangles = self.triangles - triangles + indices.len() as u64 / 3;
        self.more_bytes -= capacity * size_of::<u16>();
        self.more_bytes += indices.capacity() * size_of::<u16>();
        self.stamps += 1;
        let stamp = self.stamps;
        let node = self.node_mut(index);
        node.mesh.indices = indices;
        node.mesh.index_stamp = stamp;
        node.stale_triangles = false;
    }

    /// The triangles of a page without holes, by table.
    fn fans(&self, index: Index, indices: &mut Vec<u16>) {
        let node = self.node(index);
        let enabled = |sample: u16| node.vertices[sample as usize].is_enabled();
        let mut left = node.centres;
        while left != 0 {
            let at = left.trailing_zeros() as At;
            left &= left - 1;
            let place = &PLACES[at];
            let bit = |i: usize, is_set: bool| u8::from(is_set) << i;
            let mut mask = 0;
            for (i, &sample) in place.edges.iter().enumerate() {
                mask |= bit(i, enabled(sample));
            }
            if at < FIRST_FINEST {
                mask |= ((node.centres >> (4 * at + 1)) as u8 & 15) << 4;
            } else if !node.children.is_empty() {
                for (i, slot) in place.slots().into_iter().enumerate() {
                    mask |= bit(4 + i, node.children_enabled.has(slot));
                }
            }
            fans::emit(indices, at, mask);
        }
    }

    /// The triangles of a page with holes, those in holes left out.
    fn drawn(&self, index: Index, indices: &mut Vec<u16>) {
        let page = &self.node(index).page;
        self.leaves(index, &mut |leaf| {
            let mut corners = leaf.corners.iter();
            if leaf.kind != Kind::Empty && corners.all(|&corner| page.is_valid(corner.into())) {
                indices.extend(leaf.corners);
            }
        });
    }

    /// All triangles of a page's own squares, drawn or not.
    pub(super) fn leaves(&self, index: Index, emit: &mut impl FnMut(Leaf)) {
        if self.is_enabled((index, PageSquare::ROOT.centre() as u16)) {
            self.leaves_of(index, PageSquare::ROOT, emit);
        }
    }

    fn leaves_of(&self, index: Index, square: PageSquare, emit: &mut impl FnMut(Leaf)) {
        let centre = square.centre() as u16;
        let outlines = self.node(index).outlines.as_deref();
        let at = |square: PageSquare| (square.level, square.column as usize, square.row as usize);
        let kind = |edge: Edge| {
            let (level, column, row) = at(square);
            let kinds = outlines.map(|bounds| bounds.square(level, column, row).kinds);
            kinds.map_or(Kind::Full, |kinds| kinds[edge as usize])
        };
        let half_kind = |child: PageSquare, edge: Edge| {
            let (level, column, row) = at(child);
            outlines.map_or(Kind::Full, |bounds| {
                bounds.half_kind(level, column, row, edge)
            })
        };
        for edge in Edge::ALL {
            let middle = square.edge(edge) as u16;
            let [from, to] = square.ends(edge).map(|end| end as u16);
            if !self.is_enabled((index, middle)) {
                emit(Leaf {
                    corners: [centre, from, to],
                    kind: kind(edge),
                });
                continue;
            }
            let [first, last] = PageSquare::end_quadrants(edge);
            for (quadrant, corners) in [
                (first, [centre, from, middle]),
                (last, [centre, middle, to]),
            ] {
                let child = square.child(quadrant);
                let below = self.square_below(index, child);
                let splits = below
                    .is_some_and(|(page, square)| self.is_enabled((page, square.centre() as u16)));
                if !splits {
                    emit(Leaf {
                        corners,
                        kind: half_kind(child, edge),
                    });
                }
            }
        }
        if square.level < 3 {
            for quadrant in escarp_proto::geometry::Quadrant::ALL {
                let child = square.child(quadrant);
                if self.is_enabled((index, child.centre() as u16)) {
                    self.leaves_of(index, child, emit);
                }
            }
        }
    }

    /// Heights and normals of the samples that have arrived, as far as they are stale.
    fn place_vertices(&mut self, index: Index) {
        let mut vertices = std::mem::take(&mut self.node_mut(index).mesh.vertices);
        let node = self.node(index);
        let stale = node.stale_vertices;
        let all = vertices.is_empty() || stale.is_all();
        vertices.resize(PAGE_AREA, Vertex::on_slope(0, 0.0, 0.0));
        let step = level_step(node.page.depth());
        let edge_of = |i: usize, low: Edge, high: Edge| match i {
            0 => stale.has_edge(low),
            PAGE_CELLS => stale.has_edge(high),
            _ => false,
        };
        for y in (0..PAGE_SAMPLES).step_by(step) {
            let row = all || edge_of(y, Edge::South, Edge::North);
            for x in (0..PAGE_SAMPLES).step_by(step) {
                if row || edge_of(x, Edge::West, Edge::East) {
                    vertices[y * PAGE_SAMPLES + x] = self.vertex(node, x, y, step);
                }
            }
        }
        self.stamps += 1;
        let stamp = self.stamps;
        let node = self.node_mut(index);
        node.mesh.vertices = vertices;
        node.mesh.vertex_stamp = stamp;
        node.stale_vertices = Stale::NONE;
    }

    /// A vertex with the slopes to its neighbouring samples, those of neighbouring pages included.
    ///
    /// Slopes are taken over the largest step of the pages that share the vertex, so that they
    /// agree on its normal and their shading meets; where one of them is not resident, the page
    /// above has the surface there, and so has the say.
    fn vertex(&self, node: &Node, x: usize, y: usize, step: usize) -> Vertex {
        match (self.shared_step(node, x, y, step), node.parent) {
            (None, Some((parent, slot)))
                if x.is_multiple_of(PAGE_CELLS) && y.is_multiple_of(PAGE_CELLS) =>
            {
                let (column, row) = slot.position();
                let parent = self.node(parent);
                let (x, y) = (column + x / PAGE_CELLS, row + y / PAGE_CELLS);
                self.vertex(parent, x, y, level_step(parent.page.depth()))
            }
            (shared, _) => self.vertex_over(node, x, y, shared.unwrap_or(step)),
        }
    }

    /// The largest step of the pages around a vertex; `None` if one of them is not resident.
    fn shared_step(&self, node: &Node, x: usize, y: usize, step: usize) -> Option<usize> {
        let edge = |i: usize, low: Edge, high: Edge| match i {
            0 => Some(low),
            PAGE_CELLS => Some(high),
            _ => None,
        };
        let (along, across) = (
            edge(x, Edge::West, Edge::East),
            edge(y, Edge::South, Edge::North),
        );
        let mut largest = step;
        for path in [[along, None], [across, None], [along, across]] {
            let mut there = node;
            for edge in path.into_iter().flatten() {
                // Beyond the border of the grid there is nothing to agree with.
                if there.page.id().neighbour(edge).is_none() {
                    there = node;
                    break;
                }
                there = self.node(there.neighbours[edge as usize]?);
            }
            largest = largest.max(level_step(there.page.depth()));
        }
        Some(largest)
    }

    fn vertex_over(&self, node: &Node, x: usize, y: usize, step: usize) -> Vertex {
        let own = node.page.height(y * PAGE_SAMPLES + x);
        let slope = |back: Edge, ahead: Edge, spacing_m: f64| {
            let height = |edge| self.sample_towards(node, (x, y), edge, step);
            let (low, high) = (height(back), height(ahead));
            let cells = u32::from(low.is_some()) + u32::from(high.is_some());
            let rise = f64::from(high.unwrap_or(own)) - f64::from(low.unwrap_or(own));
            rise * self.georef.quantum_m / (f64::from(cells.max(1)) * spacing_m)
        };
        let cells = f64::from(node.mesh.stride) * step as f64;
        let [dx, dy] = self
            .georef
            .sample_spacing_m
            .map(|spacing_m| spacing_m * cells);
        Vertex::on_slope(
            own,
            slope(Edge::West, Edge::East, dx),
            slope(Edge::South, Edge::North, dy),
        )
    }

    /// Height of the sample a step towards an edge; `None` if it is a hole or not resident.
    fn sample_towards(
        &self,
        node: &Node,
        (x, y): (usize, usize),
        edge: Edge,
        step: usize,
    ) -> Option<i32> {
        let (dx, dy) = edge.step();
        let beyond = |w: usize, d: i32| w as i32 + d * step as i32;
        let (x, y) = (beyond(x, dx), beyond(y, dy));
        let side = PAGE_CELLS as i32;
        let inside = (0..=side).contains(&x) && (0..=side).contains(&y);
        let (page, x, y) = match inside {
            true => (&node.page, x, y),
            false => {
                let neighbour = self.node(node.neighbours[edge as usize]?);
                (&neighbour.page, x - dx * side, y - dy * side)
            }
        };
        let sample = y as usize * PAGE_SAMPLES + x as usize;
        let known = level_step(page.depth()) <= step && page.is_valid(sample);
        known.then(|| page.height(sample))
    }
}
