//! Choosing an adapter and opening a device on it.

use std::fmt;
use std::sync::Arc;
use thiserror::Error;
use winit::window::Window;

/// Why no picture can be drawn.
#[derive(Debug, Error)]
pub enum GpuError {
    /// There is no adapter at all, or none for this window.
    #[error(
        "no graphics adapter found (tried {tried}); install a GPU driver, or the software one: \
         apt-get install mesa-vulkan-drivers libvulkan1 (WGPU_BACKEND and WGPU_ADAPTER_NAME, if \
         set, restrict the choice)"
    )]
    NoAdapter {
        /// The backends that were asked.
        tried: String,
    },
    /// The adapter refused to open.
    #[error("graphics adapter {adapter} cannot be opened: {reason}")]
    Device {
        /// The adapter's name.
        adapter: String,
        /// What it said.
        reason: String,
    },
    /// The window cannot be drawn on.
    #[error("no picture can be shown in the window: {0}")]
    Surface(String),
    /// A picture that the adapter cannot make.
    #[error("a picture of {0} x {1} px, allowed are 1..={2} px a side")]
    Size(u32, u32, u32),
    /// The picture was drawn, but did not come back.
    #[error("the picture cannot be read back: {0}")]
    ReadBack(String),
}

/// An open graphics device. Cheap to clone; clones are the same device.
#[derive(Clone)]
pub struct Gpu {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    pub(super) adapter: wgpu::Adapter,
}

impl Gpu {
    /// A device for pictures without a window. A real GPU is preferred, a software one counts.
    ///
    /// # Errors
    /// [`GpuError::NoAdapter`], which says what to install, or [`GpuError::Device`].
    pub fn headless() -> Result<Gpu, GpuError> {
        let instance =
            wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
        open(choose(&instance, None)?)
    }

    /// A device that can draw on this window, and the window's surface.
    ///
    /// # Errors
    /// As [`headless`](Self::headless), and [`GpuError::Surface`] if the window cannot be drawn on.
    pub(super) fn for_window(
        window: &Arc<Window>,
        display: winit::event_loop::OwnedDisplayHandle,
    ) -> Result<(Gpu, wgpu::Instance, wgpu::Surface<'static>), GpuError> {
        let instance = wgpu::Instance::new(
            wgpu::InstanceDescriptor::new_with_display_handle_from_env(Box::new(display)),
        );
        let surface = instance
            .create_surface(Arc::clone(window))
            .map_err(|error| GpuError::Surface(error.to_string()))?;
        let gpu = open(choose(&instance, Some(&surface))?)?;
        Ok((gpu, instance, surface))
    }

    /// Name, kind and interface of the adapter, for people.
    pub fn describe(&self) -> String {
        let info = self.adapter.get_info();
        format!("{} ({:?}, {:?})", info.name, info.device_type, info.backend)
    }

    /// Longest side of a picture, pixels.
    pub fn max_side_px(&self) -> u32 {
        self.device.limits().max_texture_dimension_2d
    }

    /// Waits for what was submitted, and reads a buffer back.
    ///
    /// # Errors
    /// [`GpuError::ReadBack`] if the device was lost meanwhile.
    pub(super) fn read(&self, buffer: &wgpu::Buffer) -> Result<Vec<u8>, GpuError> {
        let lost = |error: &dyn fmt::Display| GpuError::ReadBack(error.to_string());
        let (send, receive) = std::sync::mpsc::channel();
        buffer.map_async(wgpu::MapMode::Read, .., move |result| {
            let _ = send.send(result);
        });
        let waited = self.device.poll(wgpu::PollType::wait_indefinitely());
        waited.map_err(|error| lost(&error))?;
        let mapped = receive.recv().map_err(|error| lost(&error))?;
        mapped.map_err(|error| lost(&error))?;
        let view = buffer.get_mapped_range(..).map_err(|error| lost(&error))?;
        let bytes = view.to_vec();
        drop(view);
        buffer.unmap();
        Ok(bytes)
    }

    /// Whether triangles can be drawn as their edges.
    pub(super) fn draws_line_polygons(&self) -> bool {
        let features = self.device.features();
        features.contains(wgpu::Features::POLYGON_MODE_LINE)
    }
}

impl fmt::Debug for Gpu {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Gpu").field(&self.describe()).finish()
    }
}

/// The best adapter: real before software, a modern interface before an old one.
fn choose(
    instance: &wgpu::Instance,
    surface: Option<&wgpu::Surface<'_>>,
) -> Result<wgpu::Adapter, GpuError> {
    let backends =
        wgpu::Backends::from_env().unwrap_or(wgpu::Backends::PRIMARY | wgpu::Backends::GL);
    let wanted = std::env::var("WGPU_ADAPTER_NAME")
        .unwrap_or_default()
        .to_lowercase();
    pollster::block_on(instance.enumerate_adapters(backends))
        .into_iter()
        .filter(|adapter| surface.is_none_or(|s| adapter.is_surface_supported(s)))
        .filter(|adapter| adapter.get_info().name.to_lowercase().contains(&wanted))
        .min_by_key(|adapter| rank(&adapter.get_info()))
        .ok_or_else(|| GpuError::NoAdapter {
            tried: format!("{backends:?}"),
        })
}

fn rank(info: &wgpu::AdapterInfo) -> (u8, bool) {
    let kind = match info.device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    };
    (kind, info.backend == wgpu::Backend::Gl)
}

fn open(adapter: wgpu::Adapter) -> Result<Gpu, GpuError> {
    // Only what every adapter has is asked for; buffers are kept small for the same reason.
    let limits = wgpu::Limits::downlevel_webgl2_defaults().using_resolution(adapter.limits());
    let request = adapter.request_device(&wgpu::DeviceDescriptor {
        label: Some("escarp"),
        required_features: adapter.features() & wgpu::Features::POLYGON_MODE_LINE,
        required_limits: limits,
        ..Default::default()
    });
    match pollster::block_on(request) {
        Ok((device, queue)) => Ok(Gpu {
            device,
            queue,
            adapter,
        }),
        Err(error) => Err(GpuError::Device {
            adapter: adapter.get_info().name,
            reason: error.to_string(),
        }),
    }
}
