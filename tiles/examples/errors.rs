//! What a better bound of the error is worth: triangles of a mesh that keeps a tolerance
//! everywhere, and CPU time, for four ways to tell how far a triangle is from the surface.
//!
//! ```text
//! cargo run --release -p escarp-tiles --example errors -- 1,5,20 moon.tif
//! ```
//!
//! The ways: *exact*, the largest deviation of all full-resolution samples in the triangle; *ours*,
//! that of a dataset: exact within a page, plus the coded bound of the cell below it; *sum*, a
//! triangle's own deviation where it is split, plus the largest of the two it splits into; *local*,
//! the own deviation alone, which is Ulrich's and bounds nothing.
//!
//! Areas are squares of 4096 cells, or of 256 where the data is smaller; those with holes are left
//! out. A mesh is conforming: a vertex is there if a triangle that it splits is too far off, or if
//! another vertex depends on it.

use anyhow::{Context, Result, bail};
use escarp_proto::geometry::{Edge, PAGE_CELLS, PAGE_LEVELS, PAGE_SAMPLES, PageId, Slot};
use escarp_proto::page::{Bounds, ChildSlot, PAGE_AREA, Page};
use escarp_tiles::build::{Quantum, choose_quantum};
use escarp_tiles::dem::{DemSource, OpenOptions, open_all};
use escarp_tiles::process;
use std::path::PathBuf;

/// The most samples that are looked at, so that memory is bounded.
const MOST_SAMPLES: usize = 1 << 25;

const WAYS: [&str; 4] = ["exact", "ours", "sum", "local"];

/// Heights of a square of `cells` a side, row by row from the south-west.
struct Area {
    cells: usize,
    heights: Vec<i32>,
}

/// For each vertex the error of the triangles that it splits, in half quanta.
type Errors = Vec<u64>;

fn main() -> Result<()> {
    let mut words = std::env::args().skip(1);
    let usage = "usage: errors E,E,... INPUT...   (E: tolerances in metres)";
    let tolerances: Vec<f64> = words
        .next()
        .context(usage)?
        .split(',')
        .map(|word| word.parse().with_context(|| format!("tolerance {word:?}")))
        .collect::<Result<_>>()?;
    let inputs: Vec<PathBuf> = words.map(PathBuf::from).collect();
    if inputs.is_empty() {
        bail!(usage);
    }
    let mut source = open_all(&inputs, &OpenOptions::default())?;
    let quantum_m = choose_quantum(&mut *source, Quantum::Natural)?;
    let areas = areas(&mut *source, quantum_m)?;
    let Some(first) = areas.first() else {
        bail!("no square of 257 samples a side without holes");
    };
    println!(
        "{} areas of {} cells a side, heights in steps of {quantum_m} m",
        areas.len(),
        first.cells
    );
    let ways: [fn(&Area) -> Errors; 4] = [exact, ours, sum, local];
    let mut triangles = vec![[0; 4]; tolerances.len()];
    let mut cpu_s = [0.0; 4];
    for area in &areas {
        for (way, errors) in ways.iter().enumerate() {
            let before = process::usage().map_or(0.0, |usage| usage.cpu_s);
            let errors = errors(area);
            cpu_s[way] += process::usage().map_or(0.0, |usage| usage.cpu_s) - before;
            for (tolerance, triangles) in tolerances.iter().zip(&mut triangles) {
                let most = (2.0 * tolerance / quantum_m).floor() as u64;
                triangles[way] += count(area.cells, &errors, most);
            }
        }
    }
    println!("| E, m | {} |", WAYS.join(" | "));
    println!("|---|---|---|---|---|");
    for (tolerance, triangles) in tolerances.iter().zip(triangles) {
        let share = |way: usize| {
            let more = 100.0 * (triangles[way] as f64 / triangles[0] as f64 - 1.0);
            format!("{} ({more:+.1} %)", triangles[way])
        };
        let cells: Vec<String> = (0..4).map(share).collect();
        println!("| {tolerance} | {} |", cells.join(" | "));
    }
    let samples: usize = areas.iter().map(|area| area.cells * area.cells).sum();
    let speeds = cpu_s.map(|s| format!("{s:.2} s, {:.1} M/s", samples as f64 / 1e6 / s));
    println!("| CPU | {} |", speeds.join(" | "));
    Ok(())
}

/// Squares without holes, side by side, from the north-west.
fn areas(source: &mut dyn DemSource, quantum_m: f64) -> Result<Vec<Area>> {
    let (width, height) = (source.info().width as usize, source.info().height as usize);
    let cells = if width.min(height) > 4096 { 4096 } else { 256 };
    let side = cells + 1;
    let mut found = Vec::new();
    let mut band = vec![0.0; side * width];
    for first in (0..height.saturating_sub(cells)).step_by(cells) {
        source.read_rows(first as u32, side as u32, &mut band)?;
        for west in (0..width.saturating_sub(cells)).step_by(cells) {
            if (found.len() + 1) * side * side > MOST_SAMPLES {
                return Ok(found);
            }
            let rows = band.chunks_exact(width).rev();
            let metres = rows.flat_map(|row| &row[west..west + side]);
            if metres.clone().any(|metres| metres.is_nan()) {
                continue;
            }
            let heights = metres.map(|metres| (metres / quantum_m).round() as i32);
            found.push(Area {
                cells,
                heights: heights.collect(),
            });
        }
    }
    Ok(found)
}

impl Area {
    fn side(&self) -> usize {
        self.cells + 1
    }

    fn height(&self, at: usize) -> i64 {
        i64::from(self.heights[at])
    }

    fn levels(&self) -> u32 {
        self.cells.ilog2()
    }

    /// Outwards and along, by [`Edge`], in places of a row-major grid.
    fn ways(&self) -> [(isize, isize); 4] {
        let row = self.side() as isize;
        [(1, row), (row, 1), (-1, row), (-row, 1)]
    }

    /// Calls `each` with cells on the side, south-western vertex and diagonal of every square.
    fn squares(&self, level: u32, mut each: impl FnMut(usize, usize, bool)) {
        let cells = self.cells >> level;
        for row in 0..1 << level {
            for column in 0..1usize << level {
                let south_west = row * cells * self.side() + column * cells;
                each(cells, south_west, (row + column) % 2 == 0);
            }
        }
    }

    fn centre(&self, cells: usize, south_west: usize) -> usize {
        south_west + cells / 2 * self.side() + cells / 2
    }

    /// Twice the distance of a vertex from the middle of two others `reach` away.
    fn off_middle(&self, at: usize, reach: usize) -> u64 {
        (2 * self.height(at) - self.height(at - reach) - self.height(at + reach)).unsigned_abs()
    }

    /// From the middle to the ends of the diagonal.
    fn diagonal(&self, cells: usize, rises: bool) -> usize {
        cells / 2
            * if rises {
                self.side() + 1
            } else {
                self.side() - 1
            }
    }

    fn note(&self, errors: &mut Errors, at: usize, error: u64) {
        errors[at] = errors[at].max(error);
    }
}

fn step(at: usize, by: isize) -> usize {
    at.wrapping_add_signed(by)
}

/// Twice `scaled / scale`, rounded up.
fn doubled(scaled: u64, scale: usize) -> u64 {
    2 * scaled.div_ceil(scale as u64)
}

fn exact(area: &Area) -> Errors {
    let mut errors = vec![0; area.heights.len()];
    for level in 0..area.levels() {
        area.squares(level, |cells, sw, rises| {
            let centre = area.centre(cells, sw);
            for (out, along) in area.ways() {
                let error = edge_triangle(area, centre, (out, along), cells);
                area.note(&mut errors, step(centre, out * (cells / 2) as isize), error);
            }
            let row = area.side() as isize;
            let (se, nw) = (sw + cells, sw + cells * area.side());
            let halves = match rises {
                true => [(se, -1, row), (nw, 1, -row)],
                false => [(sw, 1, row), (nw + cells, -1, -row)],
            };
            for (corner, along, up) in halves {
                let error = half(area, corner, (along, up), cells);
                area.note(&mut errors, centre, error);
            }
        });
    }
    errors
}

fn edge_triangle(area: &Area, centre: usize, (out, along): (isize, isize), cells: usize) -> u64 {
    let half = (cells / 2) as isize;
    let at = |u: isize, v: isize| area.height(step(centre, u * along + v * out));
    let (middle, left, right) = (at(0, 0), at(-half, half), at(half, half));
    let mut largest = 0;
    for v in 1..=half {
        let mut plane = cells as i64 * middle + 2 * v as i64 * (left - middle);
        for u in -v..=v {
            largest = largest.max((cells as i64 * at(u, v) - plane).unsigned_abs());
            plane += right - left;
        }
    }
    doubled(largest, cells)
}

fn half(area: &Area, corner: usize, (along, up): (isize, isize), cells: usize) -> u64 {
    let side = cells as isize;
    let at = |u: isize, v: isize| area.height(step(corner, u * along + v * up));
    let (start, end, top) = (at(0, 0), at(side, 0), at(0, side));
    let mut largest = 0;
    for v in 0..=side {
        let mut plane = cells as i64 * start + v as i64 * (top - start);
        for u in 0..=side - v {
            largest = largest.max((cells as i64 * at(u, v) - plane).unsigned_abs());
            plane += end - start;
        }
    }
    doubled(largest, cells)
}

/// Pages from the finest level up, as a build makes them.
fn ours(area: &Area) -> Errors {
    let mut errors = vec![0; area.heights.len()];
    let mut below: Option<Vec<ChildSlot>> = None;
    let mut stride = 1;
    let mut level = area.levels() as u8;
    while let Some(page_level) = level.checked_sub(PAGE_LEVELS) {
        level = page_level;
        let pages = 1 << level;
        let mut slots = Vec::with_capacity(pages * pages);
        for (row, column) in (0..pages).flat_map(|row| (0..pages).map(move |column| (row, column)))
        {
            let south_west = (row * area.side() + column) * PAGE_CELLS * stride;
            let at = |i: usize| {
                let (x, y) = (i % PAGE_SAMPLES, i / PAGE_SAMPLES);
                south_west + (y * area.side() + x) * stride
            };
            let heights: [i32; PAGE_AREA] = std::array::from_fn(|i| area.heights[at(i)]);
            let own = below.as_ref().map(|below| {
                Box::new(std::array::from_fn(|i| {
                    let (x, y) = Slot::from_index(i as u8).position();
                    below[(row * PAGE_CELLS + y) * pages * PAGE_CELLS + column * PAGE_CELLS + x]
                }))
            });
            let id = PageId::new(level, column as u32, row as u32);
            let made = id.map(|id| Page::with_slot(id, Box::new(heights), None, own));
            let Some(Ok((page, slot))) = made else {
                continue; // heights of a DEM within the limits make a page
            };
            note_page(area, &page, south_west, stride, &mut errors);
            slots.push(slot);
        }
        below = Some(slots);
        stride *= PAGE_CELLS;
    }
    errors
}

fn note_page(area: &Area, page: &Page, south_west: usize, stride: usize, errors: &mut Errors) {
    let bounds = Bounds::derive(page, None);
    for level in 0..PAGE_LEVELS {
        let cells = (PAGE_CELLS >> level) * stride;
        for (row, column) in (0..1 << level).flat_map(|row| (0..1 << level).map(move |c| (row, c)))
        {
            let centre = area.centre(cells, south_west + (row * area.side() + column) * cells);
            let own = bounds.box_error(level, column, row).error;
            area.note(errors, centre, 2 * u64::from(own));
            let square = bounds.square(level, column, row);
            for (edge, (out, _)) in Edge::ALL.into_iter().zip(area.ways()) {
                let at = step(centre, out * (cells / 2) as isize);
                area.note(errors, at, 2 * u64::from(square.edges[edge as usize]));
            }
        }
    }
}

/// A triangle's own deviation, plus the largest sum of the two that it splits into.
fn sum(area: &Area) -> Errors {
    let mut errors = vec![0; area.heights.len()];
    // By square of the level below: its southern and northern half.
    let mut below: Vec<[u64; 2]> = Vec::new();
    for level in (0..area.levels()).rev() {
        let mut halves = Vec::new();
        let mut number = 0;
        area.squares(level, |cells, sw, rises| {
            let (row, column) = (number >> level, number & ((1 << level) - 1));
            number += 1;
            let child = |x: usize, y: usize, half: usize| {
                let at = ((2 * row + y) << (level + 1)) + 2 * column + x;
                below.get(at).map_or(0, |halves| halves[half])
            };
            // East, north, west, south: the halves on that side of the two quadrants there.
            let deepest = [
                child(1, 1, 0).max(child(1, 0, 1)),
                child(1, 1, 1).max(child(0, 1, 1)),
                child(0, 1, 0).max(child(0, 0, 1)),
                child(0, 0, 0).max(child(1, 0, 0)),
            ];
            let centre = area.centre(cells, sw);
            let mut edges = [0; 4];
            for (i, (out, along)) in area.ways().into_iter().enumerate() {
                let at = step(centre, out * (cells / 2) as isize);
                edges[i] = area.off_middle(at, along as usize * cells / 2) + deepest[i];
                area.note(&mut errors, at, edges[i]);
            }
            let [east, north, west, south] = edges;
            let own = area.off_middle(centre, area.diagonal(cells, rises));
            let both = match rises {
                true => [south.max(east), north.max(west)],
                false => [south.max(west), north.max(east)],
            };
            let both = both.map(|below| own + below);
            area.note(&mut errors, centre, both[0].max(both[1]));
            halves.push(both);
        });
        below = halves;
    }
    errors
}

fn local(area: &Area) -> Errors {
    let mut errors = vec![0; area.heights.len()];
    for level in 0..area.levels() {
        area.squares(level, |cells, sw, rises| {
            let centre = area.centre(cells, sw);
            for (out, along) in area.ways() {
                let at = step(centre, out * (cells / 2) as isize);
                errors[at] = area.off_middle(at, along as usize * cells / 2);
            }
            errors[centre] = area.off_middle(centre, area.diagonal(cells, rises));
        });
    }
    errors
}

/// Triangles of the coarsest conforming mesh in which no triangle has more than `most`.
fn count(cells: usize, errors: &Errors, most: u64) -> u64 {
    let side = cells + 1;
    let mut enabled: Vec<bool> = errors.iter().map(|error| *error > most).collect();
    let mut triangles = 2;
    let mut reach = 1;
    while reach < cells {
        let square = 2 * reach;
        // Edge vertices: each needs the centres on its two sides.
        for y in (0..side).step_by(reach) {
            let along_row = (y / reach) % 2 == 0;
            for x in ((if along_row { reach } else { 0 })..side).step_by(square) {
                if !enabled[y * side + x] {
                    continue;
                }
                let (dx, dy) = if along_row { (0, reach) } else { (reach, 0) };
                if x >= dx && y >= dy {
                    enabled[(y - dy) * side + x - dx] = true;
                    triangles += 1;
                }
                if x + dx < side && y + dy < side {
                    enabled[(y + dy) * side + x + dx] = true;
                    triangles += 1;
                }
            }
        }
        // Centres: each needs the two edge vertices of its parent that are its square's corners.
        for (row, y) in (reach..side).step_by(square).enumerate() {
            for (column, x) in (reach..side).step_by(square).enumerate() {
                if !enabled[y * side + x] {
                    continue;
                }
                triangles += 2;
                if square == cells {
                    continue;
                }
                let (west, south) = (x - reach, y - reach);
                let (east, north) = (x + reach, y + reach);
                // The other diagonal runs from the parent's corner to its centre.
                let corners = match (row + column) % 2 {
                    0 => [(east, south), (west, north)],
                    _ => [(west, south), (east, north)],
                };
                for (x, y) in corners {
                    enabled[y * side + x] = true;
                }
            }
        }
        reach = square;
    }
    triangles
}
