//! What no generation but old ones needs is dropped: segments in which little is left are written
//! anew, and all files that the published generation does not name are removed.

use crate::build::Progress;
use crate::dataset::{Dataset, DatasetError, DatasetWriter, FamilyBytes, IndexEntry, disk_bytes};
use serde::Serialize;

/// What a compaction did.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CompactReport {
    /// The published generation: a new one, or the old one if no segment was written anew.
    pub generation: u64,
    /// Bytes of all files in the folder before.
    pub bytes_before: u64,
    /// Bytes of all files in the folder now.
    pub bytes_after: u64,
    /// Segments that were written anew.
    pub segments: u64,
}

/// Drops what only old generations need. A segment is written anew if more than `dead_share` of
/// it, 0 to 1, is of no family of the published generation. Readers that have an old generation
/// open keep its files until they close them.
///
/// # Errors
/// [`DatasetError`]; the published generation stays readable at every moment.
pub fn compact(
    dataset: &Dataset,
    dead_share: f64,
    progress: Progress<'_>,
) -> Result<CompactReport, DatasetError> {
    let folder = dataset.folder();
    let bytes_before = disk_bytes(folder)?;
    let mut writer = DatasetWriter::extend(dataset)?;
    let segments = sparse_segments(dataset, dead_share);
    let mut moved: Vec<IndexEntry> = dataset
        .families()
        .filter(|entry| segments.contains(&entry.segment))
        .collect();
    // As they lie, so that neighbours stay neighbours and reading is in order.
    moved.sort_unstable_by_key(|entry| (entry.segment, entry.offset));
    for (done, entry) in moved.iter().enumerate() {
        let (family, pages) = FamilyBytes::copy(dataset, entry)?;
        writer.replace(entry.family, pages)?;
        writer.append(&family)?;
        progress(done as u64 + 1, moved.len() as u64);
    }
    let generation = match segments.is_empty() {
        true => writer.remove_unnamed(dataset.manifest())?,
        false => {
            let mut manifest = dataset.manifest().clone();
            manifest.filled = writer.write_filled(&dataset.filled()?)?;
            writer.publish(manifest)?.generation
        }
    };
    Ok(CompactReport {
        generation,
        bytes_before,
        bytes_after: disk_bytes(folder)?,
        segments: segments.len() as u64,
    })
}

/// Numbers of the segments of which too much is dead.
fn sparse_segments(dataset: &Dataset, dead_share: f64) -> Vec<u32> {
    let segments = &dataset.manifest().segments;
    let mut live = vec![0; segments.len()];
    for entry in dataset.families() {
        live[entry.segment as usize] += u64::from(entry.bytes);
    }
    let is_sparse = |(live, bytes): (u64, u64)| {
        bytes > live && (bytes - live) as f64 > dead_share * bytes as f64
    };
    let shares = live.into_iter().zip(segments.iter().map(|s| s.bytes));
    let numbered = shares.enumerate().filter(|&(_, share)| is_sparse(share));
    numbered.map(|(number, _)| number as u32).collect()
}
