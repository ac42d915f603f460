//! How two datasets differ: families whose checksums are the same are passed over.

use crate::build::{FAMILY_CELLS, HOLE, Level};
use crate::dataset::{Dataset, DatasetError, FamilyId, IndexEntry, PageReader};
use crate::update::old;
use escarp_proto::geometry::{PAGE_CELLS, PAGE_SLOTS, PageId, Slot};
use escarp_proto::page::Codec;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::{BTreeMap, HashSet};

/// How two datasets differ.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Difference {
    /// Pages whose records differ, or that only one has, by level of their root square.
    pub pages_a_level: BTreeMap<u8, u64>,
    /// Samples with data in both, and different heights.
    pub samples: u64,
    /// Samples with data in the first alone.
    pub only_in_first: u64,
    /// Samples with data in the second alone.
    pub only_in_second: u64,
    /// Largest difference of a sample with data in both, metres.
    pub largest_m: f64,
    /// World `x` and `y` of that sample, metres.
    pub largest_at_m: Option<[f64; 2]>,
    /// Families that were compared page by page.
    pub families_compared: u64,
}

impl Difference {
    /// Whether nothing differs.
    pub fn is_none(&self) -> bool {
        let samples = self.samples + self.only_in_first + self.only_in_second;
        self.pages_a_level.is_empty() && samples == 0
    }

    fn merge(mut self, other: Difference) -> Difference {
        for (level, pages) in other.pages_a_level {
            *self.pages_a_level.entry(level).or_insert(0) += pages;
        }
        self.samples += other.samples;
        self.only_in_first += other.only_in_first;
        self.only_in_second += other.only_in_second;
        self.families_compared += other.families_compared;
        if other.largest_m > self.largest_m {
            (self.largest_m, self.largest_at_m) = (other.largest_m, other.largest_at_m);
        }
        self
    }
}

/// Compares two datasets of the same grid.
///
/// # Errors
/// [`DatasetError::Usage`] if their grids differ; [`DatasetError::Damaged`].
pub fn diff(
    first: &Dataset,
    second: &Dataset,
    progress: &(dyn Fn(u64, u64) + Sync),
) -> Result<Difference, DatasetError> {
    check_grids(first, second)?;
    let families = differing_families(first, second);
    let set: HashSet<FamilyId> = families.iter().copied().collect();
    let done = std::sync::atomic::AtomicU64::new(0);
    families
        .par_iter()
        .map(|&family| {
            let found = compare([first, second], family, &set);
            let now = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
            progress(now, families.len() as u64);
            found
        })
        .try_reduce(Difference::default, |a, b| Ok(a.merge(b)))
}

fn check_grids(first: &Dataset, second: &Dataset) -> Result<(), DatasetError> {
    let (a, b) = (first.manifest(), second.manifest());
    let cell = a.georef.sample_spacing_m[0].min(a.georef.sample_spacing_m[1]);
    let close = |a: [f64; 2], b: [f64; 2]| (0..2).all(|i| (a[i] - b[i]).abs() <= 1e-6 * cell);
    let why = if a.samples != b.samples {
        format!("{:?} samples, the other has {:?}", a.samples, b.samples)
    } else if a.georef.plane != b.georef.plane {
        format!(
            "plane {:?}, the other has {:?}",
            a.georef.plane, b.georef.plane
        )
    } else if !close(a.georef.origin_m, b.georef.origin_m)
        || !close(a.georef.sample_spacing_m, b.georef.sample_spacing_m)
    {
        format!("place {:?}, the other has {:?}", a.georef, b.georef)
    } else {
        return Ok(());
    };
    let (path, other) = (first.folder().to_path_buf(), second.folder().display());
    let why = format!("cannot be compared with {other}: {why}");
    Err(DatasetError::Usage { path, why })
}

/// Families that are not the same by their checksums, ascending.
fn differing_families(first: &Dataset, second: &Dataset) -> Vec<FamilyId> {
    let comparable = first.manifest().georef.quantum_m == second.manifest().georef.quantum_m;
    let same = |a: &IndexEntry, b: &IndexEntry| {
        comparable && (a.bytes, a.table_crc32c) == (b.bytes, b.table_crc32c)
    };
    let (mut ours, mut theirs) = (first.families().peekable(), second.families().peekable());
    let mut differing = Vec::new();
    loop {
        let family = match (ours.peek(), theirs.peek()) {
            (None, None) => return differing,
            (Some(a), Some(b)) => a.family.min(b.family),
            (Some(one), None) | (None, Some(one)) => one.family,
        };
        let a = ours.next_if(|entry| entry.family == family);
        let b = theirs.next_if(|entry| entry.family == family);
        if !matches!((&a, &b), (Some(a), Some(b)) if same(a, b)) {
            differing.push(family);
        }
    }
}

fn compare(
    both: [&Dataset; 2],
    family: FamilyId,
    differing: &HashSet<FamilyId>,
) -> Result<Difference, DatasetError> {
    let records = [
        old::records(both[0], family)?,
        old::records(both[1], family)?,
    ];
    let mut found = Difference {
        families_compared: 1,
        ..Difference::default()
    };
    let slots = (0..PAGE_SLOTS).map(|i| Slot::from_index(i as u8));
    for page in slots.filter_map(|slot| family.page(slot)) {
        let slot = page.parent().map_or(0, |(_, slot)| slot.index());
        if records[0][slot] != records[1][slot] {
            *found.pages_a_level.entry(page.level()).or_insert(0) += 1;
        }
    }
    let first = family.page(Slot::from_index(0));
    if let Some(page) = first.filter(|&page| both[0].grid().is_finest(page)) {
        compare_samples(both, page, differing, &mut found)?;
    }
    Ok(found)
}

/// Compares the samples of a family of finest pages, of which `first` is the south-western one.
fn compare_samples(
    both: [&Dataset; 2],
    first: PageId,
    differing: &HashSet<FamilyId>,
    found: &mut Difference,
) -> Result<(), DatasetError> {
    let manifest = both[0].manifest();
    let [width, height] = manifest.samples;
    let level = Level::new(both[0].grid(), first.level(), [width, height], Codec::Dense);
    let (x, y) = (first.square().x as usize, first.square().y as usize);
    let (columns, rows) = level.pages();
    let at = (x / PAGE_CELLS, y / PAGE_CELLS);
    let pages = old::Pages {
        x: [x, (x + PAGE_CELLS).min(columns)],
        y: [y, (y + PAGE_CELLS).min(rows)],
    };
    let read = |dataset| old::samples(&mut PageReader::new(dataset), &level, at, pages);
    let bands = [read(both[0])?, read(both[1])?];
    let quanta = both.map(|dataset| dataset.manifest().georef.quantum_m);
    for i in 0..bands[0].samples.len() {
        let heights = [bands[0].samples[i], bands[1].samples[i]];
        let x = bands[0].west + i % bands[0].stride;
        let y = at.1 * FAMILY_CELLS + i / bands[0].stride;
        if heights == [HOLE; 2] || !counts(&level, at, (x, y), differing) {
            continue;
        }
        let metres = [0, 1].map(|i| f64::from(heights[i]) * quanta[i]);
        let by = (metres[0] - metres[1]).abs();
        match heights {
            [HOLE, _] => found.only_in_second += 1,
            [_, HOLE] => found.only_in_first += 1,
            _ if by > 0.0 => found.samples += 1,
            _ => continue,
        }
        if !heights.contains(&HOLE) && by > found.largest_m {
            let georef = &manifest.georef;
            found.largest_m = by;
            found.largest_at_m = Some([georef.world_x(x as u32), georef.world_y(y as u32)]);
        }
    }
    Ok(())
}

/// Whether a sample is counted here: families share those at their borders, and the first one
/// that is compared at all counts them.
fn counts(
    level: &Level,
    at: (usize, usize),
    (x, y): (usize, usize),
    differing: &HashSet<FamilyId>,
) -> bool {
    let sharing = |at: usize| {
        let last = at / FAMILY_CELLS;
        let before = at.is_multiple_of(FAMILY_CELLS) && at > 0;
        last - usize::from(before)..=last
    };
    let is_compared = |&(column, row): &(usize, usize)| {
        let place = |family: usize| u32::try_from(family * PAGE_CELLS).ok();
        let page = place(column).zip(place(row));
        let page = page.and_then(|(x, y)| PageId::new(level.level(), x, y));
        page.is_some_and(|page| differing.contains(&FamilyId::of(page)))
    };
    let mut all = sharing(y).flat_map(|row| sharing(x).map(move |column| (column, row)));
    all.find(is_compared) == Some(at)
}
