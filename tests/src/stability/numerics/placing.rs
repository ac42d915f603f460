//! Where vertices are drawn, against where they are.

use super::setup::{Ranges, Setup, Worst};
use super::{Case, setup::Random};
use crate::stability::{Outcome, Verdict};

/// What is allowed on the screen, pixels.
const ALLOWED_PX: f64 = 0.1;
/// Setups of each row.
const SETUPS: usize = 20_000;
const DRAWN: &str = "in single precision at most 0.1 px from where exact numbers have it";

/// A picture of 1920 x 1080 px and 60 degrees, of the terrains that there are.
const USUAL: Ranges = Ranges {
    fov_y: std::f32::consts::FRAC_PI_3,
    viewport_px: [1920, 1080],
    spacing_m: [0.1, 100.0],
    distance_m: [0.2, 1e7],
    origin_m: 1e7,
    cells: 1e5,
};

/// All cases.
pub fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    let usual = [
        ("a vertex in a picture of 1920 x 1080 px, 60 degrees", USUAL),
        (
            "a vertex nearer than a hundredth of the distance of samples, which are 37 km apart",
            Ranges {
                spacing_m: [37_000.0, 37_000.1],
                distance_m: [0.1, 370.0],
                origin_m: 2e7,
                cells: 1080.0,
                ..USUAL
            },
        ),
        (
            "a vertex near the eye, samples 1 to 1e6 m apart",
            Ranges {
                spacing_m: [1.0, 1e6],
                distance_m: [0.1, 1e3],
                cells: 1e4,
                ..USUAL
            },
        ),
        (
            "a vertex at coordinates of the largest grids",
            Ranges {
                spacing_m: [1e-3, 3e3],
                cells: (1u64 << 28) as f64,
                origin_m: 1e11,
                distance_m: [1e3, 1e12],
                ..USUAL
            },
        ),
        (
            "a vertex in a picture of 32,768 px, 60 degrees",
            Ranges {
                viewport_px: [32_768, 32_768],
                ..USUAL
            },
        ),
        (
            "a vertex in a picture of 1080 px, 1 degree",
            Ranges {
                fov_y: std::f32::consts::PI / 180.0,
                ..USUAL
            },
        ),
        (
            "a vertex at the widest field of view",
            Ranges {
                fov_y: 3.0,
                ..USUAL
            },
        ),
    ];
    for (name, ranges) in usual {
        cases.push(Case::new(name, DRAWN, move || placed(ranges)));
    }
    let narrow = [
        (
            "a vertex in a picture of 1080 px at the narrowest field of view (0.06 degrees)",
            [1920, 1080],
        ),
        (
            "a vertex in a picture of 32,768 px at the narrowest field of view",
            [32_768, 32_768],
        ),
    ];
    for (name, viewport_px) in narrow {
        let ranges = Ranges {
            viewport_px,
            fov_y: 0.001,
            ..USUAL
        };
        cases.push(Case::new(name, DRAWN, move || placed(ranges)).known_to_fail(
            "positions are single-precision metres from the eye, and these pixels are finer than \
             its steps; two singles a coordinate, in the shaders, would mend it",
        ));
    }
    cases.extend([shared(), millimetres(), interpolated()]);
    cases
}

fn placed(ranges: Ranges) -> Outcome {
    let mut worst = Worst::default();
    for setup in ranges.setups(SETUPS, 7) {
        worst.add(setup.error_px(), setup);
    }
    let at = worst.at.as_ref();
    let slope = at.map_or(1.0, |setup| setup.view.px_per_slope());
    let measured = format!(
        "{} px at most, {:.1} x 2^-24 of the distance, of {} vertices; worst: {}",
        figure(worst.value),
        worst.value / slope * f64::from(1 << 24),
        worst.count,
        at.map_or(String::new(), Setup::describe)
    );
    let verdict = Verdict::of(
        worst.count > SETUPS / 2 && worst.value <= ALLOWED_PX,
        || format!("{} px", figure(worst.value)),
    );
    Outcome { measured, verdict }
}

pub(super) fn figure(value: f64) -> String {
    match value {
        0.0 => "0".into(),
        v if (0.01..1000.0).contains(&v) => format!("{v:.3}"),
        v => format!("{v:.1e}"),
    }
}

/// A vertex is the same bits in every page that has it, as only sums of integers go in.
fn shared() -> Case {
    Case::new(
        "a vertex that pages of all levels share",
        "the same bits, whichever page draws it",
        || {
            let mut same = 0;
            let mut tried = 0;
            for setup in USUAL.setups(2000, 11) {
                let frame = setup.frame();
                let [x, y] = setup.vertex;
                let right = super::place(&frame, [x, y], setup.height);
                for stride in [1u32, 2, 16, 256, 4096] {
                    for (column, row) in [(0u32, 0u32), (16, 0), (0, 16), (16, 16), (5, 11)] {
                        let (Some(x0), Some(y0)) =
                            (x.checked_sub(column * stride), y.checked_sub(row * stride))
                        else {
                            continue;
                        };
                        // As the shader has it: the page's corner from the eye's cell, then steps.
                        let [dx, dy] = frame.relative([x0, y0]);
                        let steps = [dx + (column * stride) as i32, dy + (row * stride) as i32];
                        let spacing = frame.spacing_m.to_array();
                        let remainder = frame.remainder_m.to_array();
                        let at =
                            [0, 1].map(|axis| steps[axis] as f32 * spacing[axis] - remainder[axis]);
                        tried += 1;
                        same += u32::from(at == right[..2]);
                    }
                }
            }
            Outcome::of(tried > 1000 && same == tried, format!("{same} of {tried}"))
        },
    )
}

/// The picture must move with the eye, not in steps of its own.
fn millimetres() -> Case {
    Case::new(
        "2000 steps of 1 mm at coordinates of 2e7 m, 2 to 20 m from a vertex",
        "the vertex moves on the screen as it should, to 0.1 px a step",
        || {
            let mut worst = Worst::default();
            let near = Ranges {
                distance_m: [2.0, 20.0],
                origin_m: 2e7,
                ..USUAL
            };
            let mut random = Random::new(3);
            for mut setup in near.setups(100, 5) {
                let way = random.direction();
                let mut last = None;
                for _ in 0..20 {
                    let off = {
                        let (found, right) = (setup.as_drawn(), setup.exactly());
                        [found[0] - right[0], found[1] - right[1]]
                    };
                    if let Some([x, y]) = last.replace(off) {
                        let jump: f64 = off[0] - x;
                        worst.add(jump.hypot(off[1] - y), setup.clone());
                    }
                    for (eye, step) in setup.view.eye_m.iter_mut().zip(way) {
                        *eye += step * 1e-3;
                    }
                }
            }
            let measured = format!(
                "off by at most {} px a step, of {} steps",
                figure(worst.value),
                worst.count
            );
            Outcome::of(worst.count >= 1000 && worst.value <= ALLOWED_PX, measured)
        },
    )
}

/// The middle of a large triangle close to the eye takes the errors of its far corners.
fn interpolated() -> Case {
    Case::new(
        "the ground in the middle of a triangle, as its corners' errors move it",
        "at most 0.1 px where the eye is farther than a thousandth of the triangle's size",
        || {
            let mut text = Vec::new();
            let mut far: f64 = 0.0;
            for share in [1e-1, 1e-2, 1e-3, 1e-4, 1e-5] {
                let mut worst: f64 = 0.0;
                let mut random = Random::new(23);
                for _ in 0..3000 {
                    worst = worst.max(ground_error_px(share, &mut random));
                }
                if share >= 1e-3 {
                    far = far.max(worst);
                }
                text.push(format!("{} px at {share:e}", figure(worst)));
            }
            let measured = format!("with the eye so many sizes over it: {}", text.join(", "));
            let verdict = match far <= ALLOWED_PX {
                true => Verdict::Bounded("single precision, 1e-7 of a triangle's size".into()),
                false => Verdict::Fails(format!("{} px", figure(far))),
            };
            Outcome { measured, verdict }
        },
    )
}

/// Error of a point in a triangle of 1 to 1000 cells' size, with the eye `share` sizes away, px.
fn ground_error_px(share: f64, random: &mut Random) -> f64 {
    let ranges = Ranges {
        distance_m: [1.0, 2.0],
        ..USUAL
    };
    let Some(mut setup) = ranges.setup(random) else {
        return 0.0;
    };
    let cells = random.decades(1.0, 1000.0) as u32;
    let [x, y] = setup.vertex;
    let size = f64::from(cells) * setup.georef.sample_spacing_m[0];
    let rise =
        |random: &mut Random| (random.within(-0.5, 0.5) * size / setup.georef.quantum_m) as i32;
    let corners = [(x, y), (x + cells, y), (x + cells, y + cells)].map(|at| (at, rise(random)));
    let mut weights = [0; 3].map(|_| random.within(0.1, 1.0));
    let sum: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|weight| *weight /= sum);
    let middle: [f64; 3] = std::array::from_fn(|axis| {
        let world = |i: usize| {
            setup
                .georef
                .world(corners[i].0.0, corners[i].0.1, corners[i].1)[axis]
        };
        (0..3).map(|i| weights[i] * world(i)).sum()
    });
    let way = setup.view.direction.map(f64::from);
    let length = way.iter().map(|v| v * v).sum::<f64>().sqrt();
    setup.view.eye_m = std::array::from_fn(|axis| middle[axis] - way[axis] / length * size * share);
    let frame = setup.frame();
    let (mut found, mut right) = ([0.0; 4], [0.0; 3]);
    for (weight, ((x, y), height)) in weights.into_iter().zip(corners) {
        let clip = super::clip(&frame, super::place(&frame, [x, y], height));
        (0..4).for_each(|i| found[i] += weight * f64::from(clip[i]));
        let corner = Setup {
            vertex: [x, y],
            height,
            ..setup.clone()
        }
        .from_eye();
        (0..3).for_each(|i| right[i] += weight * corner[i]);
    }
    let [x, y, _] = setup.on_screen(right);
    let [width, height] = setup.view.viewport_px.map(|px| f64::from(px) / 2.0);
    (found[0] / found[3] * width - x).hypot(found[1] / found[3] * height - y)
}
