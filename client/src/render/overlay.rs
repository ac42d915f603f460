//! The pass that draws the user interface over the picture.

use super::gpu::Gpu;
use super::target::Output;

/// A user interface that has been laid out.
pub struct UiFrame {
    /// What to paint.
    pub primitives: Vec<egui::ClippedPrimitive>,
    /// Textures that came, changed or went; every frame's must be drawn, or letters are missing.
    pub textures: egui::TexturesDelta,
    /// Physical pixels a point.
    pub pixels_per_point: f32,
}

/// Draws user interfaces.
pub struct Overlay(egui_wgpu::Renderer);

impl Overlay {
    pub fn new(gpu: &Gpu, output: Output) -> Overlay {
        let options = egui_wgpu::RendererOptions::default();
        Overlay(egui_wgpu::Renderer::new(
            &gpu.device,
            output.format,
            options,
        ))
    }

    /// Takes over what changed in the textures; also for frames that are not drawn.
    pub fn update_textures(&mut self, gpu: &Gpu, delta: &mut egui::TexturesDelta) {
        for (id, images) in delta.set.drain() {
            for image in images {
                self.0.update_texture(&gpu.device, &gpu.queue, id, &image);
            }
        }
    }

    pub fn draw(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        view: &wgpu::TextureView,
        size_px: [u32; 2],
        ui: &UiFrame,
    ) {
        let screen = egui_wgpu::ScreenDescriptor {
            size_in_pixels: size_px,
            pixels_per_point: ui.pixels_per_point,
        };
        let (device, queue) = (&gpu.device, &gpu.queue);
        let extra = self
            .0
            .update_buffers(device, queue, encoder, &ui.primitives, &screen);
        queue.submit(extra);
        let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("overlay"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Load,
                    store: wgpu::StoreOp::Store,
                },
            })],
            ..Default::default()
        });
        self.0
            .render(&mut pass.forget_lifetime(), &ui.primitives, &screen);
    }

    /// Forgets textures that no later frame uses.
    pub fn free_textures(&mut self, delta: &mut egui::TexturesDelta) {
        for id in delta.free.drain() {
            self.0.free_texture(&id);
        }
    }
}
