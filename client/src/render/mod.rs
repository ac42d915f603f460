//! Pictures of page meshes: the only folder that knows the graphics interface.
//!
//! In reading order: an adapter ([`Gpu`]), where the eye is and what it sees ([`EyeFrame`]), the
//! meshes on the GPU (`pages`, `pool`, `buddy`), one folder for each pass (`terrain`, `wireframe`,
//! `sky`), what ties them together ([`Scene`]), and where pictures go: [`Headless`] images, or a
//! [`WindowTarget`] with a user interface on top ([`UiFrame`]).
//!
//! Two things hold by construction:
//! - *No cracks.* A vertex's place is computed from integers alone that are the same in every page
//!   that shares the vertex, by the same instructions; so it is the same to the bit.
//! - *No jitter.* The GPU never sees a world position, only differences to the eye's grid cell.

mod gpu;

mod eye;
mod frame;

mod buddy;
mod pages;
mod pool;

mod sky;
mod terrain;
mod wireframe;

mod scene;

mod headless;
mod overlay;
mod probe;
mod target;
mod window;

#[cfg(test)]
mod tests;

pub use eye::EyeFrame;
pub use gpu::{Gpu, GpuError};
pub use headless::{Headless, render_to_image};
pub use overlay::UiFrame;
pub use pages::UploadStats;
pub use probe::{ProbePage, Probed, probe};
pub use scene::{DrawParams, DrawStats, EXAGGERATIONS, PageSync, Scene};
pub use target::Output;
pub use window::{Presented, WindowTarget};
