//! Shapes of the ground that are hard on a mesh.

use super::Case;
use super::stage::{Found, examine, ground, over_meshers, view, views};
use crate::feed::Feed;
use crate::measure::{plane_height, triangles};
use crate::terrain::{TempDataset, hash, hills};
use escarp_proto::page::MAX_HEIGHT;

/// What a mesh must hold whatever the ground.
const MESH: &str =
    "no crack, converges, deviation within the stated bound at every sample, buffers in order";
/// Samples a side; not a multiple of a page.
const SIDE: u32 = 141;
const MAX: f64 = MAX_HEIGHT as f64;

/// All cases.
pub fn cases() -> Vec<Case> {
    let mut cases = vec![flat(), plane(), border()];
    cases.extend(spikes());
    cases.extend(over_ground([
        ("cliff off a page seam", on(|x, _| step(x >= 67))),
        ("cliff on a page seam", on(|x, _| step(x >= 64))),
        (
            "cliff across all seams",
            on(|x, y| step(x * 3 + y * 5 < 421)),
        ),
        ("white noise", on(|x, y| f64::from(hash(x, y) % 4000))),
        (
            "white noise over the whole range of heights",
            on(|x, y| f64::from(hash(x, y) as i32 / 2)),
        ),
        (
            "heights that alternate between the lowest and the highest",
            on(|x, y| if (x + y) % 2 == 0 { MAX } else { -MAX }),
        ),
        (
            "stripes of the lowest and the highest height",
            on(|x, _| if x % 2 == 0 { MAX } else { -MAX }),
        ),
        (
            "staircase of a step a page",
            on(|x, _| f64::from(x / 16) * 100.0),
        ),
        ("staircase of a step a sample", on(|x, y| f64::from(x + y))),
        (
            "holes as on a chess board",
            on(holed(|x, y| (x + y) % 2 == 0)),
        ),
        ("holes in every second column", on(holed(|x, _| x % 2 == 0))),
        (
            "a hole in every second cell",
            on(holed(|x, y| x % 2 == 0 && y % 2 == 0)),
        ),
        (
            "one hole, on a corner of pages",
            on(holed(|x, y| (x, y) == (64, SIDE - 1 - 64))),
        ),
        (
            "data in one cell of a corner alone",
            on(|x, y| if x < 2 && y < 2 { 5.0 } else { f64::NAN }),
        ),
        (
            "data in one sample of a corner alone",
            on(|x, y| if x + y == 0 { 5.0 } else { f64::NAN }),
        ),
    ]));
    for (width, height) in [
        (1, 1),
        (2, 1),
        (1, 2),
        (2, 2),
        (1, 300),
        (300, 1),
        (2, 300),
        (17, 17),
        (18, 18),
    ] {
        let make = move || ground(width, height, |x, y| f64::from(hash(x, y) % 900));
        cases.push(over(format!("{width} x {height} samples"), make));
    }
    cases
}

type Make = Box<dyn Fn() -> TempDataset + Send + Sync>;

fn on(heights: impl Fn(u32, u32) -> f64 + Clone + Send + Sync + 'static) -> Make {
    Box::new(move || ground(SIDE, SIDE, heights.clone()))
}

fn step(high: bool) -> f64 {
    if high { 1200.0 } else { 10.0 }
}

fn holed(
    is_hole: impl Fn(u32, u32) -> bool + Clone + Send + Sync + 'static,
) -> impl Fn(u32, u32) -> f64 + Clone + Send + Sync + 'static {
    move |x, y| match is_hole(x, y) {
        true => f64::NAN,
        false => hills(x, y),
    }
}

fn over_ground<const N: usize>(grounds: [(&str, Make); N]) -> Vec<Case> {
    grounds.map(|(name, make)| over(name, make)).into()
}

/// Any ground: all that must hold of a mesh, from all views, at 1 and at 8 px.
fn over(name: impl Into<String>, make: impl Fn() -> TempDataset + Send + Sync + 'static) -> Case {
    Case::new(name, MESH, move || {
        let data = make();
        over_meshers(|options| {
            let near = examine(&data, options, &views(&data, 1.0));
            near.and(examine(&data, options, &views(&data, 8.0)))
                .outcome()
        })
    })
}

fn flat() -> Case {
    Case::new(
        "flat",
        "2 to 8 triangles, and no page but the first",
        || {
            over_meshers(|options| {
                let data = ground(257, 257, |_, _| 12.0);
                let mut found = examine(&data, options, &views(&data, 1.0));
                let keeps = options.mesher.keeps_tolerance();
                if keeps && !(2..=8).contains(&found.triangles) {
                    found.fault("2 to 8 triangles are right");
                }
                if data.dataset.manifest().pages != 1 {
                    found.fault("there is more than one page");
                }
                let measured = format!(
                    "{} triangles, {} page",
                    found.triangles,
                    data.dataset.manifest().pages
                );
                found.outcome_with(measured)
            })
        },
    )
}

/// A plane that is not level, so that the eye can be inside its box without being near it.
fn plane() -> Case {
    Case::new(
        "a tilted plane, with the eye inside its box",
        "2 to 8 triangles, deviation 0",
        || {
            over_meshers(|options| {
                let data = ground(257, 257, |x, y| f64::from(3 * x) - f64::from(2 * y));
                let mut found = examine(&data, options, &views(&data, 1.0));
                let keeps = options.mesher.keeps_tolerance();
                if keeps && !(2..=8).contains(&found.triangles) {
                    found.fault("2 to 8 triangles are right");
                }
                if found.deviation > 0.0 {
                    found.fault("the mesh is not the plane");
                }
                found.outcome()
            })
        },
    )
}

/// One sample of 1e9 m where it is most alone: of each parity, and on seams and corners of pages.
fn spikes() -> Vec<Case> {
    let places = [
        ("even column, even row", (70, 70)),
        ("odd column, even row", (71, 70)),
        ("even column, odd row", (70, 71)),
        ("odd column, odd row", (71, 71)),
        ("a seam of pages", (64, 70)),
        ("a corner of pages", (64, 64)),
        ("the border of the data", (0, 70)),
        ("a corner of the data", (0, 0)),
        ("the far corner of the data", (SIDE - 1, SIDE - 1)),
    ];
    places
        .map(|(name, (x, y))| {
            // Rows of a source run from the north.
            let place = (x, SIDE - 1 - y);
            let name = format!("a spike of 1e9 m in one sample: {name}");
            Case::new(
                name,
                format!("{MESH}; the spike is a vertex of the mesh"),
                move || {
                    let heights = move |x, y| if (x, y) == place { 1e9 } else { 3.0 };
                    let data = ground(SIDE, SIDE, heights);
                    over_meshers(|options| {
                        let mut found = examine(&data, options, &views(&data, 1.0));
                        if options.mesher.keeps_tolerance() && !has_vertex(&data, (x, y)) {
                            found.fault("the spike is no vertex of the mesh");
                        }
                        found.outcome()
                    })
                },
            )
        })
        .into()
}

fn has_vertex(data: &TempDataset, (x, y): (u32, u32)) -> bool {
    let mut feed = Feed::new(&data.dataset);
    feed.converge(&views(data, 1.0)[0]);
    let at = (x, y, 1_000_000_000);
    triangles(&feed.tree)
        .iter()
        .any(|triangle| triangle.drawn && triangle.corners.contains(&at))
}

/// The outermost samples are neither moved nor left out.
fn border() -> Case {
    Case::new(
        "border of the data",
        "at the finest tolerance, from near, the mesh has the input's height at every sample of the border",
        || {
            over_meshers(|options| {
                let height = |x: u32, y: u32| f64::from(hash(x, y) % 5000) - 2500.0;
                let data = ground(50, 37, height);
                let eye = [1245.0, 2180.0, 0.0];
                let mut found = Found::default();
                let near = view(eye, [1300.0, 2200.0, -400.0], 0.05);
                let mut feed = Feed::with_options(&data.dataset, options);
                if let Err(why) = feed.converge_within(200, &near) {
                    found.fault(why);
                }
                let triangles = triangles(&feed.tree);
                let drawn: Vec<_> = triangles.iter().filter(|triangle| triangle.drawn).collect();
                let places = (0..50).flat_map(|x| (0..37).map(move |y| (x, y)));
                let border = places.filter(|&(x, y)| x == 0 || y == 0 || x == 49 || y == 36);
                let (mut all, mut right) = (0, 0);
                for (x, y) in border {
                    let has = |plane: Option<f64>| plane == Some(height(x, 36 - y));
                    all += 1;
                    right += u32::from(
                        drawn
                            .iter()
                            .any(|triangle| has(plane_height(triangle, x, y))),
                    );
                }
                if right != all && options.mesher.keeps_tolerance() {
                    found.fault("at some it has not");
                }
                found.outcome_with(format!("at {right} of {all}"))
            })
        },
    )
}
