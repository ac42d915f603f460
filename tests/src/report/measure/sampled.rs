//! A stated share of the samples in view, for datasets that do not fit in memory.
//!
//! A triangle that lies in one finest page is measured at all its samples. One that spans several
//! is measured at all its samples in [`TILES_A_TRIANGLE`] of them, which a hash of the triangle
//! chooses among those that it touches, area by area. Where that comes to more pages than
//! [`MOST_TILES`], a hash of the page decides which are read. Each sample counts for as many as it
//! stands for, so shares and quantiles are estimates; the largest deviation is that of the samples
//! measured, of which the count is stated.

use super::Triangle;
use super::judge::Judge;
use super::scan::{Area, scan};
use super::surface::{Heights, Tile};
use super::tally::{Promise, Tally};
use crate::terrain::hash;
use anyhow::Result;
use escarp_proto::geometry::PAGE_CELLS;
use escarp_tiles::dataset::{Dataset, PageReader};
use rayon::prelude::*;
use std::collections::HashMap;

/// Finest pages in which a triangle that spans several is measured.
pub const TILES_A_TRIANGLE: u32 = 2;
/// Finest pages that are read for a picture.
pub const MOST_TILES: usize = 6000;

/// Column and row of a finest page.
type Place = (u32, u32);

/// Triangles to be measured in each page: their number, and how much of each the page stands for.
type Jobs = HashMap<Place, Vec<(u32, f64)>>;

/// Measures a share of the samples in view.
pub fn measure(
    dataset: &Dataset,
    triangles: &[Triangle],
    judge: &Judge,
    promise: Promise,
) -> Result<Tally> {
    let mut tally = Tally::default();
    let jobs = collect(triangles, judge, &mut tally);
    let all = jobs.len();
    let mut jobs: Vec<(Place, Vec<(u32, f64)>)> = jobs.into_iter().collect();
    jobs.sort_unstable_by_key(|(place, _)| (hash(place.0, place.1), *place));
    jobs.truncate(MOST_TILES);
    tally.tiles = [jobs.len() as u64, all as u64];
    let share = jobs.len() as f64 / all.max(1) as f64;
    // Neighbours hang below the same pages.
    jobs.sort_unstable_by_key(|((x, y), _)| (x >> 4, y >> 4, *x, *y));
    let level = dataset.grid().finest_page_level();
    let measured: Result<Vec<Tally>> = jobs
        .par_chunks(64)
        .map_init(
            || PageReader::new(dataset),
            |reader, some| -> Result<Tally> {
                let mut tally = Tally::default();
                for (place, list) in some {
                    let Some(tile) = Tile::read(reader, level, *place)? else {
                        continue;
                    };
                    for &(number, part) in list {
                        let triangle = &triangles[number as usize];
                        in_tile(&tile, triangle, part / share, judge, promise, &mut tally);
                    }
                }
                Ok(tally)
            },
        )
        .collect();
    Ok(measured?.iter().fold(tally, Tally::merge))
}

/// Which pages to read for which triangles. Those that are part of the surface need none.
fn collect(triangles: &[Triangle], judge: &Judge, tally: &mut Tally) -> Jobs {
    let mut jobs = Jobs::new();
    for (number, triangle) in triangles.iter().enumerate() {
        if !triangle.drawn || !judge.may_see(&judge.box_of(&triangle.corners)) {
            continue;
        }
        if triangle.exact {
            tally.add_exact(0, samples_of(triangle));
            continue;
        }
        let places = places_of(triangle);
        let part = 1.0 / places.len() as f64;
        for place in places {
            jobs.entry(place).or_default().push((number as u32, part));
        }
    }
    jobs
}

/// Samples that a triangle has for its own: half of its doubled area.
fn samples_of(triangle: &Triangle) -> f64 {
    let [a, b, c] = triangle
        .corners
        .map(|(x, y, _)| (f64::from(x), f64::from(y)));
    ((b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0)) / 2.0
}

/// The pages in which to measure a triangle.
fn places_of(triangle: &Triangle) -> Vec<Place> {
    let side = PAGE_CELLS as u32;
    let area = Area::of(&triangle.corners);
    // A triangle that ends on a border of pages lies on its lower side.
    let last = |[low, high]: [u32; 2]| (high - 1).max(low) / side;
    let first = (area.x[0] / side, area.y[0] / side);
    if first == (last(area.x), last(area.y)) {
        return vec![first];
    }
    let [a, b, c] = triangle
        .corners
        .map(|(x, y, _)| (f64::from(x), f64::from(y)));
    let mut places: Vec<Place> = (0..TILES_A_TRIANGLE)
        .map(|i| {
            let seed = hash(hash(area.x[0], area.y[0]), triangle.corners[0].0 ^ i << 20);
            let unit = |h: u32| f64::from(h) / f64::from(u32::MAX);
            let (u, v) = (unit(seed), unit(hash(seed, triangle.corners[1].1)));
            // Folded, so that every point of the triangle is as likely (Turk, "Generating Random
            // Points in Triangles", 1990).
            let (u, v) = if u + v > 1.0 {
                (1.0 - u, 1.0 - v)
            } else {
                (u, v)
            };
            let x = a.0 + u * (b.0 - a.0) + v * (c.0 - a.0);
            let y = a.1 + u * (b.1 - a.1) + v * (c.1 - a.1);
            let page = |w: f64, ends: [u32; 2]| (w as u32).min(ends[1] - 1) / side;
            (page(x, area.x), page(y, area.y))
        })
        .collect();
    places.sort_unstable();
    places.dedup();
    places
}

/// Measures the samples of a triangle in a page, which stand for a part of the triangle's.
fn in_tile(
    tile: &Tile,
    triangle: &Triangle,
    part: f64,
    judge: &Judge,
    promise: Promise,
    tally: &mut Tally,
) {
    let mut points = 0u32;
    scan(&triangle.corners, tile.area(), 1, |_| points += 1);
    let weight = samples_of(triangle) * part / f64::from(points.max(1));
    scan(&triangle.corners, tile.area(), 1, |point| {
        let Some(sample) = tile.height(point.x, point.y) else {
            return;
        };
        if let Some(at_m) = judge.sees(point.x, point.y, sample) {
            let up_m = (point.height - f64::from(sample)) * judge.georef().quantum_m;
            tally.add(judge.deviation(at_m, up_m), promise, weight);
        }
    });
}
