//! The promise on real ground: crops of the DEMs that a machine has, from a valley to orbit.

use super::stage::{Found, ROUNDING, examine, hold, over_meshers, view};
use super::{Case, Outcome, Verdict};
use crate::feed::Feed;
use crate::terrain::{FunctionSource, TempDataset, hash};
use escarp_proto::view::View;
use escarp_tiles::build::Quantum;
use escarp_tiles::dem::{OpenOptions, SampleType, open};
use std::path::PathBuf;

/// Samples a side of a crop.
const SIDE: u32 = 129;
const TOLERANCES_PX: [f32; 7] = [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0];

/// A DEM, and how its crop is made.
#[derive(Debug, Clone, Copy)]
struct Dem {
    name: &'static str,
    file: &'static str,
    spacing_m: f64,
    step_m: f64,
    /// Whether the crop is to have holes.
    holes: bool,
}

const DEMS: [Dem; 3] = [
    Dem {
        name: "Everest, with voids",
        file: "mt_everest_90m.tif",
        spacing_m: 90.0,
        step_m: 1.0,
        holes: true,
    },
    Dem {
        name: "Puget Sound",
        file: "ps_height_1k.png",
        spacing_m: 160.0,
        step_m: 0.1,
        holes: false,
    },
    Dem {
        name: "lidar of the Green River",
        file: "greenriver_lidar_1m_f32.tif",
        spacing_m: 1.0,
        step_m: 0.01,
        holes: false,
    },
];

/// All cases.
pub fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for dem in DEMS {
        cases.push(Case::new(
            format!("{}, tolerances of 0.5 to 32 px, from a valley to orbit", dem.name),
            "once converged, deviation at every sample in view, and at crossings of edges, within the tolerance; no crack",
            move || with(dem, converged),
        ));
        cases.push(Case::new(
            format!(
                "{}, flying from a valley to orbit with few pages a frame",
                dem.name
            ),
            "in every frame, deviation within the bound that is stated for it; no crack",
            move || with(dem, flying),
        ));
    }
    cases
}

/// Files of the shared data, if they are here.
fn shared(file: &str) -> Option<PathBuf> {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data");
    let folder = std::env::var("ESCARP_DATA").unwrap_or_else(|_| beside.into());
    Some(PathBuf::from(folder).join(file)).filter(|path| path.exists())
}

fn with(dem: Dem, check: fn(&TempDataset) -> Outcome) -> Outcome {
    match shared(dem.file).map(|path| crop(dem, path)) {
        Some(Ok(data)) => check(&data),
        Some(Err(why)) => Outcome::of(false, why),
        None => Outcome {
            measured: format!(
                "there is no {} here; ESCARP_DATA names its folder",
                dem.file
            ),
            verdict: Verdict::Bounded("nothing: not measured".into()),
        },
    }
}

/// The first square of the file that has enough data, and holes if they are wanted.
fn crop(dem: Dem, path: PathBuf) -> Result<TempDataset, String> {
    let options = OpenOptions {
        spacing_m: Some(dem.spacing_m),
        height_step_m: (dem.step_m == 0.1).then_some(dem.step_m),
        ..OpenOptions::default()
    };
    let mut source = open(&path, &options).map_err(|error| error.to_string())?;
    let (width, height) = (source.info().width, source.info().height);
    let mut band = vec![0.0; (width * SIDE) as usize];
    for first in (0..height.saturating_sub(SIDE)).step_by(SIDE as usize) {
        let read = source.read_rows(first, SIDE, &mut band);
        read.map_err(|error| error.to_string())?;
        for left in (0..width.saturating_sub(SIDE)).step_by(SIDE as usize) {
            let sample = |x: u32, y: u32| band[(y * width + left + x) as usize];
            let places = (0..SIDE).flat_map(|x| (0..SIDE).map(move |y| (x, y)));
            let heights = places.map(|(x, y)| sample(x, y));
            let holes = heights.filter(|v| v.is_nan()).count() as u32;
            let wanted = match dem.holes {
                true => (SIDE..SIDE * SIDE / 4).contains(&holes),
                false => holes == 0,
            };
            if wanted {
                let rows: Vec<Vec<f64>> = (0..SIDE)
                    .map(|y| (0..SIDE).map(|x| sample(x, y)).collect())
                    .collect();
                let heights = move |x: u32, y: u32| rows[y as usize][x as usize];
                let source = FunctionSource::spaced(SIDE, SIDE, [dem.spacing_m; 2], heights);
                let mut source = source.with(|info| info.sample_type = SampleType::F64);
                let built = TempDataset::build_with(&mut source, Quantum::Metres(dem.step_m));
                return built.map_err(|error| error.to_string());
            }
        }
    }
    Err(format!(
        "no square of {SIDE} samples of {} is as wanted",
        dem.file
    ))
}

/// A man's height over the lowest sample, on the way up, and in orbit; the first looks level.
fn eyes(data: &TempDataset) -> Vec<([f64; 3], [f64; 3])> {
    let manifest = data.dataset.manifest();
    let [x, y, z] = manifest.extent_m();
    let places = (0..SIDE).flat_map(|x| (0..SIDE).map(move |y| (x, y)));
    let inside = places.filter(|&(x, y)| x.min(y) > SIDE / 4 && x.max(y) < SIDE * 3 / 4);
    let lowest = inside
        .filter_map(|(x, y)| Some((data.sample(x, y)?, x, y)))
        .min();
    let (height, column, row) = lowest.unwrap_or((0, SIDE / 2, SIDE / 2));
    let valley = manifest.georef.world(column, row, height);
    let middle = [
        (x[0] + x[1]) / 2.0,
        (y[0] + y[1]) / 2.0,
        (z[0] + z[1]) / 2.0,
    ];
    let size = x[1] - x[0];
    let up = |share: f64| {
        [
            valley[0] - size * share * 0.3,
            valley[1] - size * share,
            z[1] + size * share,
        ]
    };
    let man = [valley[0], valley[1], valley[2] + 1.7];
    vec![
        (man, [x[1], middle[1], valley[2] + 1.7]),
        (man, [middle[0], y[1], z[1]]),
        (up(0.1), middle),
        (up(1.0), middle),
        ([middle[0], middle[1], 4e5], middle),
    ]
}

fn views(data: &TempDataset, error_px: f32) -> Vec<View> {
    let eyes = eyes(data).into_iter();
    eyes.map(|(eye, look)| view(eye, look, error_px)).collect()
}

fn converged(data: &TempDataset) -> Outcome {
    over_meshers(|options| {
        let keeps = options.mesher.keeps_tolerance();
        let mut all = Found::default();
        let mut ratios = Vec::new();
        for px in TOLERANCES_PX {
            // What does not keep to the tolerance states its bound; two tolerances show it.
            if keeps || px == 1.0 || px == 8.0 {
                let found = examine(data, options, &views(data, px));
                ratios.push(format!("{:.3} at {px} px", found.deviation));
                all = all.and(found);
            }
        }
        let measured = format!(
            "deviation in tolerances: {}; {:.3} of what is stated; {} of {} edges leave the lines of \
             finest triangles",
            ratios.join(", "),
            all.share,
            all.leaving,
            all.edges
        );
        all.outcome_with(measured)
    })
}

/// Up from the valley in 32 frames, with at most five pages a frame, and some that never come.
fn flying(data: &TempDataset) -> Outcome {
    let eyes = eyes(data);
    let ([from, look], [to, _]) = ([eyes[0].0, eyes[0].1], [eyes[3].0, eyes[3].1]);
    over_meshers(|options| {
        let mut found = Found::default();
        let mut feed = Feed::with_options(&data.dataset, options);
        let mut stated = 0;
        for frame in 0..32 {
            let share = (f64::from(frame) / 31.0).powi(2);
            let eye = std::array::from_fn(|i| from[i] + (to[i] - from[i]) * share);
            let view = view(eye, look, 2.0);
            feed.tree.update(&view);
            let lost = |key: u64| hash(key as u32, (key >> 32) as u32).is_multiple_of(11);
            let wishes = feed.tree.wishes().into_iter();
            let come = wishes.filter(|wish| wish.page.level() == 0 || !lost(wish.page.key()));
            for wish in come.take(5) {
                feed.grant(&wish);
            }
            let stats = feed.tree.update(&view);
            stated += u32::from(stats.excess.is_finite());
            hold(
                &mut feed.tree,
                data,
                &view,
                stats.excess,
                stats.wanted == 0,
                &mut found,
            );
        }
        if stated < 16 || found.share > 1.0 + ROUNDING {
            found.fault(format!("a bound is stated in {stated} of 32 frames"));
        }
        let measured = format!(
            "bounds of up to {:.0} tolerances; deviation at most {:.3} of what is stated",
            found.excess, found.share
        );
        found.outcome_with(measured)
    })
}
