//! The one place that maps files.
//!
//! A mapped file that is shortened by someone else kills the process with SIGBUS when the missing
//! part is read. Three things stand against that: published files are immutable, the length is
//! compared before mapping, and old generations are unlinked, never truncated. Who cannot trust
//! in that reads by [`Dataset::read_record`](super::Dataset::read_record), which does not touch
//! the mapping unless told to.

use super::DatasetError;
use bytes::Bytes;
use memmap2::{Mmap, MmapOptions};
use std::fs::File;
use std::path::{Path, PathBuf};

/// A file, mapped read-only.
#[derive(Debug)]
pub(super) struct Mapped {
    path: PathBuf,
    file: File,
    map: Bytes,
}

impl Mapped {
    /// Maps a file that must have exactly this length.
    pub(super) fn open(path: &Path, bytes: u64) -> Result<Mapped, DatasetError> {
        let file = open_file(path, bytes)?;
        let map = map_file(&file, bytes).map_err(DatasetError::io(path, "map"))?;
        Ok(Mapped {
            path: path.to_path_buf(),
            file,
            map,
        })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The open file.
    pub(super) fn file(&self) -> &File {
        &self.file
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &self.map
    }

    /// The mapping, to be kept as long as any part of it is.
    pub(super) fn shared(&self) -> &Bytes {
        &self.map
    }
}

/// Opens a file that must have exactly this length.
pub(super) fn open_file(path: &Path, bytes: u64) -> Result<File, DatasetError> {
    // Opening a pipe would wait for a writer.
    if std::fs::metadata(path).is_ok_and(|found| !found.is_file()) {
        return Err(DatasetError::damaged(
            path,
            "not a file, but the manifest names it",
        ));
    }
    let file = File::open(path).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound => {
            DatasetError::damaged(path, "the file is missing, but the manifest names it")
        }
        _ => DatasetError::io(path, "open")(source),
    })?;
    let found = file
        .metadata()
        .map_err(DatasetError::io(path, "read length"))?
        .len();
    if found != bytes {
        let why = format!("{found} bytes long, the manifest says {bytes}");
        return Err(DatasetError::damaged(path, why));
    }
    Ok(file)
}

/// An empty file cannot be mapped.
#[allow(unsafe_code, reason = "mapping is what this module is for")]
fn map_file(file: &File, bytes: u64) -> std::io::Result<Bytes> {
    if bytes == 0 {
        return Ok(Bytes::new());
    }
    // SAFETY: published files are immutable and are never shortened (module documentation), so
    // the bytes do not change under the shared reference.
    let map: Mmap = unsafe { MmapOptions::new().map(file) }?;
    Ok(Bytes::from_owner(map))
}
