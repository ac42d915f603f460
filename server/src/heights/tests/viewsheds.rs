//! Viewsheds against a line of sight a pixel over the whole raster.

use super::sights::truth;
use super::*;

fn request(made: &Made, grid: [f64; 2], side_px: u32) -> ViewshedRequest {
    ViewshedRequest {
        observer: made.frame().within(grid).unwrap(),
        radius_m: 2000.0,
        above_ground_m: [30.0, 0.0],
        side_px,
        curvature: Curvature::Flat,
        resolution_m: None,
    }
}

/// The place of a pixel's centre, by the picture's corners.
fn place(view: &Viewshed, side_px: u32, at: usize) -> [f64; 2] {
    let (column, row) = (at as u32 % side_px, at as u32 / side_px);
    let [[west, east], [south, north]] = view.grid;
    let part = |n: u32| (f64::from(n) + 0.5) / f64::from(side_px);
    [
        west + (east - west) * part(column),
        north - (north - south) * part(row),
    ]
}

/// Holds every pixel against the oracle; how many there are of each kind.
fn compare(made: &Made, request: &ViewshedRequest) -> [usize; 4] {
    let frame = made.frame();
    let quantum_m = made.dataset.manifest().georef.quantum_m;
    let limits = HeightLimits::default();
    let view = viewshed(&mut made.pages(), &frame, request, &limits)
        .unwrap()
        .unwrap();
    let centre = request.observer.grid();
    let eye = made.raster.height(centre).unwrap() + request.above_ground_m[0] / quantum_m;
    let mut count = [0; 4];
    for (at, seen) in view.pixels.iter().enumerate() {
        count[*seen as usize] += 1;
        let target = place(&view, request.side_px, at);
        let length_m = frame.distance_m(centre, target);
        let ground = frame
            .within(target)
            .and_then(|_| made.raster.height(target));
        let ground = ground.filter(|_| length_m <= request.radius_m);
        let Some(ground) = ground else {
            let is_coarse = view.stride > 1 && length_m <= request.radius_m;
            assert!(*seen == Seen::Nothing || (is_coarse && *seen == Seen::Undecided));
            continue;
        };
        let manifest = made.dataset.manifest();
        let bulge_m = request.curvature.bulge_m(manifest, length_m).unwrap();
        let heights = [eye, ground + request.above_ground_m[1] / quantum_m];
        let truth = truth(made, [centre, target], heights, bulge_m / quantum_m);
        match seen {
            Seen::Nothing => panic!("{target:?} has data"),
            Seen::Visible => assert!(truth.least > 0.0 && !truth.over_hole, "{target:?}"),
            Seen::Hidden => assert!(truth.least < 0.0, "{target:?} {}", truth.least),
            Seen::Undecided if view.stride == 1 && made.is_exact() => assert!(
                truth.over_hole || truth.least.abs() * quantum_m <= view.error_m + 1e-6,
                "{target:?} {}",
                truth.least
            ),
            Seen::Undecided => {}
        }
    }
    count
}

impl Made {
    fn is_exact(&self) -> bool {
        self.dataset.manifest().storage_error_m == 0.0
    }
}

#[test]
fn a_viewshed_is_a_line_of_sight_to_every_pixel() {
    let made = Made::hills([333, 271], false);
    let [nothing, hidden, undecided, visible] = compare(&made, &request(&made, [150.3, 120.8], 97));
    assert!(
        nothing > 1000 && hidden > 1000 && visible > 100,
        "{visible}"
    );
    assert!(undecided < 20, "{undecided}");
    let at_the_edge = ViewshedRequest {
        curvature: Curvature::Round { refraction: 0.13 },
        above_ground_m: [30.0, 10.0],
        ..request(&made, [332.0, 270.0], 60)
    };
    compare(&made, &at_the_edge);
}

#[test]
fn a_coarse_viewshed_is_sure_only_of_what_is_true_of_the_finest_surface() {
    let made = Made::hills([333, 271], false);
    for resolution_m in [40.0, 80.0, 160.0, 5000.0] {
        let coarse = ViewshedRequest {
            resolution_m: Some(resolution_m),
            above_ground_m: [400.0, 100.0],
            ..request(&made, [150.3, 120.8], 41)
        };
        compare(&made, &coarse);
    }
}

#[test]
fn what_lies_behind_a_hole_is_not_seen_for_sure() {
    let made = Made::hills([333, 271], true);
    let from_above = ViewshedRequest {
        above_ground_m: [900.0, 0.0],
        ..request(&made, [120.3, 160.2], 61)
    };
    let [_, _, undecided, _] = compare(&made, &from_above);
    assert!(undecided > 50, "{undecided}");
    let coarse = ViewshedRequest {
        resolution_m: Some(80.0),
        above_ground_m: [900.0, 100.0],
        ..request(&made, [170.0, 120.0], 41)
    };
    compare(&made, &coarse);
    let frame = made.frame();
    let in_the_lake = request(&made, [60.0, 220.0], 8);
    let found = viewshed(
        &mut made.pages(),
        &frame,
        &in_the_lake,
        &HeightLimits::default(),
    );
    assert_eq!(found, Ok(None));
}

#[test]
fn a_viewshed_over_real_terrain_is_a_line_of_sight_to_every_pixel() {
    for name in ["mt_everest_90m.tif", "greenriver_lidar_1m_f32.tif"] {
        let Some(made) = Made::real(name) else {
            continue;
        };
        let spacing_m = made.dataset.manifest().georef.sample_spacing_m[0];
        let [width, height] = made.raster.size.map(|n| n as f64);
        let fine = ViewshedRequest {
            radius_m: 100.0 * spacing_m,
            ..request(&made, [width * 0.4, height * 0.3], 40)
        };
        compare(&made, &fine);
        let coarse = ViewshedRequest {
            radius_m: 300.0 * spacing_m,
            resolution_m: Some(4.0 * spacing_m),
            above_ground_m: [1000.0 * spacing_m / 90.0, 100.0 * spacing_m / 90.0],
            ..fine
        };
        compare(&made, &coarse);
    }
}

#[test]
fn sizes_and_radii_beyond_the_limits_are_refused_with_what_is_allowed() {
    let made = Made::hills([33, 33], false);
    let sound = request(&made, [5.0, 5.0], 16);
    let wrong = [
        ViewshedRequest {
            side_px: 0,
            ..sound
        },
        ViewshedRequest {
            side_px: 1025,
            ..sound
        },
        ViewshedRequest {
            radius_m: f64::NAN,
            ..sound
        },
        ViewshedRequest {
            radius_m: -1.0,
            ..sound
        },
        ViewshedRequest {
            curvature: Curvature::Round { refraction: 1.0 },
            ..sound
        },
    ];
    for wrong in wrong {
        let limits = HeightLimits::default();
        let refused = viewshed(&mut made.pages(), &made.frame(), &wrong, &limits);
        assert!(
            matches!(refused, Err(HeightError::Usage { .. })),
            "{refused:?}"
        );
    }
    let large = ViewshedRequest {
        radius_m: 1e300,
        ..sound
    };
    let limits = HeightLimits {
        window_samples: 100,
        ..HeightLimits::default()
    };
    let view = viewshed(&mut made.pages(), &made.frame(), &large, &limits);
    assert!(view.unwrap().unwrap().stride >= 4);
    let mut pages = Pages::new(&made.dataset, Work::new(1000, 50, &GOES_ON));
    let refused = viewshed(&mut pages, &made.frame(), &sound, &HeightLimits::default());
    assert!(matches!(
        refused,
        Err(HeightError::TooMuch { most: 50, .. })
    ));
}
