//! What a request may cost, and how it ends if it costs more.

use crate::source::SourceError;
use escarp_proto::geometry::PageId;
use std::sync::atomic::{AtomicBool, Ordering};
use thiserror::Error;

/// What requests for heights may ask for. Each is checked before memory is taken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HeightLimits {
    /// Points of a batch.
    pub batch_points: usize,
    /// Samples of a profile.
    pub profile_samples: usize,
    /// Pages that one request reads, those without a record included.
    pub pages: u64,
    /// Squares of the quadtree that one line of sight passes.
    pub sight_steps: u64,
    /// Squares of the quadtree that all lines of one viewshed pass.
    pub viewshed_steps: u64,
    /// Pixels on a side of a viewshed.
    pub viewshed_side_px: u32,
    /// Samples of the terrain that a viewshed, or an overview, holds in memory.
    pub window_samples: u64,
    /// Pixels on a side of an overview.
    pub overview_side_px: u32,
    /// Requests computed at a time, viewsheds and overviews apart. More wait.
    pub requests: usize,
    /// Viewsheds and overviews computed at a time. More wait.
    pub images: usize,
    /// Requests that wait; more are refused with HTTP status 503.
    pub waiting: usize,
}

impl Default for HeightLimits {
    fn default() -> HeightLimits {
        HeightLimits {
            batch_points: 10_000,
            profile_samples: 10_000,
            pages: 100_000,
            sight_steps: 1_000_000,
            viewshed_steps: 400_000_000,
            viewshed_side_px: 1024,
            window_samples: 1 << 21,
            overview_side_px: 1024,
            requests: 4,
            images: 1,
            waiting: 64,
        }
    }
}

/// Why there is no answer.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum HeightError {
    /// A page that should be there cannot be read.
    #[error("page {page}: {why}")]
    Page {
        /// The page.
        page: PageId,
        /// What is wrong.
        why: String,
    },
    /// The request is not one that can be answered.
    #[error("{found}; allowed: {allowed}")]
    Usage {
        /// What was asked.
        found: String,
        /// What may be asked.
        allowed: String,
    },
    /// The answer would cost more than the server allows.
    #[error("this takes more than {most} {what}")]
    TooMuch {
        /// What there is too much of.
        what: &'static str,
        /// How much is allowed.
        most: u64,
    },
    /// Nobody waits for the answer.
    #[error("cancelled")]
    Cancelled,
}

impl HeightError {
    pub(super) fn damaged(page: PageId, error: &SourceError) -> HeightError {
        let why = error.to_string();
        HeightError::Page { page, why }
    }

    /// A request with one thing wrong in it.
    pub fn usage(found: impl Into<String>, allowed: impl Into<String>) -> HeightError {
        HeightError::Usage {
            found: found.into(),
            allowed: allowed.into(),
        }
    }
}

/// What is left of what a request may cost.
#[derive(Debug)]
pub struct Work<'a> {
    pages: [u64; 2],
    steps: [u64; 2],
    cancelled: &'a AtomicBool,
}

/// Steps between two looks at whether anybody waits.
const STEPS_A_LOOK: u64 = 1 << 16;

impl<'a> Work<'a> {
    /// So many pages and steps, until `cancelled` is set.
    pub fn new(pages: u64, steps: u64, cancelled: &'a AtomicBool) -> Work<'a> {
        Work {
            pages: [pages; 2],
            steps: [steps; 2],
            cancelled,
        }
    }

    /// One page more.
    pub(super) fn page(&mut self) -> Result<(), HeightError> {
        self.look()?;
        let [left, most] = &mut self.pages;
        *left = left.checked_sub(1).ok_or(HeightError::TooMuch {
            what: "pages of the storage tree",
            most: *most,
        })?;
        Ok(())
    }

    /// One square more of a line of sight.
    pub(super) fn step(&mut self) -> Result<(), HeightError> {
        let [left, most] = &mut self.steps;
        *left = left.checked_sub(1).ok_or(HeightError::TooMuch {
            what: "squares passed by lines of sight",
            most: *most,
        })?;
        if left.is_multiple_of(STEPS_A_LOOK) {
            self.look()?;
        }
        Ok(())
    }

    fn look(&self) -> Result<(), HeightError> {
        match self.cancelled.load(Ordering::Relaxed) {
            true => Err(HeightError::Cancelled),
            false => Ok(()),
        }
    }
}
