//! A dataset at a glance: a hillshade with a hypsometric tint, from coarse pages.

use super::window::Ground;
use super::{Frame, HeightError, HeightLimits, Pages, Window};

/// Direction to the light: from the north-west, 45 degrees up.
const LIGHT: [f64; 3] = [-0.5, 0.5, std::f64::consts::FRAC_1_SQRT_2];
/// Slopes are stretched until their root mean square is this, so that a plain and a range of
/// mountains both show their shapes.
const SLOPE: f64 = 0.7;
/// Never stretched by more than this: what is flat stays flat.
const MOST_STRETCH: f64 = 200.0;
/// Colours from the lowest to the highest ground: red, green, blue.
const TINT: [[f64; 3]; 5] = [
    [104.0, 138.0, 112.0],
    [163.0, 178.0, 128.0],
    [218.0, 203.0, 158.0],
    [180.0, 143.0, 112.0],
    [242.0, 239.0, 235.0],
];
/// The parts of the ground that are below and above all tints.
const OUTLIERS: f64 = 0.01;

/// A picture, row by row from the north-west.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Overview {
    /// Columns and rows of pixels.
    pub size_px: [u32; 2],
    /// Red, green, blue, alpha; transparent where no data is.
    pub rgba: Vec<u8>,
}

/// Draws a whole dataset, so many pixels wide, or less if it would be too high; as wide to high as
/// it lies in the world's plane.
///
/// # Errors
/// [`HeightError`] if the width is not allowed, or a page cannot be read.
pub fn overview(
    pages: &mut Pages<'_>,
    frame: &Frame,
    width_px: u32,
    limits: &HeightLimits,
) -> Result<Overview, HeightError> {
    let most = limits.overview_side_px;
    if !(1..=most).contains(&width_px) {
        let found = format!("width={width_px}");
        return Err(HeightError::usage(found, format!("1 to {most} pixels")));
    }
    let last = frame.samples().map(|n| f64::from(n - 1));
    let [dx, dy] = frame.spacing_m();
    let size_m = [last[0].max(1.0) * dx, last[1].max(1.0) * dy];
    let size_px = size_px(size_m, width_px, most);
    let cells = (last[0] / f64::from(size_px[0])).max(last[1] / f64::from(size_px[1]));
    let bits = cells.max(1.0).log2() as u8;
    let whole = last.map(|last| [0.0, last]);
    let levels = pages.manifest().grid_levels.get();
    let bits = Window::stride_bits(whole, bits, levels, limits.window_samples);
    // A stride that has few samples in each page reads many of them. A picture that is less sharp
    // is better than none.
    let grid = pages.manifest().grid_levels;
    let fits = |bits: &u8| Window::pages(whole, *bits, grid) <= limits.pages;
    let bits = (bits..levels).find(fits).unwrap_or(bits);
    let window = Window::read(pages, whole, bits, false)?;
    let quantum_m = pages.manifest().georef.quantum_m;
    let heights = heights(&window, last, size_px, quantum_m);
    let step_m = [0, 1].map(|axis: usize| size_m[axis] / f64::from(size_px[axis]));
    Ok(Overview {
        size_px,
        rgba: shaded(&heights, size_px, step_m),
    })
}

fn size_px([width_m, height_m]: [f64; 2], width_px: u32, most: u32) -> [u32; 2] {
    let height_px = f64::from(width_px) * height_m / width_m;
    let most_px = f64::from(most);
    let scale = (most_px / height_px).min(1.0);
    [f64::from(width_px) * scale, height_px * scale]
        .map(|side| (side.round() as u32).clamp(1, most))
}

/// Heights at the pixels' centres, metres.
fn heights(
    window: &Window,
    last: [f64; 2],
    [width, height]: [u32; 2],
    quantum_m: f64,
) -> Vec<Option<f64>> {
    let part = |pixel: u32, side: u32| (f64::from(pixel) + 0.5) / f64::from(side);
    let pixels = (0..height).flat_map(|row| (0..width).map(move |column| (column, row)));
    let at = |(column, row)| {
        let grid = [
            last[0] * part(column, width),
            last[1] * (1.0 - part(row, height)),
        ];
        match window.ground(grid) {
            Ground::Surface { height, .. } => Some(height * quantum_m),
            Ground::Nothing | Ground::Unclear => None,
        }
    };
    pixels.map(at).collect()
}

fn shaded(heights: &[Option<f64>], [width, height]: [u32; 2], step_m: [f64; 2]) -> Vec<u8> {
    let [width, height] = [width as usize, height as usize];
    let slopes: Vec<[f64; 2]> = (0..heights.len())
        .map(|at| slope(heights, at, [width, height], step_m))
        .collect();
    let squares = slopes.iter().map(|[x, y]| x * x + y * y);
    let there = heights.iter().flatten().count().max(1) as f64;
    let rms = (squares.sum::<f64>() / there).sqrt();
    let stretch = if rms > 0.0 {
        (SLOPE / rms).min(MOST_STRETCH)
    } else {
        1.0
    };
    let range = tinted(heights);
    let mut rgba = Vec::with_capacity(4 * heights.len());
    for (height, [x, y]) in heights.iter().zip(slopes) {
        let Some(height) = height else {
            rgba.extend([0; 4]);
            continue;
        };
        let normal = [-x * stretch, -y * stretch, 1.0];
        let length = normal.iter().map(|v| v * v).sum::<f64>().sqrt();
        let light = normal.iter().zip(LIGHT).map(|(n, l)| n * l).sum::<f64>() / length;
        // The light of the sky reaches what the sun does not.
        let shade = 0.35 + 0.92 * light.max(0.0);
        rgba.extend(tint(*height, range).map(|v| (v * shade).clamp(0.0, 255.0) as u8));
        rgba.push(255);
    }
    rgba
}

/// Rise to the east and to the north at a pixel, over the neighbours that there are.
fn slope(
    heights: &[Option<f64>],
    at: usize,
    [width, height]: [usize; 2],
    [dx, dy]: [f64; 2],
) -> [f64; 2] {
    let Some(here) = heights[at] else {
        return [0.0; 2];
    };
    let (column, row) = (at % width, at / width);
    let west = (column > 0).then(|| heights[at - 1]).flatten();
    let east = (column + 1 < width).then(|| heights[at + 1]).flatten();
    let north = (row > 0).then(|| heights[at - width]).flatten();
    let south = (row + 1 < height).then(|| heights[at + width]).flatten();
    let rise = |from: Option<f64>, to: Option<f64>, step: f64| {
        let steps = f64::from(u8::from(from.is_some()) + u8::from(to.is_some()));
        (to.unwrap_or(here) - from.unwrap_or(here)) / (steps.max(1.0) * step)
    };
    [rise(west, east, dx), rise(south, north, dy)]
}

/// The range of heights that the tints are spread over.
fn tinted(heights: &[Option<f64>]) -> [f64; 2] {
    let mut sorted: Vec<f64> = heights.iter().flatten().copied().collect();
    sorted.sort_by(f64::total_cmp);
    let at = |part: f64| {
        let last = sorted.len().saturating_sub(1) as f64;
        sorted.get((last * part) as usize).copied().unwrap_or(0.0)
    };
    [at(OUTLIERS), at(1.0 - OUTLIERS)]
}

fn tint(height: f64, [low, high]: [f64; 2]) -> [f64; 3] {
    let part = ((height - low) / (high - low).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    let steps = (TINT.len() - 1) as f64;
    let below = ((part * steps) as usize).min(TINT.len() - 2);
    let between = part * steps - below as f64;
    [0, 1, 2].map(|i: usize| TINT[below][i] * (1.0 - between) + TINT[below + 1][i] * between)
}
