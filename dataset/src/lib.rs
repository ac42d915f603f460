//! The files of a dataset: opened, mapped read-only, read page by page, written, published.
//!
//! A published dataset: opened, mapped read-only, and read page by page.
//!
//! Invariants, checked when a dataset is opened: every file has the length that the manifest
//! says; manifest and index match their checksums; the index is ascending and points inside the
//! segments. Family tables and records are checked when they are read.
//!
//! `tiles/FORMAT.md` has the byte map.

pub mod checksum;
mod current;
mod error;
mod family;
mod figures;
mod files;
mod filled;
mod index;
mod journal;
mod map;
mod read;
mod serve;
mod write;

pub use current::{Current, current_path};
pub use error::DatasetError;
pub use family::{FamilyId, FamilyTable, StoredRecord};
pub use figures::Figures;
pub use files::{Unfinished, disk_bytes, generations, unfinished};
pub use filled::{FilledRun, FilledRuns};
pub use index::IndexEntry;
pub use journal::{Journal, MAX_ENTRY_BYTES};
pub use read::PageReader;
pub use serve::{Io, ReadError, Stored, Wait};
pub use write::{DatasetWriter, FamilyBytes, MAX_SEGMENT_BYTES};

use crate::checksum::crc32c;
use escarp_proto::geometry::{GridLevels, PageId};
use escarp_proto::manifest::Manifest;
use index::Index;
use map::Mapped;
use serve::Checked;
use std::path::{Path, PathBuf};

/// A dataset of one generation. Files of that generation are immutable: while it is open, nothing
/// may shorten them (`map` says why, and `serve` what can be done where that is not certain).
#[derive(Debug)]
pub struct Dataset {
    folder: PathBuf,
    name: String,
    manifest: Manifest,
    manifest_json: Vec<u8>,
    manifest_crc32c: u32,
    index: Index,
    segments: Vec<Mapped>,
    io: Io,
    checked: Checked,
}

impl Dataset {
    /// Opens the published generation.
    ///
    /// # Errors
    /// [`DatasetError`] if the folder is no finished dataset, or a file is missing, has another
    /// length than stated, or does not match its checksum.
    pub fn open(folder: &Path) -> Result<Dataset, DatasetError> {
        let current = Current::read(folder)?;
        let manifest_json = current.read_manifest(folder)?;
        let path = current.manifest_path(folder);
        Self::with_manifest(folder, (&path, current.generation), manifest_json)
    }

    /// Opens a generation that was published before, and is still there. Its manifest's checksum
    /// is known no more; all else is checked as ever.
    ///
    /// # Errors
    /// As [`open`](Self::open); [`DatasetError::Usage`] if there is no such generation.
    pub fn open_generation(folder: &Path, generation: u64) -> Result<Dataset, DatasetError> {
        let published = Current::read(folder)?;
        if generation == published.generation {
            return Self::open(folder);
        }
        let there = generations(folder)?;
        if generation > published.generation || !there.contains(&generation) {
            let why = format!("no generation {generation}, there are {there:?}");
            let path = folder.to_path_buf();
            return Err(DatasetError::Usage { path, why });
        }
        let (path, json) = Current::read_old_manifest(folder, generation)?;
        Self::with_manifest(folder, (&path, generation), json)
    }

    fn with_manifest(
        folder: &Path,
        (path, generation): (&Path, u64),
        manifest_json: Vec<u8>,
    ) -> Result<Dataset, DatasetError> {
        let manifest =
            Manifest::from_json(&manifest_json).map_err(|why| DatasetError::damaged(path, why))?;
        if manifest.generation != generation {
            let found = manifest.generation;
            let why = format!("is of generation {found}, its name says {generation}");
            return Err(DatasetError::damaged(path, why));
        }
        let index = Index::open(folder, &manifest)?;
        let segments = manifest
            .segments
            .iter()
            .map(|segment| Mapped::open(&segment_path(folder, &segment.file)?, segment.bytes))
            .collect::<Result<_, _>>()?;
        Ok(Dataset {
            folder: folder.to_path_buf(),
            name: name_of(folder),
            manifest,
            manifest_crc32c: crc32c(&manifest_json),
            manifest_json,
            checked: Checked::new(index.len()),
            index,
            segments,
            io: Io::default(),
        })
    }

    /// The folder's name without `.escarp`: the last part of the dataset's address.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Where it lies.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The manifest.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// The manifest's bytes as published.
    pub fn manifest_json(&self) -> &[u8] {
        &self.manifest_json
    }

    /// CRC-32C of the manifest's bytes, as `CURRENT` has it.
    pub fn manifest_crc32c(&self) -> u32 {
        self.manifest_crc32c
    }

    /// Depth of the grid.
    pub fn grid(&self) -> GridLevels {
        self.manifest.grid_levels
    }

    /// Bytes of the whole dataset on disk.
    pub fn total_bytes(&self) -> u64 {
        let segments: u64 = self
            .manifest
            .segments
            .iter()
            .map(|segment| segment.bytes)
            .sum();
        let filled = self.manifest.filled.map_or(0, |filled| filled.file.bytes);
        segments + filled + self.manifest.index.bytes + self.manifest_json.len() as u64
    }

    /// Which samples are no data but fill.
    ///
    /// # Errors
    /// [`DatasetError`] if the file that says so is missing, or is not what the manifest says.
    pub fn filled(&self) -> Result<FilledRuns, DatasetError> {
        FilledRuns::read(&self.folder, &self.manifest)
    }

    /// A page's record, checked against its revision. `None` if none is stored.
    ///
    /// # Errors
    /// [`DatasetError::Damaged`] if the family's table or the record does not match its checksum.
    pub fn record(&self, page: PageId) -> Result<Option<StoredRecord<'_>>, DatasetError> {
        if !self.grid().holds(page) {
            return Ok(None);
        }
        let family = FamilyId::of(page);
        match self.find(family) {
            Some(entry) => self.family(&entry)?.record(page),
            None => Ok(None),
        }
    }

    /// All families, by id, ascending.
    pub fn families(&self) -> impl Iterator<Item = IndexEntry> + '_ {
        self.index.entries()
    }

    /// Where a family lies; `None` if none of its pages has a record.
    pub fn find(&self, family: FamilyId) -> Option<IndexEntry> {
        self.index.find(family).map(|(_, entry)| entry)
    }

    /// The table of a family, checked.
    ///
    /// # Errors
    /// [`DatasetError::Damaged`] if it does not match its checksum.
    pub fn family(&self, entry: &IndexEntry) -> Result<FamilyTable<'_>, DatasetError> {
        let path = self.segments[entry.segment as usize].path();
        FamilyTable::read(entry, self.family_bytes(entry), path)
    }

    /// The bytes of a family, not checked.
    pub fn family_bytes(&self, entry: &IndexEntry) -> &[u8] {
        let segment = &self.segments[entry.segment as usize];
        &segment.bytes()[entry.offset as usize..][..entry.bytes as usize]
    }
}

/// A segment's path; its name is checked, as it comes from a file.
fn segment_path(folder: &Path, file: &str) -> Result<PathBuf, DatasetError> {
    let plain =
        file.starts_with("seg-") && file[4..].bytes().all(|b| b.is_ascii_digit() || b == b'-');
    if !plain {
        let why = format!("segment named {file:?}, allowed is seg-<generation>-<number>");
        return Err(DatasetError::damaged(folder, why));
    }
    Ok(folder.join(file))
}

/// The last part of a dataset's address.
pub fn name_of(folder: &Path) -> String {
    let name = folder
        .file_name()
        .unwrap_or(folder.as_os_str())
        .to_string_lossy();
    name.strip_suffix(".escarp").unwrap_or(&name).to_owned()
}
