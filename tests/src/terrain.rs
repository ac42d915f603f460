//! Datasets made from functions.

use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;
use escarp_tiles::build::{BuildError, BuildOptions, Coarsened, Quantum, Tolerances, Wish, build};
use escarp_tiles::dataset::{Dataset, PageReader};
use escarp_tiles::dem::{Crs, DemError, DemInfo, DemSource, Placement, Registration, SampleType};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tempfile::TempDir;

/// Height in metres of a column and row, row 0 the northern one; NaN is a hole.
pub type Heights = fn(u32, u32) -> f64;

/// Heights of a grid from a function of column and row, row 0 the northern one; NaN is a hole.
pub struct FunctionSource<F> {
    info: DemInfo,
    height: F,
}

impl<F: Fn(u32, u32) -> f64 + Send> FunctionSource<F> {
    /// `width` x `height` samples, 10 m apart, stored in whole metres.
    pub fn new(width: u32, height: u32, heights: F) -> Self {
        Self::spaced(width, height, [10.0, 10.0], heights)
    }

    /// As [`new`](Self::new), with another distance between samples, east and north, metres.
    pub fn spaced(width: u32, height: u32, [dx, dy]: [f64; 2], heights: F) -> Self {
        let info = DemInfo {
            path: PathBuf::from("function"),
            format: "function",
            width,
            height,
            placement: Placement {
                x0: 1000.0,
                y0: 2000.0 + f64::from(height - 1) * dy,
                dx,
                dy,
            },
            crs: Crs::Projected {
                name: "EPSG:32632".into(),
                metres_per_unit: 1.0,
            },
            registration: Registration::Grid,
            sample_type: SampleType::I32,
            height_step_m: 1.0,
            nodata: None,
            vertical: None,
        };
        FunctionSource {
            info,
            height: heights,
        }
    }

    /// With what is said of it changed.
    pub fn with(mut self, change: impl FnOnce(&mut DemInfo)) -> Self {
        change(&mut self.info);
        self
    }
}

impl<F: Fn(u32, u32) -> f64 + Send> DemSource for FunctionSource<F> {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        for (i, out) in out
            .iter_mut()
            .enumerate()
            .take((rows * self.info.width) as usize)
        {
            let (column, row) = (i as u32 % self.info.width, i as u32 / self.info.width);
            *out = (self.height)(column, first_row + row);
        }
        Ok(())
    }
}

/// Where a [`TempDataset`] lies in its folder.
const FOLDER: &str = "test.escarp";

/// A dataset in a folder that goes with it.
pub struct TempDataset {
    /// The open dataset.
    pub dataset: Dataset,
    /// Heights in quanta by grid `x` and `y`; `None` is a hole.
    pub samples: Vec<Option<i32>>,
    folder: Arc<TempDir>,
}

impl TempDataset {
    /// Builds a dataset from a function, as [`FunctionSource`] has it.
    ///
    /// # Panics
    /// If it cannot be built.
    pub fn of(width: u32, height: u32, heights: impl Fn(u32, u32) -> f64 + Send) -> TempDataset {
        let mut source = FunctionSource::new(width, height, heights);
        Self::build(&mut source)
    }

    /// Builds a dataset from a source.
    ///
    /// # Panics
    /// If it cannot be built.
    pub fn build(source: &mut dyn DemSource) -> TempDataset {
        Self::build_with(source, Quantum::Natural).expect("the dataset builds")
    }

    /// Builds a dataset from a source, with this quantum.
    ///
    /// # Errors
    /// Those of [`build`].
    ///
    /// # Panics
    /// If there is no temporary folder, or the dataset does not open.
    pub fn build_with(
        source: &mut dyn DemSource,
        quantum: Quantum,
    ) -> Result<TempDataset, BuildError> {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join(FOLDER);
        build_with(&path, source, quantum, true)?;
        let dataset = Dataset::open(&path).expect("the dataset opens");
        let samples = read_samples(&dataset);
        Ok(TempDataset {
            dataset,
            samples,
            folder: Arc::new(folder),
        })
    }

    /// Builds a dataset from a function, stored no more exactly than it must be.
    ///
    /// # Panics
    /// If it cannot be built.
    pub fn coarse(
        width: u32,
        height: u32,
        heights: impl Fn(u32, u32) -> f64 + Send + 'static,
        tolerance_m: f64,
    ) -> TempDataset {
        let source = FunctionSource::new(width, height, heights);
        let wish = Wish {
            tolerance_m,
            region: None,
        };
        let tolerances = Tolerances::open(&[wish], source.info()).expect("a tolerance");
        let coarse = Coarsened::new(Box::new(source), 1.0, tolerances);
        Self::build(&mut coarse.expect("it fits a grid"))
    }

    /// The dataset's folder.
    pub fn path(&self) -> PathBuf {
        self.folder.path().join(FOLDER)
    }

    /// The dataset once more, as a server opens it.
    ///
    /// # Panics
    /// If it does not open.
    pub fn open(&self) -> Dataset {
        Dataset::open(&self.path()).expect("the dataset opens")
    }

    /// A generation of the dataset, as a server opens it.
    ///
    /// # Panics
    /// If it does not open.
    pub fn open_generation(&self, generation: u64) -> Dataset {
        Dataset::open_generation(&self.path(), generation).expect("the generation opens")
    }

    /// The newest generation, in the same folder.
    ///
    /// # Panics
    /// If it does not open.
    pub fn newest(&self) -> TempDataset {
        let dataset = self.open();
        let samples = read_samples(&dataset);
        TempDataset {
            dataset,
            samples,
            folder: self.folder.clone(),
        }
    }

    /// Sample at grid `x`, `y`; beyond the data there are holes.
    pub fn sample(&self, x: u32, y: u32) -> Option<i32> {
        let [width, height] = self.dataset.manifest().samples;
        if x >= width || y >= height {
            return None;
        }
        self.samples[y as usize * width as usize + x as usize]
    }
}

/// Builds a dataset in a folder, replacing what is there.
///
/// # Panics
/// If it cannot be built.
pub fn build_at(path: &Path, source: &mut dyn DemSource) {
    let built = build_with(path, source, Quantum::Natural, true);
    built.expect("the dataset builds");
}

/// Builds a dataset in a folder.
///
/// # Errors
/// Those of [`build`].
pub fn build_with(
    path: &Path,
    source: &mut dyn DemSource,
    quantum: Quantum,
    overwrite: bool,
) -> Result<Manifest, BuildError> {
    let options = BuildOptions {
        quantum,
        overwrite,
        ..BuildOptions::default()
    };
    build(source, path, vec!["test".into()], options, &|_, _| {})
}

/// Columns and rows of [`kinds`].
pub const KINDS_SIZE: (u32, u32) = (230, 190);

/// Small terrains of all kinds, by name.
pub fn kinds() -> Vec<(&'static str, TempDataset)> {
    let (w, h) = KINDS_SIZE;
    vec![
        ("hills", TempDataset::of(w, h, hills)),
        ("holed hills", TempDataset::of(w, h, holed_hills)),
        ("coarse hills", TempDataset::coarse(w, h, hills, 25.0)),
        ("cliff", TempDataset::of(w, h, cliff)),
        ("spike", TempDataset::of(w, h, spike)),
        ("flat", TempDataset::of(w, h, |_, _| 12.0)),
    ]
}

/// All samples of a dataset, row by row from the south.
///
/// # Panics
/// If the dataset is damaged.
pub fn read_samples(dataset: &Dataset) -> Vec<Option<i32>> {
    let [width, height] = dataset.manifest().samples;
    let mut samples = vec![None; width as usize * height as usize];
    let mut reader = PageReader::new(dataset);
    let level = dataset.grid().finest_page_level();
    for row in 0..(height - 1).div_ceil(16).max(1) {
        assert!(PageId::new(level, 0, row).is_some());
        let rows = reader.page_row(row).expect("the pages decode");
        for (i, sample) in rows.into_iter().enumerate() {
            let at = row as usize * 16 * width as usize + i;
            if let (Some(to), Some(_)) = (samples.get_mut(at), sample) {
                *to = sample;
            }
        }
    }
    samples
}

/// Hills with detail at every scale, metres, deterministic.
pub fn hills(column: u32, row: u32) -> f64 {
    let (x, y) = (f64::from(column), f64::from(row));
    let wave = |k: f64, a: f64, p: f64| a * ((x * k + p).sin() * (y * k * 0.9 - p).cos());
    let noise = f64::from(hash(column, row) % 7);
    (wave(0.013, 300.0, 0.3) + wave(0.071, 60.0, 1.1) + wave(0.31, 12.0, 2.0) + noise).round()
}

/// A number that looks random.
pub fn hash(a: u32, b: u32) -> u32 {
    let mut h = a.wrapping_mul(0x9e37_79b1) ^ b.wrapping_mul(0x85eb_ca77);
    h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
    h ^ (h >> 15)
}

/// Hills with a lake's hole, a ragged border and lone samples.
pub fn holed_hills(column: u32, row: u32) -> f64 {
    let (dx, dy) = (f64::from(column) - 90.0, f64::from(row) - 70.0);
    let ragged = hash(row / 3, 5) % 9;
    let in_hole = dx * dx + dy * dy * 2.0 < 900.0 || column < ragged;
    let speck = hash(column, row).is_multiple_of(97);
    if in_hole != speck {
        f64::NAN
    } else {
        hills(column, row)
    }
}

/// A plain with a cliff that follows no axis.
pub fn cliff(column: u32, row: u32) -> f64 {
    if column * 3 + row * 5 < 700 {
        10.0
    } else {
        1200.0
    }
}

/// Flat but for one spike.
pub fn spike(column: u32, row: u32) -> f64 {
    if (column, row) == (101, 67) { 1e9 } else { 3.0 }
}
