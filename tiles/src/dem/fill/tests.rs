//! Fills against what a look at every sample says.

use super::super::testing::{Folder, Tag, Tiff, real_data};
use super::super::{OpenOptions, SampleType, open};
use super::*;
use proptest::prelude::*;

const HOLE: f64 = -9999.0;

fn source(width: u32, height: u32, heights: &[f64], sample: SampleType) -> Box<dyn DemSource> {
    let folder = Folder::new();
    let bytes = Tiff::plain(width, height, sample)
        .with(42113, Tag::Text("-9999"))
        .bytes(|r, c| heights[(r * width + c) as usize]);
    let path = folder.write("a.tif", &bytes);
    let mut file = open(&path, &OpenOptions::default()).unwrap();
    let mut read = vec![0.0; (width * height) as usize];
    file.read_rows(0, height, &mut read).unwrap();
    Box::new(Held {
        info: file.info().clone(),
        heights: read,
    })
}

/// A source in memory.
struct Held {
    info: DemInfo,
    heights: Vec<f64>,
}

impl DemSource for Held {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, _: u32, out: &mut [f64]) -> Result<(), DemError> {
        let start = (first_row * self.info.width) as usize;
        out.copy_from_slice(&self.heights[start..start + out.len()]);
        Ok(())
    }
}

fn filled(source: Box<dyn DemSource>, max_samples: u32) -> (Vec<f64>, Fills) {
    let (width, height) = (source.info().width, source.info().height);
    let mut filled = Filled::new(source, max_samples, &|_, _| {}).unwrap();
    let mut out = vec![0.0; (width * height) as usize];
    for row in (0..height).rev() {
        let start = (row * width) as usize;
        let to = &mut out[start..start + width as usize];
        filled.read_rows(row, 1, to).unwrap();
    }
    (out, filled.fills().unwrap().clone())
}

/// The void of each sample, by flooding: its samples, and whether it reaches the border.
fn flood(width: usize, heights: &[f64], start: usize) -> (Vec<usize>, bool) {
    let rows = heights.len() / width;
    let (mut seen, mut todo, mut outside) = (vec![start], vec![start], false);
    while let Some(at) = todo.pop() {
        let (x, y) = (at % width, at / width);
        outside |= x == 0 || y == 0 || x + 1 == width || y + 1 == rows;
        for (dx, dy) in (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy))) {
            let (Some(u), Some(v)) = (x.checked_add_signed(dx), y.checked_add_signed(dy)) else {
                continue;
            };
            let next = v * width + u;
            if u < width && v < rows && heights[next] == HOLE && !seen.contains(&next) {
                seen.push(next);
                todo.push(next);
            }
        }
    }
    (seen, outside)
}

proptest! {
    #[test]
    fn exactly_the_enclosed_voids_up_to_the_size_are_filled_within_the_range_of_their_rims(
        width in 1usize..14,
        given in prop::collection::vec(prop_oneof![2 => Just(HOLE), 3 => (-50..50i32).prop_map(f64::from)], 1..160),
        max_samples in 1u32..12,
        whole: bool,
    ) {
        let rows = given.len().div_ceil(width);
        let mut given = given;
        given.resize(rows * width, 3.0);
        let sample = if whole { SampleType::I16 } else { SampleType::F32 };
        let (found, fills) = filled(source(width as u32, rows as u32, &given, sample), max_samples);
        let mut marked = vec![false; given.len()];
        for run in &fills.runs {
            let start = run.row as usize * width + run.column as usize;
            marked[start..start + run.length as usize].fill(true);
        }
        prop_assert_eq!(fills.samples, marked.iter().filter(|m| **m).count() as u64);
        for at in 0..given.len() {
            if given[at] != HOLE {
                prop_assert_eq!(found[at], given[at]);
                continue;
            }
            let (void, outside) = flood(width, &given, at);
            let is_filled = !outside && void.len() <= max_samples as usize;
            prop_assert_eq!(marked[at], is_filled);
            prop_assert_eq!(found[at].is_nan(), !is_filled);
            if is_filled {
                prop_assert!(!whole || found[at].fract() == 0.0);
                let rim = void.iter().flat_map(|&i| [i - 1, i + 1, i - width, i + width]);
                let rim: Vec<f64> = rim.map(|i| given[i]).filter(|h| *h != HOLE).collect();
                let low = rim.iter().copied().fold(f64::INFINITY, f64::min);
                let high = rim.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                prop_assert!((low..=high).contains(&found[at]));
            }
        }
    }

    #[test]
    fn an_even_slope_goes_on_evenly_and_each_height_is_the_mean_of_those_beside_it(
        (a, b) in (-20..20i32, -20..20i32),
        holes in prop::collection::vec(any::<bool>(), 900),
        bumps in prop::collection::vec(-9..9i32, 900),
        even: bool,
    ) {
        let side = 32;
        let inside = |i: usize| (1..31).contains(&(i % side)) && (1..31).contains(&(i / side));
        let slope = |i: usize| f64::from(a) * (i % side) as f64 + f64::from(b) * (i / side) as f64;
        let bump = |i: usize| if even { 0.0 } else { f64::from(bumps[i % 900]) };
        let given: Vec<f64> = (0..side * side)
            .map(|i| if inside(i) && holes[i % 900] { HOLE } else { slope(i) + bump(i) })
            .collect();
        let (found, fills) = filled(source(32, 32, &given, SampleType::F64), 1024);
        prop_assert_eq!(fills.samples as usize, given.iter().filter(|h| **h == HOLE).count());
        for i in (0..given.len()).filter(|&i| given[i] == HOLE) {
            let mean = (found[i - 1] + found[i + 1] + found[i - side] + found[i + side]) / 4.0;
            prop_assert!((found[i] - mean).abs() < 1e-3, "{} {mean}", found[i]);
            prop_assert!(!even || (found[i] - slope(i)).abs() < 1e-2);
        }
    }
}

#[test]
fn a_void_that_reaches_the_border_by_a_corner_only_stays_a_hole() {
    let mut given = vec![1.0; 36];
    for at in [0, 7, 14] {
        given[at] = HOLE;
    }
    let (found, fills) = filled(source(6, 6, &given, SampleType::I16), 100);
    assert_eq!((fills.samples, fills.voids, fills.left), (0, 0, 0));
    assert!(found[14].is_nan());
}

#[test]
fn a_void_that_is_too_large_stays_and_is_counted() {
    let mut given = vec![1.0; 100];
    for at in [22, 23, 24, 66] {
        given[at] = HOLE;
    }
    let (found, fills) = filled(source(10, 10, &given, SampleType::I16), 2);
    assert_eq!((fills.samples, fills.voids, fills.left), (1, 1, 1));
    assert!(found[23].is_nan() && found[66] == 1.0);
}

#[test]
fn a_size_beyond_the_limit_is_refused() {
    for size in [0, MAX_FILL_SAMPLES + 1] {
        let given = source(2, 2, &[1.0; 4], SampleType::I16);
        let refused = Filled::new(given, size, &|_, _| {}).err().unwrap();
        assert!(refused.to_string().contains("give 1 to"), "{refused}");
    }
}

#[test]
fn the_voids_of_everest_are_filled_within_its_heights() {
    let Some(data) = real_data() else { return };
    let path = data.join("mt_everest_90m.tif");
    let dem = open(&path, &OpenOptions::default()).unwrap();
    let mut filled = Filled::new(dem, DEFAULT_FILL_SAMPLES, &|_, _| {}).unwrap();
    let fills = filled.fills().unwrap().clone();
    assert!(
        fills.samples == 90_205 && fills.left == 0,
        "{} {}",
        fills.samples,
        fills.left
    );
    let mut heights = vec![0.0; 1201 * 1201];
    filled.read_rows(0, 1201, &mut heights).unwrap();
    let holes = heights.iter().filter(|h| h.is_nan()).count() as u64;
    assert_eq!(holes + fills.samples, 130_953);
    assert!(
        heights
            .iter()
            .all(|h| h.is_nan() || (192.0..=8642.0).contains(h))
    );
}
