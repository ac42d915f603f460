//! The pass that draws the triangles' edges over the ground.

use super::frame::{FrameBinding, PassKind, Reads, pipeline};
use super::gpu::Gpu;
use super::target::Output;

/// Whether this adapter needs lists of edges, since it cannot draw triangles as lines.
pub fn needs_line_lists(gpu: &Gpu) -> bool {
    !gpu.draws_line_polygons()
}

/// Its pipeline, fed with line lists or with the triangles themselves.
pub fn new(
    gpu: &Gpu,
    frame: &FrameBinding,
    output: Output,
    lists: bool,
    reads: Reads,
) -> wgpu::RenderPipeline {
    let (topology, polygon_mode) = if lists {
        (wgpu::PrimitiveTopology::LineList, wgpu::PolygonMode::Fill)
    } else {
        (
            wgpu::PrimitiveTopology::TriangleList,
            wgpu::PolygonMode::Line,
        )
    };
    let kind = PassKind {
        label: "wireframe",
        shader: include_str!("wireframe.wgsl"),
        reads,
        primitive: wgpu::PrimitiveState {
            topology,
            polygon_mode,
            ..Default::default()
        },
        writes_depth: false,
        depth_compare: wgpu::CompareFunction::GreaterEqual,
        blend: Some(wgpu::BlendState::ALPHA_BLENDING),
    };
    pipeline(gpu, frame, output, &kind)
}
