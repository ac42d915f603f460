//! Journals of unfinished builds, hostile under checksums that match.

use super::crc32c;
use super::slope::Slope;
use escarp_tiles::build::{BuildOptions, build};
use escarp_tiles::dataset::Dataset;
use std::fs;
use std::path::Path;
use std::sync::OnceLock;

/// A journal of which the input has the entries; the first byte says after how many of those that
/// a build wrote. Each is two bytes of length, and content.
pub fn journal(data: &[u8]) {
    let Some((&kept, mut data)) = data.split_first() else {
        return;
    };
    static STOPPED: OnceLock<Vec<(String, Vec<u8>)>> = OnceLock::new();
    let stopped = STOPPED.get_or_init(stopped);
    let folder = tempfile::tempdir().expect("a folder");
    for (name, bytes) in stopped {
        fs::write(folder.path().join(name), bytes).expect("a file");
    }
    let path = folder.path().join("resume-1");
    let mut entries = entries(&fs::read(&path).expect("a journal"));
    entries.truncate(1 + usize::from(kept & 3));
    while let Some((length, rest)) = data.split_first_chunk() {
        let length = usize::from(u16::from_le_bytes(*length)).min(rest.len());
        entries.push(rest[..length].to_vec());
        data = &rest[length..];
    }
    fs::write(&path, sealed(&entries)).expect("a file");
    if resume(folder.path(), u32::MAX, true).is_ok() {
        Dataset::open(folder.path()).expect("it was published");
    }
}

/// Entries of a sound journal.
pub fn entries(mut journal: &[u8]) -> Vec<Vec<u8>> {
    let mut entries = Vec::new();
    while let Some((&[a, b, c, d, ..], rest)) = journal.split_first_chunk::<8>() {
        let (content, rest) = rest.split_at(u32::from_le_bytes([a, b, c, d]) as usize);
        entries.push(content.to_vec());
        journal = rest;
    }
    entries
}

fn sealed(entries: &[Vec<u8>]) -> Vec<u8> {
    let mut journal = Vec::new();
    for (number, entry) in entries.iter().enumerate() {
        let salted = [&(number as u64).to_le_bytes()[..], entry].concat();
        journal.extend((entry.len() as u32).to_le_bytes());
        journal.extend(crc32c(&salted).to_le_bytes());
        journal.extend(entry);
    }
    journal
}

/// Files of a build that was stopped by a bad block.
fn stopped() -> Vec<(String, Vec<u8>)> {
    let folder = tempfile::tempdir().expect("a folder");
    resume(folder.path(), 2, false).expect_err("a bad block");
    let names = ["resume-1", "seg-1-0"];
    let read = |name: &str| fs::read(folder.path().join(name)).expect("it was kept");
    names.map(|name| (name.to_owned(), read(name))).into()
}

fn resume(folder: &Path, reads_left: u32, resume: bool) -> Result<(), String> {
    let mut source = Slope::new(20, 600, reads_left);
    let options = BuildOptions {
        resume,
        checkpoint_samples: 1,
        ..BuildOptions::default()
    };
    build(
        &mut source,
        folder,
        vec!["slope".into()],
        options,
        &|_, _| {},
    )
    .map(|_| ())
    .map_err(|error| error.to_string())
}
