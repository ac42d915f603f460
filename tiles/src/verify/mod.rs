//! Proof that a dataset is what it says: every checksum; every sample that pages share; every
//! bound, by brute force, on a share of the pages or on all; and, against the inputs, every sample.
//! How two datasets differ, and what the bytes of one are spent on.

mod against;
mod brute;
mod diff;
mod edges;
mod survey;

pub use against::{Against, compare};
pub use diff::{Difference, diff};
pub use survey::{LevelSurvey, SlotErrors, Survey, survey};

use crate::dataset::{Dataset, DatasetError, IndexEntry};
use edges::Shared;
use escarp_proto::geometry::PageId;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::{BTreeMap, BinaryHeap};
use std::sync::atomic::{AtomicU64, Ordering};

/// Which pages have their bounds recomputed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Share {
    /// At most this many of each level, chosen by a seed.
    PagesALevel(usize, u64),
    /// All.
    Full,
}

/// What was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct VerifyReport {
    /// Records whose checksum matches: all of them.
    pub records: u64,
    /// Comparisons of a sample that two pages share.
    pub shared: u64,
    /// Pages whose bounds were recomputed, by level of their root square.
    pub pages_a_level: BTreeMap<u8, u64>,
    /// Comparisons of a sample with a triangle.
    pub comparisons: u64,
    /// Largest deviation over its bound. At most 1 if every bound holds.
    pub largest_ratio: f64,
    /// What does not hold, the first few, in words: bounds, samples that pages share and that
    /// differ, records without a parent that knows of them.
    pub broken: Vec<String>,
}

/// Verifies checksums, samples that pages share, and bounds. Memory does not grow with the dataset
/// but by its index.
///
/// # Errors
/// [`DatasetError::Damaged`] at the first checksum that does not match, or page that does not
/// decode. What does not hold otherwise is no error, but is reported.
pub fn verify(
    dataset: &Dataset,
    share: Share,
    progress: &(dyn Fn(u64, u64) + Sync),
) -> Result<VerifyReport, DatasetError> {
    let families: Vec<IndexEntry> = dataset.families().collect();
    let (most, seed) = match share {
        Share::PagesALevel(most, seed) => (most, seed),
        Share::Full => (0, 0),
    };
    dataset.filled()?;
    let done = AtomicU64::new(0);
    let total = families.len() as u64 * if share == Share::Full { 2 } else { 1 };
    let step = || progress(done.fetch_add(1, Ordering::Relaxed) + 1, total);
    let (records, chosen, shared) = families
        .par_iter()
        .map(|entry| {
            let (records, chosen) = check_records(dataset, entry, most, seed)?;
            let shared = edges::check_family(dataset, entry)?;
            step();
            Ok((records, chosen, shared))
        })
        .try_reduce(
            || (0, Chosen::new(most), Shared::default()),
            |a, b| Ok((a.0 + b.0, a.1.merge(b.1), a.2.merge(b.2))),
        )?;
    let bounds = match share {
        Share::Full => families
            .par_iter()
            .map(|entry| {
                let found = check_bounds(dataset, entry)?;
                step();
                Ok(found)
            })
            .try_reduce(Bounds::default, |a, b| Ok(a.merge(b)))?,
        Share::PagesALevel(..) => chosen
            .pages()
            .par_iter()
            .map(|&page| Bounds::of(dataset, page))
            .try_reduce(Bounds::default, |a, b| Ok(a.merge(b)))?,
    };
    let stated = dataset.manifest().pages;
    let counted = (stated != records)
        .then(|| format!("the manifest says {stated} pages, but {records} have a record"));
    let counted: Vec<String> = counted.into_iter().collect();
    Ok(VerifyReport {
        records,
        shared: shared.comparisons,
        pages_a_level: bounds.pages_a_level,
        comparisons: bounds.finding.comparisons,
        largest_ratio: bounds.finding.largest_ratio,
        broken: [counted, shared.broken, bounds.finding.broken].concat(),
    })
}

/// Bounds of some pages, by brute force.
#[derive(Debug, Default)]
struct Bounds {
    pages_a_level: BTreeMap<u8, u64>,
    finding: brute::Finding,
}

impl Bounds {
    fn of(dataset: &Dataset, page: PageId) -> Result<Bounds, DatasetError> {
        Ok(Bounds {
            pages_a_level: BTreeMap::from([(page.level(), 1)]),
            finding: brute::check_page(dataset, page)?,
        })
    }

    fn merge(mut self, other: Bounds) -> Bounds {
        for (level, pages) in other.pages_a_level {
            *self.pages_a_level.entry(level).or_insert(0) += pages;
        }
        self.finding = self.finding.merge(other.finding);
        self
    }
}

fn check_bounds(dataset: &Dataset, entry: &IndexEntry) -> Result<Bounds, DatasetError> {
    let table = dataset.family(entry)?;
    let mut bounds = Bounds::default();
    for record in table.records() {
        bounds = bounds.merge(Bounds::of(dataset, record?.page)?);
    }
    Ok(bounds)
}

/// Reads every record of a family: how many there are, and some of their pages.
fn check_records(
    dataset: &Dataset,
    entry: &IndexEntry,
    most: usize,
    seed: u64,
) -> Result<(u64, Chosen), DatasetError> {
    let (mut records, mut chosen) = (0, Chosen::new(most));
    for record in dataset.family(entry)?.records() {
        let page = record?.page;
        records += 1;
        chosen.offer(page.level(), (mix(page.key() ^ mix(seed)), page));
    }
    Ok((records, chosen))
}

/// So many pages of each level, those that come first in an order that anyone can repeat: by a
/// mixed key.
#[derive(Debug)]
struct Chosen {
    most: usize,
    levels: BTreeMap<u8, BinaryHeap<(u64, PageId)>>,
}

impl Chosen {
    fn new(most: usize) -> Chosen {
        Chosen {
            most,
            levels: BTreeMap::new(),
        }
    }

    fn offer(&mut self, level: u8, page: (u64, PageId)) {
        let pages = self.levels.entry(level).or_default();
        pages.push(page);
        if pages.len() > self.most {
            pages.pop();
        }
    }

    fn merge(mut self, other: Chosen) -> Chosen {
        for (level, pages) in other.levels {
            pages.into_iter().for_each(|page| self.offer(level, page));
        }
        self
    }

    fn pages(&self) -> Vec<PageId> {
        let pages = self.levels.values().flatten();
        pages.map(|&(_, page)| page).collect()
    }
}

/// SplitMix64 (Steele, Lea, Flood, "Fast Splittable Pseudorandom Number Generators", 2014).
fn mix(seed: u64) -> u64 {
    let mut z = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
