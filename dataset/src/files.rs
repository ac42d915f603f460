//! Names of a dataset's files: whose they are, and which generation's.

use super::DatasetError;
use super::current::{Current, MAX_GENERATION};
use std::fs;
use std::path::{Path, PathBuf};

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

/// The generation in the name of one of a dataset's files. Names are taken as exactly those of
/// `tiles/FORMAT.md`: what is only like them is someone else's.
pub(super) fn generation_of(name: &str) -> Option<u64> {
    let (kind, rest) = name.split_once('-')?;
    let generation = match kind {
        "manifest" | "build" => rest.strip_suffix(".json")?,
        "index" | "filled" | "resume" => rest,
        "seg" => {
            let (generation, number) = rest.split_once('-')?;
            number_of(number)?;
            generation
        }
        _ => return None,
    };
    number_of(generation).filter(|&g| g <= MAX_GENERATION)
}

/// A number as we write it: digits only.
fn number_of(digits: &str) -> Option<u64> {
    let number: u64 = digits.parse().ok()?;
    (number.to_string() == digits).then_some(number)
}

/// Whether a name is one that `tempfile` gives: what a crash left of a new `CURRENT`.
fn is_temporary(name: &str) -> bool {
    name.strip_prefix(".tmp")
        .is_some_and(|rest| rest.len() == 6 && rest.bytes().all(|b| b.is_ascii_alphanumeric()))
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

/// Whether a folder can be taken for a dataset: nothing of anyone else's is ever written over, nor
/// through a link.
pub(super) fn holds_only_ours(folder: &Path) -> Result<bool, DatasetError> {
    let ours = |name: &String| {
        let known = name == "CURRENT" || name == "LOCK" || is_temporary(name);
        (known || generation_of(name).is_some())
            && fs::symlink_metadata(folder.join(name)).is_ok_and(|found| found.is_file())
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
        if is_temporary(&name) || picked {
            let path = folder.join(name);
            fs::remove_file(&path).map_err(DatasetError::io(&path, "remove"))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_names_that_a_writer_gives_are_ours() {
        let names = [
            ("manifest-3.json", Some(3)),
            ("index-12", Some(12)),
            ("seg-3-0", Some(3)),
            ("filled-1", Some(1)),
            ("resume-1", Some(1)),
            ("build-7.json", Some(7)),
            ("build-7.log", None),
            ("index-2.html", None),
            ("manifest-3.webmanifest", None),
            ("seg-3", None),
            ("seg-3-x", None),
            ("seg-+3-1", None),
            ("index-007", None),
            ("index-18446744073709551615", None),
        ];
        for (name, generation) in names {
            assert_eq!(generation_of(name), generation, "{name}");
        }
        assert!(is_temporary(".tmpAb12Cd") && !is_temporary(".tmpx") && !is_temporary(".tmp"));
    }

    #[test]
    fn a_folder_with_someone_elses_files_or_links_is_not_taken() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::write(path("index-1"), "").unwrap();
        assert!(holds_only_ours(folder.path()).unwrap());
        fs::write(path("build-7.log"), "notes").unwrap();
        assert!(!holds_only_ours(folder.path()).unwrap());
        fs::remove_file(path("build-7.log")).unwrap();
        fs::create_dir(path("seg-1-0")).unwrap();
        assert!(!holds_only_ours(folder.path()).unwrap());
        fs::remove_dir(path("seg-1-0")).unwrap();
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink("../victim", path("LOCK")).unwrap();
            assert!(!holds_only_ours(folder.path()).unwrap());
        }
    }
}
