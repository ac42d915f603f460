//! Units, distances of samples and coordinates from one end of what is allowed to the other.

use super::stage::{Found, examine, over_meshers, view, views};
use super::{Case, Outcome, Verdict};
use crate::terrain::{FunctionSource, TempDataset, hash, hills};
use escarp_client::render::EyeFrame;
use escarp_proto::georef::{Georef, Plane};
use escarp_proto::page::MAX_HEIGHT;
use escarp_tiles::build::Quantum;
use escarp_tiles::dem::SampleType;

const MESH: &str = "no crack, converges, deviation within the tolerance, buffers in order";
const SIDE: u32 = 77;

/// All cases.
pub fn cases() -> Vec<Case> {
    let mut cases = vec![millimetres()];
    for quantum_m in [1e-9, 1e-3, 900.0] {
        let name = format!("a unit of height of {quantum_m:e} m, samples 10 m apart");
        cases.push(scaled(name, [10.0, 10.0], quantum_m, [1000.0, 2000.0]));
    }
    for spacing_m in [1e-9, 1e-3, 1e6, 1e9] {
        let name = format!("samples {spacing_m:e} m apart, heights in that unit or 900 m");
        cases.push(scaled(name, [spacing_m; 2], spacing_m.min(900.0), [0.0; 2]));
    }
    for spacing_m in [[1.0, 1e4], [1e4, 1.0], [1e-9, 1e9]] {
        let [dx, dy] = spacing_m;
        let name = format!("samples {dx:e} m apart to the east and {dy:e} m to the north");
        cases.push(scaled(name, spacing_m, 1.0, [0.0; 2]));
    }
    for far_m in [2e7, 1e10, 9.9e11] {
        let name = format!("an origin at {far_m:e} m, samples 10 m apart");
        cases.push(scaled(name, [10.0; 2], 1.0, [-far_m, far_m]));
    }
    cases.extend([
        refused_scales(),
        exaggerated(),
        without_relief(),
        promise_of_exaggerated(),
    ]);
    cases
}

/// Hills of a size that fits the spacing, in whole quanta.
fn dataset(spacing_m: [f64; 2], quantum_m: f64, origin_m: [f64; 2]) -> Result<TempDataset, String> {
    let wide = spacing_m[0].max(spacing_m[1]);
    // Neither a mere step nor more than fits the range.
    let units = (wide / 10.0 / quantum_m).clamp(1.0, f64::from(MAX_HEIGHT) / 500.0);
    let heights = move |x, y| (hills(x, y) * units).round() * quantum_m;
    let source = FunctionSource::spaced(SIDE, SIDE, spacing_m, heights);
    let mut source = source.with(|info| {
        info.sample_type = SampleType::F64;
        info.placement.x0 = origin_m[0];
        info.placement.y0 = origin_m[1] + f64::from(SIDE - 1) * spacing_m[1];
    });
    TempDataset::build_with(&mut source, Quantum::Metres(quantum_m))
        .map_err(|error| error.to_string())
}

fn scaled(name: String, spacing_m: [f64; 2], quantum_m: f64, origin_m: [f64; 2]) -> Case {
    Case::new(name, MESH, move || {
        let data = match dataset(spacing_m, quantum_m, origin_m) {
            Ok(data) => data,
            Err(why) => return Outcome::of(false, why),
        };
        over_meshers(|options| {
            let near = examine(&data, options, &views(&data, 1.0));
            near.and(examine(&data, options, &views(&data, 8.0)))
                .outcome()
        })
    })
}

/// From the deepest trench to the highest mountain, in millimetres.
fn millimetres() -> Case {
    Case::new(
        "heights from -11,000 to 9,000 m in steps of 1 mm",
        format!("{MESH}; every height is stored as given"),
        || {
            let height = |x, y| f64::from(hash(x, y) % 20_000_001) * 1e-3 - 11_000.0;
            let source = FunctionSource::new(SIDE, SIDE, height);
            let mut source = source.with(|info| info.sample_type = SampleType::F64);
            let data = TempDataset::build_with(&mut source, Quantum::Metres(1e-3));
            let data = data.unwrap_or_else(|error| panic!("{error}"));
            let stored = (0..SIDE).all(|y| {
                (0..SIDE).all(|x| {
                    let right = (height(x, SIDE - 1 - y) * 1e3).round() as i32;
                    data.sample(x, y) == Some(right)
                })
            });
            over_meshers(|options| {
                let mut found = examine(&data, options, &views(&data, 1.0));
                if !stored {
                    found.fault("a height is not stored as given");
                }
                found.outcome()
            })
        },
    )
}

/// What is beyond the range is refused with the range.
fn refused_scales() -> Case {
    Case::new(
        "scales beyond what is allowed",
        "refused, with what was found and what is allowed",
        || {
            let mut found = Found::default();
            let mut refused = 0;
            let tries = [
                ([10.0; 2], 1e-10, [0.0; 2]),
                ([10.0; 2], 1e10, [0.0; 2]),
                ([10.0; 2], f64::NAN, [0.0; 2]),
                ([10.0; 2], f64::INFINITY, [0.0; 2]),
                ([10.0; 2], 0.0, [0.0; 2]),
                ([10.0; 2], -1.0, [0.0; 2]),
                ([10.0; 2], f64::MIN_POSITIVE / 4.0, [0.0; 2]),
                ([1e-10, 1.0], 1.0, [0.0; 2]),
                ([1.0, 1e10], 1.0, [0.0; 2]),
                ([10.0; 2], 1.0, [1e12, 0.0]),
                ([10.0; 2], 1.0, [0.0, f64::NAN]),
                ([10.0; 2], 1.0, [f64::NEG_INFINITY, 0.0]),
                ([1e9; 2], 1e9, [9.99e11, 0.0]),
            ];
            for (spacing_m, quantum_m, origin_m) in tries {
                match dataset(spacing_m, quantum_m, origin_m) {
                    Err(why) if why.contains("allowed") => refused += 1,
                    Err(why) => found.fault(format!("says no range: {why}")),
                    Ok(_) => {
                        found.fault(format!("{spacing_m:?} {quantum_m} {origin_m:?} is taken"))
                    }
                }
            }
            found.outcome_with(format!("{refused} of {} refused so", tries.len()))
        },
    )
}

fn georef(quantum_m: f64) -> Georef {
    Georef {
        origin_m: [5e5, 5e6],
        sample_spacing_m: [30.0, 25.0],
        quantum_m,
        plane: Plane::Local,
    }
}

/// What decides where a vertex is drawn, but for the factor on normals.
fn placing(frame: &EyeFrame) -> impl PartialEq + use<> {
    (
        frame.cell,
        frame.height,
        frame.remainder_m.to_array(),
        frame.spacing_m.to_array(),
        frame.clip_from_eye().to_cols_array(),
    )
}

fn exaggerated() -> Case {
    Case::new(
        "heights drawn 1000 times as high",
        "every vertex is placed, to the bit, where input 1000 times as high is",
        || {
            let (mut same, mut tried) = (0, 0);
            for quantum_m in [1e-9, 1e-3, 0.1, 1.0, 1e6] {
                for z in [-1e6, -3.0, 0.0, 0.25, 1234.5, 1e9] {
                    let view = view([5.1e5, 5.01e6, z], [5.2e5, 5.02e6, 0.0], 1.0);
                    let drawn = EyeFrame::of(&view, &georef(quantum_m), 1000.0);
                    let scaled = EyeFrame::of(&view, &georef(quantum_m * 1000.0), 1.0);
                    tried += 1;
                    same += u32::from(placing(&drawn) == placing(&scaled));
                }
            }
            Outcome::of(same == tried, format!("{same} of {tried} frames"))
        },
    )
}

fn without_relief() -> Case {
    Case::new(
        "heights drawn 0 times as high",
        "every vertex is placed where flat input is",
        || {
            let mut found = Found::default();
            let mut tried = 0;
            for z in [-1e9, -3.0, 0.0, 0.25, 1234.5, 1e12] {
                let view = view([5.1e5, 5.01e6, z], [5.2e5, 5.02e6, 0.0], 1.0);
                let frame = EyeFrame::of(&view, &georef(0.1), 0.0);
                let flat = EyeFrame::of(&view, &georef(0.1), 1.0);
                for height in [-MAX_HEIGHT, -1, 0, 7, MAX_HEIGHT] {
                    tried += 1;
                    let drawn = super::numerics::place(&frame, [400, 400], height);
                    let right = super::numerics::place(&flat, [400, 400], 0);
                    let differs = f64::from(drawn[2]) - f64::from(right[2]);
                    if drawn[..2] != right[..2] || differs.abs() > z.abs() * 1e-6 {
                        found.fault(format!("{drawn:?} where {right:?} is right"));
                    }
                }
            }
            found.outcome_with(format!("{tried} vertices"))
        },
    )
}

fn promise_of_exaggerated() -> Case {
    Case::new(
        "the tolerance while heights are drawn 1000 times as high",
        "the deviation on the screen is within the tolerance",
        || Outcome {
            measured: "meshes are made for true heights".into(),
            verdict: Verdict::Bounded(
                "the exaggeration times the tolerance; the viewer says `at true heights` beside \
                 its figure"
                    .into(),
            ),
        },
    )
}
