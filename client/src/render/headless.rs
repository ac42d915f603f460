//! Pictures without a window.

use super::gpu::{Gpu, GpuError};
use super::scene::{DrawParams, DrawStats, Scene};
use super::target::{Attachments, Output, texture};
use image::RgbaImage;

/// An image that scenes are drawn into and read back from.
pub struct Headless {
    gpu: Gpu,
    output: Output,
    size_px: [u32; 2],
    attachments: Attachments,
    colour: wgpu::Texture,
    read_back: wgpu::Buffer,
}

impl Headless {
    /// An image of this size in pixels, with 1 or 4 samples a pixel.
    ///
    /// # Errors
    /// [`GpuError::Size`] if a side is 0 or longer than the adapter allows.
    pub fn new(gpu: &Gpu, size_px: [u32; 2], samples: u32) -> Result<Headless, GpuError> {
        Headless::of(gpu, size_px, Output::image(samples))
    }

    /// An image of the same kind as another picture, such as a window's.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn of(gpu: &Gpu, size_px: [u32; 2], output: Output) -> Result<Headless, GpuError> {
        let attachments = Attachments::new(gpu, output, size_px)?;
        let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC;
        let [width, height] = size_px;
        Ok(Headless {
            gpu: gpu.clone(),
            output,
            size_px,
            attachments,
            colour: texture(gpu, output.format, size_px, 1, usage),
            read_back: gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("read back"),
                size: u64::from(row_bytes(width)) * u64::from(height),
                usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
                mapped_at_creation: false,
            }),
        })
    }

    /// The kind of picture; a scene that is drawn here must be of the same.
    pub fn output(&self) -> Output {
        self.output
    }

    /// Draws a scene and waits for the picture.
    ///
    /// # Errors
    /// [`GpuError::ReadBack`] if the device was lost meanwhile.
    pub fn render(
        &mut self,
        scene: &mut Scene,
        params: &DrawParams,
    ) -> Result<(RgbaImage, DrawStats), GpuError> {
        self.render_over(scene, params, None)
    }

    pub(super) fn render_over(
        &mut self,
        scene: &mut Scene,
        params: &DrawParams,
        background: Option<wgpu::Color>,
    ) -> Result<(RgbaImage, DrawStats), GpuError> {
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        let view = self.colour.create_view(&Default::default());
        let stats = scene.draw_over(&mut encoder, &self.attachments, &view, params, background);
        self.record_copy(&mut encoder);
        self.gpu.queue.submit([encoder.finish()]);
        Ok((self.read()?, stats))
    }

    fn record_copy(&self, encoder: &mut wgpu::CommandEncoder) {
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(row_bytes(self.size_px[0])),
            rows_per_image: None,
        };
        let to = wgpu::TexelCopyBufferInfo {
            buffer: &self.read_back,
            layout,
        };
        encoder.copy_texture_to_buffer(self.colour.as_image_copy(), to, self.colour.size());
    }

    fn read(&self) -> Result<RgbaImage, GpuError> {
        Ok(self.unpad(&self.gpu.read(&self.read_back)?))
    }

    /// Takes the padding off the rows, and brings the channels into the image's order.
    fn unpad(&self, rows: &[u8]) -> RgbaImage {
        let [width, height] = self.size_px;
        let mut pixels: Vec<u8> = rows
            .chunks_exact(row_bytes(width) as usize)
            .flat_map(|row| &row[..width as usize * 4])
            .copied()
            .collect();
        let blue_first = matches!(
            self.output.format,
            wgpu::TextureFormat::Bgra8Unorm | wgpu::TextureFormat::Bgra8UnormSrgb
        );
        for pixel in pixels.chunks_exact_mut(4) {
            if blue_first {
                pixel.swap(0, 2);
            }
            pixel[3] = 255;
        }
        RgbaImage::from_raw(width, height, pixels).unwrap_or_default()
    }
}

/// Bytes of a row of pixels in a copy, which must be a multiple of 256.
fn row_bytes(width: u32) -> u32 {
    (width * 4).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT)
}

/// One picture of a scene, in the size of its view; the scene must be of [`Output::image`].
///
/// # Errors
/// As [`Headless::new`] and [`Headless::render`].
pub fn render_to_image(
    gpu: &Gpu,
    scene: &mut Scene,
    params: &DrawParams,
) -> Result<RgbaImage, GpuError> {
    let mut target = Headless::of(gpu, params.view.viewport_px, scene.output())?;
    Ok(target.render(scene, params)?.0)
}
