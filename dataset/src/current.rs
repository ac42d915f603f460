//! `CURRENT`: which generation is published. It is replaced by a rename, so a reader sees either
//! the old generation or the new one.

use super::DatasetError;
use crate::checksum::crc32c;
use escarp_proto::manifest::MAX_MANIFEST_BYTES;
use std::fs::{self, File};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

/// No generation is later: there is always a next one.
pub(super) const MAX_GENERATION: u64 = 1 << 62;

/// No `CURRENT` is longer, bytes.
const LONGEST: u64 = 200;

/// What `CURRENT` says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Current {
    /// The published generation.
    pub generation: u64,
    /// Length of its manifest, bytes.
    pub manifest_bytes: u64,
    /// CRC-32C of its manifest.
    pub manifest_crc32c: u32,
}

/// Path of the file in a dataset's folder.
pub fn current_path(folder: &Path) -> PathBuf {
    folder.join("CURRENT")
}

impl Current {
    /// Reads and checks the file.
    ///
    /// # Errors
    /// [`DatasetError::NotADataset`] if there is none, [`DatasetError::Damaged`] if it says
    /// something else.
    pub fn read(folder: &Path) -> Result<Current, DatasetError> {
        let path = current_path(folder);
        let found = fs::metadata(&path).map_err(|source| match source.kind() {
            ErrorKind::NotFound | ErrorKind::NotADirectory => not_a_dataset(folder),
            _ => DatasetError::io(&path, "read length")(source),
        })?;
        if !found.is_file() || found.len() > LONGEST {
            let why = format!("no file of at most {LONGEST} bytes");
            return Err(DatasetError::damaged(&path, why));
        }
        let text = fs::read(&path).map_err(DatasetError::io(&path, "read"))?;
        let text = String::from_utf8_lossy(&text).into_owned();
        Self::parse(&text).ok_or_else(|| {
            let why = format!("says {text:?}, allowed are the three lines of tiles/FORMAT.md");
            DatasetError::damaged(&path, why)
        })
    }

    fn parse(text: &str) -> Option<Current> {
        let mut lines = text.lines();
        if lines.next()? != "escarp 1" {
            return None;
        }
        let generation = lines.next()?.strip_prefix("generation ")?.parse().ok()?;
        if !(1..=MAX_GENERATION).contains(&generation) {
            return None;
        }
        let (bytes, crc) = lines.next()?.strip_prefix("manifest ")?.split_once(' ')?;
        let current = Current {
            generation,
            manifest_bytes: bytes.parse().ok()?,
            manifest_crc32c: u32::from_str_radix(crc, 16).ok()?,
        };
        // Byte for byte what a writer writes: anything else was changed since.
        (current.text() == text).then_some(current)
    }

    /// The file's content.
    fn text(&self) -> String {
        format!(
            "escarp 1\ngeneration {}\nmanifest {} {:08x}\n",
            self.generation, self.manifest_bytes, self.manifest_crc32c
        )
    }

    /// Path of the manifest that this names.
    pub fn manifest_path(&self, folder: &Path) -> PathBuf {
        folder.join(format!("manifest-{}.json", self.generation))
    }

    /// The manifest's bytes, checked.
    pub(super) fn read_manifest(&self, folder: &Path) -> Result<Vec<u8>, DatasetError> {
        let path = self.manifest_path(folder);
        let found = fs::metadata(&path).map_err(|source| match source.kind() {
            ErrorKind::NotFound => {
                DatasetError::damaged(&path, "the file is missing, but CURRENT names it")
            }
            _ => DatasetError::io(&path, "read length")(source),
        })?;
        if !found.is_file() {
            return Err(DatasetError::damaged(&path, "it is not a file"));
        }
        let found = found.len();
        if found != self.manifest_bytes || found > MAX_MANIFEST_BYTES as u64 {
            let said = self.manifest_bytes;
            let why = format!(
                "{found} bytes long, CURRENT says {said}, allowed are {MAX_MANIFEST_BYTES}"
            );
            return Err(DatasetError::damaged(&path, why));
        }
        let json = fs::read(&path).map_err(DatasetError::io(&path, "read"))?;
        let crc = crc32c(&json);
        if crc != self.manifest_crc32c {
            let said = self.manifest_crc32c;
            let why = format!("checksum {crc:08x}, CURRENT says {said:08x}");
            return Err(DatasetError::damaged(&path, why));
        }
        Ok(json)
    }

    /// Path and bytes of the manifest of a generation that is published no more.
    pub(super) fn read_old_manifest(
        folder: &Path,
        generation: u64,
    ) -> Result<(PathBuf, Vec<u8>), DatasetError> {
        let path = folder.join(format!("manifest-{generation}.json"));
        let found = fs::metadata(&path).map_err(DatasetError::io(&path, "read length"))?;
        if !found.is_file() || found.len() > MAX_MANIFEST_BYTES as u64 {
            let why = format!("no file of at most {MAX_MANIFEST_BYTES} bytes");
            return Err(DatasetError::damaged(&path, why));
        }
        let json = fs::read(&path).map_err(DatasetError::io(&path, "read"))?;
        Ok((path, json))
    }

    /// Publishes: replaces `CURRENT` and syncs the folder. All that it names must be synced before.
    pub(super) fn publish(&self, folder: &Path) -> Result<(), DatasetError> {
        let path = current_path(folder);
        let mut file =
            new_file_in(folder).map_err(DatasetError::io(folder, "create a file in the folder"))?;
        let written = file
            .write_all(self.text().as_bytes())
            .and_then(|()| file.as_file().sync_all());
        written.map_err(DatasetError::io(&path, "write"))?;
        file.persist(&path)
            .map_err(|error| DatasetError::io(&path, "rename into place")(error.error))?;
        sync_folder(folder)
    }
}

/// A file beside the one that it is to replace, with the permissions of any new file: whoever may
/// read the segments may read this.
fn new_file_in(folder: &Path) -> std::io::Result<tempfile::NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // The umask takes away what it takes away from the others.
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder)
}

/// Makes renames and new names in a folder durable.
pub(super) fn sync_folder(folder: &Path) -> Result<(), DatasetError> {
    File::open(folder)
        .and_then(|folder| folder.sync_all())
        .map_err(DatasetError::io(folder, "sync the folder"))
}

fn not_a_dataset(folder: &Path) -> DatasetError {
    let why = if folder.is_dir() {
        "no finished dataset: there is no CURRENT in it, so its build did not end; go on with \
         build --resume, or build it again"
    } else if folder.exists() {
        "not a dataset: a dataset is a folder; make one with escarp-tiles build"
    } else {
        "there is no such folder; make it with escarp-tiles build"
    };
    DatasetError::NotADataset {
        path: folder.to_path_buf(),
        why: why.into(),
    }
}
