//! Folders and files of the cache: names, the cap, and what is removed first.

use super::segment::MAX_ADDRESS;
use escarp_dataset::checksum::crc32c;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// The folder by the XDG Base Directory Specification: `$XDG_CACHE_HOME/escarp`, else
/// `~/.cache/escarp`; on Windows `%LOCALAPPDATA%\escarp`. `None` if the environment names none.
pub fn default_folder() -> Option<PathBuf> {
    let absolute = |name: &str| {
        let value = std::env::var_os(name).map(PathBuf::from);
        value.filter(|path| path.is_absolute())
    };
    let base = absolute("XDG_CACHE_HOME")
        .or_else(|| absolute("LOCALAPPDATA"))
        .or_else(|| absolute("HOME").map(|home| home.join(".cache")))?;
    Some(base.join("escarp"))
}

/// The folder of an address. Two addresses may share one: the head of a segment tells.
pub(super) fn of_address(folder: &Path, address: &str) -> PathBuf {
    let address = &address.as_bytes()[..address.len().min(MAX_ADDRESS)];
    let reversed: Vec<u8> = address.iter().rev().copied().collect();
    folder.join(format!("{:08x}{:08x}", crc32c(address), crc32c(&reversed)))
}

fn is_bucket(name: &str) -> bool {
    name.len() == 16 && name.bytes().all(|b| b.is_ascii_hexdigit())
}

/// Segments of a folder, by the time in their names, oldest first.
pub(super) fn segments(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(folder) else {
        return Vec::new();
    };
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let mut names: Vec<String> = names.filter(|name| name.starts_with("seg-")).collect();
    names.sort_unstable();
    let paths = names.into_iter().map(|name| folder.join(name));
    paths
        .filter(|path| path.symlink_metadata().is_ok_and(|found| found.is_file()))
        .collect()
}

struct Old {
    path: PathBuf,
    bytes: u64,
    used: SystemTime,
    is_live: bool,
}

/// Makes room for a segment of so many bytes among all of the cache, oldest first. Whether there
/// is. A segment that is being written counts as a whole one.
pub(super) fn make_room(folder: &Path, cap: u64, segment: u64) -> io::Result<bool> {
    let mut all = Vec::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if !entry.file_name().to_str().is_some_and(is_bucket) {
            continue;
        }
        all.extend(segments(&entry.path()).into_iter().filter_map(old));
    }
    let counted = |old: &Old| {
        if old.is_live {
            segment.max(old.bytes)
        } else {
            old.bytes
        }
    };
    let mut total: u64 = all.iter().map(counted).sum();
    all.sort_by_key(|old| old.used);
    for old in all.iter().filter(|old| !old.is_live) {
        if total + segment <= cap {
            break;
        }
        // Another program may have removed it; what it has open, it still can read.
        if fs::remove_file(&old.path).is_ok() {
            total -= counted(old);
        }
    }
    Ok(total + segment <= cap)
}

fn old(path: PathBuf) -> Option<Old> {
    let file = File::open(&path).ok()?;
    let found = file.metadata().ok()?;
    Some(Old {
        bytes: found.len(),
        used: found.modified().unwrap_or(SystemTime::UNIX_EPOCH),
        is_live: file.try_lock_shared().is_err(),
        path,
    })
}

/// A lock on the whole cache, if no other program has it now.
pub(super) fn lock(folder: &Path) -> io::Result<Option<File>> {
    let file = File::create(folder.join("LOCK"))?;
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(fs::TryLockError::WouldBlock) => Ok(None),
        Err(fs::TryLockError::Error(error)) => Err(error),
    }
}
