//! The terrain as a whole: pages in, pictures out.

use super::eye::EyeFrame;
use super::frame::{Body, FrameBinding, FrameUniform, PageInstance, Reads};
use super::gpu::Gpu;
use super::pages::{Indices, Pages, Resident, UploadStats};
use super::target::{Attachments, Output};
use super::{sky, terrain, wireframe};
use crate::mesh::PageMesh;
use escarp_proto::georef::Georef;
use escarp_proto::view::{View, ViewError};

/// From the north-west, 38 degrees up, where maps have it.
const MAP_SUN: [f32; 3] = [-0.557, 0.557, 0.616];

/// How a picture is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DrawParams {
    /// The eye. Its viewport gives the aspect; the picture is drawn in the target's own size.
    pub view: View,
    /// Whether the triangles' edges are drawn over the ground.
    pub wireframe: bool,
    /// Towards the sun; any length but zero.
    pub sun: [f32; 3],
    /// Factor on all heights, in [`EXAGGERATIONS`]; 1 is true.
    pub exaggeration: f32,
}

/// Allowed exaggerations: beyond, squares of distances are too large for single precision.
pub const EXAGGERATIONS: [f32; 2] = [0.0, 1000.0];

impl DrawParams {
    /// A view with the sun where maps have it, true heights, and no wireframe.
    pub fn new(view: View) -> DrawParams {
        DrawParams {
            view,
            wireframe: false,
            sun: MAP_SUN,
            exaggeration: 1.0,
        }
    }

    /// Parameters that are in order, and what had to be changed for it: the view as
    /// [`View::clamped`] does, an exaggeration that is no number is 1.
    pub fn clamped(&self) -> (DrawParams, Vec<ViewError>) {
        let (view, mut notes) = self.view.clamped();
        let [least, most] = EXAGGERATIONS;
        if !(least..=most).contains(&self.exaggeration) {
            notes.push(ViewError {
                field: "exaggeration",
                found: self.exaggeration.to_string(),
                allowed: format!("{least}..={most}"),
            });
        }
        let exaggeration = match self.exaggeration.is_nan() {
            true => 1.0,
            false => self.exaggeration.clamp(least, most),
        };
        let params = DrawParams {
            view,
            exaggeration,
            ..*self
        };
        (params, notes)
    }
}

/// What a picture consists of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DrawStats {
    /// Pages drawn: those with triangles that can be in the picture.
    pub pages_drawn: u32,
    /// Pages with triangles that cannot be in the picture.
    pub pages_culled: u32,
    /// Triangles of the pages drawn.
    pub triangles_drawn: u64,
}

/// The terrain on the GPU.
///
/// Call [`sync`](Self::sync) with all pages when the mesh has changed, then draw with
/// [`Headless::render`](super::Headless::render) or
/// [`WindowTarget::present`](super::WindowTarget::present), whose [`Output`] must be the scene's.
pub struct Scene {
    gpu: Gpu,
    georef: Georef,
    body: Body,
    output: Output,
    pages: Pages,
    frame: FrameBinding,
    passes: Passes,
    instances: wgpu::Buffer,
}

struct Passes {
    ground: Ground,
    /// The same for vertices on their way; made when the first are.
    morphed: Option<Ground>,
    lines_from_lists: bool,
    sky: wgpu::RenderPipeline,
}

/// The passes that read pages.
struct Ground {
    terrain: wgpu::RenderPipeline,
    wireframe: wgpu::RenderPipeline,
}

impl Ground {
    fn new(gpu: &Gpu, frame: &FrameBinding, output: Output, lists: bool, reads: Reads) -> Ground {
        Ground {
            terrain: terrain::new(gpu, frame, output, reads),
            wireframe: wireframe::new(gpu, frame, output, lists, reads),
        }
    }
}

impl Scene {
    /// An empty scene of a dataset. `height_range` is its lowest and highest height in quanta,
    /// which the tint runs between.
    pub fn new(
        gpu: &Gpu,
        georef: &Georef,
        height_range: Option<[i32; 2]>,
        output: Output,
    ) -> Scene {
        let lists = wireframe::needs_line_lists(gpu);
        Scene::with_line_lists(gpu, georef, height_range, output, lists)
    }

    pub(super) fn with_line_lists(
        gpu: &Gpu,
        georef: &Georef,
        height_range: Option<[i32; 2]>,
        output: Output,
        lists: bool,
    ) -> Scene {
        let frame = FrameBinding::new(gpu);
        Scene {
            gpu: gpu.clone(),
            georef: georef.clone(),
            body: Body::of(georef, height_range),
            output,
            pages: Pages::new(gpu, lists),
            passes: Passes {
                ground: Ground::new(gpu, &frame, output, lists, Reads::Pages),
                morphed: None,
                lines_from_lists: lists,
                sky: sky::new(gpu, &frame, output),
            },
            frame,
            instances: instance_buffer(gpu, 1024),
        }
    }

    /// The kind of picture that this scene is drawn into.
    pub fn output(&self) -> Output {
        self.output
    }

    /// Makes the pages on the GPU the same as these: uploads what changed, forgets the rest.
    pub fn sync<'a>(&mut self, pages: impl Iterator<Item = &'a PageMesh>) -> UploadStats {
        let mut sync = self.begin_sync();
        pages.for_each(|mesh| sync.keep(mesh));
        sync.end()
    }

    /// The same for pages that come one by one, from a visitor.
    pub fn begin_sync(&mut self) -> PageSync<'_> {
        self.pages.begin();
        PageSync(&mut self.pages)
    }

    /// Records the drawing of a picture into `view`.
    pub(super) fn draw(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        attachments: &Attachments,
        view: &wgpu::TextureView,
        params: &DrawParams,
    ) -> DrawStats {
        self.draw_over(encoder, attachments, view, params, None)
    }

    /// As `draw`; with a colour, that is the background instead of the sky.
    pub(super) fn draw_over(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        attachments: &Attachments,
        view: &wgpu::TextureView,
        params: &DrawParams,
        background: Option<wgpu::Color>,
    ) -> DrawStats {
        // Whatever is asked for, no buffer gets a NaN.
        let (params, _) = params.clamped();
        let eye = EyeFrame::of(&params.view, &self.georef, params.exaggeration);
        let frame = FrameUniform::new(&eye, &self.body, &params, self.output);
        self.frame.write(&self.gpu, &frame);
        self.prepare_morph();
        let ground = self.passes.morphed.as_ref();
        let ground = ground.unwrap_or(&self.passes.ground);
        let (visible, mut stats) = visible(&self.pages, &eye);
        write_instances(&self.gpu, &mut self.instances, &visible, &eye);
        let clear = background.unwrap_or(wgpu::Color::BLACK);
        let mut pass = attachments.begin(encoder, view, clear);
        self.frame.bind(&mut pass);
        pass.set_pipeline(&ground.terrain);
        stats.triangles_drawn = self.draw_pages(&mut pass, &visible, |page| page.triangles) / 3;
        if background.is_none() {
            pass.set_pipeline(&self.passes.sky);
            pass.draw(0..3, 0..1);
        }
        if params.wireframe {
            let lists = self.passes.lines_from_lists;
            pass.set_pipeline(&ground.wireframe);
            let indices = |page: &Resident| if lists { page.lines } else { page.triangles };
            self.draw_pages(&mut pass, &visible, indices);
        }
        stats
    }

    /// Makes the passes for vertices on their way, once there are any.
    fn prepare_morph(&mut self) {
        if self.pages.have_offsets() && self.passes.morphed.is_none() {
            let lists = self.passes.lines_from_lists;
            let reads = Reads::MorphedPages;
            let ground = Ground::new(&self.gpu, &self.frame, self.output, lists, reads);
            self.passes.morphed = Some(ground);
        }
    }

    /// One draw for each page; returns how many indices were drawn.
    fn draw_pages(
        &self,
        pass: &mut wgpu::RenderPass<'_>,
        visible: &[&Resident],
        indices: impl Fn(&Resident) -> Option<Indices>,
    ) -> u64 {
        let (mut vertex_block, mut index_block, mut drawn) = (None, None, 0);
        pass.set_vertex_buffer(1, self.instances.slice(..));
        for (instance, page) in (0..).zip(visible) {
            let Some(list) = indices(page) else { continue };
            if vertex_block.replace(page.vertex_block()) != Some(page.vertex_block()) {
                let block = page.vertex_block();
                pass.set_vertex_buffer(0, self.pages.vertex_buffer(block).slice(..));
                if let Some(offsets) = self.pages.offset_buffer(block) {
                    pass.set_vertex_buffer(2, offsets.slice(..));
                }
            }
            if index_block.replace(list.block()) != Some(list.block()) {
                let buffer = self.pages.index_buffer(list.block());
                pass.set_index_buffer(buffer.slice(..), wgpu::IndexFormat::Uint16);
            }
            pass.draw_indexed(list.range(), page.base_vertex(), instance..instance + 1);
            drawn += u64::from(list.count);
        }
        drawn
    }
}

/// A round of page meshes on their way to the GPU. All that it is not given is forgotten.
pub struct PageSync<'a>(&'a mut Pages);

impl PageSync<'_> {
    /// Keeps a page, and uploads what changed in it.
    ///
    /// # Panics
    /// If the mesh has not the vertices of a page.
    pub fn keep(&mut self, mesh: &PageMesh) {
        self.0.keep(mesh);
    }

    /// Ends the round.
    pub fn end(self) -> UploadStats {
        self.0.end()
    }
}

/// The pages to draw, ordered so that buffers are seldom switched.
fn visible<'a>(pages: &'a Pages, eye: &EyeFrame) -> (Vec<&'a Resident>, DrawStats) {
    let mut stats = DrawStats::default();
    let mut visible: Vec<&Resident> = pages
        .iter()
        .filter(|page| page.triangles.is_some())
        .filter(|page| {
            let seen = eye.sees(&page.bounds);
            stats.pages_culled += u32::from(!seen);
            seen
        })
        .collect();
    visible.sort_unstable_by_key(|page| {
        (
            page.vertex_block(),
            page.triangles.map(|list| list.block()),
            page.base_vertex(),
        )
    });
    stats.pages_drawn = visible.len() as u32;
    (visible, stats)
}

/// Fills the instance buffer, and takes a larger one if need be.
fn write_instances(gpu: &Gpu, buffer: &mut wgpu::Buffer, visible: &[&Resident], eye: &EyeFrame) {
    let instances: Vec<PageInstance> = visible
        .iter()
        .map(|page| PageInstance {
            origin: eye.relative(page.origin),
            stride: page.stride,
        })
        .collect();
    let bytes: &[u8] = bytemuck::cast_slice(&instances);
    if buffer.size() < bytes.len() as u64 {
        *buffer = instance_buffer(gpu, instances.len().next_power_of_two());
    }
    gpu.queue.write_buffer(buffer, 0, bytes);
}

fn instance_buffer(gpu: &Gpu, count: usize) -> wgpu::Buffer {
    gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("page instances"),
        size: (count * size_of::<PageInstance>()) as u64,
        usage: wgpu::BufferUsages::VERTEX | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}
