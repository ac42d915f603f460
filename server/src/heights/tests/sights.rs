//! Lines of sight against every crossing with the whole raster.

use super::*;

/// Places at which a line crosses sides of triangles, from 0 to 1, its ends not counted.
fn crossings([a, b]: [[f64; 2]; 2]) -> Vec<f64> {
    let families: [fn([f64; 2]) -> f64; 4] = [
        |p| p[0],
        |p| p[1],
        |p| (p[0] - p[1]) / 2.0,
        |p| (p[0] + p[1]) / 2.0,
    ];
    let mut all = Vec::new();
    for family in families {
        let (from, to) = (family(a), family(b));
        let (low, high) = (from.min(to).ceil() as i64, from.max(to).floor() as i64);
        for whole in low..=high {
            let t = (whole as f64 - from) / (to - from);
            if t > 0.0 && t < 1.0 {
                all.push(t);
            }
        }
    }
    all.sort_by(f64::total_cmp);
    all
}

/// What the oracle says: the least clearance and where, and the first crossing below the surface.
pub(super) struct Truth {
    pub least: f64,
    pub over_hole: bool,
    pub blocked: Option<f64>,
}

/// `ends` in the grid, `heights` in quanta, `bulge` as of a line.
pub(super) fn truth(made: &Made, ends: [[f64; 2]; 2], heights: [f64; 2], bulge: f64) -> Truth {
    let place = |t: f64| [0, 1].map(|i: usize| ends[0][i] * (1.0 - t) + ends[1][i] * t);
    let line = |t: f64| heights[0] * (1.0 - t) + heights[1] * t - bulge * t * (1.0 - t);
    let mut truth = Truth {
        least: f64::INFINITY,
        over_hole: false,
        blocked: None,
    };
    let crossings = crossings(ends);
    for &t in &crossings {
        // On a side either triangle will do: where one is a hole, the other may not be.
        let beside = [t, t - 1e-12, t + 1e-12].map(|t| made.raster.height(place(t)));
        let Some(ground) = beside.into_iter().flatten().next() else {
            continue;
        };
        let clearance = line(t) - ground;
        truth.least = truth.least.min(clearance);
        if clearance < 0.0 && truth.blocked.is_none() {
            truth.blocked = Some(t);
        }
    }
    let between: Vec<f64> = [0.0].into_iter().chain(crossings).chain([1.0]).collect();
    truth.over_hole = between.windows(2).any(|pair| {
        pair[1] - pair[0] > 1e-9
            && made
                .raster
                .height(place((pair[0] + pair[1]) / 2.0))
                .is_none()
    });
    truth
}

fn random_ends(made: &Made, number: u32) -> SightEnds {
    let frame = made.frame();
    let [width, height] = made.raster.size.map(|n| (n - 1) as f64);
    let place = |seed: u32| {
        let mut grid = [part(seed, number) * width, part(seed + 1, number) * height];
        if number.is_multiple_of(5) {
            grid = grid.map(f64::round);
        }
        grid
    };
    let (observer, mut target) = (place(10), place(20));
    if number.is_multiple_of(7) {
        target[0] = observer[0];
    }
    SightEnds {
        observer: frame.within(observer).unwrap(),
        target: frame.within(target).unwrap(),
        above_ground_m: [
            1.8 + f64::from(number % 9) * 20.0,
            f64::from(number % 11) * 15.0,
        ],
        curvature: match number % 3 {
            0 => Curvature::Round { refraction: 0.13 },
            _ => Curvature::Flat,
        },
    }
}

fn compare(made: &Made, lines: u32) -> [u32; 4] {
    let frame = made.frame();
    let manifest = made.dataset.manifest();
    let quantum_m = manifest.georef.quantum_m;
    let mut count = [0; 4];
    for number in 0..lines {
        let ends = random_ends(made, number);
        let grid = [ends.observer.grid(), ends.target.grid()];
        let found = sight(&mut made.pages(), &frame, &ends).unwrap();
        let ground = grid.map(|place| made.raster.height(place));
        let [Some(a), Some(b)] = ground else {
            assert_eq!(found, None);
            count[3] += 1;
            continue;
        };
        let found = found.unwrap();
        let bulge_m = ends.curvature.bulge_m(manifest, found.length_m).unwrap();
        let heights = [
            a + ends.above_ground_m[0] / quantum_m,
            b + ends.above_ground_m[1] / quantum_m,
        ];
        let truth = truth(made, grid, heights, bulge_m / quantum_m);
        assert_eq!(
            found.over_hole,
            truth.over_hole || found.over_hole,
            "{ends:?}"
        );
        let least_m = truth.least * quantum_m;
        if least_m.is_finite() {
            let margin = found.margin_m.unwrap();
            // A crossing at an end, which does not count, may be a hair's breadth before it.
            let near_end = |at: f64| margin < least_m && at.min(1.0 - at) < 1e-12;
            assert!(
                (margin - least_m).abs() < 1e-6 || near_end(found.margin_at),
                "{ends:?}: {found:?} {least_m}"
            );
        }
        // A crossing less than this deep is rounding.
        if least_m < -1e-6 {
            let (blocked, first) = (found.blocked_at.unwrap(), truth.blocked.unwrap());
            assert!(blocked <= first + 1e-9, "{ends:?}: {found:?} {first}");
            let cells = (grid[1][0] - grid[0][0]).hypot(grid[1][1] - grid[0][1]);
            assert!(
                (first - blocked) * cells < 1.5,
                "{ends:?}: {found:?} {first}"
            );
        }
        match found.verdict {
            Verdict::Visible => {
                assert!(truth.least >= 0.0 && !truth.over_hole);
                assert_eq!(found.visible, Some(true));
            }
            Verdict::Hidden => {
                assert!(truth.least < 0.0);
                assert_eq!(found.visible, Some(false));
            }
            Verdict::Undecided => {
                assert!(found.over_hole || least_m.abs() <= found.margin_error_m + 1e-6);
            }
        }
        count[found.verdict as usize] += 1;
    }
    count
}

#[test]
fn a_line_of_sight_is_that_over_the_whole_raster() {
    let [visible, hidden, undecided, none] = compare(&Made::hills([333, 271], false), 600);
    assert!(visible > 50 && hidden > 50 && none == 0);
    // The samples are stored exactly: only grazing lines are left.
    assert!(undecided < 6, "{undecided}");
}

#[test]
fn a_line_over_a_hole_is_hidden_or_undecided() {
    let [_, hidden, undecided, none] = compare(&Made::hills([333, 271], true), 400);
    assert!(hidden > 20 && undecided > 20 && none > 0);
}

#[test]
fn lines_of_sight_over_real_terrain_are_those_over_the_whole_raster() {
    for name in ["mt_everest_90m.tif", "greenriver_lidar_1m_f32.tif"] {
        if let Some(made) = Made::real(name) {
            compare(&made, 150);
        }
    }
}

#[test]
fn curvature_hides_what_a_plane_shows() {
    let mut source = function([2001, 5], |_, _| 0.0);
    source.info.placement.dx = 50.0;
    let made = Made::of(&mut source);
    let ends = |curvature| SightEnds {
        observer: GridPlace::sample(0, 2),
        target: GridPlace::sample(2000, 2),
        above_ground_m: [100.0, 100.0],
        curvature,
    };
    let seen = |curvature| {
        sight(&mut made.pages(), &made.frame(), &ends(curvature))
            .unwrap()
            .unwrap()
    };
    assert_eq!(seen(Curvature::Flat).verdict, Verdict::Visible);
    let round = seen(Curvature::Round { refraction: 0.0 });
    assert_eq!(round.verdict, Verdict::Hidden);
    // 100 km: the ground rises by 50 km squared over two radii in the middle.
    let expected = 100.0 - 50_000.0 * 50_000.0 / (2.0 * 6_378_137.0);
    assert!(
        (round.margin_m.unwrap() - expected).abs() < 0.01,
        "{round:?}"
    );
    assert!((round.margin_at - 0.5).abs() < 1e-3);
}

#[test]
fn a_long_line_reads_few_pages_where_it_is_far_above_the_ground() {
    let made = Made::hills([2000, 600], false);
    let ends = SightEnds {
        observer: GridPlace::sample(3, 5),
        target: GridPlace::sample(1990, 590),
        above_ground_m: [4000.0, 4000.0],
        curvature: Curvature::Flat,
    };
    let mut pages = Pages::new(&made.dataset, Work::new(40, 4000, &GOES_ON));
    let found = sight(&mut pages, &made.frame(), &ends).unwrap().unwrap();
    assert_eq!(found.verdict, Verdict::Visible);
    let mut pages = Pages::new(&made.dataset, Work::new(40, 10, &GOES_ON));
    let refused = sight(&mut pages, &made.frame(), &ends);
    assert!(matches!(
        refused,
        Err(HeightError::TooMuch { most: 10, .. })
    ));
}
