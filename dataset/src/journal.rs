//! An append-only file of entries, each with its length and checksum: what a crash cuts short is
//! told from what was finished.
//!
//! An entry is its length (4 bytes), the CRC-32C of its number (8 bytes) and content (4 bytes),
//! and its content. Reading ends at the first entry that is not whole.

use super::DatasetError;
use crate::checksum::crc32c;
use std::fs::{File, OpenOptions};
use std::io::{BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// No entry is longer, bytes.
pub const MAX_ENTRY_BYTES: usize = 256 << 20;

const HEAD: u64 = 4 + 4;

/// A journal that is open for appending.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: File,
    entries: u64,
}

impl Journal {
    /// Starts an empty journal.
    pub fn create(path: &Path) -> Result<Journal, DatasetError> {
        let file = File::create(path).map_err(DatasetError::io(path, "create"))?;
        Ok(Journal {
            path: path.to_path_buf(),
            file,
            entries: 0,
        })
    }

    /// Reads all whole entries in turn, and drops what follows them. `None` if there is no file.
    pub fn open(
        path: &Path,
        mut each: impl FnMut(u64, &[u8]) -> Result<(), DatasetError>,
    ) -> Result<Option<Journal>, DatasetError> {
        let mut file = match OpenOptions::new().read(true).write(true).open(path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            opened => opened.map_err(DatasetError::io(path, "open"))?,
        };
        let length = file
            .metadata()
            .map_err(DatasetError::io(path, "read"))?
            .len();
        let mut reader = BufReader::new(&file);
        let (mut end, mut entries) = (0, 0);
        while let Some(content) = next(&mut reader, entries, length - end) {
            each(entries, &content)?;
            end += HEAD + content.len() as u64;
            entries += 1;
        }
        let cut = file
            .set_len(end)
            .and_then(|()| file.seek(SeekFrom::Start(end)));
        cut.map_err(DatasetError::io(path, "shorten"))?;
        Ok(Some(Journal {
            path: path.to_path_buf(),
            file,
            entries,
        }))
    }

    /// Whether there is any.
    pub const fn has_entries(&self) -> bool {
        self.entries > 0
    }

    /// Appends an entry, and makes it durable.
    pub fn append(&mut self, content: &[u8]) -> Result<(), DatasetError> {
        let mut entry = Vec::with_capacity(content.len() + HEAD as usize);
        entry.extend((content.len() as u32).to_le_bytes());
        entry.extend(checksum(self.entries, content).to_le_bytes());
        entry.extend(content);
        let written = self
            .file
            .write_all(&entry)
            .and_then(|()| self.file.sync_data());
        written.map_err(DatasetError::io(&self.path, "write"))?;
        self.entries += 1;
        Ok(())
    }
}

/// The next entry, if it is whole; `left` bytes of the file are not yet read.
fn next(reader: &mut impl Read, number: u64, left: u64) -> Option<Vec<u8>> {
    let mut head = [0; HEAD as usize];
    reader.read_exact(&mut head).ok()?;
    let [a, b, c, d, crc @ ..] = head;
    let length = u32::from_le_bytes([a, b, c, d]);
    // Checked before memory is taken.
    if u64::from(length) + HEAD > left || length as usize > MAX_ENTRY_BYTES {
        return None;
    }
    let mut content = vec![0; length as usize];
    reader.read_exact(&mut content).ok()?;
    (checksum(number, &content) == u32::from_le_bytes(crc)).then_some(content)
}

/// Entries that changed places do not match.
fn checksum(number: u64, content: &[u8]) -> u32 {
    let mut salted = Vec::with_capacity(content.len() + 8);
    salted.extend(number.to_le_bytes());
    salted.extend(content);
    crc32c(&salted)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(path: &Path) -> Vec<Vec<u8>> {
        let mut found = Vec::new();
        Journal::open(path, |number, content| {
            assert_eq!(number, found.len() as u64);
            found.push(content.to_vec());
            Ok(())
        })
        .unwrap()
        .expect("a journal");
        found
    }

    fn three(path: &Path) -> Vec<Vec<u8>> {
        let entries = vec![b"head".to_vec(), Vec::new(), vec![7; 3000]];
        let mut journal = Journal::create(path).unwrap();
        entries.iter().for_each(|e| journal.append(e).unwrap());
        entries
    }

    #[test]
    fn what_is_cut_short_anywhere_gives_the_whole_entries_before_it_and_can_go_on() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal");
        let entries = three(&path);
        let whole = std::fs::read(&path).unwrap();
        for length in 0..=whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            let found = read(&path);
            let ends = [12, 20, 3028];
            assert_eq!(
                found.len(),
                ends.iter().filter(|&&end| end <= length).count()
            );
            assert_eq!(found, entries[..found.len()]);
            let mut journal = Journal::open(&path, |_, _| Ok(())).unwrap().unwrap();
            journal.append(b"next").unwrap();
            assert_eq!(read(&path).last(), Some(&b"next".to_vec()));
        }
    }

    #[test]
    fn a_changed_byte_and_swapped_entries_end_the_reading() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal");
        let entries = three(&path);
        let whole = std::fs::read(&path).unwrap();
        for at in (0..100).chain([whole.len() - 1]) {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x20;
            std::fs::write(&path, &bytes).unwrap();
            let found = read(&path);
            assert!(
                found.len() < 3 && found == entries[..found.len()],
                "byte {at}"
            );
        }
        let swapped = [&whole[12..20], &whole[..12], &whole[20..]].concat();
        std::fs::write(&path, swapped).unwrap();
        assert_eq!(read(&path), Vec::<Vec<u8>>::new());
    }

    #[test]
    fn a_length_beyond_the_file_takes_no_memory() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal");
        std::fs::write(&path, [0xff; 64]).unwrap();
        assert_eq!(read(&path), Vec::<Vec<u8>>::new());
    }
}
