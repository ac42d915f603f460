//! What an observer sees of the ground around.

use super::accuracy::metres_up;
use super::sight::{beside_last_samples, margin_bound_m};
use super::surface::found_at;
use super::walk::{Clearance, Goal, Line, follow};
use super::window::{Ground, Pyramid};
use super::{Curvature, Detail, Frame, GridPlace, HeightError, HeightLimits, Pages, Window};

/// What is asked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewshedRequest {
    /// Who looks.
    pub observer: GridPlace,
    /// How far around, metres in the world's plane.
    pub radius_m: f64,
    /// Heights of observer and targets above the ground, metres.
    pub above_ground_m: [f64; 2],
    /// Pixels on a side.
    pub side_px: u32,
    /// How the body's curvature counts.
    pub curvature: Curvature,
    /// How far samples may be apart, metres; the finest that fit into memory if absent.
    pub resolution_m: Option<f64>,
}

/// What is known of a pixel's centre.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Seen {
    /// Outside of the radius, or no data.
    Nothing,
    /// Hidden, whatever the heights are within their bounds.
    Hidden,
    /// Within the bounds it may be either; or data is missing between.
    Undecided,
    /// Visible, whatever the heights are within their bounds.
    Visible,
}

/// A picture of what is seen.
#[derive(Debug, Clone, PartialEq)]
pub struct Viewshed {
    /// Row by row from the north-west, [`ViewshedRequest::side_px`] a side.
    pub pixels: Vec<Seen>,
    /// Distance of the samples it was computed from, in grid cells.
    pub stride: u32,
    /// Height of the ground below the observer, metres.
    pub ground_m: f64,
    /// Bound of the error with which a line clears a sample of the finest surface, metres.
    pub error_m: f64,
    /// `[[west, east], [south, north]]` of the picture, in columns and rows of the grid.
    pub grid: [[f64; 2]; 2],
}

/// Computes a viewshed. `None` if there is no ground below the observer.
///
/// # Errors
/// [`HeightError`] if the request is not allowed, or costs more than is, or a page cannot be read.
pub fn viewshed(
    pages: &mut Pages<'_>,
    frame: &Frame,
    request: &ViewshedRequest,
    limits: &HeightLimits,
) -> Result<Option<Viewshed>, HeightError> {
    check(request, limits)?;
    let manifest = pages.manifest();
    let quantum_m = manifest.georef.quantum_m;
    let Some(ground) = found_at(pages, request.observer, Detail::Finest)? else {
        return Ok(None);
    };
    let spacing_m = frame.spacing_m();
    let centre = request.observer.grid();
    let around = [0, 1].map(|axis: usize| {
        let cells = request.radius_m / spacing_m[axis];
        [centre[axis] - cells, centre[axis] + cells]
    });
    let window = window(pages, frame, request, around, limits)?;
    let radius_bulge_m = request.curvature.bulge_m(manifest, request.radius_m)?;
    let scene = Scene {
        window: &window,
        frame,
        request,
        eye: ground.height + request.above_ground_m[0] / quantum_m,
        aim_above: request.above_ground_m[1] / quantum_m,
        radius_bulge: radius_bulge_m / quantum_m,
        need: margin_bound_m(manifest, frame, radius_bulge_m, request.radius_m) / quantum_m,
    };
    let mut pixels = Vec::with_capacity(request.side_px as usize * request.side_px as usize);
    let mut pyramid = Pyramid {
        window: &window,
        pages,
    };
    for row in 0..request.side_px {
        for column in 0..request.side_px {
            pixels.push(scene.pixel(&mut pyramid, [column, row])?);
        }
    }
    Ok(Some(Viewshed {
        pixels,
        stride: window.stride(),
        ground_m: ground.height * quantum_m,
        error_m: metres_up(scene.need, quantum_m),
        grid: around,
    }))
}

fn check(request: &ViewshedRequest, limits: &HeightLimits) -> Result<(), HeightError> {
    let most = limits.viewshed_side_px;
    if !(1..=most).contains(&request.side_px) {
        let found = format!("size={}", request.side_px);
        return Err(HeightError::usage(found, format!("1 to {most} pixels")));
    }
    if !(request.radius_m > 0.0 && request.radius_m.is_finite()) {
        let found = format!("radius={}", request.radius_m);
        return Err(HeightError::usage(found, "more than 0 metres"));
    }
    Ok(())
}

/// The terrain around, as fine as is asked and as fits.
fn window(
    pages: &mut Pages<'_>,
    frame: &Frame,
    request: &ViewshedRequest,
    around: [[f64; 2]; 2],
    limits: &HeightLimits,
) -> Result<Window, HeightError> {
    let samples = frame.samples();
    let rectangle = [0, 1].map(|axis: usize| {
        let last = f64::from(samples[axis] - 1);
        around[axis].map(|v| v.clamp(0.0, last))
    });
    let levels = pages.manifest().grid_levels.get();
    let [dx, dy] = frame.spacing_m();
    let fine = request.resolution_m.unwrap_or(0.0) / dx.max(dy);
    let wanted = (0..levels)
        .rev()
        .find(|bits| f64::from(1u32 << bits) <= fine);
    let most = limits.window_samples;
    let bits = Window::stride_bits(rectangle, wanted.unwrap_or(0), levels, most);
    Ok(Window::read(pages, rectangle, bits, true)?.with_tops())
}

struct Scene<'a> {
    window: &'a Window,
    frame: &'a Frame,
    request: &'a ViewshedRequest,
    /// In quanta, as all that follows.
    eye: f64,
    aim_above: f64,
    /// The bulge of a line as long as the radius.
    radius_bulge: f64,
    /// By how much a line must be clear, or blocked, to be surely so.
    need: f64,
}

impl Scene<'_> {
    fn pixel(
        &self,
        pyramid: &mut Pyramid<'_, '_, '_>,
        pixel: [u32; 2],
    ) -> Result<Seen, HeightError> {
        let [column, row] = pixel.map(|v| (f64::from(v) + 0.5) / f64::from(self.request.side_px));
        // East and north of the observer, in radii.
        let away = [2.0 * column - 1.0, 1.0 - 2.0 * row];
        let part = away[0].hypot(away[1]);
        if part > 1.0 {
            return Ok(Seen::Nothing);
        }
        let centre = self.request.observer.grid();
        let spacing_m = self.frame.spacing_m();
        let target = [0, 1]
            .map(|axis: usize| centre[axis] + away[axis] * self.request.radius_m / spacing_m[axis]);
        let Some(target) = self.frame.within(target) else {
            return Ok(Seen::Nothing);
        };
        let (ground, end_bound) = match self.window.ground(target.grid()) {
            Ground::Nothing => return Ok(Seen::Nothing),
            Ground::Unclear => return Ok(Seen::Undecided),
            Ground::Surface { height, bound } => (height, bound),
        };
        if target == self.request.observer {
            return Ok(Seen::Visible);
        }
        let ends = beside_last_samples([centre, target.grid()], self.frame.samples());
        let line = Line {
            ends: ends.map(|end| self.window.local(end)),
            heights: [self.eye, ground + self.aim_above],
            end_bound,
            bulge: self.radius_bulge * part * part,
        };
        let clearance = follow(pyramid, &line, Goal::Decide(self.need))?;
        Ok(self.judged(&clearance))
    }

    fn judged(&self, clearance: &Clearance) -> Seen {
        if clearance.upper < -self.need {
            Seen::Hidden
        } else if clearance.over_hole || clearance.lower <= self.need {
            Seen::Undecided
        } else {
            Seen::Visible
        }
    }
}
