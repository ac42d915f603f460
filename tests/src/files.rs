//! Copies of datasets, and what can happen to their files.

use crate::terrain::hash;
use escarp_tiles::dataset::Dataset;
use escarp_tiles::verify::{Share, VerifyReport, verify};
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A copy of a dataset that may be damaged.
pub struct Copy {
    folder: TempDir,
}

impl Copy {
    /// Copies all files of a dataset.
    ///
    /// # Panics
    /// If the system refuses.
    pub fn of(dataset: &Path) -> Copy {
        let folder = tempfile::tempdir().unwrap();
        let copy = Copy { folder };
        fs::create_dir(copy.path()).unwrap();
        for name in files(dataset) {
            fs::copy(dataset.join(&name), copy.path().join(&name)).unwrap();
        }
        copy
    }

    /// Where it lies.
    pub fn path(&self) -> PathBuf {
        self.folder.path().join("copy.escarp")
    }

    /// Replaces the content of a file by what a function makes of it.
    ///
    /// # Panics
    /// If the system refuses.
    pub fn change(&self, name: &str, change: impl FnOnce(&mut Vec<u8>)) {
        let path = self.path().join(name);
        let mut bytes = fs::read(&path).unwrap();
        change(&mut bytes);
        fs::write(path, bytes).unwrap();
    }

    /// What opening and verifying the whole dataset says.
    pub fn verdict(&self) -> Result<VerifyReport, String> {
        let dataset = Dataset::open(&self.path()).map_err(|error| error.to_string())?;
        verify(&dataset, Share::Full, &|_, _| {}).map_err(|error| error.to_string())
    }
}

/// Names of a dataset's files, sorted, but the lock, which says nothing.
///
/// # Panics
/// If the folder cannot be read.
pub fn files(dataset: &Path) -> Vec<String> {
    let entries = fs::read_dir(dataset).unwrap();
    let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = names.filter(|name| name != "LOCK").collect();
    names.sort();
    names
}

/// Names and contents of a dataset's files, but the lock.
///
/// # Panics
/// If they cannot be read.
pub fn contents(dataset: &Path) -> Vec<(String, Vec<u8>)> {
    let read = |name: String| {
        let bytes = fs::read(dataset.join(&name)).unwrap();
        (name, bytes)
    };
    files(dataset).into_iter().map(read).collect()
}

/// Changes one byte at a place that looks random, and says which.
pub fn flip(bytes: &mut [u8], seed: u32) -> usize {
    let at = hash(seed, 1) as usize % bytes.len();
    // Never by nothing.
    bytes[at] ^= (hash(seed, 2) % 255 + 1) as u8;
    at
}
