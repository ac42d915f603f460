//! Names of a dataset's files: whose they are, and which generation's.

use super::DatasetError;
use super::current::{Current, MAX_GENERATION};
use std::fs;
use std::path::{Path, PathBuf};

/// What the names of files of a generation start with.
const PREFIXES: [&str; 6] = [
    "manifest-",
    "index-",
    "seg-",
    "filled-",
    "resume-",
    "build-",
];

/// What an unfinished build left in a folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Unfinished {
    /// The generation that it was to publish.
    pub generation: u64,
    /// What its files take, bytes.
    pub bytes: u64,
    /// Whether a build can go on with it.
    pub resumable: bool,
}

/// What an unfinished build left in a folder; `None` where there is none.
///
/// # Errors
/// [`DatasetError`] if the folder cannot be listed, or its `CURRENT` is damaged.
pub fn unfinished(folder: &Path) -> Result<Option<Unfinished>, DatasetError> {
    if !folder.is_dir() {
        return Ok(None);
    }
    let published = published(folder)?;
    let mut found: Option<Unfinished> = None;
    for name in names(folder)? {
        let Some(generation) = generation_of(&name).filter(|&g| g > published) else {
            continue;
        };
        let length = fs::metadata(folder.join(&name)).map_or(0, |data| data.len());
        let before = found.unwrap_or(Unfinished {
            generation,
            bytes: 0,
            resumable: false,
        });
        found = Some(Unfinished {
            generation: generation.max(before.generation),
            bytes: before.bytes + length,
            resumable: before.resumable || name.starts_with("resume-"),
        });
    }
    Ok(found)
}

/// Bytes of all files of a dataset, those of old generations and leftovers included.
///
/// # Errors
/// [`DatasetError::Io`] if the folder cannot be listed.
pub fn disk_bytes(folder: &Path) -> Result<u64, DatasetError> {
    let length = |name: &String| fs::metadata(folder.join(name)).map_or(0, |data| data.len());
    Ok(names(folder)?.iter().map(length).sum())
}

/// Generations of which there is a manifest, ascending.
///
/// # Errors
/// [`DatasetError::Io`] if the folder cannot be listed.
pub fn generations(folder: &Path) -> Result<Vec<u64>, DatasetError> {
    let names = names(folder)?;
    let manifests = names.iter().filter(|name| name.starts_with("manifest-"));
    let mut found: Vec<u64> = manifests.filter_map(|name| generation_of(name)).collect();
    found.sort_unstable();
    Ok(found)
}

/// The published generation; 0 if none is.
pub(super) fn published(folder: &Path) -> Result<u64, DatasetError> {
    match Current::read(folder) {
        Ok(current) => Ok(current.generation),
        Err(DatasetError::NotADataset { .. }) => Ok(0),
        Err(error) => Err(error),
    }
}

/// Where a build notes how far it has come.
pub(super) fn journal_path(folder: &Path, generation: u64) -> PathBuf {
    folder.join(format!("resume-{generation}"))
}

/// The generation in the name of one of a dataset's files.
pub(super) fn generation_of(name: &str) -> Option<u64> {
    let rest = PREFIXES
        .iter()
        .find_map(|prefix| name.strip_prefix(prefix))?;
    let digits = rest.split(['-', '.']).next()?;
    digits.parse().ok().filter(|&g| g <= MAX_GENERATION)
}

/// Names of all files of a folder.
pub(super) fn names(folder: &Path) -> Result<Vec<String>, DatasetError> {
    let entries = fs::read_dir(folder).map_err(DatasetError::io(folder, "list"))?;
    let names = entries.map(|entry| entry.map(|e| e.file_name().to_string_lossy().into_owned()));
    names
        .collect::<Result<_, _>>()
        .map_err(DatasetError::io(folder, "list"))
}

/// The highest generation of which there is any file.
pub(super) fn newest_generation(folder: &Path) -> Result<u64, DatasetError> {
    let names = names(folder)?;
    Ok(names
        .iter()
        .filter_map(|name| generation_of(name))
        .max()
        .unwrap_or(0))
}

/// Whether a folder can be taken for a dataset: nothing of anyone else's is ever written over.
pub(super) fn holds_only_ours(folder: &Path) -> Result<bool, DatasetError> {
    let ours = |name: &String| {
        name == "CURRENT"
            || name == "LOCK"
            || name.starts_with(".tmp")
            || generation_of(name).is_some()
    };
    Ok(names(folder)?.iter().all(ours))
}

/// Removes the files that a test of name and generation picks, and temporary ones.
pub(super) fn remove_files(
    folder: &Path,
    which: impl Fn(&str, u64) -> bool,
) -> Result<(), DatasetError> {
    for name in names(folder)? {
        let picked = generation_of(&name).is_some_and(|generation| which(&name, generation));
        if name.starts_with(".tmp") || picked {
            let path = folder.join(name);
            fs::remove_file(&path).map_err(DatasetError::io(&path, "remove"))?;
        }
    }
    Ok(())
}
