//! What the adapter computes for single vertices, read back to the bit. For reports and tests: it
//! shows whether the arithmetic that keeps meshes without cracks is what the adapter does.

use super::eye::EyeFrame;
use super::frame::{
    Body, COMMON, FrameBinding, FrameUniform, PageInstance, STILL, instance_layout, vertex_layout,
};
use super::gpu::{Gpu, GpuError};
use super::pages::PAGE_VERTICES;
use super::scene::DrawParams;
use super::target::{Output, texture};
use crate::mesh::Vertex;
use escarp_proto::geometry::PAGE_SAMPLES;
use escarp_proto::georef::Georef;

/// Draws each vertex as a pixel, and says the same as the terrain's shader of where it is.
const SHADER: &str = "
struct Found {
    @builtin(position) pixel: vec4f,
    @location(0) @interpolate(flat) from_eye: vec4u,
    @location(1) @interpolate(flat) clip: vec4u,
}

@vertex
fn vertex(@builtin(vertex_index) index: u32, @location(0) height: i32, page: Page) -> Found {
    let from_eye = place(index, height, page);
    let clip = frame.clip_from_eye * vec4f(from_eye, 1.0);
    let pixel = vec2f(f32(index % 289u), f32(index / 289u)) + 0.5;
    let size = vec2f(289.0, f32(PAGES));
    var found: Found;
    found.pixel = vec4f(pixel / size * 2.0 - 1.0, 0.5, 1.0);
    found.pixel.y = -found.pixel.y;
    found.from_eye = bitcast<vec4u>(vec4f(from_eye, 0.0));
    found.clip = bitcast<vec4u>(clip);
    return found;
}

struct Bits {
    @location(0) from_eye: vec4u,
    @location(1) clip: vec4u,
}

@fragment
fn fragment(found: Found) -> Bits {
    return Bits(found.from_eye, found.clip);
}
";

const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Uint;
const PIXEL_BYTES: u32 = 16;
/// Most pages of a probe.
const MOST_PAGES: usize = 1024;

/// A page's 17 x 17 vertices, all of one height.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProbePage {
    /// Grid coordinates of its south-west sample.
    pub origin: [u32; 2],
    /// Grid cells between neighbouring samples.
    pub stride: u32,
    /// Height in quanta.
    pub height: i32,
}

/// Where the adapter has a vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Probed {
    /// From the eye, metres.
    pub from_eye: [f32; 3],
    /// In clip space.
    pub clip: [f32; 4],
}

/// Where the adapter has the vertices of these pages, page by page, row by row from the
/// south-west. At most 1024 pages; more are left out.
///
/// # Errors
/// [`GpuError::ReadBack`] if the device was lost meanwhile.
pub fn probe(
    gpu: &Gpu,
    georef: &Georef,
    params: &DrawParams,
    pages: &[ProbePage],
) -> Result<Vec<Probed>, GpuError> {
    let pages = &pages[..pages.len().min(MOST_PAGES)];
    if pages.is_empty() {
        return Ok(Vec::new());
    }
    let eye = EyeFrame::of(&params.view, georef, params.exaggeration);
    let frame = FrameBinding::new(gpu);
    let body = Body::of(georef, None);
    frame.write(
        gpu,
        &FrameUniform::new(&eye, &body, params, Output::image(1)),
    );
    let size = [PAGE_VERTICES as u32, pages.len() as u32];
    let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC;
    let textures = [0; 2].map(|_| texture(gpu, FORMAT, size, 1, usage));
    let mut encoder = gpu.device.create_command_encoder(&Default::default());
    draw(gpu, &frame, &mut encoder, &textures, &eye, pages);
    let buffers = [0, 1].map(|i| copy(gpu, &mut encoder, &textures[i], size));
    gpu.queue.submit([encoder.finish()]);
    let [from_eye, clip] = [read(gpu, &buffers[0], size)?, read(gpu, &buffers[1], size)?];
    let probed = |(from_eye, clip): ([f32; 4], [f32; 4])| Probed {
        from_eye: [from_eye[0], from_eye[1], from_eye[2]],
        clip,
    };
    Ok(from_eye.into_iter().zip(clip).map(probed).collect())
}

fn draw(
    gpu: &Gpu,
    frame: &FrameBinding,
    encoder: &mut wgpu::CommandEncoder,
    textures: &[wgpu::Texture; 2],
    eye: &EyeFrame,
    pages: &[ProbePage],
) {
    let vertices: Vec<Vertex> = pages
        .iter()
        .flat_map(|page| [Vertex::on_slope(page.height, 0.0, 0.0); PAGE_SAMPLES * PAGE_SAMPLES])
        .collect();
    let instances: Vec<PageInstance> = pages
        .iter()
        .map(|page| PageInstance {
            origin: eye.relative(page.origin),
            stride: page.stride,
        })
        .collect();
    let vertices = buffer(gpu, bytemuck::cast_slice(&vertices));
    let instances = buffer(gpu, bytemuck::cast_slice(&instances));
    let pipeline = pipeline(gpu, frame, pages.len());
    let views = [0, 1].map(|i: usize| textures[i].create_view(&Default::default()));
    let attachments = [0, 1].map(|i: usize| {
        Some(wgpu::RenderPassColorAttachment {
            view: &views[i],
            depth_slice: None,
            resolve_target: None,
            ops: wgpu::Operations {
                load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                store: wgpu::StoreOp::Store,
            },
        })
    });
    let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("probe"),
        color_attachments: &attachments,
        ..Default::default()
    });
    frame.bind(&mut pass);
    pass.set_pipeline(&pipeline);
    pass.set_vertex_buffer(0, vertices.slice(..));
    pass.set_vertex_buffer(1, instances.slice(..));
    for page in 0..pages.len() as u32 {
        let first = page * PAGE_VERTICES as u32;
        pass.draw(first..first + PAGE_VERTICES as u32, page..page + 1);
    }
}

fn pipeline(gpu: &Gpu, frame: &FrameBinding, pages: usize) -> wgpu::RenderPipeline {
    let source = format!("{COMMON}\n{STILL}\nconst PAGES = {pages}u;\n{SHADER}");
    let module = gpu
        .device
        .create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("probe"),
            source: wgpu::ShaderSource::Wgsl(source.into()),
        });
    let target = Some(wgpu::ColorTargetState::from(FORMAT));
    gpu.device
        .create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("probe"),
            layout: Some(frame.layout()),
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("vertex"),
                compilation_options: Default::default(),
                buffers: &[Some(vertex_layout()), Some(instance_layout())],
            },
            primitive: wgpu::PrimitiveState {
                topology: wgpu::PrimitiveTopology::PointList,
                ..Default::default()
            },
            depth_stencil: None,
            multisample: Default::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("fragment"),
                compilation_options: Default::default(),
                targets: &[target.clone(), target],
            }),
            multiview_mask: None,
            cache: None,
        })
}

fn buffer(gpu: &Gpu, bytes: &[u8]) -> wgpu::Buffer {
    let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("probe"),
        size: bytes.len() as u64,
        usage: wgpu::BufferUsages::VERTEX | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    gpu.queue.write_buffer(&buffer, 0, bytes);
    buffer
}

/// Bytes of a row of pixels in a copy, which must be a multiple of 256.
fn row_bytes(width: u32) -> u32 {
    (width * PIXEL_BYTES).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT)
}

fn copy(
    gpu: &Gpu,
    encoder: &mut wgpu::CommandEncoder,
    texture: &wgpu::Texture,
    [width, height]: [u32; 2],
) -> wgpu::Buffer {
    let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("probe read back"),
        size: u64::from(row_bytes(width)) * u64::from(height),
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let to = wgpu::TexelCopyBufferInfo {
        buffer: &buffer,
        layout: wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(row_bytes(width)),
            rows_per_image: None,
        },
    };
    encoder.copy_texture_to_buffer(texture.as_image_copy(), to, texture.size());
    buffer
}

fn read(gpu: &Gpu, buffer: &wgpu::Buffer, [width, _]: [u32; 2]) -> Result<Vec<[f32; 4]>, GpuError> {
    let bytes = gpu.read(buffer)?;
    let pixels = |row: &[u8]| -> Vec<[f32; 4]> {
        let row = &row[..(width * PIXEL_BYTES) as usize];
        let pixel = |bytes: &[u8]| bytemuck::pod_read_unaligned(bytes);
        row.chunks_exact(PIXEL_BYTES as usize).map(pixel).collect()
    };
    let rows = bytes.chunks_exact(row_bytes(width) as usize);
    Ok(rows.flat_map(pixels).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::look_at;
    use escarp_proto::georef::Plane;

    #[test]
    fn vertices_come_back_where_they_are() {
        let gpu = Gpu::headless().unwrap_or_else(|error| panic!("{error}"));
        let georef = Georef {
            origin_m: [1000.0, 2000.0],
            sample_spacing_m: [10.0, 20.0],
            quantum_m: 0.5,
            plane: Plane::Local,
        };
        let eye = [1040.0, 2060.0, 7.0];
        let view = look_at(eye, [1100.0, 2500.0, 0.0], 1.0, [640, 480], 2.0);
        let page = |x, stride, height| ProbePage {
            origin: [x, 16],
            stride,
            height,
        };
        let pages = [page(0, 1, 3), page(32, 2, -8)];
        let found = probe(&gpu, &georef, &DrawParams::new(view), &pages).unwrap();
        assert_eq!(found.len(), 2 * PAGE_VERTICES);
        for (k, vertex) in found.iter().enumerate() {
            let (page, k) = (pages[k / PAGE_VERTICES], k % PAGE_VERTICES);
            let at = [k % 17, k / 17].map(|steps| steps as u32 * page.stride);
            let right = georef.world(page.origin[0] + at[0], page.origin[1] + at[1], page.height);
            for axis in 0..3 {
                let off = f64::from(vertex.from_eye[axis]) - (right[axis] - eye[axis]);
                assert!(off.abs() < 1e-3, "{k} {vertex:?}");
            }
        }
        assert!(
            probe(&gpu, &georef, &DrawParams::new(view), &[])
                .unwrap()
                .is_empty()
        );
    }
}
