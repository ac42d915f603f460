//! Grids against formulas: planes must come out as planes, samples as samples.

use super::*;
use crate::crs::{self, Projection};
use crate::dem::{Placement, Registration, SampleType};
use proptest::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

/// A source by a formula of place, that notes how many samples were read.
struct Formula<F> {
    info: DemInfo,
    height: F,
    read: Arc<AtomicU64>,
    block: Option<[u32; 2]>,
    rows: Arc<Mutex<Vec<Range<u32>>>>,
}

impl<F: Fn(f64, f64) -> f64 + Send> DemSource for Formula<F> {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        self.info.check_band(first_row, rows, out)?;
        let width = self.info.width;
        self.read_window(first_row..first_row + rows, 0..width, out)
    }

    fn read_window(
        &mut self,
        rows: Range<u32>,
        columns: Range<u32>,
        out: &mut [f64],
    ) -> Result<(), DemError> {
        self.info.check_window(&rows, &columns, out)?;
        self.read.fetch_add(out.len() as u64, Ordering::Relaxed);
        self.rows.lock().unwrap().push(rows.clone());
        let place = self.info.placement;
        let mut heights = out.iter_mut();
        for r in rows {
            for c in columns.clone() {
                let (x, y) = (
                    place.x0 + f64::from(c) * place.dx,
                    place.y0 - f64::from(r) * place.dy,
                );
                *heights.next().unwrap() = (self.height)(x, y);
            }
        }
        Ok(())
    }

    fn block_shape(&self) -> [u32; 2] {
        self.block.unwrap_or([self.info.width, 1])
    }
}

fn info(crs: &str, size: [u32; 2], [x0, y0]: [f64; 2], [dx, dy]: [f64; 2]) -> DemInfo {
    DemInfo {
        path: "formula".into(),
        format: "formula",
        width: size[0],
        height: size[1],
        placement: Placement { x0, y0, dx, dy },
        crs: match crs {
            "" => Crs::Local,
            crs => crs::from_user(crs).unwrap(),
        },
        registration: Registration::Grid,
        sample_type: SampleType::F64,
        height_step_m: 1.0,
        nodata: None,
        vertical: None,
    }
}

fn formula<F: Fn(f64, f64) -> f64 + Send>(info: DemInfo, height: F) -> Formula<F> {
    Formula {
        info,
        height,
        read: Arc::default(),
        block: None,
        rows: Arc::default(),
    }
}

fn wish(crs: &str, spacing: Option<f64>, bounds: Option<[f64; 4]>) -> Wish {
    Wish {
        crs: (!crs.is_empty()).then(|| crs::from_user(crs).unwrap()),
        spacing,
        bounds,
        interpolation: Interpolation::Linear,
    }
}

fn all(source: &mut dyn DemSource) -> Vec<f64> {
    let (width, height) = (source.info().width, source.info().height);
    let mut out = vec![0.0; width as usize * height as usize];
    // Uneven bands, one row shared, as a build asks for them.
    let mut first = 0;
    while first < height {
        let rows = (height - first).min(37);
        let from = (first * width) as usize;
        let band = &mut out[from..from + (rows * width) as usize];
        source.read_rows(first, rows, band).unwrap();
        first += if rows > 1 { rows - 1 } else { rows };
        if first + 1 == height {
            break;
        }
    }
    out
}

/// Height, column, row, x and y of each sample.
fn each(source: &mut dyn DemSource) -> Vec<(f64, [f64; 2])> {
    let heights = all(source);
    let (place, width) = (source.info().placement, source.info().width as usize);
    let at = |i: usize| {
        [
            place.x0 + (i % width) as f64 * place.dx,
            place.y0 - (i / width) as f64 * place.dy,
        ]
    };
    heights
        .into_iter()
        .enumerate()
        .map(|(i, h)| (h, at(i)))
        .collect()
}

#[test]
fn a_crop_is_sample_for_sample_and_reads_nothing_else() {
    let source = formula(
        info("EPSG:32612", [1000, 800], [5e5, 4e6], [10.0, 20.0]),
        |x, y| x + 7.0 * y,
    );
    let (read, rows) = (source.read.clone(), source.rows.clone());
    let bounds = Some([501_000.0, 3_990_001.0, 502_005.0, 3_995_000.0]);
    let mut placed = place(Box::new(source), &wish("", None, bounds)).unwrap();
    let info = placed.info().clone();
    assert_eq!((info.width, info.height), (101, 250));
    let expected = Placement {
        x0: 501_000.0,
        y0: 3_995_000.0,
        dx: 10.0,
        dy: 20.0,
    };
    assert_eq!(info.placement, expected);
    assert_eq!(placed.resampling(), None);
    let mut band = vec![0.0; 101 * 250];
    placed.read_rows(0, 250, &mut band).unwrap();
    assert_eq!(band[0], 501_000.0 + 7.0 * 3_995_000.0);
    assert_eq!(band[101 * 250 - 1], 502_000.0 + 7.0 * 3_990_020.0);
    assert_eq!(read.load(Ordering::Relaxed), 101 * 250);
    assert!(
        rows.lock()
            .unwrap()
            .iter()
            .all(|rows| rows.start >= 250 && rows.end <= 500)
    );
}

#[test]
fn nothing_wished_or_the_same_again_leaves_the_source_alone() {
    let same = wish("EPSG:32612", Some(10.0), None);
    for wish in [Wish::default(), same] {
        let source = formula(
            info("EPSG:32612", [10, 10], [5e5, 4e6], [10.0; 2]),
            |x, _| x,
        );
        let placed = place(Box::new(source), &wish).unwrap();
        assert_eq!(placed.info().format, "formula");
    }
}

#[test]
fn a_multiple_of_the_spacing_takes_exact_samples() {
    let mut info = info("EPSG:32612", [101, 61], [5e5, 4e6], [10.0; 2]);
    info.sample_type = SampleType::I16;
    let rough = |x: f64, y: f64| {
        (x * 0.37)
            .sin()
            .mul_add(50.0, (y * 0.11).cos() * 70.0)
            .round()
    };
    let mut placed = place(Box::new(formula(info, rough)), &wish("", Some(30.0), None)).unwrap();
    assert_eq!((placed.info().width, placed.info().height), (34, 21));
    assert_eq!(placed.info().sample_type, SampleType::I16);
    for (height, [x, y]) in each(&mut *placed) {
        assert_eq!(height, rough(x, y));
    }
    let found = placed.resampling().unwrap();
    assert_eq!(found.horizontal_error_m, 0.0);
    assert!(found.largest_difference_m > 10.0);
    assert_eq!(found.compared, 100 * 61);
}

#[test]
fn a_plane_stays_a_plane_in_the_same_crs() {
    let plane = |x: f64, y: f64| 0.25 * (x - 5e5) - 0.5 * (y - 4e6) + 100.0;
    let source = formula(
        info("EPSG:32612", [200, 150], [5e5, 4e6], [10.0, 15.0]),
        plane,
    );
    let mut placed = place(Box::new(source), &wish("", Some(7.0), None)).unwrap();
    for (height, [x, y]) in each(&mut *placed) {
        assert!((height - plane(x, y)).abs() < 1e-6, "{x} {y}");
    }
    assert!(placed.resampling().unwrap().largest_difference_m < 1e-6);
}

/// Longitude and latitude into UTM: the height is a plane there, up to what bilinear
/// interpolation in degrees bends and places being a hundredth of a cell off.
#[test]
fn each_height_lies_where_the_projection_says() {
    let utm = Projection::of(&crs::from_user("EPSG:32645").unwrap()).unwrap();
    let height = move |lon: f64, lat: f64| {
        let [x, y] = utm.from_degrees(lon, lat).unwrap();
        (x - 4e5) + 0.5 * (y - 3e6)
    };
    for block in [None, Some([64, 64])] {
        let mut source = formula(
            info("EPSG:4326", [301, 301], [86.0, 28.0], [1.0 / 1200.0; 2]),
            height.clone(),
        );
        source.block = block;
        let mut placed = place(Box::new(source), &wish("EPSG:32645", Some(100.0), None)).unwrap();
        assert_eq!(placed.info().crs, crs::from_user("EPSG:32645").unwrap());
        let mut valid = 0;
        for (height, [x, y]) in each(&mut *placed) {
            assert_eq!((x % 100.0, y % 100.0), (0.0, 0.0));
            if !height.is_nan() {
                valid += 1;
                let expected = (x - 4e5) + 0.5 * (y - 3e6);
                // A hundredth of 92 m, on a slope of 1.12.
                assert!(
                    (height - expected).abs() < 1.0,
                    "{x} {y}: {height} {expected}"
                );
            }
        }
        let found = placed.resampling().unwrap();
        assert!(
            valid > 60_000 && found.compared > 85_000,
            "{valid} {found:?}"
        );
        assert!(
            found.largest_difference_m < 1.0 && found.horizontal_error_m < 1.5,
            "{found:?}"
        );
    }
}

#[test]
fn places_between_exact_ones_are_right_to_a_hundredth_of_a_cell() {
    for (from, to, origin, step) in [
        ("EPSG:4326", "EPSG:32645", [86.0, 28.0], 1.0 / 1200.0),
        ("EPSG:4326", "EPSG:3413", [-60.0, 89.0], 0.01),
        ("EPSG:4326", "EPSG:3035", [-10.0, 70.0], 0.05),
        ("EPSG:3857", "EPSG:32723", [-4.8e6, -2.6e6], 30.0),
    ] {
        let info = info(from, [600, 500], origin, [step; 2]);
        let mapping = Mapping::between(&info, &crs::from_user(to).unwrap()).unwrap();
        let target = Target::choose(
            &info,
            &mapping,
            Some(&crs::from_user(to).unwrap()),
            None,
            None,
        )
        .unwrap();
        let place = target.placement;
        let map =
            |c: f64, r: f64| mapping.to_source([place.x0 + c * place.dx, place.y0 - r * place.dy]);
        let size = [target.width.min(500), target.height.min(400)];
        let mut out = vec![[0.0; 2]; (size[0] * size[1]) as usize];
        let cells = size.map(|n| n as usize);
        mapping::fill_lattice(&map, [0, 0], cells, resampled::LATTICE_TOLERANCE, &mut out);
        for (i, found) in out.iter().enumerate() {
            let (c, r) = ((i % cells[0]) as f64, (i / cells[0]) as f64);
            let exact = map(c, r).unwrap_or([f64::NAN; 2]);
            for (f, e) in found.iter().zip(exact) {
                assert!(
                    (f - e).abs() < 0.01 || f.is_nan() && e.is_nan(),
                    "{from} {to} {c} {r}"
                );
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// The stated difference is the largest that a direct comparison finds.
    #[test]
    fn the_stated_difference_is_that_of_a_direct_comparison(
        seed in 0u64..1000, spacing in 8.0f64..60.0, cubic: bool, holes: bool,
    ) {
        let noise = move |x: f64, y: f64| {
            let bits = (x as i64 as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
                ^ (y as i64 as u64).wrapping_mul(0xbf58_476d_1ce4_e5b9) ^ seed;
            let bits = bits.wrapping_mul(0x94d0_49bb_1331_11eb) >> 33;
            if holes && bits.is_multiple_of(50) { f64::NAN } else { (bits % 1000) as f64 }
        };
        let source_info = info("EPSG:32612", [90, 75], [5e5, 4e6], [10.0; 2]);
        let mut wish = wish("", Some(spacing), None);
        wish.interpolation = if cubic { Interpolation::Cubic } else { Interpolation::Linear };
        let mut placed = place(Box::new(formula(source_info.clone(), noise)), &wish).unwrap();
        let heights = all(&mut *placed);
        let (info, found) = (placed.info().clone(), placed.resampling());
        let Some(found) = found else { return Ok(()) };
        let (mut compared, mut uncovered, mut largest) = (0, 0, 0.0f64);
        for r in 0..source_info.height {
            for c in 0..source_info.width {
                let cells = |n: u32| {
                    let cells = f64::from(n) * 10.0 / spacing;
                    if (cells - cells.round()).abs() < 1e-6 { cells.round() } else { cells }
                };
                let (x, y) = (cells(c), cells(r));
                let height = noise(5e5 + f64::from(c) * 10.0, 4e6 - f64::from(r) * 10.0);
                if height.is_nan() || x > f64::from(info.width - 1) || y > f64::from(info.height - 1) {
                    continue;
                }
                match naive_surface(&info, &heights, x, y) {
                    Some(surface) => { compared += 1; largest = largest.max((surface - height).abs()); }
                    None => uncovered += 1,
                }
            }
        }
        prop_assert_eq!((found.compared, found.uncovered), (compared, uncovered));
        prop_assert!((found.largest_difference_m - largest).abs() < 1e-6);
    }
}

/// A triangle's height by its plane through three points, found among the cell's two.
fn naive_surface(info: &DemInfo, heights: &[f64], x: f64, y: f64) -> Option<f64> {
    let column = (x as u32).min(info.width - 2);
    let row = (y as u32).min(info.height - 2);
    let corner = |c: u32, r: u32| {
        let height = heights[(r * info.width + c) as usize];
        [f64::from(c), f64::from(r), height]
    };
    let (nw, ne) = (corner(column, row), corner(column + 1, row));
    let (sw, se) = (corner(column, row + 1), corner(column + 1, row + 1));
    // The cell's corner in the grid, which counts rows from the south.
    let cell = [column, info.height - 2 - row];
    let triangles = if cell[0] % 2 == cell[1] % 2 {
        [[sw, se, ne], [sw, ne, nw]]
    } else {
        [[nw, sw, se], [nw, se, ne]]
    };
    let solve = |[a, b, c]: [[f64; 3]; 3]| {
        let det = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
        let u = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / det;
        let v = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / det;
        let inside = u >= -1e-9 && v >= -1e-9 && u + v <= 1.0 + 1e-9;
        let height = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2]);
        (inside && !height.is_nan()).then_some(height)
    };
    triangles.into_iter().find_map(solve)
}

#[test]
fn a_hole_makes_holes_of_the_samples_that_it_would_count_in_and_no_more() {
    let hole = |x: f64, y: f64| {
        if (x, y) == (5e5 + 50.0, 4e6 - 50.0) {
            f64::NAN
        } else {
            1.0
        }
    };
    let source = formula(info("EPSG:32612", [11, 11], [5e5, 4e6], [10.0; 2]), hole);
    let mut placed = place(Box::new(source), &wish("", Some(5.0), None)).unwrap();
    for (height, [x, y]) in each(&mut *placed) {
        let near = (x - 5e5 - 50.0).abs() < 10.0 && (y - 4e6 + 50.0).abs() < 10.0;
        assert_eq!(height.is_nan(), near, "{x} {y}");
    }
}

#[test]
fn a_source_across_the_date_line_is_one_piece() {
    let height = |lon: f64, _: f64| crs::longitude::from_west(lon, 0.0);
    for west in [170.0, -190.0] {
        let source = formula(
            info("EPSG:4326", [201, 51], [west, -10.0], [0.1; 2]),
            height,
        );
        let bounds = Some([178.0, -14.0, -178.0, -12.0]);
        let mut placed = place(Box::new(source), &wish("", None, bounds)).unwrap();
        assert_eq!((placed.info().width, placed.info().height), (41, 21));
        for (height, [lon, _]) in each(&mut *placed) {
            assert!(
                (178.0 - 1e-6..182.0 + 1e-6).contains(&height),
                "{lon} {height}"
            );
        }
        let georef = crate::frame::georef_of(placed.info(), 1.0);
        let escarp_proto::georef::Plane::Geographic {
            middle_longitude_deg,
            ..
        } = georef.plane
        else {
            panic!();
        };
        assert!((middle_longitude_deg.abs() - 180.0).abs() < 1e-9);
    }
    // Fiji's map grid lies on both sides.
    let source = formula(
        info("EPSG:4326", [101, 51], [176.0, -15.0], [0.1; 2]),
        height,
    );
    let mut placed = place(Box::new(source), &wish("EPSG:3460", Some(10_000.0), None)).unwrap();
    let heights: Vec<f64> = all(&mut *placed)
        .into_iter()
        .filter(|h| !h.is_nan())
        .collect();
    assert!(placed.info().width < 150 && heights.len() > 4000);
    assert!(heights.iter().all(|h| (176.0..=186.0).contains(h)));
}

#[test]
fn a_whole_turn_has_no_seam() {
    // 0.5 degree cells around the world, without a column twice, from 20 to 379.5.
    let height = |lon: f64, _: f64| 1000.0 * lon.to_radians().cos();
    let source = formula(info("EPSG:4326", [720, 21], [20.0, 5.0], [0.5; 2]), height);
    let mut placed = place(
        Box::new(source),
        &wish("", None, Some([15.0, -5.0, 25.0, 5.0])),
    )
    .unwrap();
    assert_eq!((placed.info().width, placed.info().height), (21, 21));
    for (height, [lon, _]) in each(&mut *placed) {
        assert!(
            (height - 1000.0 * lon.to_radians().cos()).abs() < 1e-6,
            "{lon}"
        );
    }
    assert_eq!(placed.resampling(), None);
    // A rounded third of a degree is a whole turn, too, and its samples stay exact.
    let mut third = info("EPSG:4326", [1081, 21], [20.166_667, 5.0], [0.333_333_3; 2]);
    third.sample_type = SampleType::I16;
    let source = formula(third, |lon, _| (lon * 3.0).round());
    let bounds = Some([10.0, -1.0, 30.0, 1.0]);
    let mut placed = place(Box::new(source), &wish("", None, bounds)).unwrap();
    assert_eq!((placed.info().width, placed.resampling()), (60, None));
    assert!(all(&mut *placed).iter().all(|h| h.fract() == 0.0));
    let source = formula(info("EPSG:4326", [720, 21], [20.0, 5.0], [0.5; 2]), height);
    let mut placed = place(
        Box::new(source),
        &wish("EPSG:32633", Some(50_000.0), Some([0.0, -4e5, 1e6, 4e5])),
    )
    .unwrap();
    assert!(all(&mut *placed).iter().all(|h| !h.is_nan()));
}

#[test]
fn integers_are_rounded_to_a_quarter_of_their_step() {
    let mut info = info("EPSG:32612", [50, 50], [5e5, 4e6], [10.0; 2]);
    info.sample_type = SampleType::I16;
    let source = formula(info, |x, y| ((x - 5e5) * 0.1 + (4e6 - y) * 0.3).round());
    let mut placed = place(Box::new(source), &wish("", Some(7.0), None)).unwrap();
    assert!(placed.info().sample_type.is_integer());
    assert_eq!(placed.info().height_step_m, 0.25);
    assert!(all(&mut *placed).iter().all(|h| (h * 4.0).fract() == 0.0));
}

#[test]
fn what_cannot_be_placed_says_what_to_do() {
    let error = |crs: &str, wish: Wish| {
        let source = formula(info(crs, [50, 50], [10.0, 50.0], [0.1; 2]), |x, _| x);
        let placed = place(Box::new(source), &wish);
        placed.err().expect("an error").to_string()
    };
    let text = error("EPSG:4326", wish("", None, Some([100.0, 0.0, 110.0, 10.0])));
    assert!(text.contains("does not reach the bounds"), "{text}");
    let text = error("EPSG:4326", wish("", Some(f64::NAN), None));
    assert!(text.contains("spacing of NaN"), "{text}");
    let text = error("EPSG:4326", wish("", Some(1e-9), None));
    assert!(text.contains("wider --spacing"), "{text}");
    let text = error("EPSG:4326", wish("+proj=eqc +R=1737400", None, None));
    assert!(text.contains("same body"), "{text}");
    let text = error("", wish("EPSG:32633", None, None));
    assert!(text.contains("no georeference"), "{text}");
    let named = Crs::Projected {
        name: "Site grid".into(),
        metres_per_unit: 1.0,
    };
    let mut source = formula(info("", [5, 5], [0.0; 2], [1.0; 2]), |x, _| x);
    source.info.crs = named;
    let text = place(Box::new(source), &wish("EPSG:32633", None, None))
        .err()
        .unwrap();
    assert!(
        text.to_string().contains("does not say what it is"),
        "{text}"
    );
}

#[test]
fn without_georeference_bounds_are_metres_from_the_south_west() {
    let source = formula(info("", [11, 21], [0.0, 0.0], [10.0; 2]), |x, y| {
        x * 1000.0 + y
    });
    let mut placed = place(
        Box::new(source),
        &wish("", None, Some([20.0, 30.0, 50.0, 40.0])),
    )
    .unwrap();
    assert_eq!((placed.info().width, placed.info().height), (4, 2));
    // Row 0 lies at 0, the southern one at -200.
    assert_eq!(
        all(&mut *placed)[..4],
        [19_840.0, 29_840.0, 39_840.0, 49_840.0]
    );
}

#[test]
fn what_is_stated_does_not_depend_on_which_rows_were_read() {
    let rough = |x: f64, y: f64| (x * 0.37).sin() * 50.0 + (y * 0.11).cos() * 70.0;
    let placed = || {
        let source_info = info("EPSG:32612", [300, 400], [5e5, 4e6], [10.0; 2]);
        let mut wish = wish("EPSG:4326", None, None);
        wish.interpolation = Interpolation::Cubic;
        place(Box::new(formula(source_info, rough)), &wish).unwrap()
    };
    let (mut whole, mut resumed) = (placed(), placed());
    all(&mut *whole);
    let (width, height) = (resumed.info().width as usize, resumed.info().height);
    let from = height / 2;
    let mut half = vec![0.0; (height - from) as usize * width];
    resumed.read_rows(from, height - from, &mut half).unwrap();
    assert_ne!(whole.resampling(), resumed.resampling());
    resumed.finish().unwrap();
    assert_eq!(whole.resampling(), resumed.resampling());
}
