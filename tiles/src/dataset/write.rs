//! Writing a generation: families go to segments as they come; publishing is the last step, so
//! that a crash at any moment leaves what was published before.

use super::current::{Current, sync_folder};
use super::family::encode_family;
use super::index::{IndexEntry, write_index, write_synced};
use super::{DatasetError, FamilyId, FilledRuns};
use crate::checksum::crc32c;
use escarp_proto::geometry::Slot;
use escarp_proto::manifest::{Filled, Manifest, Segment};
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// No segment is longer.
pub const MAX_SEGMENT_BYTES: u64 = 1 << 30;

/// A family, encoded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FamilyBytes {
    family: FamilyId,
    bytes: Vec<u8>,
    table_crc32c: u32,
    pages: usize,
}

impl FamilyBytes {
    /// Encodes records, which come by slot, ascending. `None` if there are none.
    pub fn encode(family: FamilyId, records: &[(Slot, Vec<u8>)]) -> Option<FamilyBytes> {
        if records.is_empty() {
            return None;
        }
        let (bytes, table_crc32c) = encode_family(family, records);
        Some(FamilyBytes {
            family,
            bytes,
            table_crc32c,
            pages: records.len(),
        })
    }
}

/// Writes a new generation of a dataset beside the published one.
#[derive(Debug)]
pub struct DatasetWriter {
    folder: PathBuf,
    generation: u64,
    segments: Vec<Segment>,
    open: Option<BufWriter<File>>,
    index: Vec<IndexEntry>,
    pages: u64,
    published: bool,
    /// Held until the writer goes.
    _lock: File,
}

impl Drop for DatasetWriter {
    /// What was not published is of no use: a full disk gets its room back.
    fn drop(&mut self) {
        if !self.published {
            self.open = None;
            let own = self.generation;
            // There is nobody to tell, and the next writer tries again.
            let _ = remove_generations(&self.folder, |generation| generation == own);
        }
    }
}

impl DatasetWriter {
    /// Starts a generation. What an unfinished writer left behind is removed.
    ///
    /// # Errors
    /// [`DatasetError::Usage`] if a dataset is published there and `overwrite` is not set, or if
    /// another program writes there; [`DatasetError::Io`] if the system refuses.
    pub fn create(folder: &Path, overwrite: bool) -> Result<DatasetWriter, DatasetError> {
        let usage = |why: &str| DatasetError::Usage {
            path: folder.to_path_buf(),
            why: why.into(),
        };
        if folder.is_dir() && !holds_only_ours(folder)? {
            return Err(usage("the folder holds other files; choose another name"));
        }
        fs::create_dir_all(folder).map_err(DatasetError::io(folder, "create the folder"))?;
        let path = folder.join("LOCK");
        let lock = File::create(&path).map_err(DatasetError::io(&path, "create"))?;
        lock.try_lock()
            .map_err(|_| usage("another program is writing this dataset"))?;
        let published = match Current::read(folder) {
            Ok(_) if !overwrite => {
                return Err(usage("exists already; give --overwrite to replace it"));
            }
            Ok(current) => current.generation,
            Err(DatasetError::NotADataset { .. }) => 0,
            Err(_) if overwrite => newest_generation(folder)?,
            Err(error) => return Err(error),
        };
        remove_generations(folder, |generation| generation != published)?;
        Ok(DatasetWriter {
            folder: folder.to_path_buf(),
            generation: published + 1,
            segments: Vec::new(),
            open: None,
            index: Vec::new(),
            pages: 0,
            published: false,
            _lock: lock,
        })
    }

    /// The generation that is being written.
    pub const fn generation(&self) -> u64 {
        self.generation
    }

    /// Pages written so far.
    pub const fn pages(&self) -> u64 {
        self.pages
    }

    /// Bytes of records written so far.
    pub fn bytes(&self) -> u64 {
        self.segments.iter().map(|segment| segment.bytes).sum()
    }

    /// Appends a family.
    ///
    /// # Errors
    /// [`DatasetError::Io`] if the system refuses, as on a full disk.
    pub fn append(&mut self, family: &FamilyBytes) -> Result<(), DatasetError> {
        let length = family.bytes.len() as u64;
        let full = |segment: &Segment| segment.bytes + length > MAX_SEGMENT_BYTES;
        if self.segments.last().is_none_or(full) {
            self.next_segment()?;
        }
        let number = self.segments.len() - 1;
        let segment = &mut self.segments[number];
        let path = self.folder.join(&segment.file);
        if let Some(open) = &mut self.open {
            open.write_all(&family.bytes)
                .map_err(DatasetError::io(&path, "write"))?;
        }
        self.index.push(IndexEntry {
            family: family.family,
            offset: segment.bytes,
            bytes: length as u32,
            segment: number as u32,
            table_crc32c: family.table_crc32c,
        });
        segment.bytes += length;
        self.pages += family.pages as u64;
        Ok(())
    }

    fn next_segment(&mut self) -> Result<(), DatasetError> {
        self.close_segment()?;
        let file = format!("seg-{}-{}", self.generation, self.segments.len());
        let path = self.folder.join(&file);
        let created = File::create(&path).map_err(DatasetError::io(&path, "create"))?;
        self.open = Some(BufWriter::with_capacity(1 << 20, created));
        self.segments.push(Segment { file, bytes: 0 });
        Ok(())
    }

    fn close_segment(&mut self) -> Result<(), DatasetError> {
        let Some(open) = self.open.take() else {
            return Ok(());
        };
        let synced = open.into_inner().map_err(|error| error.into_error());
        let name = self.segments.last().map_or("", |segment| &segment.file);
        let path = self.folder.join(name);
        synced
            .and_then(|file| file.sync_all())
            .map_err(DatasetError::io(&path, "write"))
    }

    /// Writes which samples are fill, and gives what the manifest is to say of it.
    ///
    /// # Errors
    /// [`DatasetError::Io`] if the system refuses.
    pub fn write_filled(&self, filled: &FilledRuns) -> Result<Filled, DatasetError> {
        filled.write(&self.folder, self.generation)
    }

    /// Publishes. The writer fills in generation, pages, segments and index of the manifest, and
    /// removes the generation before.
    ///
    /// # Errors
    /// [`DatasetError::Io`] if the system refuses; what was published before then stays.
    pub fn publish(mut self, mut manifest: Manifest) -> Result<Manifest, DatasetError> {
        self.close_segment()?;
        manifest.generation = self.generation;
        manifest.pages = self.pages;
        manifest.index = write_index(&self.folder, self.generation, &mut self.index)?;
        manifest.segments = std::mem::take(&mut self.segments);
        let json = manifest.to_json();
        let current = Current {
            generation: self.generation,
            manifest_bytes: json.len() as u64,
            manifest_crc32c: crc32c(&json),
        };
        write_synced(&current.manifest_path(&self.folder), &json)?;
        sync_folder(&self.folder)?;
        // From here on CURRENT may name this generation, whatever fails.
        self.published = true;
        current.publish(&self.folder)?;
        remove_generations(&self.folder, |generation| generation != self.generation)?;
        Ok(manifest)
    }
}

/// The generation in the name of one of a dataset's files.
fn generation_of(name: &str) -> Option<u64> {
    let rest = ["manifest-", "index-", "seg-", "filled-"]
        .iter()
        .find_map(|prefix| name.strip_prefix(prefix))?;
    let digits = rest.split(['-', '.']).next()?;
    digits.parse().ok()
}

fn names(folder: &Path) -> Result<Vec<String>, DatasetError> {
    let entries = fs::read_dir(folder).map_err(DatasetError::io(folder, "list"))?;
    let names = entries.map(|entry| entry.map(|e| e.file_name().to_string_lossy().into_owned()));
    names
        .collect::<Result<_, _>>()
        .map_err(DatasetError::io(folder, "list"))
}

fn newest_generation(folder: &Path) -> Result<u64, DatasetError> {
    let names = names(folder)?;
    Ok(names
        .iter()
        .filter_map(|name| generation_of(name))
        .max()
        .unwrap_or(0))
}

/// Whether a folder can be taken for a dataset: nothing of anyone else's is ever written over.
fn holds_only_ours(folder: &Path) -> Result<bool, DatasetError> {
    let ours = |name: &String| {
        name == "CURRENT"
            || name == "LOCK"
            || name.starts_with(".tmp")
            || generation_of(name).is_some()
    };
    Ok(names(folder)?.iter().all(ours))
}

fn remove_generations(folder: &Path, which: impl Fn(u64) -> bool) -> Result<(), DatasetError> {
    for name in names(folder)? {
        if name.starts_with(".tmp") || generation_of(&name).is_some_and(&which) {
            let path = folder.join(name);
            fs::remove_file(&path).map_err(DatasetError::io(&path, "remove"))?;
        }
    }
    Ok(())
}
