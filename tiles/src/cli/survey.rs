//! What `info` says beyond the manifest: what the bytes are spent on, and what lies on the disk.

use crate::dataset::{Dataset, disk_bytes, generations, unfinished};
use crate::verify::Survey;
use anyhow::Result;
use serde_json::{Value, json};

/// What the folder holds, whichever generation it is of.
pub(super) struct OnDisk {
    generations: Vec<u64>,
    bytes: u64,
    /// Of records that the published generation does not have.
    dead: u64,
    /// Of a build that did not finish.
    unfinished: u64,
}

/// Looks at the dataset's folder.
pub(super) fn on_disk(dataset: &Dataset) -> Result<OnDisk> {
    let folder = dataset.folder();
    let bytes = disk_bytes(folder)?;
    let unfinished = unfinished(folder)?.map_or(0, |found| found.bytes);
    let live: u64 = dataset.families().map(|entry| u64::from(entry.bytes)).sum();
    let of_index = dataset.manifest().index.bytes + dataset.manifest_json().len() as u64;
    let needed = live + of_index + unfinished;
    Ok(OnDisk {
        generations: generations(folder)?,
        bytes,
        dead: bytes.saturating_sub(needed),
        unfinished,
    })
}

impl OnDisk {
    pub(super) fn json(&self) -> Value {
        json!({
            "generations": self.generations,
            "bytes": self.bytes,
            "dead_bytes": self.dead,
            "unfinished_bytes": self.unfinished,
        })
    }
}

fn bits(dataset: &Dataset, bytes: u64) -> f64 {
    let [width, height] = dataset.manifest().samples;
    bytes as f64 * 8.0 / (u64::from(width) * u64::from(height)) as f64
}

pub(super) fn print_survey(dataset: &Dataset, survey: &Survey) {
    for (level, found) in &survey.levels {
        println!(
            "level {level:<2}    {} pages, {:.3} MB, {:.1} bytes a page",
            found.pages,
            found.bytes as f64 / 1e6,
            found.bytes as f64 / found.pages as f64
        );
    }
    let names = [
        "headers",
        "vertices of level 1",
        "of level 2",
        "of level 3",
        "of level 4",
        "child slots",
    ];
    let index = dataset.manifest().index.bytes + dataset.manifest_json().len() as u64;
    let parts = names.into_iter().zip(survey.parts);
    let parts = parts.chain([
        ("tables of families", survey.tables),
        ("index and manifest", index),
    ]);
    for (i, (name, bytes)) in parts.enumerate() {
        let heading = if i == 0 { "bits" } else { "" };
        println!("{heading:<11} {:.4} a sample: {name}", bits(dataset, bytes));
    }
    let slots: u64 = survey.slot_errors.iter().map(|bin| bin.slots).sum();
    let all = slots + survey.mixed_slots + survey.empty_slots;
    let share = |count: u64| 100.0 * count as f64 / all.max(1) as f64;
    for (i, bin) in survey.slot_errors.iter().enumerate() {
        let heading = if i == 0 { "errors" } else { "" };
        let (slots, share) = (bin.slots, share(bin.slots));
        println!(
            "{heading:<11} at most {:.6} m: {slots} child slots, {share:.2} %",
            bin.most_m
        );
    }
    for (name, count) in [
        ("crossed by an outline", survey.mixed_slots),
        ("empty", survey.empty_slots),
    ] {
        println!(
            "{:<11} {name}: {count} child slots, {:.2} %",
            "",
            share(count)
        );
    }
}

pub(super) fn print_disk(on_disk: &OnDisk) {
    let megabytes = |bytes: u64| bytes as f64 / 1e6;
    println!(
        "disk        {:.1} MB, {:.1} MB of it dead; generations {:?}",
        megabytes(on_disk.bytes),
        megabytes(on_disk.dead),
        on_disk.generations
    );
    if on_disk.unfinished > 0 {
        let left = megabytes(on_disk.unfinished);
        println!("            {left:.1} MB are of an unfinished build");
    }
}
