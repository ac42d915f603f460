//! Writing a generation: families go to segments as they come; publishing is the last step, so
//! that a crash at any moment leaves what was published before.

use super::current::{Current, sync_folder};
use super::family::{FamilyTable, encode_family};
use super::files::{holds_only_ours, journal_path, newest_generation, published, remove_files};
use super::index::{IndexEntry, write_index, write_synced};
use super::map::Mapped;
use super::{Dataset, DatasetError, FamilyId};
use crate::checksum::crc32c;
use escarp_proto::geometry::Slot;
use escarp_proto::manifest::{MAX_MANIFEST_BYTES, Manifest, Segment};
use rayon::prelude::*;
use std::collections::HashSet;
use std::fs::{self, File};
use std::io::{BufWriter, Seek, SeekFrom, Write};
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
    pub(crate) fn reopen(folder: &Path, overwrite: bool) -> Result<DatasetWriter, DatasetError> {
        Self::lock(folder, overwrite)
    }

    /// Starts a generation that has all families of the published one, until they are replaced.
    ///
    /// # Errors
    /// [`DatasetError::Usage`] if another program writes there, if an unfinished build lies there,
    /// or if the dataset is no more the published one; [`DatasetError::Io`].
    pub(crate) fn extend(base: &Dataset) -> Result<DatasetWriter, DatasetError> {
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
        if base.manifest().generation + 1 != writer.generation {
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
            return Err(usage("the folder holds other files; choose another name"));
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
    pub(crate) fn start_anew(&mut self) -> Result<(), DatasetError> {
        self.keep = false;
        let own = self.generation;
        remove_files(&self.folder, |name, generation| {
            generation >= own || name.starts_with("resume-")
        })
    }

    /// Goes on with what an unfinished writer left behind, as far as `index` says, which it gave
    /// before. What was written after is dropped; the rest is checked.
    ///
    /// # Errors
    /// [`DatasetError::Damaged`] if the segments do not hold what the index says.
    pub(crate) fn go_on(&mut self, index: Vec<IndexEntry>, pages: u64) -> Result<(), DatasetError> {
        for entry in &index {
            if entry.segment as usize == self.segments.len() {
                self.segments.push(self.named());
            }
            let last = self.segments.last_mut();
            match last.filter(|segment| segment.bytes == entry.offset) {
                Some(segment) => segment.bytes += u64::from(entry.bytes),
                None => {
                    let path = journal_path(&self.folder, self.generation);
                    return Err(DatasetError::damaged(
                        &path,
                        "its families are not in order",
                    ));
                }
            }
        }
        (self.index, self.pages) = (index, pages);
        let ours = |name: &str| self.segments.iter().any(|segment| segment.file == name);
        let journal = format!("resume-{}", self.generation);
        remove_files(&self.folder, |name, generation| {
            generation >= self.generation && name != journal && !ours(name)
        })?;
        self.open = self.reopened()?;
        self.check_written()
    }

    /// The last segment, cut to what counts, and ready for more.
    fn reopened(&self) -> Result<Option<BufWriter<File>>, DatasetError> {
        let Some(segment) = self.segments.last() else {
            return Ok(None);
        };
        let path = self.folder.join(&segment.file);
        let opened = File::options().read(true).write(true).open(&path);
        let mut file = opened.map_err(DatasetError::io(&path, "open"))?;
        let length = file.metadata().map_or(0, |data| data.len());
        if length < segment.bytes {
            let why = format!("{length} bytes long, {} were noted", segment.bytes);
            return Err(DatasetError::damaged(&path, why));
        }
        let cut = file
            .set_len(segment.bytes)
            .and_then(|()| file.seek(SeekFrom::End(0)));
        cut.map_err(DatasetError::io(&path, "shorten"))?;
        Ok(Some(BufWriter::with_capacity(1 << 20, file)))
    }

    /// Reads all that an unfinished writer wrote.
    fn check_written(&self) -> Result<(), DatasetError> {
        let open =
            |segment: &Segment| Mapped::open(&self.folder.join(&segment.file), segment.bytes);
        let maps: Vec<Mapped> = self.segments.iter().map(open).collect::<Result<_, _>>()?;
        self.index.par_iter().try_for_each(|entry| {
            let map = &maps[entry.segment as usize];
            let bytes = &map.bytes()[entry.offset as usize..][..entry.bytes as usize];
            let table = FamilyTable::read(entry, bytes, map.path())?;
            table.records().try_for_each(|record| record.map(|_| ()))
        })
    }

    /// From now on, what is written stays when the writer goes, for [`go_on`](Self::go_on).
    pub(crate) fn keep_unfinished(&mut self, keep: bool) {
        self.keep = keep;
    }

    /// Where a journal of this writer belongs.
    pub(crate) fn journal_path(&self) -> PathBuf {
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
    pub(crate) fn written(&self) -> &[IndexEntry] {
        &self.index
    }

    /// Makes durable what was written so far.
    pub(crate) fn sync(&mut self) -> Result<(), DatasetError> {
        let Some(open) = &mut self.open else {
            return Ok(());
        };
        let synced = open.flush().and_then(|()| open.get_ref().sync_data());
        let name = self.segments.last().map_or("", |segment| &segment.file);
        synced.map_err(DatasetError::io(&self.folder.join(name), "write"))
    }

    /// Leaves out a family of the generation before, which had so many pages.
    pub(crate) fn replace(&mut self, family: FamilyId, pages: usize) {
        if self.replaced.insert(family) {
            self.pages -= pages as u64;
        }
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

    /// Publishes, and removes all generations before.
    ///
    /// # Errors
    /// As [`publish_beside`](Self::publish_beside).
    pub fn publish(self, manifest: Manifest) -> Result<Manifest, DatasetError> {
        let (folder, own) = (self.folder.clone(), self.generation);
        let manifest = self.publish_beside(manifest)?;
        remove_files(&folder, |name, generation| {
            generation != own || name.starts_with("resume-")
        })?;
        Ok(manifest)
    }

    /// Publishes; the generations before stay on disk. The writer fills in generation, pages,
    /// segments and index of the manifest.
    ///
    /// # Errors
    /// [`DatasetError::Usage`] if there are more segments than a manifest can name;
    /// [`DatasetError::Io`] if the system refuses. What was published before then stays.
    pub(crate) fn publish_beside(
        mut self,
        mut manifest: Manifest,
    ) -> Result<Manifest, DatasetError> {
        self.close_segment()?;
        self.drop_unused();
        manifest.generation = self.generation;
        manifest.pages = self.pages;
        manifest.index = write_index(&self.folder, self.generation, &mut self.index)?;
        manifest.segments = std::mem::take(&mut self.segments);
        let json = manifest.to_json();
        if json.len() > MAX_MANIFEST_BYTES {
            return Err(DatasetError::Usage {
                path: self.folder.clone(),
                why: format!(
                    "{} segments are more than a manifest can name; compact the dataset first",
                    manifest.segments.len()
                ),
            });
        }
        let current = Current {
            generation: self.generation,
            manifest_bytes: json.len() as u64,
            manifest_crc32c: crc32c(&json),
        };
        write_synced(&current.manifest_path(&self.folder), &json)?;
        sync_folder(&self.folder)?;
        // From here on CURRENT may name this generation, whatever fails.
        self.keep = true;
        current.publish(&self.folder)?;
        Ok(manifest)
    }

    /// Leaves out replaced families, and segments in which nothing is left.
    fn drop_unused(&mut self) {
        let (shared, replaced) = (self.shared as u32, &self.replaced);
        self.index
            .retain(|entry| entry.segment >= shared || !replaced.contains(&entry.family));
        let mut used = vec![false; self.segments.len()];
        for entry in &self.index {
            used[entry.segment as usize] = true;
        }
        let mut next = 0;
        let numbers: Vec<u32> = used
            .iter()
            .map(|&used| {
                next += u32::from(used);
                next.saturating_sub(1)
            })
            .collect();
        for entry in &mut self.index {
            entry.segment = numbers[entry.segment as usize];
        }
        let mut used = used.into_iter();
        self.segments.retain(|_| used.next() == Some(true));
    }
}
