//! The page meshes that are on the GPU, kept equal to those of the mesh tree.

use super::gpu::Gpu;
use super::pool::{Pool, Run, Staging, Twin};
use crate::mesh::{Offset, PageMesh, Vertex};
use escarp_proto::geometry::{PAGE_SAMPLES, PageId};
use escarp_proto::georef::WorldBox;
use std::collections::HashMap;

/// Vertices of a page; the shader counts on it.
pub const PAGE_VERTICES: usize = PAGE_SAMPLES * PAGE_SAMPLES;
/// `2^11` pages of vertices a block, 4.7 MB.
const VERTEX_BLOCK_ORDER: u8 = 11;
/// Runs of indices are powers of two of 48, so that the `2 * 16 * 16` triangles of a full page,
/// 1536 indices, waste nothing.
const INDEX_UNIT: usize = 48;
/// `2^15` units of indices a block, 3.1 MB.
const INDEX_BLOCK_ORDER: u8 = 15;

/// What bringing the GPU up to date took.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct UploadStats {
    /// Bytes sent to the GPU.
    pub bytes: u64,
    /// Pages of which something was sent.
    pub pages_changed: u32,
    /// Pages forgotten.
    pub pages_removed: u32,
}

/// Part of the index pool.
#[derive(Debug, Clone, Copy)]
pub struct Indices {
    run: Run,
    /// How many there are.
    pub count: u32,
}

impl Indices {
    /// Block of the index pool.
    pub fn block(&self) -> u32 {
        self.run.block
    }

    /// Their place in the block, in indices.
    pub fn range(&self) -> std::ops::Range<u32> {
        let start = self.run.unit * INDEX_UNIT as u32;
        start..start + self.count
    }
}

/// A page on the GPU.
#[derive(Debug)]
pub struct Resident {
    vertex_run: Run,
    vertex_stamp: u64,
    index_stamp: u64,
    offset_stamp: u64,
    seen: u64,
    /// Its triangles; none if it has no indices.
    pub triangles: Option<Indices>,
    /// Their edges, where the adapter needs a list of its own to draw them.
    pub lines: Option<Indices>,
    /// As in [`PageMesh`].
    pub bounds: WorldBox,
    /// As in [`PageMesh`].
    pub origin: [u32; 2],
    /// As in [`PageMesh`].
    pub stride: u32,
}

impl Resident {
    /// Block of the vertex pool.
    pub fn vertex_block(&self) -> u32 {
        self.vertex_run.block
    }

    /// Its first vertex in the block: a multiple of [`PAGE_VERTICES`].
    pub fn base_vertex(&self) -> i32 {
        (self.vertex_run.unit as usize * PAGE_VERTICES) as i32
    }
}

/// All pages on the GPU.
pub struct Pages {
    gpu: Gpu,
    with_lines: bool,
    vertices: Pool,
    /// Offsets of vertices, once any page has had some.
    offsets: Option<Twin>,
    indices: Pool,
    resident: HashMap<PageId, Resident>,
    round: u64,
    staging: Staging,
    stats: UploadStats,
}

impl Pages {
    /// None yet. `with_lines`: keep a list of edges for each page as well.
    pub fn new(gpu: &Gpu, with_lines: bool) -> Pages {
        let slot = PAGE_VERTICES * size_of::<Vertex>();
        let unit = INDEX_UNIT * size_of::<u16>();
        let vertex = wgpu::BufferUsages::VERTEX;
        let index = wgpu::BufferUsages::INDEX;
        Pages {
            gpu: gpu.clone(),
            with_lines,
            vertices: Pool::new("page vertices", vertex, slot as u32, VERTEX_BLOCK_ORDER),
            offsets: None,
            indices: Pool::new("page indices", index, unit as u32, INDEX_BLOCK_ORDER),
            resident: HashMap::new(),
            round: 0,
            staging: Staging::default(),
            stats: UploadStats::default(),
        }
    }

    /// Begins a round: pages that it does not [`keep`](Self::keep) are forgotten at its end.
    pub fn begin(&mut self) {
        self.round += 1;
        self.stats = UploadStats::default();
    }

    /// Keeps a page, and uploads what changed in it.
    ///
    /// # Panics
    /// If the mesh has not the vertices of a page, or not as many offsets.
    pub fn keep(&mut self, mesh: &PageMesh) {
        assert_eq!(
            mesh.vertices.len(),
            PAGE_VERTICES,
            "vertices of page {}",
            mesh.id
        );
        if let Some(offsets) = &mesh.offsets {
            assert_eq!(offsets.len(), PAGE_VERTICES, "offsets of page {}", mesh.id);
        }
        let fresh = (mesh.vertex_stamp, mesh.index_stamp, mesh.offset_stamp);
        if let Some(page) = self.resident.get_mut(&mesh.id)
            && (page.vertex_stamp, page.index_stamp, page.offset_stamp) == fresh
        {
            page.seen = self.round;
            return;
        }
        let known = self.resident.remove(&mesh.id);
        let stamps = known
            .as_ref()
            .map(|page| (page.vertex_stamp, page.index_stamp, page.offset_stamp));
        let mut page = known.unwrap_or_else(|| self.enter(mesh));
        if stamps.is_none_or(|(vertices, ..)| vertices != mesh.vertex_stamp) {
            let bytes = bytemuck::cast_slice(&mesh.vertices);
            self.staging
                .put(&self.gpu, &self.vertices, page.vertex_run, bytes);
        }
        if stamps.is_none_or(|(_, _, offsets)| offsets != mesh.offset_stamp) {
            self.store_offsets(mesh, page.vertex_run);
        }
        if stamps.is_none_or(|(_, indices, _)| indices != mesh.index_stamp) {
            page.triangles = self.store(page.triangles, &mesh.indices);
            if self.with_lines {
                page.lines = self.store(page.lines, &edges(&mesh.indices));
            }
        }
        self.stats.pages_changed += 1;
        page.seen = self.round;
        (page.vertex_stamp, page.index_stamp, page.offset_stamp) = fresh;
        (page.bounds, page.origin, page.stride) = (mesh.bounds, mesh.origin, mesh.stride);
        self.resident.insert(mesh.id, page);
    }

    /// Ends the round: forgets what was not kept, and sends the uploads off.
    pub fn end(&mut self) -> UploadStats {
        let (round, vertices, indices) = (self.round, &mut self.vertices, &mut self.indices);
        let before = self.resident.len();
        self.resident.retain(|_, page| {
            let stays = page.seen == round;
            if !stays {
                vertices.give(page.vertex_run);
                let lists = [page.triangles, page.lines];
                lists
                    .iter()
                    .flatten()
                    .for_each(|list| indices.give(list.run));
            }
            stays
        });
        self.stats.pages_removed = (before - self.resident.len()) as u32;
        self.staging.send(&self.gpu);
        if let Some(offsets) = &mut self.offsets {
            offsets.follow(&self.gpu, vertices);
        }
        self.stats.bytes = std::mem::take(&mut self.staging.bytes);
        self.stats
    }

    /// The pages, in no order.
    pub fn iter(&self) -> impl Iterator<Item = &Resident> {
        self.resident.values()
    }

    /// A block's vertices.
    pub fn vertex_buffer(&self, block: u32) -> &wgpu::Buffer {
        self.vertices.buffer(block)
    }

    /// A block's offsets, if any page has had some.
    pub fn offset_buffer(&self, block: u32) -> Option<&wgpu::Buffer> {
        Some(self.offsets.as_ref()?.buffer(block))
    }

    /// Whether any page has had offsets.
    pub fn have_offsets(&self) -> bool {
        self.offsets.is_some()
    }

    /// A block's indices.
    pub fn index_buffer(&self, block: u32) -> &wgpu::Buffer {
        self.indices.buffer(block)
    }

    fn enter(&mut self, mesh: &PageMesh) -> Resident {
        let slot = PAGE_VERTICES * size_of::<Vertex>();
        Resident {
            vertex_run: self.vertices.take(&self.gpu, slot),
            vertex_stamp: 0,
            index_stamp: 0,
            offset_stamp: 0,
            seen: 0,
            triangles: None,
            lines: None,
            bounds: mesh.bounds,
            origin: mesh.origin,
            stride: mesh.stride,
        }
    }

    /// Stores a page's offsets. As long as no page has had any, there is no room for them.
    fn store_offsets(&mut self, mesh: &PageMesh, run: Run) {
        if self.offsets.is_none() && mesh.offsets.is_none() {
            return;
        }
        let unit = PAGE_VERTICES * size_of::<Offset>();
        let new = || Twin::new("page offsets", wgpu::BufferUsages::VERTEX, unit as u32);
        let twin = self.offsets.get_or_insert_with(new);
        twin.follow(&self.gpu, &self.vertices);
        let none = [Offset::default(); PAGE_VERTICES];
        let offsets = mesh.offsets.as_deref().unwrap_or(&none);
        let bytes = bytemuck::cast_slice(offsets);
        self.staging.put_beside(&self.gpu, twin, run, bytes);
    }

    /// Puts indices where the old ones were, or elsewhere if they do not suit.
    fn store(&mut self, old: Option<Indices>, indices: &[u16]) -> Option<Indices> {
        let bytes: &[u8] = bytemuck::cast_slice(indices);
        let kept = old.filter(|old| !bytes.is_empty() && self.indices.suits(old.run, bytes.len()));
        if let (Some(old), None) = (old, kept) {
            self.indices.give(old.run);
        }
        if bytes.is_empty() {
            return None;
        }
        let run = match kept {
            Some(kept) => kept.run,
            None => self.indices.take(&self.gpu, bytes.len()),
        };
        self.staging.put(&self.gpu, &self.indices, run, bytes);
        let count = indices.len() as u32;
        Some(Indices { run, count })
    }
}

/// The edges of a triangle list, each once.
fn edges(triangles: &[u16]) -> Vec<u16> {
    let mut edges: Vec<[u16; 2]> = triangles
        .chunks_exact(3)
        .flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]])
        .map(|[a, b]| [a.min(b), a.max(b)])
        .collect();
    edges.sort_unstable();
    edges.dedup();
    edges.into_flattened()
}

#[cfg(test)]
mod unit {
    use super::edges;

    #[test]
    fn two_triangles_that_share_an_edge_have_five() {
        assert_eq!(edges(&[0, 1, 2, 2, 1, 3]), [0, 1, 0, 2, 1, 2, 1, 3, 2, 3]);
    }
}
