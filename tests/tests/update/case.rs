//! A dataset, patches, and what must come of them.

use escarp_proto::geometry::PageId;
use escarp_tests::terrain::{FunctionSource, Heights, TempDataset, cliff, hash, hills};
use escarp_tiles::build::BuildError;
use escarp_tiles::dataset::Dataset;
use escarp_tiles::dem::{DemError, DemInfo, DemSource};
use escarp_tiles::update::{Edit, UpdateReport, update};
use std::collections::BTreeMap;

/// Samples of a grid, ends included: west, south, east, north.
pub type Rectangle = [u32; 4];

/// A part of a function's grid, as a source of its own.
pub struct Part {
    pub info: DemInfo,
    pub whole: [u32; 2],
    pub place: Rectangle,
    pub heights: Box<dyn Fn(u32, u32) -> f64 + Send>,
}

/// The patch of a grid of `whole` samples that covers a rectangle; heights by column and row of
/// the whole grid, row 0 the northern one.
pub fn part(
    whole: [u32; 2],
    place: Rectangle,
    heights: impl Fn(u32, u32) -> f64 + Send + 'static,
) -> Part {
    let mut info = FunctionSource::new(whole[0], whole[1], hills)
        .info()
        .clone();
    let [west, south, east, north] = place;
    info.placement.x0 += f64::from(west) * info.placement.dx;
    info.placement.y0 -= f64::from(whole[1] - 1 - north) * info.placement.dy;
    (info.width, info.height) = (east - west + 1, north - south + 1);
    Part {
        info,
        whole,
        place,
        heights: Box::new(heights),
    }
}

impl DemSource for Part {
    fn info(&self) -> &DemInfo {
        &self.info
    }

    fn read_rows(&mut self, first_row: u32, rows: u32, out: &mut [f64]) -> Result<(), DemError> {
        let top = self.whole[1] - 1 - self.place[3] + first_row;
        let width = self.info.width as usize;
        for (i, out) in out.iter_mut().enumerate().take(rows as usize * width) {
            *out = (self.heights)(self.place[0] + (i % width) as u32, top + (i / width) as u32);
        }
        Ok(())
    }
}

/// World coordinates of a rectangle of samples.
pub fn bounds(place: Rectangle) -> [f64; 4] {
    let [w, s, e, n] = place.map(f64::from);
    [
        1000.0 + 10.0 * w,
        2000.0 + 10.0 * s,
        1000.0 + 10.0 * e,
        2000.0 + 10.0 * n,
    ]
}

/// Patches, each with its heights.
pub type Patches = Vec<(Rectangle, Heights)>;

/// Patches and removed rectangles.
pub struct Case {
    pub size: [u32; 2],
    pub base: Heights,
    pub patches: Patches,
    pub removed: Vec<Rectangle>,
}

impl Case {
    /// Height of the merged inputs at a column and row, row 0 the northern one.
    pub fn merged(&self, column: u32, row: u32) -> f64 {
        let y = self.size[1] - 1 - row;
        let inside = |&[w, s, e, n]: &Rectangle| (w..=e).contains(&column) && (s..=n).contains(&y);
        let patched = self.patches.iter().filter(|(place, _)| inside(place));
        let mut heights = patched.map(|(_, heights)| heights(column, row));
        match heights.find(|height| !height.is_nan()) {
            Some(height) => height,
            None if self.removed.iter().any(inside) => f64::NAN,
            None => (self.base)(column, row),
        }
    }

    pub fn apply(&self, dataset: &Dataset) -> Result<UpdateReport, BuildError> {
        let mut parts: Vec<Part> = self
            .patches
            .iter()
            .map(|&(place, heights)| part(self.size, place, heights))
            .collect();
        let edit = Edit {
            patches: parts
                .iter_mut()
                .map(|part| part as &mut dyn DemSource)
                .collect(),
            remove: self.removed.iter().map(|&place| bounds(place)).collect(),
            sources: vec!["patch".into()],
        };
        update(dataset, edit, &|_, _| {})
    }

    /// Updates, and compares with a dataset that is built from the merged inputs.
    pub fn check(&self, what: &str) -> TempDataset {
        let data = TempDataset::of(self.size[0], self.size[1], self.base);
        let before = records(&data.dataset);
        let report = self
            .apply(&data.dataset)
            .unwrap_or_else(|e| panic!("{what}: {e}"));
        let rebuilt = TempDataset::of(self.size[0], self.size[1], |x, y| self.merged(x, y));
        let updated = data.open();
        same(&updated, &rebuilt.dataset, what);
        assert_eq!(updated.manifest().generation, report.generation, "{what}");
        let differing = data.samples.iter().zip(&rebuilt.samples);
        let differing = differing.filter(|(a, b)| a != b).count() as u64;
        assert_eq!(report.changed, differing, "{what}");
        // Whoever had the old generation open goes on with it.
        assert!(records(&data.dataset) == before, "{what}");
        data
    }
}

/// All records of a dataset by page.
pub fn records(dataset: &Dataset) -> BTreeMap<PageId, Vec<u8>> {
    let mut records = BTreeMap::new();
    for entry in dataset.families() {
        for record in dataset.family(&entry).expect("a table").records() {
            let record = record.expect("a record");
            records.insert(record.page, record.bytes.to_vec());
        }
    }
    records
}

/// The same pages with the same records, and the same said of them.
pub fn same(updated: &Dataset, rebuilt: &Dataset, what: &str) {
    let (ours, theirs) = (records(updated), records(rebuilt));
    let differs = |id: &&PageId| ours.get(*id) != theirs.get(*id);
    let differing: Vec<_> = ours.keys().chain(theirs.keys()).filter(differs).collect();
    assert!(differing.is_empty(), "{what}: pages differ: {differing:?}");
    let (a, b) = (updated.manifest(), rebuilt.manifest());
    assert_eq!(a.pages, b.pages, "{what}");
    assert_eq!(a.valid_samples, b.valid_samples, "{what}");
    assert_eq!(a.height_range, b.height_range, "{what}");
    assert_eq!(a.georef, b.georef, "{what}");
    assert!(a.storage_error_m >= b.storage_error_m, "{what}");
}

pub fn terrace(_: u32, _: u32) -> f64 {
    250.0
}

pub fn higher(x: u32, y: u32) -> f64 {
    hills(x, y) + 1000.0
}

pub fn nothing(_: u32, _: u32) -> f64 {
    f64::NAN
}

/// A dataset after some updates.
pub fn updated_often() -> TempDataset {
    let data = TempDataset::of(600, 500, hills);
    for round in 0..5 {
        let (x, y) = (hash(round, 1) % 400, hash(round, 2) % 300);
        let case = Case {
            size: [600, 500],
            base: hills,
            patches: vec![(
                [x, y, x + 150, y + 100],
                [higher as Heights, cliff, terrace][round as usize % 3],
            )],
            removed: vec![[x + 20, y + 20, x + 40, y + 60]],
        };
        case.apply(&data.open()).unwrap();
    }
    data
}
