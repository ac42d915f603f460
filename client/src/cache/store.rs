//! The pages of one address on disk: read, written, and looked through. Blocks; [`DiskCache`] calls
//! it on a thread of its own.
//!
//! [`DiskCache`]: super::DiskCache

use super::index::{Index, Piece};
use super::segment::{self, Head};
use super::{CacheOptions, folder};
use escarp_dataset::checksum::crc32c;
use escarp_proto::manifest::MAX_MANIFEST_BYTES;
use escarp_proto::page::MAX_RECORD_BYTES;
use escarp_proto::wire::{Chunk, Have};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{SystemTime, UNIX_EPOCH};

/// Allowed lengths of a segment, bytes; between them, a sixteenth of the cap.
const SEGMENT_BYTES: [u64; 2] = [64 << 10, 4 << 20];
/// No longer file is looked through.
const MOST_SCANNED: u64 = 2 * SEGMENT_BYTES[1];

/// A segment that is being written.
#[derive(Debug)]
struct Active {
    file: File,
    number: u32,
    end: u64,
}

/// The pages of one address.
#[derive(Debug)]
pub struct Store {
    options: CacheOptions,
    address: String,
    bucket: PathBuf,
    pub(super) index: Arc<Mutex<Index>>,
    segments: Vec<PathBuf>,
    active: Option<Active>,
    /// Nothing more is written: the disk is full, or not ours to write to.
    is_closed: bool,
    /// Segments that count as old when a page of theirs is used.
    old: u32,
    begun: u32,
}

impl Store {
    /// The pages of an address; call [`scan`](Self::scan) to find what there is.
    pub fn new(options: CacheOptions, address: &str) -> Store {
        Store {
            bucket: folder::of_address(&options.folder, address),
            address: address.to_owned(),
            options,
            index: Arc::default(),
            segments: Vec::new(),
            active: None,
            is_closed: false,
            old: 0,
            begun: 0,
        }
    }

    fn index(&self) -> MutexGuard<'_, Index> {
        // An index after a panic is still one: every record is checked when it is read.
        self.index
            .lock()
            .unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    fn segment_bytes(&self) -> u64 {
        (self.options.cap_bytes / 16).clamp(SEGMENT_BYTES[0], SEGMENT_BYTES[1])
    }

    /// Looks through the segments, and goes on with the last one if no other program does.
    pub fn scan(&mut self) {
        self.segments = folder::segments(&self.bucket);
        let mut last = None;
        for number in 0..self.segments.len() {
            let Ok(bytes) = read_file(&self.segments[number]) else {
                continue;
            };
            let Some(found) = segment::scan(&bytes, &self.address) else {
                continue;
            };
            let mut index = self.index();
            for (offset, head) in found.records {
                index.add(Piece {
                    segment: number as u32,
                    offset,
                    head,
                });
            }
            last = found.is_clean.then_some((number, found.end as u64));
        }
        if let Some((number, end)) = last.filter(|(_, end)| *end < self.segment_bytes() / 2) {
            self.active = reopen(&self.segments[number], end).map(|file| Active {
                file,
                number: number as u32,
                end,
            });
        }
        self.old = self.segments.len() as u32 / 2;
        let manifest = self.read_manifest();
        let mut index = self.index();
        if let Some(manifest) = &manifest {
            index.set_tag(tag_of(manifest));
        }
        index.manifest = manifest;
        index.is_ready = true;
    }

    fn read_manifest(&self) -> Option<Vec<u8>> {
        let bytes = read_file(&self.bucket.join("manifest")).ok()?;
        let rest = bytes.strip_prefix(&segment::segment_head(&self.address)[..])?;
        let (crc, json) = rest.split_first_chunk::<4>()?;
        (crc32c(json) == u32::from_le_bytes(*crc)).then(|| json.to_vec())
    }

    /// The manifest of the session that begins: what comes belongs to it.
    pub fn start(&mut self, manifest: &[u8]) {
        {
            let mut index = self.index();
            index.set_tag(tag_of(manifest));
            if index.manifest.as_deref() == Some(manifest) {
                return;
            }
            index.manifest = Some(manifest.to_vec());
        }
        if manifest.len() <= MAX_MANIFEST_BYTES
            && let Err(error) = self.write_manifest(manifest)
        {
            self.close(&error);
        }
    }

    fn write_manifest(&self, manifest: &[u8]) -> io::Result<()> {
        if self.is_closed {
            return Ok(());
        }
        fs::create_dir_all(&self.bucket)?;
        let mut bytes = segment::segment_head(&self.address);
        bytes.extend(crc32c(manifest).to_le_bytes());
        bytes.extend(manifest);
        let new = self.bucket.join(format!("manifest.{}", std::process::id()));
        let written = fs::write(&new, &bytes);
        let renamed = written.and_then(|()| fs::rename(&new, self.bucket.join("manifest")));
        if renamed.is_err() {
            let _ = fs::remove_file(&new);
        }
        renamed
    }

    /// Goes on without writing, and notes why.
    fn close(&mut self, error: &io::Error) {
        if !self.is_closed {
            self.is_closed = true;
            self.active = None;
            let folder = self.options.folder.display().to_string();
            let why = format!("{folder}: cannot be written, so nothing more is kept: {error}");
            self.index().trouble = Some(why);
        }
    }

    /// Keeps parts of a page, unless they are there.
    pub fn put(&mut self, chunk: &Chunk) {
        let Ok(length) = u16::try_from(chunk.bytes.len()) else {
            return;
        };
        let is_nothing = chunk.first_part == 0 && length == 0;
        if self.is_closed || is_nothing || usize::from(length) > MAX_RECORD_BYTES {
            return;
        }
        let head = {
            let index = self.index();
            let head = Head {
                page: chunk.page,
                revision: chunk.revision,
                first_part: chunk.first_part,
                last_part: chunk.last_part,
                length,
                tag: index.tag(),
            };
            if chunk.first_part > chunk.last_part || !index.lacks(&head) {
                return;
            }
            head
        };
        match self.append(&head, &chunk.bytes) {
            Ok(Some(piece)) => self.index().add(piece),
            Ok(None) => {}
            Err(error) => self.close(&error),
        }
    }

    /// These pages, if they are kept in these revisions, belong to the manifest of this session,
    /// whichever they came with: says so by a record without parts for each.
    pub fn confirm(&mut self, same: &[Have]) {
        for have in same {
            let tag = self.index().tag();
            let head = Head {
                page: have.page,
                revision: have.revision,
                first_part: 0,
                last_part: 0,
                length: 0,
                tag,
            };
            if self.is_closed || !self.index().confirms(&head) {
                continue;
            }
            match self.append(&head, &[]) {
                Ok(Some(piece)) => self.index().add(piece),
                Ok(None) => {}
                Err(error) => self.close(&error),
            }
        }
    }

    /// Appends a record. `None` if there is no room now.
    fn append(&mut self, head: &Head, parts: &[u8]) -> io::Result<Option<Piece>> {
        let bytes = segment::encode(head, parts);
        let most = self.segment_bytes();
        let is_full = |active: &Active| active.end + bytes.len() as u64 > most;
        if self.active.as_ref().is_none_or(is_full) {
            self.active = None;
            self.active = self.begin()?;
        }
        let Some(active) = &mut self.active else {
            return Ok(None);
        };
        if let Err(error) = active.file.write_all(&bytes) {
            // What was half written is no record; whoever goes on finds a clean end.
            let _ = active.file.set_len(active.end);
            return Err(error);
        }
        let piece = Piece {
            segment: active.number,
            offset: active.end as u32,
            head: *head,
        };
        active.end += bytes.len() as u64;
        Ok(Some(piece))
    }

    /// Begins a segment. `None` if other programs leave no room under the cap, or are about to.
    fn begin(&mut self) -> io::Result<Option<Active>> {
        fs::create_dir_all(&self.bucket)?;
        let Some(_lock) = folder::lock(&self.options.folder)? else {
            return Ok(None);
        };
        let most = self.segment_bytes();
        if !folder::make_room(&self.options.folder, self.options.cap_bytes, most)? {
            return Ok(None);
        }
        // Eviction may have taken the folder's last file, but never the folder.
        let time = SystemTime::now().duration_since(UNIX_EPOCH);
        let time = time.map_or(0, |time| time.as_nanos() as u64);
        self.begun += 1;
        let name = format!("seg-{time:016x}-{}-{}", std::process::id(), self.begun);
        let path = self.bucket.join(name);
        let mut file = OpenOptions::new()
            .append(true)
            .create_new(true)
            .open(&path)?;
        if file.try_lock().is_err() {
            return Ok(None);
        }
        let head = segment::segment_head(&self.address);
        file.write_all(&head)?;
        let number = self.segments.len() as u32;
        self.segments.push(path);
        Ok(Some(Active {
            file,
            number,
            end: head.len() as u64,
        }))
    }

    /// All parts of a page that are kept, checked. What is damaged, or gone, is forgotten.
    pub fn get(&mut self, page: u64) -> Option<Chunk> {
        let entry = self.index().get(page).cloned()?;
        let mut bytes = Vec::new();
        for piece in &entry.pieces {
            match self.read(piece) {
                Some(parts) if bytes.len() + parts.len() <= MAX_RECORD_BYTES => bytes.extend(parts),
                _ => {
                    self.index().remove(page);
                    return None;
                }
            }
        }
        let chunk = Chunk {
            page,
            revision: entry.revision,
            first_part: 0,
            last_part: entry.last_part(),
            bytes,
        };
        if entry.pieces.iter().any(|piece| piece.segment < self.old) {
            self.renew(&chunk);
        }
        Some(chunk)
    }

    /// Writes a page once more, so that it outlives the segment that it is in.
    fn renew(&mut self, chunk: &Chunk) {
        let tag = self.index().tag();
        let head = Head {
            page: chunk.page,
            revision: chunk.revision,
            first_part: 0,
            last_part: chunk.last_part,
            length: chunk.bytes.len() as u16,
            tag,
        };
        if self.is_closed {
            return;
        }
        match self.append(&head, &chunk.bytes) {
            Ok(Some(piece)) => self.index().add(piece),
            Ok(None) => {}
            Err(error) => self.close(&error),
        }
    }

    fn read(&self, piece: &Piece) -> Option<Vec<u8>> {
        let mut file = File::open(self.segments.get(piece.segment as usize)?).ok()?;
        let mut bytes = vec![0; segment::record_len(piece.head.length)];
        file.seek(SeekFrom::Start(u64::from(piece.offset))).ok()?;
        file.read_exact(&mut bytes).ok()?;
        segment::decode(&bytes, &piece.head).map(<[u8]>::to_vec)
    }

    /// Forgets pages.
    pub fn forget(&mut self, pages: &[u64]) {
        let mut index = self.index();
        pages.iter().for_each(|&page| index.remove(page));
    }

    /// The pages that were written last, newest first.
    pub fn newest(&self, most: usize) -> Vec<Have> {
        self.index().newest(most)
    }

    /// Pages that are known.
    pub fn pages(&self) -> usize {
        self.index().len()
    }

    /// What went wrong, once.
    pub fn take_trouble(&mut self) -> Option<String> {
        self.index().trouble.take()
    }
}

/// Tells manifests apart.
pub(super) fn tag_of(manifest: &[u8]) -> u64 {
    u64::from(crc32c(manifest)) << 32 | manifest.len() as u64 & 0xffff_ffff
}

fn read_file(path: &Path) -> io::Result<Vec<u8>> {
    let file = File::open(path)?;
    let mut bytes = Vec::new();
    file.take(MOST_SCANNED).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Opens a segment to go on with it: it must be as it was when it was looked through.
fn reopen(path: &Path, end: u64) -> Option<File> {
    let file = OpenOptions::new().append(true).open(path).ok()?;
    file.try_lock().ok()?;
    (file.metadata().ok()?.len() == end).then_some(file)
}
