//! Budgets of triangles, time and memory: the tolerance that keeps to them. No clock and no mesh: it is
//! told, frame by frame, what the last tolerance came to.
//!
//! The logarithm of the tolerance is controlled, as triangles fall with a power of it:
//! `triangles ~ tolerance^-p`, where `p` depends on the terrain and is learnt from what each
//! coarsening brings. Within a band below the budget nothing is done, so that noise moves nothing.
//! Above it the tolerance rises at once to where the model says that the aim is; below it, it
//! falls slowly, as pages for a finer mesh must arrive first and their triangles come later. It
//! never falls below the tolerance that is wished for, so there is nothing to wind up; and not
//! below one that proved too fine for as long as what it was measured on stays as it is, so that a
//! mesh whose size jumps over the budget does not make it swing.

mod gauge;
#[cfg(test)]
mod tests;

use escarp_proto::view::SCREEN_ERRORS_PX;
use gauge::{Ask, Gauge};
use std::fmt::{self, Display};

/// Allowed budgets of triangles. The coarsest mesh has two; a budget below a few is never met.
pub const TRIANGLE_BUDGETS: [u64; 2] = [16, u32::MAX as u64];
/// Allowed budgets of time, milliseconds a frame.
pub const TIME_BUDGETS_MS: [f64; 2] = [0.05, 10_000.0];
/// How far the tolerance may fall in a frame, as a logarithm: 3 %, and 0.7 % while pages are
/// still to come.
const FALLS: [f64; 2] = [0.03, 0.007];
/// Changes that are smaller than this, as a logarithm, are not worth a whole update of the mesh.
const LEAST_CHANGE: f64 = 0.004;

/// What a frame may cost.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Budgets {
    /// Most triangles of the mesh.
    pub max_triangles: Option<u64>,
    /// Most milliseconds of the stages that grow with the mesh.
    pub max_ms: Option<f64>,
    /// Most bytes of the pages that the mesh needs.
    pub max_memory_bytes: Option<u64>,
    /// Most bytes of what is drawn, on the GPU.
    pub max_gpu_bytes: Option<u64>,
}

/// What a frame came to.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Load {
    /// Triangles of the mesh.
    pub triangles: u64,
    /// What the stages that grow with the mesh took, milliseconds.
    pub ms: f64,
    /// Bytes of the pages that the mesh needs, those that it lacks included; 0 if nobody knows.
    pub memory_bytes: u64,
    /// Bytes of what is drawn, on the GPU; 0 if nobody knows.
    pub gpu_bytes: u64,
    /// All pages that the tolerance asks for are here.
    pub settled: bool,
}

/// What a tolerance can be widened for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Limit {
    /// [`Budgets::max_triangles`].
    Triangles,
    /// [`Budgets::max_ms`].
    Time,
    /// [`Budgets::max_memory_bytes`].
    Memory,
    /// [`Budgets::max_gpu_bytes`].
    Gpu,
}

impl Limit {
    const ALL: [Limit; 4] = [Limit::Triangles, Limit::Time, Limit::Memory, Limit::Gpu];
}

impl Display for Limit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Limit::Triangles => "triangle budget",
            Limit::Time => "time budget",
            Limit::Memory => "memory cap",
            Limit::Gpu => "GPU memory cap",
        })
    }
}

/// Chooses the tolerance, frame by frame: [`tolerance_px`](Self::tolerance_px), then the frame,
/// then [`observe`](Self::observe).
#[derive(Debug, Clone)]
pub struct Governor {
    /// Of each [`Limit`].
    gauges: [Option<Gauge>; Limit::ALL.len()],
    /// What the tolerance was raised for last.
    limit: Limit,
    /// Logarithms of the tolerance in use, and of the one wished for.
    level: f64,
    wished: f64,
    /// Frames since the tolerance changed.
    held: u32,
}

impl Governor {
    /// A governor for budgets; those that are out of their ranges are taken as the nearest that
    /// are not.
    pub fn new(budgets: Budgets) -> Governor {
        let [least, most] = TRIANGLE_BUDGETS;
        let triangles = budgets.max_triangles.map(|most_triangles| {
            let budget = most_triangles.clamp(least, most);
            Gauge::of_count(budget as f64)
        });
        let [least, most] = TIME_BUDGETS_MS;
        let ms = budgets.max_ms.filter(|ms| !ms.is_nan());
        let ms = ms.map(|ms| Gauge::of_time(ms.clamp(least, most)));
        let of_bytes = |most: Option<u64>| most.map(|most| Gauge::of_count(most.max(1) as f64));
        let memory = of_bytes(budgets.max_memory_bytes);
        let wished = f64::from(SCREEN_ERRORS_PX[0]).ln();
        Governor {
            gauges: [triangles, ms, memory, of_bytes(budgets.max_gpu_bytes)],
            limit: Limit::Triangles,
            level: wished,
            wished,
            held: 0,
        }
    }

    /// The tolerance for the next frame, pixels: at least the one wished for, at most the coarsest
    /// that is allowed.
    pub fn tolerance_px(&mut self, wished_px: f32) -> f32 {
        let [least, most] = SCREEN_ERRORS_PX;
        let wished_px = match wished_px.is_nan() {
            true => most,
            false => wished_px.clamp(least, most),
        };
        let wished = f64::from(wished_px).ln();
        let engaged = self.level > self.wished;
        self.wished = wished;
        if !engaged || self.level < wished {
            self.level = wished;
        }
        match self.level > wished {
            true => (self.level.exp() as f32).clamp(wished_px, most),
            false => wished_px,
        }
    }

    /// What the tolerance is wider for than wished, if it is.
    pub fn limit(&self) -> Option<Limit> {
        (self.level > self.wished).then_some(self.limit)
    }

    /// Whether the tolerance stands, as far as the last frames tell: a program that waits for its
    /// best picture may stop.
    pub fn is_steady(&self) -> bool {
        let needed = self.gauges.iter().flatten().map(Gauge::patience).max();
        self.held >= needed.unwrap_or(0)
    }

    /// Takes what the frame with the last tolerance came to.
    pub fn observe(&mut self, load: &Load) {
        let (level, held) = (self.level, self.held);
        let values = [
            load.triangles as f64,
            load.ms,
            load.memory_bytes as f64,
            load.gpu_bytes as f64,
        ];
        let mut all = None;
        for ((gauge, value), limit) in self.gauges.iter_mut().zip(values).zip(Limit::ALL) {
            let ask = gauge
                .as_mut()
                .map(|gauge| gauge.observe(level, held, value));
            if matches!(ask, Some(Ask::Raise(_))) {
                self.limit = limit;
            }
            all = together(all, ask);
        }
        let step = all.map_or(0.0, |ask| match ask {
            Ask::Raise(step) => step,
            Ask::Hold => 0.0,
            Ask::Lower(step) => -step.min(FALLS[usize::from(!load.settled)]),
        });
        let most = f64::from(SCREEN_ERRORS_PX[1]).ln();
        let next = (self.level + step).clamp(self.wished, most);
        let at_limit = next == self.wished || next == most;
        if (next - self.level).abs() < LEAST_CHANGE && !at_limit || next == self.level {
            self.held = self.held.saturating_add(1);
            return;
        }
        self.level = next;
        self.held = 0;
    }
}

/// What all gauges can agree to: the largest rise that one asks for, or else the smallest fall.
fn together(a: Option<Ask>, b: Option<Ask>) -> Option<Ask> {
    let (Some(one), Some(other)) = (a, b) else {
        return a.or(b);
    };
    Some(match (one, other) {
        (Ask::Raise(one), Ask::Raise(other)) => Ask::Raise(one.max(other)),
        (Ask::Raise(step), _) | (_, Ask::Raise(step)) => Ask::Raise(step),
        (Ask::Lower(one), Ask::Lower(other)) => Ask::Lower(one.min(other)),
        (Ask::Hold, _) | (_, Ask::Hold) => Ask::Hold,
    })
}
