//! Programs over a terrain client: what they need of one, and the viewer.

#[cfg(test)]
pub(crate) mod fake;
mod ground;
pub mod headless;
pub mod viewer;

use crate::mesh::{MeshOptions, PageMesh};
use crate::stages::StageTimes;
use escarp_proto::manifest::Manifest;
use escarp_proto::view::View;
use std::sync::Arc;
use std::time::Duration;

pub use ground::GroundProbe;

/// Wakes a program that waits for news. May be called from any thread, at any time.
pub type Waker = Arc<dyn Fn() + Send + Sync>;

/// What a program needs of a client: no more than this, so that it can be shown any terrain.
pub trait TerrainClient {
    /// The dataset's manifest, once it is known.
    fn manifest(&self) -> Option<Arc<Manifest>>;

    /// Lets the connection go on while there is no view to step for. `now` is the time since the
    /// program began.
    fn poll(&mut self, _now: Duration) {}

    /// Brings pages and mesh up to date for a view. `now` is the time since the program began.
    fn step(&mut self, view: &View, now: Duration) -> StepStats;

    /// Shows every page with triangles, each once, in any order.
    fn visit_pages(&self, visit: &mut dyn FnMut(&PageMesh));

    /// What had to be changed of the last view, for people; usually nothing.
    fn notes(&self) -> &[String] {
        &[]
    }

    /// Takes note of what uploading the mesh took, milliseconds.
    fn uploaded(&mut self, _upload_ms: f32) {}

    /// Takes note of what a frame took beside the step, milliseconds: uploading, drawing, and
    /// waiting for the screen.
    fn shown(&mut self, _beside_ms: f32) {}

    /// How it meshes.
    fn mesh_options(&self) -> MeshOptions {
        MeshOptions::default()
    }

    /// Meshes in another way from the next step on.
    fn set_mesh_options(&mut self, _options: MeshOptions) {}

    /// State of the connection, for people: `connected`, `reconnecting in 3 s`.
    fn status(&self) -> String;

    /// Takes a waker to call when something has arrived. Without it a program that rests asks
    /// twice a second.
    fn set_waker(&mut self, _waker: Waker) {}
}

/// Where a client stands after a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepStats {
    /// Triangles of the mesh.
    pub triangles: u64,
    /// Bytes received since the beginning.
    pub bytes_received: u64,
    /// Pages that are worth having, and are not here.
    pub pages_wanted: u32,
    /// Pages on their way.
    pub pages_in_flight: u32,
    /// Pages that are here.
    pub pages_resident: u32,
    /// Chunks that have arrived, and for which there was no time.
    pub chunks_waiting: u32,
    /// How far, on the screen, the mesh may be from the data, pixels; infinite if nobody knows.
    pub bound_px: f64,
    /// The tolerance that was used, pixels: more than the view's where a budget is kept.
    pub tolerance_px: f32,
    /// Whether the mesh is all that the tolerance asks for.
    pub converged: bool,
    /// Whether the tolerance stands: with a budget it goes on to move when all pages are here.
    pub steady: bool,
    /// What the stages of the step took.
    pub times: StageTimes,
}

impl Default for StepStats {
    /// Before anything is here: nobody knows a bound.
    fn default() -> StepStats {
        StepStats {
            triangles: 0,
            bytes_received: 0,
            pages_wanted: 0,
            pages_in_flight: 0,
            pages_resident: 0,
            chunks_waiting: 0,
            bound_px: f64::INFINITY,
            tolerance_px: 0.0,
            converged: false,
            steady: true,
            times: StageTimes::default(),
        }
    }
}
