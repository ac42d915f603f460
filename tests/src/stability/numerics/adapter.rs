//! What the graphics adapter at hand makes of the same formulas.

use super::setup::{Ranges, Worst};
use super::{Case, clip, place};
use crate::stability::numerics::placing::figure;
use crate::stability::{Outcome, Verdict};
use escarp_client::render::{DrawParams, Gpu, ProbePage, probe};

/// All cases.
pub fn cases() -> Vec<Case> {
    vec![Case::new(
        "the shader's place() and its projection, on the adapter at hand",
        "places are the bits that the processor computes; clip coordinates within 8 x 2^-24 of their parts",
        on_adapter,
    )]
}

fn on_adapter() -> Outcome {
    let gpu = match Gpu::headless() {
        Ok(gpu) => gpu,
        Err(error) => {
            return Outcome {
                measured: error.to_string(),
                verdict: Verdict::Bounded("nothing: there is no graphics adapter here".into()),
            };
        }
    };
    let (mut same, mut tried) = (0, 0);
    let mut worst = Worst::default();
    for (i, ranges) in RANGES.into_iter().enumerate() {
        for setup in ranges.setups(12, 97 + i as u32) {
            let [x, y] = setup.vertex;
            let pages = [1u32, 16, 4096].map(|stride| ProbePage {
                origin: [x - x % (16 * stride), y - y % (16 * stride)],
                stride,
                height: setup.height,
            });
            let params = DrawParams::new(setup.view);
            let found = match probe(&gpu, &setup.georef, &params, &pages) {
                Ok(found) => found,
                Err(error) => return Outcome::of(false, error.to_string()),
            };
            let frame = setup.frame();
            for (k, vertex) in found.iter().enumerate() {
                let (page, k) = (pages[k / 289], k as u32 % 289);
                let at = [
                    page.origin[0] + k % 17 * page.stride,
                    page.origin[1] + k / 17 * page.stride,
                ];
                let right = place(&frame, at, page.height);
                tried += 1;
                same += u32::from(vertex.from_eye.map(f32::to_bits) == right.map(f32::to_bits));
                let right = clip(&frame, right);
                let m = frame.clip_from_eye().to_cols_array_2d();
                for row in 0..4 {
                    let parts = (0..3)
                        .map(|c| (m[c][row] * vertex.from_eye[c]).abs())
                        .fold(0.0, f32::max);
                    let off = (vertex.clip[row] - right[row]).abs() / parts.max(m[3][row].abs());
                    if off != 0.0 {
                        worst.add(f64::from(off) * f64::from(1 << 24), ());
                    }
                }
            }
        }
    }
    let measured = format!(
        "{}: {same} of {tried} places the same; clip off by at most {} x 2^-24",
        gpu.describe(),
        figure(worst.value)
    );
    Outcome::of(
        same == tried && tried > 10_000 && worst.value <= 8.0,
        measured,
    )
}

const RANGES: [Ranges; 2] = [
    Ranges {
        fov_y: 1.0,
        viewport_px: [1920, 1080],
        spacing_m: [0.1, 100.0],
        distance_m: [1.0, 1e6],
        origin_m: 1e7,
        cells: 1e5,
    },
    Ranges {
        fov_y: 0.5,
        viewport_px: [1920, 1080],
        spacing_m: [1e-3, 3e3],
        distance_m: [1e3, 1e12],
        origin_m: 1e11,
        cells: 2.5e8,
    },
];
