//! The pass that fills what the ground left open.

use super::frame::{FrameBinding, PassKind, Reads, pipeline};
use super::gpu::Gpu;
use super::target::Output;

/// Its pipeline: one triangle over the whole picture, infinitely far away.
pub fn new(gpu: &Gpu, frame: &FrameBinding, output: Output) -> wgpu::RenderPipeline {
    let kind = PassKind {
        label: "sky",
        shader: include_str!("sky.wgsl"),
        reads: Reads::Nothing,
        primitive: wgpu::PrimitiveState::default(),
        writes_depth: false,
        // Depth 0 equals what the depth was cleared to, and nothing else.
        depth_compare: wgpu::CompareFunction::GreaterEqual,
        blend: None,
    };
    pipeline(gpu, frame, output, &kind)
}
