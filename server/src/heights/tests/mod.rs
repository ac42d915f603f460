//! Heights against oracles that read the whole raster and know nothing of the tree.

mod overviews;
mod points;
mod sights;
mod viewsheds;

use super::*;
use crate::PageSource;
use escarp_proto::geometry::PAGE_CELLS;
use escarp_tiles::build::{BuildOptions, build};
use escarp_tiles::dataset::{Dataset, PageReader};
use escarp_tiles::dem::{
    Crs, DemError, DemInfo, DemSource, OpenOptions, Placement, Registration, SampleType, open,
};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use tempfile::TempDir;

pub(crate) static GOES_ON: AtomicBool = AtomicBool::new(false);

/// A DEM from a function of column and row, row 0 the northern one; NaN is a hole.
pub(crate) struct FunctionSource<F> {
    info: DemInfo,
    height: F,
}

impl<F: Fn(u32, u32) -> f64 + Send> DemSource for FunctionSource<F> {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        let width = self.info.width;
        for (i, out) in out.iter_mut().enumerate().take((rows * width) as usize) {
            *out = (self.height)(i as u32 % width, first_row + i as u32 / width);
        }
        Ok(())
    }
}

/// Samples 10 m apart east and 20 m north, in UTM zone 32.
pub(crate) fn function<F: Fn(u32, u32) -> f64 + Send>(
    [width, height]: [u32; 2],
    heights: F,
) -> FunctionSource<F> {
    FunctionSource {
        info: DemInfo {
            path: PathBuf::from("function"),
            format: "function",
            width,
            height,
            placement: Placement {
                x0: 500_000.0,
                y0: 5_000_000.0,
                dx: 10.0,
                dy: 20.0,
            },
            crs: Crs::Projected {
                name: "EPSG:32632".into(),
                metres_per_unit: 1.0,
            },
            registration: Registration::Grid,
            sample_type: SampleType::I32,
            height_step_m: 1.0,
            nodata: None,
            vertical: Some("EGM96 height (EPSG:5773)".into()),
        },
        height: heights,
    }
}

/// A dataset, and its whole raster.
pub(crate) struct Made {
    pub(crate) dataset: Dataset,
    pub(crate) raster: Raster,
    _folder: TempDir,
}

impl Made {
    pub(crate) fn of(source: &mut dyn DemSource) -> Made {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("made.escarp");
        build(
            source,
            &path,
            Vec::new(),
            BuildOptions::default(),
            &|_, _| {},
        )
        .unwrap();
        let dataset = Dataset::open(&path).unwrap();
        Made {
            raster: Raster::read(&dataset),
            dataset,
            _folder: folder,
        }
    }

    /// Hills of 1,500 m with rough sides; with holes of several sizes if asked for.
    pub(crate) fn hills(size: [u32; 2], holes: bool) -> Made {
        Made::of(&mut function(size, move |x, y| {
            if holes && is_hole(x, y) {
                return f64::NAN;
            }
            let (u, v) = (f64::from(x) / 37.0, f64::from(y) / 23.0);
            let rough = f64::from(hash(x, y) % 40);
            (700.0 + 500.0 * u.sin() * v.cos() + 300.0 * (u * 0.3 + v).sin() + rough).round()
        }))
    }

    /// A DEM of the shared test data; `None` where that is absent.
    pub(crate) fn real(name: &str) -> Option<Made> {
        let Some(data) = std::env::var_os("ESCARP_DATA") else {
            eprintln!("ESCARP_DATA is not set: {name} is left out");
            return None;
        };
        let mut source = open(&Path::new(&data).join(name), &OpenOptions::default()).unwrap();
        Some(Made::of(source.as_mut()))
    }

    pub(crate) fn pages(&self) -> Pages<'_> {
        Pages::new(&self.dataset, Work::new(u64::MAX, u64::MAX, &GOES_ON))
    }

    pub(crate) fn frame(&self) -> Frame {
        let manifest = PageSource::manifest(&self.dataset);
        Frame::of(manifest, CoordinateKind::Native).unwrap()
    }
}

fn is_hole(x: u32, y: u32) -> bool {
    let lake = (f64::from(x) - 60.0).hypot(f64::from(y) - 50.0) < 22.0;
    lake || hash(x / 3, y / 3).is_multiple_of(97) || x + y < 30
}

pub(crate) fn hash(x: u32, y: u32) -> u32 {
    let mut v = x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77);
    for _ in 0..3 {
        v ^= v >> 15;
        v = v.wrapping_mul(0x2c1b_3c6d);
    }
    v ^ v >> 16
}

/// From 0 to below 1.
pub(crate) fn part(seed: u32, number: u32) -> f64 {
    f64::from(hash(seed, number)) / (f64::from(u32::MAX) + 1.0)
}

/// All finest samples, in quanta, row by row from the south.
pub(crate) struct Raster {
    pub(crate) size: [usize; 2],
    pub(crate) samples: Vec<Option<i32>>,
}

impl Raster {
    fn read(dataset: &Dataset) -> Raster {
        let size = dataset.manifest().samples.map(|n| n as usize);
        let mut samples = vec![None; size[0] * size[1]];
        let mut reader = PageReader::new(dataset);
        for row in 0..size[1].div_ceil(PAGE_CELLS) {
            let found = reader.page_row(row as u32).unwrap();
            for (i, sample) in found.into_iter().enumerate() {
                let at = row * PAGE_CELLS * size[0] + i;
                if at < samples.len() {
                    samples[at] = sample.or(samples[at]);
                }
            }
        }
        Raster { size, samples }
    }

    fn sample(&self, x: i64, y: i64) -> Option<f64> {
        let [width, height] = self.size.map(|n| n as i64);
        let inside = (0..width).contains(&x) && (0..height).contains(&y);
        inside.then(|| self.samples[(y * width + x) as usize].map(f64::from))?
    }

    /// The surface at a place, by looking at every triangle near it that may hold it; in quanta.
    pub(crate) fn height(&self, [x, y]: [f64; 2]) -> Option<f64> {
        let cells = |v: f64| [v.floor() as i64, v.ceil() as i64 - 1];
        for cy in cells(y) {
            for cx in cells(x) {
                for corners in triangles(cx, cy) {
                    if let Some(height) = self.on(corners, [x, y]) {
                        return Some(height);
                    }
                }
            }
        }
        None
    }

    /// By the areas of the triangle's three parts.
    fn on(&self, [a, b, c]: [(i64, i64); 3], [x, y]: [f64; 2]) -> Option<f64> {
        let area = |p: [f64; 2], q: [f64; 2], r: [f64; 2]| {
            (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
        };
        let place = |(x, y): (i64, i64)| [x as f64, y as f64];
        let (pa, pb, pc) = (place(a), place(b), place(c));
        let whole = area(pa, pb, pc);
        let parts = [
            area(pb, pc, [x, y]) / whole,
            area(pc, pa, [x, y]) / whole,
            area(pa, pb, [x, y]) / whole,
        ];
        let inside = parts.iter().all(|part| *part >= 0.0);
        let heights = [a, b, c].map(|(x, y)| self.sample(x, y));
        let [Some(a), Some(b), Some(c)] = heights else {
            return None;
        };
        inside.then(|| a * parts[0] + b * parts[1] + c * parts[2])
    }
}

/// The two triangles of a cell, counter-clockwise.
fn triangles(x: i64, y: i64) -> [[(i64, i64); 3]; 2] {
    let (sw, se, nw, ne) = ((x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1));
    match (x + y).rem_euclid(2) {
        0 => [[sw, se, ne], [sw, ne, nw]],
        _ => [[sw, se, nw], [se, ne, nw]],
    }
}
