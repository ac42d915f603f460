//! Which of two surfaces is in front.

use super::setup::{Random, Ranges, Setup};
use crate::stability::{Case, Outcome, Verdict};
use escarp_proto::georef::{Georef, Plane};

/// All cases.
pub fn cases() -> Vec<Case> {
    vec![order(), ends()]
}

/// Two vertices of a fine grid on one ray, and their depths.
fn pair(distance: f64, apart: f64, random: &mut Random) -> Option<[(f64, f32); 2]> {
    // A grid so fine that rounding to it does not matter, with the eye in its middle.
    let step = distance * 2e-8;
    let georef = Georef {
        origin_m: [-step * 2f64.powi(27); 2],
        sample_spacing_m: [step; 2],
        quantum_m: step,
        plane: Plane::Local,
    };
    let way = random.direction();
    let usual = Ranges {
        fov_y: 1.0,
        viewport_px: [1920, 1080],
        spacing_m: [1.0, 2.0],
        distance_m: [1.0, 2.0],
        origin_m: 0.0,
        cells: 1.0,
    };
    let mut setup = std::iter::repeat_with(|| usual.setup(random))
        .flatten()
        .next()?;
    setup.georef = georef;
    setup.view.eye_m = [0; 3].map(|_| random.within(-step, step));
    let aside = random.direction();
    setup.view.direction = std::array::from_fn(|i| (way[i] + aside[i] * 0.3) as f32);
    let at = |distance: f64| {
        let cell = |axis: usize| (way[axis] * distance / step + 2f64.powi(27)).round() as u32;
        let height = (way[2] * distance / step).round() as i32;
        let placed = Setup {
            vertex: [cell(0), cell(1)],
            height,
            ..setup.clone()
        };
        let frame = placed.frame();
        let clip = super::clip(&frame, super::place(&frame, placed.vertex, height));
        (placed.exactly()[2], clip[2] / clip[3])
    };
    let found = [at(distance), at(distance * (1.0 + apart))];
    found
        .iter()
        .all(|(ahead, _)| *ahead > distance * 0.5)
        .then_some(found)
}

/// Whether the nearer one is in front in all of many pairs.
fn is_ordered(distance: f64, apart: f64) -> bool {
    let mut random = Random::new(17);
    (0..400)
        .filter_map(|_| pair(distance, apart, &mut random))
        .all(|[near, far]| near.1 > far.1)
}

fn order() -> Case {
    Case::new(
        "two surfaces one behind the other, 1 m to 10,000 km away",
        "the nearer one hides the other if they are a millionth of their distance apart",
        || {
            let mut text = Vec::new();
            let mut worst: f64 = 0.0;
            for decade in 0..=7 {
                let distance = 10f64.powi(decade);
                let least = (10..30)
                    .map(|k| 0.5f64.powi(k))
                    .take_while(|apart| is_ordered(distance, *apart));
                let least = least.last().unwrap_or(f64::INFINITY);
                worst = worst.max(least);
                text.push(format!("{:.1e} m at {distance:e} m", least * distance));
            }
            let measured = format!("told apart from {}", text.join(", "));
            Outcome {
                measured,
                verdict: Verdict::of(worst <= 1e-6, || format!("{worst:e} of the distance")),
            }
        },
    )
}

fn ends() -> Case {
    Case::new(
        "depth at the nearest and the farthest, samples 1e-9 to 1e9 m apart",
        "above 0, at most 1, falls with distance, and is a normal number",
        || {
            let mut tried = 0;
            let mut wrong = 0;
            for decade in -9..=9 {
                let spacing = 10f64.powi(decade);
                let usual = Ranges {
                    fov_y: 1.0,
                    viewport_px: [1920, 1080],
                    spacing_m: [spacing, spacing * 1.001],
                    distance_m: [1.0, 2.0],
                    origin_m: 0.0,
                    cells: 100.0,
                };
                let mut random = Random::new(29);
                let Some(setup) = std::iter::repeat_with(|| usual.setup(&mut random))
                    .take(500)
                    .flatten()
                    .next()
                else {
                    continue;
                };
                // On a sample, so that nothing is to be given back for the remainder.
                let (mut setup, [x, y]) = (setup.clone(), setup.vertex);
                setup.view.eye_m = setup.georef.world(x, y, setup.height);
                let frame = setup.frame();
                let near = frame.clip_from_eye().to_cols_array()[14];
                let mut last = f32::INFINITY;
                for power in 0..60 {
                    let ahead = near * 2f32.powi(power);
                    if f64::from(ahead) > 1e13 {
                        break;
                    }
                    let from_eye = frame.forward.to_array().map(|v| v as f32 * ahead);
                    let clip = super::clip(&frame, from_eye);
                    let depth = clip[2] / clip[3];
                    tried += 1;
                    let right =
                        depth > 0.0 && depth <= 1.0 + 1e-6 && depth < last && depth.is_normal();
                    wrong += u32::from(!right);
                    last = depth;
                }
            }
            Outcome::of(
                tried > 500 && wrong == 0,
                format!("{wrong} of {tried} are not"),
            )
        },
    )
}
