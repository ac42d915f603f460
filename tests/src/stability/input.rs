//! Numbers that are none, and numbers beyond what is allowed.

use super::stage::{Found, examine, over_meshers, view, views};
use super::{Case, Outcome};
use crate::terrain::{FunctionSource, TempDataset, hash, hills};
use escarp_client::render::EyeFrame;
use escarp_proto::georef::{Georef, Plane};
use escarp_proto::view::{FIELDS_OF_VIEW, SCREEN_ERRORS_PX, VIEWPORT_PX, View};
use escarp_tiles::build::Quantum;
use escarp_tiles::dem::SampleType;

const SIDE: u32 = 77;

/// All cases.
pub fn cases() -> Vec<Case> {
    let mut cases = vec![not_numbers(), infinite_heights(), too_high(), tolerances()];
    cases.extend([
        views_refused(),
        views_clamped(),
        views_allowed(),
        exaggerations(),
    ]);
    cases
}

fn floats(heights: impl Fn(u32, u32) -> f64 + Send) -> Result<TempDataset, String> {
    let source = FunctionSource::new(SIDE, SIDE, heights);
    let mut source = source.with(|info| info.sample_type = SampleType::F64);
    let built = TempDataset::build_with(&mut source, Quantum::Metres(0.01));
    built.map_err(|error| error.to_string())
}

fn not_numbers() -> Case {
    Case::new(
        "NaN, as no data, in every third sample",
        "holes there and data elsewhere; the mesh holds",
        || {
            let is_hole = |x, y| hash(x, y).is_multiple_of(3);
            let height = move |x, y| if is_hole(x, y) { f64::NAN } else { hills(x, y) };
            let data = floats(height).unwrap_or_else(|why| panic!("{why}"));
            let holes = (0..SIDE).all(|y| {
                (0..SIDE).all(|x| data.sample(x, y).is_none() == is_hole(x, SIDE - 1 - y))
            });
            over_meshers(|options| {
                let mut found = examine(&data, options, &views(&data, 2.0));
                if !holes {
                    found.fault("holes are not where the input has them");
                }
                found.outcome()
            })
        },
    )
}

fn infinite_heights() -> Case {
    Case::new(
        "infinite heights",
        "refused, or holes; never a height",
        || {
            let mut found = Found::default();
            let mut said = Vec::new();
            for infinity in [f64::INFINITY, f64::NEG_INFINITY] {
                let height = move |x, y| {
                    if (x, y) == (30, 40) {
                        infinity
                    } else {
                        hills(x, y)
                    }
                };
                match floats(height) {
                    Err(why) if why.contains("allowed") || why.contains("inf") => {
                        said.push(format!("{infinity} is refused"));
                    }
                    Err(why) => found.fault(format!("does not say what was found: {why}")),
                    Ok(data) if data.sample(30, SIDE - 41).is_none() => {
                        said.push(format!("{infinity} is a hole"));
                    }
                    Ok(_) => found.fault(format!("{infinity} is a height")),
                }
            }
            found.outcome_with(said.join(", "))
        },
    )
}

fn too_high() -> Case {
    Case::new(
        "heights beyond 2^30 units, up to the largest number",
        "refused, with what was found and what is allowed",
        || {
            let mut found = Found::default();
            let heights = [10_737_418.25, -10_737_418.25, 1e12, -1e300, f64::MAX];
            for high in heights {
                let height = move |x, y| {
                    if (x, y) == (30, 40) {
                        high
                    } else {
                        hills(x, y)
                    }
                };
                match floats(height) {
                    Err(why) if why.contains("allowed") => {}
                    Err(why) => found.fault(format!("says no range: {why}")),
                    Ok(_) => found.fault(format!("{high} m is taken")),
                }
            }
            found.outcome_with(format!("{} heights", heights.len()))
        },
    )
}

fn usual() -> View {
    view([1400.0, 2300.0, 500.0], [1500.0, 2500.0, 0.0], 2.0)
}

fn check(change: impl FnOnce(&mut View)) -> Result<(), String> {
    let mut view = usual();
    change(&mut view);
    view.check().map_err(|error| error.to_string())
}

/// Each refused with a range.
fn refusals(tries: impl IntoIterator<Item = (String, Result<(), String>)>) -> Outcome {
    let mut found = Found::default();
    let mut count = 0;
    for (what, result) in tries {
        count += 1;
        match result {
            Err(why) if why.contains("allowed") => {}
            Err(why) => found.fault(format!("{what}: says no range: {why}")),
            Ok(()) => found.fault(format!("{what} is taken")),
        }
    }
    found.outcome_with(format!("{count} of them"))
}

const NO_NUMBERS: [f32; 3] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];

fn tolerances() -> Case {
    Case::new(
        "tolerances of 0, 1e-30, 1e30, NaN and infinity",
        "refused, with what was found and what is allowed",
        || {
            let [least, most] = SCREEN_ERRORS_PX;
            let beyond = [
                0.0,
                -0.0,
                -1.0,
                1e-30,
                1e30,
                least.next_down(),
                most.next_up(),
            ];
            refusals(beyond.into_iter().chain(NO_NUMBERS).map(|px| {
                let result = check(|view| view.max_screen_error_px = px);
                (format!("a tolerance of {px} px"), result)
            }))
        },
    )
}

fn views_refused() -> Case {
    Case::new(
        "views with a number that is none, or out of range, in any field",
        "refused, with what was found and what is allowed",
        || {
            let mut tries: Vec<(String, Result<(), String>)> = Vec::new();
            let mut add = |what: String, result| tries.push((what, result));
            for bad in NO_NUMBERS {
                for axis in 0..3 {
                    let what = |field| format!("{field} of {bad} along axis {axis}");
                    add(what("eye"), check(|view| view.eye_m[axis] = f64::from(bad)));
                    add(what("direction"), check(|view| view.direction[axis] = bad));
                    add(
                        what("velocity"),
                        check(|view| view.velocity_m_s[axis] = bad),
                    );
                }
                add(
                    format!("field of view of {bad}"),
                    check(|view| view.fov_y = bad),
                );
            }
            for far in [1e12f64.next_up(), -1e13, f64::MAX] {
                add(format!("eye of {far}"), check(|view| view.eye_m[2] = far));
            }
            for direction in [
                [0.0f32; 3],
                [f32::MIN_POSITIVE / 2.0, 0.0, 0.0],
                [f32::MAX; 3],
            ] {
                add(
                    format!("{direction:?}"),
                    check(|view| view.direction = direction),
                );
            }
            let [least, most] = FIELDS_OF_VIEW;
            for fov in [0.0, -1.0, least.next_down(), most.next_up(), f32::MAX] {
                add(
                    format!("field of view of {fov}"),
                    check(|view| view.fov_y = fov),
                );
            }
            for side in [0, VIEWPORT_PX[1] + 1, u32::MAX] {
                add(
                    format!("{side} px wide"),
                    check(|view| view.viewport_px[0] = side),
                );
                add(
                    format!("{side} px high"),
                    check(|view| view.viewport_px[1] = side),
                );
            }
            refusals(tries)
        },
    )
}

/// What a program does with a view that it was given: it goes on with the nearest allowed one.
fn views_clamped() -> Case {
    Case::new(
        "any bits as a view, clamped",
        "an allowed view, and a note for each field that was changed",
        || {
            let mut found = Found::default();
            let mut notes = 0;
            for n in 0..20_000 {
                let bits = |i: u32| match hash(n, i + 100) % 4 {
                    0 => [f32::NAN, f32::INFINITY, 0.0, f32::MIN_POSITIVE / 2.0]
                        [hash(n, i) as usize % 4],
                    _ => f32::from_bits(hash(n, i)),
                };
                let mut view = usual();
                view.eye_m = [1, 2, 3].map(|i| f64::from(bits(i)) * f64::from(bits(i + 20)));
                view.direction = [4, 5, 6].map(bits);
                view.velocity_m_s = [7, 8, 9].map(bits);
                view.fov_y = bits(10);
                view.viewport_px = [11, 12].map(|i| hash(n, i) >> (hash(n, i + 1) % 32));
                view.max_screen_error_px = bits(13);
                let (clamped, said) = view.clamped();
                notes += said.len();
                if clamped.check().is_err() {
                    found.fault(format!("{view:?} becomes {clamped:?}"));
                }
                if said.is_empty() && view.check().is_err() && view.direction == clamped.direction {
                    found.fault(format!("nothing is said of {view:?}"));
                }
            }
            found.outcome_with(format!("20000 views, {notes} notes"))
        },
    )
}

fn views_allowed() -> Case {
    Case::new(
        "the ends of every range of a view",
        "allowed, with a threshold that is a normal number",
        || {
            let mut found = Found::default();
            let mut range = [f64::INFINITY, 0.0f64];
            for fov_y in FIELDS_OF_VIEW {
                for side in VIEWPORT_PX {
                    for px in SCREEN_ERRORS_PX {
                        let mut view = usual();
                        view.fov_y = fov_y;
                        view.viewport_px = [side; 2];
                        view.max_screen_error_px = px;
                        let threshold = view.threshold();
                        range = [range[0].min(threshold), range[1].max(threshold)];
                        if view.check().is_err() || !threshold.is_normal() || threshold <= 0.0 {
                            found.fault(format!("{fov_y} {side} {px}: {threshold}"));
                        }
                    }
                }
            }
            let [least, most] = range;
            found.outcome_with(format!("thresholds from {least:.1e} to {most:.1e}"))
        },
    )
}

/// The frame is the last stop before a uniform buffer.
fn exaggerations() -> Case {
    Case::new(
        "exaggerations of NaN, infinity, below 0, and to the largest number",
        "no number of the frame, and no place of a vertex, is lost",
        || {
            let mut found = Found::default();
            let factors = [
                f32::NAN,
                f32::INFINITY,
                f32::NEG_INFINITY,
                -1.0,
                -0.0,
                0.0,
                1e-45,
                1e-30,
                1e3,
                1e30,
                f32::MAX,
            ];
            for factor in factors {
                for quantum_m in [1e-9, 1.0, 1e9] {
                    let georef = Georef {
                        origin_m: [0.0; 2],
                        sample_spacing_m: [10.0; 2],
                        quantum_m,
                        plane: Plane::Local,
                    };
                    let frame = EyeFrame::of(&usual(), &georef, factor);
                    let heights = [-1 << 30, 0, 1 << 30];
                    let places =
                        heights.map(|height| super::numerics::place(&frame, [9, 9], height));
                    let clip = |from_eye| super::numerics::clip(&frame, from_eye);
                    let clips = places.map(clip);
                    let finite = places
                        .iter()
                        .flatten()
                        .chain(clips.iter().flatten())
                        .all(|v| v.is_finite());
                    if !finite || !frame.exaggeration.is_finite() || frame.exaggeration < 0.0 {
                        found.fault(format!("x{factor}, {quantum_m:e} m a unit: {places:?}"));
                    }
                }
            }
            found.outcome_with(format!("{} factors at 3 units of height", factors.len()))
        },
    )
}
