//! The pass that draws the ground.

use super::frame::{FrameBinding, PassKind, Reads, pipeline};
use super::gpu::Gpu;
use super::target::Output;

/// Its pipeline. Both faces are drawn: an eye below the ground must not look through it.
pub fn new(gpu: &Gpu, frame: &FrameBinding, output: Output, reads: Reads) -> wgpu::RenderPipeline {
    let kind = PassKind {
        label: "terrain",
        shader: include_str!("terrain.wgsl"),
        reads,
        primitive: wgpu::PrimitiveState::default(),
        writes_depth: true,
        depth_compare: wgpu::CompareFunction::Greater,
        blend: None,
    };
    pipeline(gpu, frame, output, &kind)
}
