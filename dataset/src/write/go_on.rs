//! Going on with what an unfinished writer left behind.

use super::super::family::FamilyTable;
use super::super::files::{journal_path, remove_files};
use super::super::index::IndexEntry;
use super::super::map::Mapped;
use super::{DatasetError, DatasetWriter};
use escarp_proto::manifest::Segment;
use rayon::prelude::*;
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom};

impl DatasetWriter {
    /// Goes on with what an unfinished writer left behind, as far as `index` says, which it gave
    /// before. What was written after is dropped; the rest is checked.
    ///
    /// # Errors
    /// [`DatasetError::Damaged`] if the segments do not hold what the index says.
    pub fn go_on(&mut self, index: Vec<IndexEntry>, pages: u64) -> Result<(), DatasetError> {
        for entry in &index {
            if entry.segment as usize == self.segments.len() {
                self.segments.push(self.named());
            }
            let last = self.segments.last_mut();
            match last.filter(|segment| segment.bytes == entry.offset) {
                Some(segment) => segment.bytes += u64::from(entry.bytes),
                None => return Err(self.no_journal("its families are not in order".into())),
            }
        }
        (self.index, self.pages) = (index, pages);
        let ours = |name: &str| self.segments.iter().any(|segment| segment.file == name);
        let journal = format!("resume-{}", self.generation);
        remove_files(&self.folder, |name, generation| {
            generation >= self.generation && name != journal && !ours(name)
        })?;
        self.open = self.reopened()?;
        self.check_families()?;
        let stored = self.check_written()?;
        match self.pages == stored {
            true => Ok(()),
            false => Err(self.no_journal(format!(
                "it says {} pages, its families have {stored}",
                self.pages
            ))),
        }
    }

    fn no_journal(&self, why: String) -> DatasetError {
        DatasetError::damaged(&journal_path(&self.folder, self.generation), why)
    }

    /// No family may have been written twice.
    fn check_families(&self) -> Result<(), DatasetError> {
        let mut families: Vec<_> = self.index.iter().map(|entry| entry.family).collect();
        families.sort_unstable();
        match families.windows(2).find(|pair| pair[0] == pair[1]) {
            None => Ok(()),
            Some(pair) => {
                let why = format!("it has family {:x} twice", pair[0].to_u64());
                Err(self.no_journal(why))
            }
        }
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

    /// Reads all that an unfinished writer wrote: how many records that is.
    fn check_written(&self) -> Result<u64, DatasetError> {
        let open =
            |segment: &Segment| Mapped::open(&self.folder.join(&segment.file), segment.bytes);
        let maps: Vec<Mapped> = self.segments.iter().map(open).collect::<Result<_, _>>()?;
        let records = self.index.par_iter().map(|entry| {
            let map = &maps[entry.segment as usize];
            let bytes = &map.bytes()[entry.offset as usize..][..entry.bytes as usize];
            let table = FamilyTable::read(entry, bytes, map.path())?;
            table.records().try_for_each(|record| record.map(|_| ()))?;
            Ok(table.len() as u64)
        });
        records.try_reduce(|| 0, |a, b| Ok(a + b))
    }
}
