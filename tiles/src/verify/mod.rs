//! Proof that a dataset is what it says: every checksum; every bound, by brute force, on a share
//! of the pages or on all; and, against the inputs, every sample.

mod against;
mod brute;

pub use against::{Against, compare};

use crate::dataset::{Dataset, DatasetError};
use escarp_proto::geometry::PageId;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
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
    /// Pages whose bounds were recomputed, by level of their root square.
    pub pages_a_level: BTreeMap<u8, u64>,
    /// Comparisons of a sample with a triangle.
    pub comparisons: u64,
    /// Largest deviation over its bound. At most 1 if every bound holds.
    pub largest_ratio: f64,
    /// Bounds that do not hold, the first few, in words.
    pub broken: Vec<String>,
}

/// Verifies checksums and bounds.
///
/// # Errors
/// [`DatasetError::Damaged`] at the first checksum that does not match, or page that does not
/// decode. A bound that does not hold is no error, but is reported.
pub fn verify(
    dataset: &Dataset,
    share: Share,
    progress: &(dyn Fn(u64, u64) + Sync),
) -> Result<VerifyReport, DatasetError> {
    let pages = check_records(dataset)?;
    dataset.filled()?;
    let records = pages.len() as u64;
    let chosen = choose(pages, share);
    let mut pages_a_level = BTreeMap::new();
    for page in &chosen {
        *pages_a_level.entry(page.level()).or_insert(0) += 1;
    }
    let done = AtomicU64::new(0);
    let total = chosen.len() as u64;
    let findings = chosen
        .par_iter()
        .map(|&page| {
            let finding = brute::check_page(dataset, page);
            progress(done.fetch_add(1, Ordering::Relaxed) + 1, total);
            finding
        })
        .try_reduce(brute::Finding::default, |a, b| Ok(a.merge(b)))?;
    Ok(VerifyReport {
        records,
        pages_a_level,
        comparisons: findings.comparisons,
        largest_ratio: findings.largest_ratio,
        broken: findings.broken,
    })
}

/// Reads every family and record, and gives the pages that have one.
fn check_records(dataset: &Dataset) -> Result<Vec<PageId>, DatasetError> {
    let families: Vec<_> = dataset.families().collect();
    let lists = families
        .par_iter()
        .map(|entry| {
            let table = dataset.family(entry)?;
            table
                .records()
                .map(|record| record.map(|record| record.page))
                .collect()
        })
        .collect::<Result<Vec<Vec<PageId>>, DatasetError>>()?;
    Ok(lists.concat())
}

fn choose(mut pages: Vec<PageId>, share: Share) -> Vec<PageId> {
    let Share::PagesALevel(most, seed) = share else {
        return pages;
    };
    // An order that anyone can repeat: by a mixed key.
    pages.sort_by_key(|page| (page.level(), mix(page.key() ^ mix(seed))));
    let mut taken = BTreeMap::new();
    pages.retain(|page| {
        let count = taken.entry(page.level()).or_insert(0);
        *count += 1;
        *count <= most
    });
    pages
}

/// SplitMix64 (Steele, Lea, Flood, "Fast Splittable Pseudorandom Number Generators", 2014).
fn mix(seed: u64) -> u64 {
    let mut z = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
