//! How a client works: memory, mesher, budgets.

use crate::governor::{Budgets, Governor};
use crate::mesh::{MeshOptions, Metric};
use crate::stages::Budget;
use crate::terrain::{DEFAULT_MEMORY_BYTES, room_for_pages};

/// How a client works.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClientOptions {
    /// Most memory for resident pages, and for what waits to become some, bytes: the tolerance
    /// follows.
    pub memory_cap_bytes: usize,
    /// Most memory of the GPU for what is drawn, bytes: the tolerance follows.
    pub gpu_cap_bytes: Option<u64>,
    /// How it meshes.
    pub mesh: MeshOptions,
    /// Whether the server may send what is needed unasked, if it can and the mesher goes along.
    pub push: bool,
    /// Most milliseconds a frame of updating, triangulating and uploading: the tolerance follows.
    pub max_ms: Option<f64>,
    /// How long a step may take. Pages for which there is no time wait for the next one; at least
    /// one is linked in each.
    pub frame_budget: Budget,
}

impl Default for ClientOptions {
    fn default() -> ClientOptions {
        ClientOptions {
            memory_cap_bytes: DEFAULT_MEMORY_BYTES,
            gpu_cap_bytes: None,
            mesh: MeshOptions::default(),
            push: true,
            max_ms: None,
            frame_budget: Budget::None,
        }
    }
}

impl ClientOptions {
    /// Whether a mesh with all its pages is within the tolerance. A mesher that keeps to a number
    /// of triangles by itself may not be.
    pub(super) fn promises_tolerance(&self) -> bool {
        let MeshOptions { mesher, metric, .. } = self.mesh;
        let capped = mesher.keeps_triangles() && self.mesh.max_triangles.is_some();
        mesher.keeps_tolerance() && metric == Metric::Bounding && !capped
    }

    /// The governor of those budgets that a mesher does not keep by itself.
    pub(super) fn governor(&self) -> Governor {
        let left = (self.mesh.max_triangles).filter(|_| !self.mesh.mesher.keeps_triangles());
        Governor::new(Budgets {
            max_triangles: left.map(u64::from),
            max_ms: self.max_ms,
            max_memory_bytes: Some(room_for_pages(self.memory_cap_bytes) as u64),
            max_gpu_bytes: self.gpu_cap_bytes,
        })
    }
}
