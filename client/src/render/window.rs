//! Pictures in a window.

use super::gpu::{Gpu, GpuError};
use super::overlay::{Overlay, UiFrame};
use super::scene::{DrawParams, DrawStats, Scene};
use super::target::{Attachments, Output};
use std::sync::Arc;
use winit::event_loop::OwnedDisplayHandle;
use winit::window::Window;

/// Dark blue, while there is no terrain to draw.
const EMPTY: wgpu::Color = wgpu::Color {
    r: 0.012,
    g: 0.018,
    b: 0.030,
    a: 1.0,
};

/// What became of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Presented {
    /// It is on its way to the screen.
    Shown(DrawStats),
    /// The window could not take it just now; draw again soon.
    Retry,
    /// The window is hidden or has no area; draw again when it comes back.
    Hidden,
}

/// A window's surface, with what is needed to draw on it.
pub struct WindowTarget {
    gpu: Gpu,
    instance: wgpu::Instance,
    window: Arc<Window>,
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    output: Output,
    /// None while the window has no area.
    attachments: Option<Attachments>,
    overlay: Overlay,
}

impl WindowTarget {
    /// Opens a device that can draw on the window. `samples` a pixel: 1 or 4.
    ///
    /// # Errors
    /// As [`Gpu::headless`], and [`GpuError::Surface`] if the window cannot be drawn on.
    pub fn new(
        window: Arc<Window>,
        display: OwnedDisplayHandle,
        samples: u32,
    ) -> Result<WindowTarget, GpuError> {
        let (gpu, instance, surface) = Gpu::for_window(&window, display)?;
        let size = window.inner_size();
        let mut config = surface
            .get_default_config(&gpu.adapter, size.width.max(1), size.height.max(1))
            .ok_or_else(|| GpuError::Surface("the adapter does not support it".into()))?;
        config.format = gamma_format(&surface.get_capabilities(&gpu.adapter), config.format);
        config.present_mode = wgpu::PresentMode::AutoVsync;
        let output = Output::new(config.format, samples);
        let mut target = WindowTarget {
            overlay: Overlay::new(&gpu, output),
            gpu,
            instance,
            window,
            surface,
            config,
            output,
            attachments: None,
        };
        target.resize([size.width, size.height]);
        Ok(target)
    }

    /// The device.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// The kind of picture; a scene that is drawn here must be of the same.
    pub fn output(&self) -> Output {
        self.output
    }

    /// Width and height, pixels; `None` while the window has no area.
    pub fn size_px(&self) -> Option<[u32; 2]> {
        let size = [self.config.width, self.config.height];
        self.attachments.is_some().then_some(size)
    }

    /// Follows the window's size. Of a minimised window nothing is kept.
    pub fn resize(&mut self, [width, height]: [u32; 2]) {
        if width == 0 || height == 0 {
            self.attachments = None;
            return;
        }
        let most = self.gpu.max_side_px();
        (self.config.width, self.config.height) = (width.min(most), height.min(most));
        self.surface.configure(&self.gpu.device, &self.config);
        let size = [self.config.width, self.config.height];
        self.attachments = Attachments::new(&self.gpu, self.output, size).ok();
    }

    /// Draws the scene, if there is one yet, and the user interface, and shows them.
    ///
    /// # Errors
    /// [`GpuError::Surface`] if the surface was lost and cannot be made again.
    pub fn present(
        &mut self,
        scene: Option<(&mut Scene, &DrawParams)>,
        mut ui: UiFrame,
    ) -> Result<Presented, GpuError> {
        self.overlay.update_textures(&self.gpu, &mut ui.textures);
        let presented = self.draw(scene, &ui);
        self.overlay.free_textures(&mut ui.textures);
        presented
    }

    fn draw(
        &mut self,
        scene: Option<(&mut Scene, &DrawParams)>,
        ui: &UiFrame,
    ) -> Result<Presented, GpuError> {
        let Some(attachments) = &self.attachments else {
            return Ok(Presented::Hidden);
        };
        let (texture, stale) = match self.surface.get_current_texture() {
            wgpu::CurrentSurfaceTexture::Success(texture) => (texture, false),
            wgpu::CurrentSurfaceTexture::Suboptimal(texture) => (texture, true),
            wgpu::CurrentSurfaceTexture::Occluded => return Ok(Presented::Hidden),
            wgpu::CurrentSurfaceTexture::Lost => return self.recreate(),
            wgpu::CurrentSurfaceTexture::Outdated => return Ok(self.reconfigure()),
            wgpu::CurrentSurfaceTexture::Timeout | wgpu::CurrentSurfaceTexture::Validation => {
                return Ok(Presented::Retry);
            }
        };
        let view = texture.texture.create_view(&Default::default());
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        let stats = match scene {
            Some((scene, params)) => scene.draw(&mut encoder, attachments, &view, params),
            None => {
                drop(attachments.begin(&mut encoder, &view, EMPTY));
                DrawStats::default()
            }
        };
        let size = [self.config.width, self.config.height];
        self.overlay.draw(&self.gpu, &mut encoder, &view, size, ui);
        self.gpu.queue.submit([encoder.finish()]);
        self.window.pre_present_notify();
        self.gpu.queue.present(texture);
        if stale {
            self.reconfigure();
        }
        Ok(Presented::Shown(stats))
    }

    fn reconfigure(&mut self) -> Presented {
        let size = self.window.inner_size();
        self.resize([size.width, size.height]);
        Presented::Retry
    }

    fn recreate(&mut self) -> Result<Presented, GpuError> {
        let surface = self.instance.create_surface(Arc::clone(&self.window));
        self.surface = surface.map_err(|error| GpuError::Surface(error.to_string()))?;
        Ok(self.reconfigure())
    }
}

/// A format that stores linear light as the screen's values, if there is one; else the shaders do it.
fn gamma_format(
    capabilities: &wgpu::SurfaceCapabilities,
    default: wgpu::TextureFormat,
) -> wgpu::TextureFormat {
    let eight_bits = [
        wgpu::TextureFormat::Bgra8UnormSrgb,
        wgpu::TextureFormat::Rgba8UnormSrgb,
        wgpu::TextureFormat::Bgra8Unorm,
        wgpu::TextureFormat::Rgba8Unorm,
    ];
    let found = eight_bits
        .into_iter()
        .find(|format| capabilities.formats.contains(format));
    found.unwrap_or(default)
}
