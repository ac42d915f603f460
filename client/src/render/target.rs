//! The textures that a picture is drawn into.

use super::gpu::{Gpu, GpuError};

/// Depth is reversed: 1 near, 0 infinitely far.
pub const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// Kind of a picture: its format, and how many samples a pixel has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Output {
    pub(super) format: wgpu::TextureFormat,
    pub(super) samples: u32,
}

impl Output {
    /// Images to be read back. `samples` is rounded to 1 or 4, which every adapter can do.
    pub fn image(samples: u32) -> Output {
        Output::new(wgpu::TextureFormat::Rgba8UnormSrgb, samples)
    }

    pub(super) fn new(format: wgpu::TextureFormat, samples: u32) -> Output {
        let samples = if samples > 1 { 4 } else { 1 };
        Output { format, samples }
    }

    /// Samples a pixel, 1 or 4.
    pub fn samples(self) -> u32 {
        self.samples
    }

    /// Whether storing a value turns it from linear light into the screen's values.
    pub(super) fn applies_gamma(self) -> bool {
        self.format.is_srgb()
    }
}

/// Depth, and the samples of a pixel where there are several, of one picture.
pub struct Attachments {
    depth: wgpu::TextureView,
    samples: Option<wgpu::TextureView>,
}

impl Attachments {
    /// # Errors
    /// [`GpuError::Size`] if a side is 0 or longer than the adapter allows.
    pub fn new(gpu: &Gpu, output: Output, [width, height]: [u32; 2]) -> Result<Self, GpuError> {
        let most = gpu.max_side_px();
        if !(1..=most).contains(&width) || !(1..=most).contains(&height) {
            return Err(GpuError::Size(width, height, most));
        }
        let attachment = |format| {
            let usage = wgpu::TextureUsages::RENDER_ATTACHMENT;
            let texture = texture(gpu, format, [width, height], output.samples, usage);
            texture.create_view(&Default::default())
        };
        Ok(Attachments {
            depth: attachment(DEPTH_FORMAT),
            samples: (output.samples > 1).then(|| attachment(output.format)),
        })
    }

    /// A cleared pass that ends up in `view`.
    pub fn begin<'e>(
        &self,
        encoder: &'e mut wgpu::CommandEncoder,
        view: &wgpu::TextureView,
        clear: wgpu::Color,
    ) -> wgpu::RenderPass<'e> {
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("scene"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: self.samples.as_ref().unwrap_or(view),
                depth_slice: None,
                resolve_target: self.samples.as_ref().map(|_| view),
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(clear),
                    store: if self.samples.is_some() {
                        wgpu::StoreOp::Discard
                    } else {
                        wgpu::StoreOp::Store
                    },
                },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &self.depth,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Discard,
                }),
                stencil_ops: None,
            }),
            ..Default::default()
        })
    }
}

/// A texture of one layer and one mip level.
pub fn texture(
    gpu: &Gpu,
    format: wgpu::TextureFormat,
    [width, height]: [u32; 2],
    samples: u32,
    usage: wgpu::TextureUsages,
) -> wgpu::Texture {
    gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: wgpu::Extent3d {
            width,
            height,
            depth_or_array_layers: 1,
        },
        mip_level_count: 1,
        sample_count: samples,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage,
        view_formats: &[],
    })
}
