//! Eyes where they should not be, and views that nobody has.

use super::stage::{Found, examine, ground, over_meshers, view};
use super::{Case, Outcome};
use crate::feed::Feed;
use crate::terrain::{TempDataset, hash, hills};
use escarp_client::mesh::Frustum;
use escarp_client::render::EyeFrame;
use escarp_proto::georef::WorldBox;
use escarp_proto::view::{FIELDS_OF_VIEW, SCREEN_ERRORS_PX, VIEWPORT_PX, View};

const MESH: &str = "no crack, converges, deviation within the tolerance, buffers in order";
const SIDE: u32 = 101;

fn data() -> TempDataset {
    ground(SIDE, SIDE, hills)
}

/// World position of a sample, raised by some metres.
fn over_sample(data: &TempDataset, x: u32, y: u32, up_m: f64) -> [f64; 3] {
    let georef = &data.dataset.manifest().georef;
    let mut at = georef.world(x, y, data.sample(x, y).unwrap_or(0));
    at[2] += up_m;
    at
}

/// All cases.
pub fn cases() -> Vec<Case> {
    type Eye = fn(&TempDataset) -> [f64; 3];
    let eyes: [(&str, Eye); 12] = [
        ("eye exactly on a sample", |data| {
            over_sample(data, 37, 41, 0.0)
        }),
        ("eye exactly on a corner of pages", |data| {
            over_sample(data, 64, 48, 0.0)
        }),
        ("eye a nanometre over a sample", |data| {
            over_sample(data, 37, 41, 1e-9)
        }),
        ("eye on a seam of pages", |data| {
            over_sample(data, 48, 41, 0.5)
        }),
        ("eye on a corner of the grid", |data| {
            over_sample(data, 0, 0, 0.0)
        }),
        ("eye on the border of the data", |data| {
            over_sample(data, SIDE - 1, 50, 1.0)
        }),
        ("eye a kilometre beneath the ground", |data| {
            over_sample(data, 50, 50, -1000.0)
        }),
        ("eye far beneath the ground", |data| {
            over_sample(data, 50, 50, -1e9)
        }),
        ("eye at 1e12 m in every direction", |_| [1e12, -1e12, 1e12]),
        ("eye 1e12 m straight above", |_| [1500.0, 2500.0, 1e12]),
        ("eye at the smallest number that is not zero", |_| {
            [f64::MIN_POSITIVE / 8.0; 3]
        }),
        ("eye at minus zero", |_| [-0.0; 3]),
    ];
    let mut cases: Vec<Case> = eyes
        .map(|(name, eye)| {
            Case::new(name, MESH, move || {
                let data = data();
                let eye = eye(&data);
                let look = over_sample(&data, 60, 60, 0.0);
                let views = [1.0, 8.0].map(|error_px| view(eye, look, error_px));
                over_meshers(|options| examine(&data, options, &views).outcome())
            })
        })
        .into();
    cases.extend(views().map(|(name, change)| {
        Case::new(name, MESH, move || {
            let data = data();
            let look = over_sample(&data, 60, 60, 0.0);
            let mut views = [
                view([1400.0, 2300.0, 500.0], look, 2.0),
                view([1400.0, 2300.0, 90_000.0], look, 2.0),
            ];
            views.iter_mut().for_each(change);
            over_meshers(|options| examine(&data, options, &views).outcome())
        })
    }));
    cases.extend([velocity(), vertical(), never_culled()]);
    cases
}

type Change = fn(&mut View);

fn views() -> [(&'static str, Change); 15] {
    [
        ("narrowest field of view", |view| {
            view.fov_y = FIELDS_OF_VIEW[0]
        }),
        ("widest field of view", |view| {
            view.fov_y = FIELDS_OF_VIEW[1]
        }),
        ("a picture of one pixel", |view| view.viewport_px = [1, 1]),
        ("the largest picture", |view| {
            view.viewport_px = [VIEWPORT_PX[1]; 2]
        }),
        ("a picture of 1 x 10,000 px", |view| {
            view.viewport_px = [1, 10_000]
        }),
        ("a picture of 10,000 x 1 px", |view| {
            view.viewport_px = [10_000, 1]
        }),
        (
            "a picture of 32,768 x 1 px at the widest field of view",
            |view| {
                view.viewport_px = [VIEWPORT_PX[1], 1];
                view.fov_y = FIELDS_OF_VIEW[1];
            },
        ),
        ("the finest tolerance", |view| {
            view.max_screen_error_px = SCREEN_ERRORS_PX[0]
        }),
        ("the widest tolerance", |view| {
            view.max_screen_error_px = SCREEN_ERRORS_PX[1]
        }),
        (
            "the finest tolerance in the largest picture at the narrowest field of view",
            |view| {
                view.max_screen_error_px = SCREEN_ERRORS_PX[0];
                view.viewport_px = [VIEWPORT_PX[1]; 2];
                view.fov_y = FIELDS_OF_VIEW[0];
            },
        ),
        ("the widest tolerance in a picture of a pixel", |view| {
            view.max_screen_error_px = SCREEN_ERRORS_PX[1];
            view.viewport_px = [1, 1];
            view.fov_y = FIELDS_OF_VIEW[1];
        }),
        ("looking straight down", |view| {
            view.direction = [0.0, 0.0, -1.0]
        }),
        ("looking straight up", |view| {
            view.direction = [0.0, 0.0, 1.0]
        }),
        ("a direction as short as is allowed", |view| {
            view.direction = [0.0, 1.1e-19, -1.1e-19]
        }),
        ("a direction as long as is allowed", |view| {
            view.direction = [1e19, -1e19, -2e18]
        }),
    ]
}

/// The mesh is made for where the eye is, whatever its velocity.
fn velocity() -> Case {
    Case::new(
        "velocities from 0 to the largest number",
        "the same mesh",
        || {
            over_meshers(|options| {
                let data = data();
                let look = over_sample(&data, 60, 60, 0.0);
                let mut found = Found::default();
                let speeds = [0.0, -0.0, f32::MIN_POSITIVE / 2.0, 1e9, f32::MAX, f32::MIN];
                let mut first = None;
                for speed in speeds {
                    let mut view = view([1400.0, 2300.0, 300.0], look, 2.0);
                    view.velocity_m_s = [speed, -speed, speed];
                    let mut feed = Feed::with_options(&data.dataset, options);
                    match feed.converge_within(200, &view) {
                        Err(why) => found.fault(why),
                        Ok(_)
                            if *first.get_or_insert_with(|| feed.tree.flags())
                                != feed.tree.flags() =>
                        {
                            found.fault(format!("another mesh at {speed} m/s"));
                        }
                        Ok(_) => {}
                    }
                }
                found.outcome_with(format!("{} velocities", speeds.len()))
            })
        },
    )
}

/// Unit vectors of a picture near the poles, where up is undefined.
fn vertical() -> Case {
    Case::new(
        "directions around straight down and straight up",
        "right, up and forward are unit vectors at right angles, and no number is lost",
        || {
            let mut worst: f64 = 0.0;
            let mut tried = 0;
            for sign in [-1.0f32, 1.0] {
                for exponent in -40..=0 {
                    for (x, y) in [(1.0f32, 0.0f32), (0.0, -1.0), (0.6, 0.8), (-1.0, 1e-7)] {
                        let small = 10f32.powi(exponent);
                        let frame = frame([x * small, y * small, sign]);
                        tried += 1;
                        let vectors = [frame.right, frame.up, frame.forward];
                        for (i, a) in vectors.iter().enumerate() {
                            for (j, b) in vectors.iter().enumerate() {
                                let right = if i == j { 1.0 } else { 0.0 };
                                let off = (a.dot(*b) - right).abs();
                                worst = worst.max(if off.is_nan() { f64::INFINITY } else { off });
                            }
                        }
                    }
                }
            }
            Outcome::of(
                worst < 1e-14,
                format!("off by at most {worst:.1e} in {tried} directions"),
            )
        },
    )
}

fn frame(direction: [f32; 3]) -> EyeFrame {
    let mut view = view([0.0; 3], [0.0; 3], 1.0);
    view.direction = direction;
    let georef = escarp_proto::georef::Georef {
        origin_m: [0.0; 2],
        sample_spacing_m: [1.0; 2],
        quantum_m: 1.0,
        plane: escarp_proto::georef::Plane::Local,
    };
    EyeFrame::of(&view, &georef, 1.0)
}

/// The mesh's frustum and the picture's basis are two pieces of code that must agree.
fn never_culled() -> Case {
    Case::new(
        "what is in the picture, held against the frustum of the mesh, at every direction and aspect",
        "the frustum never says no",
        || {
            let mut found = Found::default();
            let mut seen = 0;
            let random = |n: u32, i: u32| f64::from(hash(n, i)) / f64::from(u32::MAX);
            for n in 0..40_000 {
                let tilt = 10f64.powf(-12.0 * random(n, 1));
                let turn = random(n, 2) * std::f64::consts::TAU;
                let down = if n % 2 == 0 { -1.0 } else { 1.0 };
                let mut view = view([0.0; 3], [0.0; 3], 1.0);
                view.direction = [turn.cos() * tilt, turn.sin() * tilt, down].map(|v| v as f32);
                let [least, most] = FIELDS_OF_VIEW.map(f64::from);
                view.fov_y = (least * (most / least).powf(random(n, 3))) as f32;
                view.fov_y = view.fov_y.clamp(FIELDS_OF_VIEW[0], FIELDS_OF_VIEW[1]);
                view.viewport_px = [4, 5].map(|i| 32768f64.powf(random(n, i)) as u32);
                let frame = frame(view.direction);
                let tangent = (f64::from(view.fov_y) / 2.0).tan();
                let aspect = f64::from(view.viewport_px[0]) / f64::from(view.viewport_px[1]);
                // From the middle to just inside the edges and corners of the picture.
                let inside = |i| (random(n, i) * 4.0 - 2.0).clamp(-1.0, 1.0) * (1.0 - 1e-9);
                let way = frame.forward
                    + frame.right * (inside(6) * tangent * aspect)
                    + frame.up * (inside(7) * tangent);
                let at = (way * 10f64.powf(random(n, 8) * 12.0 - 3.0)).to_array();
                let point = WorldBox { min: at, max: at };
                seen += 1;
                if !Frustum::of(&view).may_see(&point) {
                    found.fault(format!("{:?} {:?}", view.direction, view.viewport_px));
                }
            }
            let culled = found.faults.len();
            found.outcome_with(format!("{culled} of {seen} points culled"))
        },
    )
}
