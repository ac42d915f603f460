//! Lines of sight.

use super::accuracy::sum_up;
use super::pages::Pages;
use super::surface::{Cell, found_at, rises};
use super::walk::{Clearance, Goal, Line, Relief, Top, follow};
use super::{Accuracy, Detail, Frame, GridPlace, HeightError};
use escarp_proto::geometry::{PAGE_LEVELS, PageId};
use escarp_proto::manifest::Manifest;
use escarp_proto::page::{Bounds, Kind, Page};
use escarp_tiles::crs::Projection;
use escarp_tiles::crs::extent::crs_of;
use std::sync::Arc;

/// How the body's curvature counts.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Curvature {
    /// Not at all: the world is a plane, as in the viewer.
    #[default]
    Flat,
    /// The ground falls away from the line's plane; light is bent by this part of the curvature.
    Round {
        /// Coefficient of refraction, 0 to below 1; about 0.13 for light on Earth.
        refraction: f64,
    },
}

impl Curvature {
    /// What the ground rises between two ends so far apart, as [`Line::bulge`], metres.
    pub(super) fn bulge_m(self, manifest: &Manifest, length_m: f64) -> Result<f64, HeightError> {
        let Curvature::Round { refraction } = self else {
            return Ok(0.0);
        };
        if !(0.0..1.0).contains(&refraction) {
            let found = format!("refraction={refraction}");
            return Err(HeightError::usage(found, "0 to below 1"));
        }
        let projection = Projection::of(&crs_of(&manifest.georef.plane));
        let projection = projection.map_err(|why| {
            let found = format!("curvature of a body that is not known: {why}");
            HeightError::usage(found, "curvature=off")
        })?;
        let [radius_m, _] = projection.axes_m();
        Ok(length_m * length_m * (1.0 - refraction) / (2.0 * radius_m))
    }
}

/// The two ends of a line of sight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SightEnds {
    /// Who looks.
    pub observer: GridPlace,
    /// What is looked at.
    pub target: GridPlace,
    /// Their heights above the ground, metres.
    pub above_ground_m: [f64; 2],
    /// How the body's curvature counts.
    pub curvature: Curvature,
}

/// What is known of a line of sight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Visible, whatever the heights are within their bounds.
    Visible,
    /// Hidden, whatever the heights are within their bounds.
    Hidden,
    /// Within the bounds it may be either, or the line passes over a place without data.
    Undecided,
}

/// A line of sight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sight {
    /// Whether the target is visible within the bounds.
    pub verdict: Verdict,
    /// Whether it is on the stored surface; `None` where data is missing under a line that is not
    /// blocked elsewhere.
    pub visible: Option<bool>,
    /// Heights of the ground at both ends, metres.
    pub ground_m: [f64; 2],
    /// Length in the world's plane, metres.
    pub length_m: f64,
    /// The least height of the line above the surface between its ends, metres; `None` if it
    /// crosses no side of a triangle.
    pub margin_m: Option<f64>,
    /// Bound of the margin's error, metres, rounded up.
    pub margin_error_m: f64,
    /// Where the least margin is, from 0 to 1 on the line.
    pub margin_at: f64,
    /// Where the line first meets the surface.
    pub blocked_at: Option<f64>,
    /// Whether the line passes over a place without data.
    pub over_hole: bool,
}

/// Whether a target can be seen. `None` if there is no ground at one of the ends.
///
/// # Errors
/// [`HeightError`] if a page cannot be read, or the line passes more than is allowed.
pub fn sight(
    pages: &mut Pages<'_>,
    frame: &Frame,
    ends: &SightEnds,
) -> Result<Option<Sight>, HeightError> {
    let manifest = pages.manifest();
    let quantum_m = manifest.georef.quantum_m;
    let places = [ends.observer, ends.target];
    let mut ground = [0.0; 2];
    for (ground, place) in ground.iter_mut().zip(places) {
        match found_at(pages, place, Detail::Finest)? {
            Some(found) => *ground = found.height,
            None => return Ok(None),
        }
    }
    let places = beside_last_samples(places.map(GridPlace::grid), frame.samples());
    let length_m = frame.distance_m(places[0], places[1]);
    let bulge_m = ends.curvature.bulge_m(manifest, length_m)?;
    let above = ends.above_ground_m.map(|metres| metres / quantum_m);
    let line = Line {
        ends: places,
        heights: [ground[0] + above[0], ground[1] + above[1]],
        end_bound: 0.0,
        bulge: bulge_m / quantum_m,
    };
    let clearance = match length_m {
        0.0 => None,
        _ => Some(follow(&mut Tree::new(pages), &line, Goal::Least)?),
    };
    let bound_m = margin_bound_m(manifest, frame, bulge_m, length_m);
    let mut found = summary(ground, clearance, length_m, bound_m, quantum_m);
    found.bury(ends.above_ground_m);
    Ok(Some(found))
}

impl Sight {
    /// Nothing is seen from below the ground, nor below it, even if no triangle's side is between.
    fn bury(&mut self, above_ground_m: [f64; 2]) {
        for (end, height_m) in above_ground_m.into_iter().enumerate() {
            if height_m >= 0.0 {
                continue;
            }
            self.verdict = Verdict::Hidden;
            self.visible = Some(false);
            self.blocked_at.get_or_insert(end as f64);
            if self.margin_m.is_none_or(|margin_m| height_m < margin_m) {
                self.margin_m = Some(height_m);
                self.margin_at = end as f64;
            }
        }
    }
}

fn summary(
    ground: [f64; 2],
    clearance: Option<Clearance>,
    length_m: f64,
    margin_error_m: f64,
    quantum_m: f64,
) -> Sight {
    let margin_m = clearance
        .map(|clearance| clearance.least * quantum_m)
        .filter(|margin| margin.is_finite());
    let over_hole = clearance.is_some_and(|clearance| clearance.over_hole);
    let is_clear = margin_m.is_none_or(|margin| margin >= 0.0);
    let verdict = match margin_m {
        Some(margin) if margin < -margin_error_m => Verdict::Hidden,
        _ if over_hole => Verdict::Undecided,
        Some(margin) if margin <= margin_error_m => Verdict::Undecided,
        _ => Verdict::Visible,
    };
    Sight {
        verdict,
        visible: (!is_clear || !over_hole).then_some(is_clear),
        ground_m: ground.map(|height| height * quantum_m),
        length_m,
        margin_m,
        margin_error_m,
        margin_at: clearance.map_or(0.0, |clearance| clearance.at),
        blocked_at: clearance.and_then(|clearance| clearance.blocked),
        over_hole,
    }
}

/// A line along the last column or row of samples has its cells before it, not behind.
pub(super) fn beside_last_samples(mut ends: [[f64; 2]; 2], samples: [u32; 2]) -> [[f64; 2]; 2] {
    for axis in 0..2 {
        let last = f64::from(samples[axis] - 1);
        if ends.iter().all(|end| end[axis] == last) && last > 0.0 {
            for end in &mut ends {
                end[axis] = last.next_down();
            }
        }
    }
    ends
}

/// Bound of a margin's error: line and surface may both be off by the bound of a height; what the
/// curvature makes of one cell, of the error of the line's length, and of rounding is added.
pub(super) fn margin_bound_m(
    manifest: &Manifest,
    frame: &Frame,
    bulge_m: f64,
    length_m: f64,
) -> f64 {
    let accuracy = Accuracy::of(manifest);
    let scale = accuracy.scale_percent.unwrap_or(0.0) / 100.0;
    let [dx, dy] = frame.spacing_m();
    let cell = if length_m > 0.0 {
        (dx.hypot(dy) / length_m).min(1.0)
    } else {
        0.0
    };
    let curved = bulge_m / 4.0 * (scale * (2.0 + scale) + cell * cell);
    let highest = manifest
        .height_range
        .map_or(0, |[lo, hi]| lo.abs().max(hi.abs()));
    let rounding = (f64::from(highest) * manifest.georef.quantum_m + bulge_m) * 64.0 * f64::EPSILON;
    sum_up(sum_up(2.0 * accuracy.finest_m(), curved), rounding)
}

/// A page, and what is known of its squares.
type Known = (Arc<Page>, Bounds);

/// The storage tree as a quadtree of squares.
pub(super) struct Tree<'p, 'a> {
    pages: &'p mut Pages<'a>,
    /// By level: the page last looked into.
    known: Vec<Option<Known>>,
}

impl<'p, 'a> Tree<'p, 'a> {
    pub fn new(pages: &'p mut Pages<'a>) -> Tree<'p, 'a> {
        let levels = usize::from(pages.grid().get() / PAGE_LEVELS);
        Tree {
            pages,
            known: vec![None; levels],
        }
    }

    /// The page in which a square of a level hangs, and the square's place in it.
    fn page_of(
        &mut self,
        level: u8,
        square: [u32; 2],
    ) -> Result<(&Known, [usize; 2]), HeightError> {
        let number = (level - 1) / PAGE_LEVELS;
        let inside = level - number * PAGE_LEVELS;
        let [x, y] = square.map(|v| v >> inside);
        let id = PageId::new(number * PAGE_LEVELS, x, y).unwrap_or(PageId::ROOT);
        let last = &mut self.known[usize::from(number)];
        let known = match last.take() {
            Some(known) if known.0.id() == id => known,
            _ => {
                let page = self.pages.page(id)?;
                let bounds = Bounds::derive(&page, None);
                (page, bounds)
            }
        };
        let place = square.map(|v| v as usize & ((1 << inside) - 1));
        Ok((last.insert(known), place))
    }
}

impl Relief for Tree<'_, '_> {
    fn levels(&self) -> u8 {
        self.pages.grid().get()
    }

    fn top(&mut self, above: u8, square: [u32; 2]) -> Result<Top, HeightError> {
        let level = self.levels() - above;
        if level == 0 {
            return Ok(Top {
                highest: f64::INFINITY,
                whole: false,
            });
        }
        let ((_, bounds), [column, row]) = self.page_of(level, square)?;
        let inside = (level - 1) % PAGE_LEVELS + 1;
        let told = bounds.box_error(inside, column, row);
        Ok(Top {
            highest: match told.kind {
                Kind::Empty => f64::NEG_INFINITY,
                _ => f64::from(told.range.hi),
            },
            whole: told.kind == Kind::Full,
        })
    }

    fn cell(&mut self, square: [u32; 2]) -> Result<Cell, HeightError> {
        let ((page, _), [column, row]) = self.page_of(self.levels(), square)?;
        Ok(Cell::of(page, column, row, rises(square)))
    }

    fn step(&mut self) -> Result<(), HeightError> {
        self.pages.work.step()
    }
}
