//! The stages of a frame's work: what each took, and when there is no time for more.

use serde::Serialize;
use std::time::Duration;

/// A stage of a frame, in their order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Bytes become a page.
    Decode,
    /// A page is held against those around it, its bounds are derived, and it joins the mesh tree.
    Link,
    /// Vertices are enabled and disabled.
    Update,
    /// Triangles are made of what changed.
    Triangulate,
}

/// What the stages of a frame took, milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct StageTimes {
    /// Decoding pages.
    pub decode_ms: f32,
    /// Linking and unlinking pages.
    pub link_ms: f32,
    /// Enabling and disabling vertices.
    pub update_ms: f32,
    /// Making triangles.
    pub triangulate_ms: f32,
}

impl StageTimes {
    /// All of them together, milliseconds.
    pub fn total_ms(&self) -> f32 {
        self.decode_ms + self.link_ms + self.mesh_ms()
    }

    /// The stages that follow from the mesh alone, however many pages arrive, milliseconds.
    pub fn mesh_ms(&self) -> f32 {
        self.update_ms + self.triangulate_ms
    }
}

/// How long a step may take.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Budget {
    /// As long as it needs.
    #[default]
    None,
    /// So long.
    Fixed(Duration),
    /// By what the rest of a frame takes: where pictures take long to draw, a step may take longer,
    /// too, as few of them would else make pages wait for many frames.
    ByFrame,
}

impl Budget {
    /// What a step gets in any case, by [`Budget::ByFrame`]: half of a frame at 60 a second.
    pub const LEAST: Duration = Duration::from_millis(8);
    /// What it gets at most, so that a key that is pressed is answered.
    pub const MOST: Duration = Duration::from_millis(125);

    /// The time for a step, if the rest of the frame takes so long. Half of that: a frame with a
    /// step that uses all of it takes at most half as long again as one without.
    pub fn time(self, beside: Duration) -> Option<Duration> {
        match self {
            Budget::None => None,
            Budget::Fixed(time) => Some(time),
            Budget::ByFrame => Some((beside / 2).clamp(Budget::LEAST, Budget::MOST)),
        }
    }
}

/// One frame's clock. The time is the caller's: a function that gives it, since any moment.
pub struct Stages<'a> {
    now: &'a dyn Fn() -> Duration,
    /// When no further page is to be begun.
    until: Option<Duration>,
    pages: u64,
    times: StageTimes,
}

impl<'a> Stages<'a> {
    /// A frame begins. With a budget, pages are decoded and linked no longer than that; the mesh
    /// is brought up to date in any case, as half of an update would be a crack. `reserved` is
    /// what of the budget that is going to take; a quarter is left for pages whatever it is.
    pub fn begin(
        now: &'a dyn Fn() -> Duration,
        budget: Option<Duration>,
        reserved: Duration,
    ) -> Stages<'a> {
        let for_pages = |all: Duration| all.saturating_sub(reserved).max(all / 4);
        Stages {
            until: budget.map(|budget| now().saturating_add(for_pages(budget))),
            now,
            pages: 0,
            times: StageTimes::default(),
        }
    }

    /// A frame without clock and budget.
    pub fn untimed() -> Stages<'static> {
        Stages {
            now: &|| Duration::ZERO,
            until: None,
            pages: 0,
            times: StageTimes::default(),
        }
    }

    /// Does a part of a stage's work.
    pub fn time<T>(&mut self, stage: Stage, work: impl FnOnce() -> T) -> T {
        let began = (self.now)();
        let done = work();
        let ms = (self.now)().saturating_sub(began).as_secs_f32() * 1e3;
        *match stage {
            Stage::Decode => &mut self.times.decode_ms,
            Stage::Link => &mut self.times.link_ms,
            Stage::Update => &mut self.times.update_ms,
            Stage::Triangulate => &mut self.times.triangulate_ms,
        } += ms;
        done
    }

    /// Whether there is time for another page, which is then begun. There always is for the first
    /// of a frame, so that pages come to an end however small the budget.
    pub fn begin_page(&mut self) -> bool {
        let in_time = self.pages == 0 || self.until.is_none_or(|until| (self.now)() < until);
        self.pages += u64::from(in_time);
        in_time
    }

    /// What the stages took so far.
    pub fn times(&self) -> StageTimes {
        self.times
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    /// Pages that are begun in a frame, if each takes this many milliseconds.
    fn begun(budget_ms: Option<u64>, reserved_ms: u64, page_ms: u64) -> u64 {
        let clock = Cell::new(Duration::from_secs(7));
        let now = || clock.get();
        let ms = Duration::from_millis;
        let mut stages = Stages::begin(&now, budget_ms.map(ms), ms(reserved_ms));
        while stages.pages < 1000 && stages.begin_page() {
            stages.time(Stage::Link, || clock.set(clock.get() + ms(page_ms)));
        }
        let link_ms = stages.times().link_ms;
        assert!((link_ms - (stages.pages * page_ms) as f32).abs() < 0.1 + link_ms * 1e-4);
        stages.pages
    }

    #[test]
    fn a_budget_by_the_frame_is_half_of_what_the_rest_takes_within_limits() {
        let ms = Duration::from_millis;
        let of = |beside| Budget::ByFrame.time(ms(beside));
        assert_eq!([0, 2, 16].map(of), [Some(Budget::LEAST); 3]);
        assert_eq!(of(158), Some(ms(79)));
        assert_eq!([250, 5000].map(of), [Some(Budget::MOST); 2]);
        assert_eq!(Budget::Fixed(ms(3)).time(ms(158)), Some(ms(3)));
        assert_eq!(Budget::None.time(ms(158)), None);
    }

    #[test]
    fn pages_are_begun_while_there_is_time_and_one_in_any_case() {
        assert_eq!(begun(Some(10), 0, 2), 5);
        assert_eq!(begun(Some(10), 7, 2), 2);
        assert_eq!(begun(Some(10), 50, 2), 2);
        assert_eq!(begun(Some(4), 4, 2), 1);
        assert_eq!(begun(Some(0), 0, 2), 1);
        assert_eq!(begun(Some(u64::MAX), 0, 2), 1000);
        assert_eq!(begun(None, 50, 2), 1000);
    }
}
