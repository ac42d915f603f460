//! What the shaders know of a frame, and what every pass's pipeline has in common.

use super::eye::EyeFrame;
use super::gpu::Gpu;
use super::scene::DrawParams;
use super::target::{DEPTH_FORMAT, Output};
use crate::mesh::{Offset, Vertex};
use bytemuck::{Pod, Zeroable};
use escarp_proto::georef::{Georef, Plane};
use glam::{DVec3, Vec3};

/// Shader source that every pass begins with.
pub const COMMON: &str = include_str!("common.wgsl");
/// Vertices at their heights, or on their way.
pub const STILL: &str = include_str!("still.wgsl");
const MORPHED: &str = include_str!("morphed.wgsl");

/// Whether a pass reads pages, and how they are placed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reads {
    Nothing,
    /// Pages whose vertices are at their heights.
    Pages,
    /// Pages with an offset for each vertex.
    MorphedPages,
}

/// Share of light that a metre of air on the ground scatters: one in 150 km.
const AIR_A_METRE: f32 = 1.0 / 150_000.0;
/// Height in which the air's density falls to 1/e, metres.
const AIR_FALL_M: f32 = 8_000.0;
/// A body is the Earth if its radius is within this share of the Earth's.
const EARTH_RADIUS_M: f64 = 6_371_000.0;
const EARTH_RADIUS_SHARE: f64 = 0.01;

/// Mirrors `Frame` of `common.wgsl`, where the fields are described.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct FrameUniform {
    clip_from_eye: [[f32; 4]; 4],
    right: [f32; 4],
    up: [f32; 4],
    forward: [f32; 4],
    sun: [f32; 4],
    spacing: [f32; 4],
    remainder: [f32; 4],
    heights: [i32; 4],
    range: [f32; 4],
    air: [f32; 4],
    flags: [u32; 4],
}

const _: () = assert!(size_of::<FrameUniform>() == 64 + 10 * 16);

/// Where a page is in this frame; mirrors `Page` of `common.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct PageInstance {
    /// South-west sample, counted from the eye's cell.
    pub origin: [i32; 2],
    /// Grid cells between samples.
    pub stride: u32,
}

const _: () = assert!(size_of::<PageInstance>() == 12);

/// What the shaders know of a dataset.
#[derive(Debug, Clone, Copy)]
pub struct Body {
    lowest: i32,
    relief: f32,
    quantum_m: f64,
    air: bool,
}

impl Body {
    /// The body of a dataset whose heights are in this range of quanta.
    pub fn of(georef: &Georef, height_range: Option<[i32; 2]>) -> Body {
        let [lowest, highest] = height_range.unwrap_or([0, 1]);
        Body {
            lowest,
            relief: (f64::from(highest) - f64::from(lowest)).max(1.0) as f32,
            quantum_m: georef.quantum_m,
            air: has_air(&georef.plane),
        }
    }
}

/// The Earth, and what does not say what it is, has air; the Moon has none.
fn has_air(plane: &Plane) -> bool {
    match plane {
        Plane::Geographic { radius_m, .. } => {
            (radius_m / EARTH_RADIUS_M - 1.0).abs() < EARTH_RADIUS_SHARE
        }
        Plane::Projected { crs, .. } => !crs.to_lowercase().contains("moon"),
        Plane::Local => true,
    }
}

impl FrameUniform {
    pub fn new(eye: &EyeFrame, body: &Body, params: &DrawParams, output: Output) -> FrameUniform {
        let lowest_m = f64::from(body.lowest) * body.quantum_m * eye.exaggeration;
        let [x, y] = eye.half_tangents;
        let px_a_radian = params.view.px_per_slope() as f32;
        let vector = |v: DVec3| v.as_vec3().extend(0.0).to_array();
        FrameUniform {
            clip_from_eye: eye.clip_from_eye().to_cols_array_2d(),
            right: vector(eye.right * x),
            up: vector(eye.up * y),
            forward: vector(eye.forward),
            sun: Vec3::from(params.sun)
                .normalize_or(Vec3::Z)
                .extend(0.0)
                .to_array(),
            spacing: eye.spacing_m.extend(eye.exaggeration as f32).to_array(),
            remainder: eye.remainder_m.extend(0.0).to_array(),
            heights: [eye.height, body.lowest, 0, 0],
            range: [
                1.0 / body.relief,
                (eye.eye_m.z - lowest_m) as f32,
                px_a_radian,
                0.0,
            ],
            air: [AIR_A_METRE, AIR_FALL_M, 0.0, 0.0],
            flags: [
                u32::from(body.air),
                u32::from(!output.applies_gamma()),
                0,
                0,
            ],
        }
    }
}

/// The frame's uniform on the GPU, and the layout that all pipelines share.
pub struct FrameBinding {
    buffer: wgpu::Buffer,
    group: wgpu::BindGroup,
    layout: wgpu::PipelineLayout,
}

impl FrameBinding {
    pub fn new(gpu: &Gpu) -> FrameBinding {
        let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("frame"),
            size: size_of::<FrameUniform>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let entry = wgpu::BindGroupLayoutEntry {
            binding: 0,
            visibility: wgpu::ShaderStages::VERTEX_FRAGMENT,
            ty: wgpu::BindingType::Buffer {
                ty: wgpu::BufferBindingType::Uniform,
                has_dynamic_offset: false,
                min_binding_size: wgpu::BufferSize::new(size_of::<FrameUniform>() as u64),
            },
            count: None,
        };
        let group_layout = gpu
            .device
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some("frame"),
                entries: &[entry],
            });
        let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("frame"),
            layout: &group_layout,
            entries: &[wgpu::BindGroupEntry {
                binding: 0,
                resource: buffer.as_entire_binding(),
            }],
        });
        let layout = gpu
            .device
            .create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some("frame"),
                bind_group_layouts: &[Some(&group_layout)],
                immediate_size: 0,
            });
        FrameBinding {
            buffer,
            group,
            layout,
        }
    }

    pub fn write(&self, gpu: &Gpu, frame: &FrameUniform) {
        gpu.queue
            .write_buffer(&self.buffer, 0, bytemuck::bytes_of(frame));
    }

    /// The layout of all pipelines.
    pub fn layout(&self) -> &wgpu::PipelineLayout {
        &self.layout
    }

    pub fn bind(&self, pass: &mut wgpu::RenderPass<'_>) {
        pass.set_bind_group(0, &self.group, &[]);
    }
}

/// How one pass differs from the others.
pub struct PassKind<'a> {
    pub label: &'a str,
    /// Follows what all passes share.
    pub shader: &'a str,
    pub reads: Reads,
    pub primitive: wgpu::PrimitiveState,
    pub writes_depth: bool,
    pub depth_compare: wgpu::CompareFunction,
    pub blend: Option<wgpu::BlendState>,
}

/// A pass's pipeline.
pub fn pipeline(
    gpu: &Gpu,
    frame: &FrameBinding,
    output: Output,
    kind: &PassKind<'_>,
) -> wgpu::RenderPipeline {
    let page = match kind.reads {
        Reads::MorphedPages => MORPHED,
        Reads::Pages | Reads::Nothing => STILL,
    };
    let source = format!("{COMMON}\n{page}\n{}", kind.shader);
    let module = gpu
        .device
        .create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(kind.label),
            source: wgpu::ShaderSource::Wgsl(source.into()),
        });
    let layouts = [vertex_layout(), instance_layout(), offset_layout()].map(Some);
    let buffers = match kind.reads {
        Reads::Nothing => &layouts[..0],
        Reads::Pages => &layouts[..2],
        Reads::MorphedPages => &layouts[..],
    };
    let target = wgpu::ColorTargetState {
        format: output.format,
        blend: kind.blend,
        write_mask: wgpu::ColorWrites::ALL,
    };
    gpu.device
        .create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(kind.label),
            layout: Some(&frame.layout),
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("vertex"),
                compilation_options: Default::default(),
                buffers,
            },
            primitive: kind.primitive,
            depth_stencil: Some(wgpu::DepthStencilState {
                format: DEPTH_FORMAT,
                depth_write_enabled: Some(kind.writes_depth),
                depth_compare: Some(kind.depth_compare),
                stencil: Default::default(),
                bias: Default::default(),
            }),
            multisample: wgpu::MultisampleState {
                count: output.samples,
                ..Default::default()
            },
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("fragment"),
                compilation_options: Default::default(),
                targets: &[Some(target)],
            }),
            multiview_mask: None,
            cache: None,
        })
}

/// How the vertices of pages lie in their buffer.
pub fn vertex_layout() -> wgpu::VertexBufferLayout<'static> {
    const ATTRIBUTES: [wgpu::VertexAttribute; 2] =
        wgpu::vertex_attr_array![0 => Sint32, 1 => Snorm16x2];
    wgpu::VertexBufferLayout {
        array_stride: size_of::<Vertex>() as u64,
        step_mode: wgpu::VertexStepMode::Vertex,
        attributes: &ATTRIBUTES,
    }
}

/// How the places of pages lie in their buffer.
pub fn instance_layout() -> wgpu::VertexBufferLayout<'static> {
    const ATTRIBUTES: [wgpu::VertexAttribute; 2] =
        wgpu::vertex_attr_array![2 => Sint32x2, 3 => Uint32];
    wgpu::VertexBufferLayout {
        array_stride: size_of::<PageInstance>() as u64,
        step_mode: wgpu::VertexStepMode::Instance,
        attributes: &ATTRIBUTES,
    }
}

fn offset_layout() -> wgpu::VertexBufferLayout<'static> {
    const ATTRIBUTES: [wgpu::VertexAttribute; 2] =
        wgpu::vertex_attr_array![4 => Float32, 5 => Snorm16x2];
    wgpu::VertexBufferLayout {
        array_stride: size_of::<Offset>() as u64,
        step_mode: wgpu::VertexStepMode::Vertex,
        attributes: &ATTRIBUTES,
    }
}

#[cfg(test)]
mod unit {
    use super::*;
    use crate::app::fake::manifest;
    use crate::mesh::Vertex;
    use crate::render::DrawParams;
    use escarp_proto::geometry::GridLevels;
    use escarp_proto::view::View;
    use proptest::prelude::*;

    fn georef(spacing: [f64; 2], quantum_m: f64, origin_m: [f64; 2]) -> Georef {
        Georef {
            origin_m,
            sample_spacing_m: spacing,
            quantum_m,
            plane: Plane::Local,
        }
    }

    /// A power of ten, which makes the extremes as likely as what is usual.
    fn scale(range: std::ops::RangeInclusive<i32>) -> impl Strategy<Value = f64> {
        range.prop_map(|power| 10f64.powi(power))
    }

    fn floats(frame: &FrameUniform) -> Vec<f32> {
        let mut floats = frame.clip_from_eye.concat();
        let vectors = [
            frame.right,
            frame.up,
            frame.forward,
            frame.sun,
            frame.spacing,
            frame.remainder,
            frame.range,
            frame.air,
        ];
        floats.extend(vectors.concat());
        floats
    }

    proptest! {
        #[test]
        fn no_view_and_no_manifest_put_anything_but_numbers_into_a_buffer(
            levels in prop::sample::select(vec![4u8, 8, 28]),
            spacing in [scale(-9..=9), scale(-9..=9)], quantum in scale(-9..=9),
            origin in [prop::num::f64::NORMAL, prop::num::f64::NORMAL],
            heights in [-(1i32 << 30)..=0, 0..=1 << 30],
            eye in [any::<f64>(), any::<f64>(), prop::num::f64::ANY], far in scale(-3..=12),
            direction in prop::array::uniform3(prop::num::f32::ANY),
            fov_y in prop::num::f32::ANY, viewport_px in [any::<u32>(), any::<u32>()],
            exaggeration in prop::num::f32::ANY, sun in prop::array::uniform3(prop::num::f32::ANY),
        ) {
            let grid = GridLevels::new(levels).unwrap();
            let origin = origin.map(|v| v % 1e12);
            let georef = georef(spacing, quantum, origin);
            let manifest = manifest(grid, 1, heights, georef.clone());
            prop_assume!(manifest.check().is_ok());
            for eye_m in [eye, eye.map(|v| v % far), [far, -far, far]] {
                let params = DrawParams {
                    exaggeration,
                    sun,
                    ..DrawParams::new(View {
                        eye_m,
                        direction,
                        velocity_m_s: [0.0; 3],
                        fov_y,
                        viewport_px,
                        max_screen_error_px: 1.0,
                    })
                };
                let (params, _) = params.clamped();
                let eye = EyeFrame::of(&params.view, &georef, params.exaggeration);
                let body = Body::of(&georef, manifest.height_range);
                let output = Output::image(1);
                let frame = FrameUniform::new(&eye, &body, &params, output);
                let floats = floats(&frame);
                prop_assert!(floats.iter().all(|v| v.is_finite()), "{:?}", frame.clip_from_eye);
                let cells = grid.cells_per_side();
                for [x, y] in [[0, 0], [cells, cells]] {
                    let [dx, dy] = eye.relative([x, y]);
                    for height in heights {
                        let steps = Vec3::new(dx as f32, dy as f32, (height - eye.height) as f32);
                        let place = steps * eye.spacing_m - eye.remainder_m;
                        // Squares of distances are numbers, too.
                        prop_assert!(place.length_squared().is_finite(), "{place}");
                    }
                }
            }
        }

        #[test]
        fn the_normal_of_any_slope_is_one(
            height in any::<i32>(), rise in -(1i64 << 31)..=1 << 31,
            quantum in scale(-9..=3), spacing in scale(-9..=9),
        ) {
            let slope = rise as f64 * quantum / spacing;
            let flat = Vertex::on_slope(height, 0.0, 0.0);
            prop_assert_eq!(flat.normal, [0, 0]);
            let vertex = Vertex::on_slope(height, slope, -slope);
            prop_assert_eq!(vertex.normal[0], -vertex.normal[1]);
        }
    }
}
