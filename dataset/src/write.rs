//! Writing a generation: families go to segments as they come; publishing is the last step, so
//! that a crash at any moment leaves what was published before.

mod go_on;
mod publish;

use super::family::encode_family;
use super::files::{holds_only_ours, journal_path, newest_generation, published, remove_files};
use super::index::IndexEntry;
use super::{Dataset, DatasetError, FamilyId};
use escarp_proto::geometry::Slot;
use escarp_proto::manifest::Segment;
use std::collections::HashSet;
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

    /// A family of a dataset as it is, each record checked; and how many there are.
    pub fn copy(
        dataset: &Dataset,
        entry: &IndexEntry,
    ) -> Result<(FamilyBytes, usize), DatasetError> {
        let table = dataset.family(entry)?;
        table.records().try_for_each(|record| record.map(|_| ()))?;
        let family = FamilyBytes {
            family: entry.family,
            bytes: dataset.family_bytes(entry).to_vec(),
            table_crc32c: entry.table_crc32c,
            pages: table.len(),
        };
        Ok((family, table.len()))
    }
}

/// Writes a new generation of a dataset beside the published one.
#[derive(Debug)]
pub struct DatasetWriter {
    folder: PathBuf,
    generation: u64,
    segments: Vec<Segment>,
    /// Of the segments, how many are those of the generation before, which are never written to.
    shared: usize,
    open: Option<BufWriter<File>>,
    index: Vec<IndexEntry>,
    /// Families of the generation before that this one has no more, or has anew.
    replaced: HashSet<FamilyId>,
    pages: u64,
    /// What is written stays when the writer goes: it is published, or can be resumed.
    keep: bool,
    /// Held until the writer goes.
    _lock: File,
}

impl Drop for DatasetWriter {
    /// What can neither be read nor resumed is of no use: a full disk gets its room back.
    fn drop(&mut self) {
        if !self.keep {
            self.open = None;
            let own = self.generation;
            // There is nobody to tell, and the next writer tries again.
            let _ = remove_files(&self.folder, |_, generation| generation == own);
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
        let mut writer = Self::lock(folder, overwrite)?;
        writer.start_anew()?;
        Ok(writer)
    }

    /// As [`create`](Self::create), but what an unfinished writer left behind stays for
    /// [`go_on`](Self::go_on), until [`start_anew`](Self::start_anew).
    pub fn reopen(folder: &Path, overwrite: bool) -> Result<DatasetWriter, DatasetError> {
        Self::lock(folder, overwrite)
    }

    /// Starts a generation that has all families of the published one, until they are replaced.
    ///
    /// # Errors
    /// [`DatasetError::Usage`] if another program writes there, if an unfinished build lies there,
    /// or if the dataset is no more the published one; [`DatasetError::Io`].
    pub fn extend(base: &Dataset) -> Result<DatasetWriter, DatasetError> {
        let folder = base.folder();
        let mut writer = Self::lock(folder, true)?;
        let usage = |why: String| {
            Err(DatasetError::Usage {
                path: folder.to_path_buf(),
                why,
            })
        };
        if journal_path(folder, writer.generation).exists() {
            return usage(
                "an unfinished build lies there: finish it with build --resume, or remove its \
                 file resume-*"
                    .into(),
            );
        }
        if base.manifest().generation.checked_add(1) != Some(writer.generation) {
            return usage("another program published meanwhile; start again".into());
        }
        writer.start_anew()?;
        writer.segments = base.manifest().segments.clone();
        writer.shared = writer.segments.len();
        writer.index = base.families().collect();
        writer.pages = base.manifest().pages;
        Ok(writer)
    }

    fn lock(folder: &Path, overwrite: bool) -> Result<DatasetWriter, DatasetError> {
        let usage = |why: &str| DatasetError::Usage {
            path: folder.to_path_buf(),
            why: why.into(),
        };
        if folder.is_dir() && !holds_only_ours(folder)? {
            return Err(usage(
                "the folder holds other files, folders or links; choose another name",
            ));
        }
        fs::create_dir_all(folder).map_err(DatasetError::io(folder, "create the folder"))?;
        let path = folder.join("LOCK");
        let lock = File::create(&path).map_err(DatasetError::io(&path, "create"))?;
        lock.try_lock()
            .map_err(|_| usage("another program is writing this dataset"))?;
        let published = match published(folder) {
            Ok(1..) if !overwrite => {
                return Err(usage("exists already; give --overwrite to replace it"));
            }
            Ok(generation) => generation,
            Err(_) if overwrite => newest_generation(folder)?,
            Err(error) => return Err(error),
        };
        Ok(DatasetWriter {
            folder: folder.to_path_buf(),
            generation: published + 1,
            segments: Vec::new(),
            shared: 0,
            open: None,
            index: Vec::new(),
            replaced: HashSet::new(),
            pages: 0,
            keep: true,
            _lock: lock,
        })
    }

    /// Removes what unfinished writers left behind. Nothing published is touched: the published
    /// generation may share segments with those before it.
    pub fn start_anew(&mut self) -> Result<(), DatasetError> {
        self.keep = false;
        let own = self.generation;
        remove_files(&self.folder, |name, generation| {
            generation >= own || name.starts_with("resume-")
        })
    }

    /// From now on, what is written stays when the writer goes, for [`go_on`](Self::go_on).
    pub fn keep_unfinished(&mut self, keep: bool) {
        self.keep = keep;
    }

    /// Where a journal of this writer belongs.
    pub fn journal_path(&self) -> PathBuf {
        journal_path(&self.folder, self.generation)
    }

    /// The generation that is being written.
    pub const fn generation(&self) -> u64 {
        self.generation
    }

    /// Pages written so far, and shared ones.
    pub const fn pages(&self) -> u64 {
        self.pages
    }

    /// Bytes of records written so far.
    pub fn bytes(&self) -> u64 {
        let own = &self.segments[self.shared..];
        own.iter().map(|segment| segment.bytes).sum()
    }

    /// Families written so far, in order.
    pub fn written(&self) -> &[IndexEntry] {
        &self.index
    }

    /// Makes durable what was written so far.
    pub fn sync(&mut self) -> Result<(), DatasetError> {
        let Some(open) = &mut self.open else {
            return Ok(());
        };
        let synced = open.flush().and_then(|()| open.get_ref().sync_data());
        let name = self.segments.last().map_or("", |segment| &segment.file);
        synced.map_err(DatasetError::io(&self.folder.join(name), "write"))
    }

    /// Leaves out a family of the generation before, which had so many pages.
    ///
    /// # Errors
    /// [`DatasetError::Damaged`] if that generation says that it has fewer in all.
    pub fn replace(&mut self, family: FamilyId, pages: usize) -> Result<(), DatasetError> {
        if self.replaced.insert(family) {
            let left = self.pages.checked_sub(pages as u64);
            self.pages = left.ok_or_else(|| {
                let why = "its manifest says fewer pages than its families have";
                DatasetError::damaged(&self.folder, why)
            })?;
        }
        Ok(())
    }

    /// Appends a family. One of the generation before must have been [replaced](Self::replace).
    ///
    /// # Errors
    /// [`DatasetError::Io`] if the system refuses, as on a full disk.
    pub fn append(&mut self, family: &FamilyBytes) -> Result<(), DatasetError> {
        let length = family.bytes.len() as u64;
        let full = |segment: &Segment| segment.bytes + length > MAX_SEGMENT_BYTES;
        if self.open.is_none() || self.segments.last().is_none_or(full) {
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

    /// The next segment, empty.
    fn named(&self) -> Segment {
        let number = self.segments.len() - self.shared;
        Segment {
            file: format!("seg-{}-{number}", self.generation),
            bytes: 0,
        }
    }

    fn next_segment(&mut self) -> Result<(), DatasetError> {
        self.close_segment()?;
        let segment = self.named();
        let path = self.folder.join(&segment.file);
        let created = File::create(&path).map_err(DatasetError::io(&path, "create"))?;
        self.open = Some(BufWriter::with_capacity(1 << 20, created));
        self.segments.push(segment);
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
}
