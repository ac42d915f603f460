//! How far each result moves when one of its inputs moves by one unit in the last place.

use super::placing::figure;
use super::setup::{Random, Ranges, Setup, Worst};
use crate::stability::{Case, Outcome, Verdict};
use escarp_client::render::EyeFrame;
use escarp_proto::georef::WorldBox;

/// Setups of each row.
const SETUPS: usize = 2000;

const USUAL: Ranges = Ranges {
    fov_y: std::f32::consts::FRAC_PI_3,
    viewport_px: [1920, 1080],
    spacing_m: [0.1, 100.0],
    distance_m: [1.0, 1e7],
    origin_m: 1e7,
    cells: 1e5,
};

/// An input, and how to move it up by one unit in the last place.
type Input = (&'static str, fn(&mut Setup));

const INPUTS: [Input; 9] = [
    ("eye x (f64)", |s| {
        s.view.eye_m[0] = s.view.eye_m[0].next_up()
    }),
    ("eye z (f64)", |s| {
        s.view.eye_m[2] = s.view.eye_m[2].next_up()
    }),
    ("direction x (f32)", |s| {
        s.view.direction[0] = s.view.direction[0].next_up()
    }),
    ("direction z (f32)", |s| {
        s.view.direction[2] = s.view.direction[2].next_up()
    }),
    ("field of view (f32)", |s| {
        s.view.fov_y = s.view.fov_y.next_up()
    }),
    ("origin (f64)", |s| {
        s.georef.origin_m[0] = s.georef.origin_m[0].next_up()
    }),
    ("spacing (f64)", |s| {
        s.georef.sample_spacing_m[0] = s.georef.sample_spacing_m[0].next_up()
    }),
    ("quantum (f64)", |s| {
        s.georef.quantum_m = s.georef.quantum_m.next_up()
    }),
    ("height (1 quantum)", |s| s.height += 1),
];

/// All cases.
pub fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    let narrow = Ranges {
        fov_y: 0.0011,
        ..USUAL
    };
    for (name, ranges) in [
        ("1920 x 1080 px, 60 degrees", USUAL),
        ("1920 x 1080 px, 0.063 degrees", narrow),
    ] {
        for input in INPUTS {
            cases.push(on_screen(name, ranges, input));
        }
    }
    cases.extend([basis(), threshold(), distance()]);
    cases
}

/// What one unit of an input moves a vertex on the screen, exactly.
fn on_screen(name: &str, ranges: Ranges, (input, change): Input) -> Case {
    let is_height = input.starts_with("height");
    let must = match is_height {
        true => "what a quantum is worth at that distance",
        false => "less than 0.1 px",
    };
    Case::new(
        format!("place on the screen, {name}: {input}"),
        must,
        move || {
            let (mut worst, mut share): (Worst<Setup>, f64) = (Worst::default(), 0.0);
            for setup in ranges.setups(SETUPS, 71) {
                let mut moved = setup.clone();
                change(&mut moved);
                if moved.view.check().is_err() {
                    continue;
                }
                let (from, to) = (setup.exactly(), moved.exactly());
                let px = (to[0] - from[0]).hypot(to[1] - from[1]);
                if is_height {
                    share = share
                        .max(px * from[2] / setup.georef.quantum_m / setup.view.px_per_slope());
                }
                worst.add(px, setup);
            }
            let at = worst.at.as_ref().map_or(String::new(), Setup::describe);
            let measured = match is_height {
                true => format!("{share:.2} times a quantum over the distance ahead"),
                false => format!("{} px at most; worst: {at}", figure(worst.value)),
            };
            let verdict = match (is_height, worst.value <= 0.1) {
            (true, _) if share < 2.0 => Verdict::Holds,
            (false, true) => Verdict::Holds,
            // What an input cannot say finer is no fault of the formula.
            (false, false) if input.contains("f32") => Verdict::Bounded(
                "the last place of the input in single precision, as the protocol has it; the whole picture moves as one".into(),
            ),
            _ => Verdict::Fails(format!("{} px", figure(worst.value))),
        };
            Outcome { measured, verdict }
        },
    )
}

fn turned(a: &EyeFrame, b: &EyeFrame) -> f64 {
    let angle = |a: [f64; 3], b: [f64; 3]| {
        (0..3)
            .map(|i| (a[i] - b[i]) * (a[i] - b[i]))
            .sum::<f64>()
            .sqrt()
    };
    angle(a.right.to_array(), b.right.to_array()).max(angle(a.up.to_array(), b.up.to_array()))
}

/// A level picture has no right and left when one looks straight down.
fn basis() -> Case {
    Case::new(
        "turn of the picture about its middle: direction (f32)",
        "below a thousandth of a radian as far down as the viewer looks (89.5 degrees)",
        || {
            let mut text = Vec::new();
            let mut usual: f64 = 0.0;
            for exponent in 0..=7 {
                let tilt = 10f64.powi(-exponent);
                let mut random = Random::new(73);
                let mut worst: f64 = 0.0;
                for setup in USUAL.setups(200, 79) {
                    let turn = random.within(0.0, std::f64::consts::TAU);
                    let mut setup = setup;
                    setup.view.direction =
                        [turn.cos() * tilt, turn.sin() * tilt, -1.0].map(|v| v as f32);
                    let before = setup.frame();
                    for axis in 0..3 {
                        let mut moved = setup.clone();
                        let v = &mut moved.view.direction[axis];
                        *v = v.next_up();
                        worst = worst.max(turned(&before, &moved.frame()));
                    }
                }
                if tilt >= 0.5f64.to_radians() {
                    usual = usual.max(worst);
                }
                text.push(format!("{} at 1e-{exponent}", figure(worst)));
            }
            let measured = format!(
                "radians, by the direction's share that is level: {}",
                text.join(", ")
            );
            let verdict = match usual < 1e-3 {
                true => Verdict::Bounded(
                    "1e-7 over that share; below 1e-6 the picture is north up, so there it leaps once".into(),
                ),
                false => Verdict::Fails(format!("{} radians", figure(usual))),
            };
            Outcome { measured, verdict }
        },
    )
}

fn threshold() -> Case {
    Case::new(
        "threshold: field of view (f32), tolerance (f32)",
        "moves by at most 30 times as much, relative",
        || {
            let mut random = Random::new(83);
            let mut worst = Worst::default();
            let base = USUAL.setups(1, 1).next();
            let Some(base) = base else {
                return Outcome::of(false, "no view");
            };
            for _ in 0..20_000 {
                let mut view = base.view;
                view.fov_y = random.decades(0.001, 2.999) as f32;
                view.max_screen_error_px = random.decades(0.05, 1000.0) as f32;
                let before = view.threshold();
                let mut fov = view;
                fov.fov_y = fov.fov_y.next_up();
                let mut px = view;
                px.max_screen_error_px = px.max_screen_error_px.next_up();
                let step = |from: f32, to: f32| f64::from(to - from) / f64::from(from);
                let moved = |after: f64| (after / before - 1.0).abs();
                worst.add(
                    moved(fov.threshold()) / step(view.fov_y, fov.fov_y),
                    view.fov_y,
                );
                worst.add(
                    moved(px.threshold()) / step(view.max_screen_error_px, px.max_screen_error_px),
                    view.fov_y,
                );
            }
            let measured = format!(
                "{:.1} times, at {:.3} radians",
                worst.value,
                worst.at.unwrap_or(0.0)
            );
            Outcome::of(worst.value <= 30.0, measured)
        },
    )
}

fn distance() -> Case {
    Case::new(
        "distance_m: eye and box (f64)",
        "moves by no more than its input, and one rounding",
        || {
            let mut random = Random::new(89);
            let mut worst = Worst::default();
            for _ in 0..50_000 {
                let scale = random.decades(1e-3, 1e12);
                let mut at = || [0; 3].map(|_| random.within(-scale, scale));
                let (a, b, eye) = (at(), at(), at());
                let region = WorldBox {
                    min: std::array::from_fn(|i| a[i].min(b[i])),
                    max: std::array::from_fn(|i| a[i].max(b[i])),
                };
                let before = region.distance_m(eye);
                for axis in 0..3 {
                    let mut moved = eye;
                    moved[axis] = moved[axis].next_up();
                    let step = moved[axis] - eye[axis];
                    let change = (region.distance_m(moved) - before).abs();
                    let rounding = before.next_up() - before;
                    worst.add((change - rounding).max(0.0) / step, ());
                }
            }
            Outcome::of(
                worst.value <= 1.0,
                format!("{:.3} of the input's step at most", worst.value),
            )
        },
    )
}
