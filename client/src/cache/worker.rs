//! The thread on which the disk is read and written.

use super::index::Index;
use super::store::tag_of;
use super::{CacheOptions, Store};
use escarp_proto::wire::{Chunk, Have, Want};
use std::collections::HashSet;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender, TryRecvError, TrySendError, channel};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

/// Bytes that wait to be written: as many as a fast line brings while the disk, or the processor,
/// is busy with something else. What has no room is not kept.
const MOST_QUEUED: usize = 16 << 20;
/// A chunk that waits takes about so much beside its bytes.
const CHUNK_BYTES: usize = size_of::<Command>() + 16;
/// Pages that are being read at a time.
const MOST_PENDING: usize = 256;
/// Longest wait for the disk at the end of a program.
const LAST_WAIT: Duration = Duration::from_secs(5);

enum Command {
    Put(Chunk),
    Get(u64),
    Start(Vec<u8>),
    Confirm(Vec<Have>),
    End,
}

/// Called on the cache's thread when there is something for [`DiskCache::poll`].
pub type Waker = Box<dyn Fn() + Send>;

/// A page that was asked for.
#[derive(Debug, Clone, PartialEq)]
pub enum Loaded {
    /// It was kept, and is sound.
    Page(Chunk),
    /// It was damaged, or has been removed: it has to come from the server.
    Gone(u64),
}

/// What is kept of a dataset, for the thread that draws: nothing here waits for the disk.
#[derive(Debug)]
pub struct DiskCache {
    index: Arc<Mutex<Index>>,
    commands: Sender<Command>,
    /// Bytes of chunks among them.
    queued: Arc<AtomicUsize>,
    loaded: Receiver<Loaded>,
    pending: HashSet<u64>,
}

impl DiskCache {
    /// Begins to look through what is kept of an address, `http://HOST:PORT/NAME`.
    pub fn open(options: CacheOptions, address: &str, waker: Waker) -> DiskCache {
        let mut store = Store::new(options, address);
        let index = Arc::clone(&store.index);
        let (commands, mut queue) = channel();
        let (found, loaded) = sync_channel(MOST_PENDING);
        let queued = Arc::new(AtomicUsize::new(0));
        let queued_there = Arc::clone(&queued);
        // Without a thread the channel is closed: nothing is kept, and nothing is found.
        let _ = std::thread::Builder::new()
            .name("escarp-cache".into())
            .spawn(move || {
                store.scan();
                waker();
                run(&mut store, &mut queue, &queued_there, &found, &waker);
            });
        DiskCache {
            index,
            commands,
            queued,
            loaded,
            pending: HashSet::new(),
        }
    }

    fn index(&self) -> MutexGuard<'_, Index> {
        self.index
            .lock()
            .unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    /// Whether the disk has been looked through.
    pub fn is_ready(&self) -> bool {
        self.index().is_ready
    }

    /// The manifest of the last session, as it was received.
    pub fn manifest(&self) -> Option<Vec<u8>> {
        self.index().manifest.clone()
    }

    /// A session, or a generation, begins with this manifest. Pages that came with another one are
    /// not used: they may have changed.
    pub fn start(&mut self, manifest: &[u8]) {
        self.index().set_tag(tag_of(manifest));
        let _ = self.commands.send(Command::Start(manifest.to_vec()));
    }

    /// These pages of before are of this session's manifest, too.
    pub fn confirm(&mut self, same: Vec<Have>) {
        let _ = self.commands.send(Command::Confirm(same));
    }

    /// What to announce: the pages that were written last, newest first.
    pub fn newest(&self, most: usize) -> Vec<Have> {
        self.index().newest(most)
    }

    /// Keeps a chunk that came from the server, if the disk is not too far behind.
    pub fn put(&mut self, chunk: &Chunk) {
        let bytes = CHUNK_BYTES + chunk.bytes.len();
        if self.queued.fetch_add(bytes, Ordering::Relaxed) + bytes > MOST_QUEUED {
            self.queued.fetch_sub(bytes, Ordering::Relaxed);
            return;
        }
        let _ = self.commands.send(Command::Put(chunk.clone()));
    }

    /// Asks the disk for pages that are wanted from their first part on. What is left has to come
    /// from the server.
    pub fn take_over(&mut self, wants: &[Want]) -> Vec<Want> {
        let mut left = Vec::with_capacity(wants.len());
        for want in wants {
            if !self.asks(want) {
                left.push(*want);
            }
        }
        left
    }

    /// Whether the disk has a page, and is asked for it, or will be.
    fn asks(&mut self, want: &Want) -> bool {
        if self.pending.contains(&want.page) {
            return true;
        }
        if want.first_part > 0 || self.index().current(want.page).is_none() {
            return false;
        }
        // Where the disk is busy, it is asked when the page is wanted again, in the next frame.
        if self.pending.len() >= MOST_PENDING {
            return true;
        }
        match self.commands.send(Command::Get(want.page)) {
            Ok(()) => self.pending.insert(want.page),
            Err(_) => false,
        }
    }

    /// Whether pages are still to come from the disk.
    pub fn is_reading(&self) -> bool {
        !self.pending.is_empty()
    }

    /// The next page from the disk.
    pub fn poll(&mut self) -> Option<Loaded> {
        match self.loaded.try_recv() {
            Ok(loaded) => {
                let page = match &loaded {
                    Loaded::Page(chunk) => chunk.page,
                    Loaded::Gone(page) => *page,
                };
                self.pending.remove(&page);
                Some(loaded)
            }
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => {
                self.pending.clear();
                None
            }
        }
    }

    /// Forgets a page: it was refused, or the server has another revision.
    pub fn forget(&mut self, page: u64) {
        self.index().remove(page);
    }

    /// What went wrong, once.
    pub fn take_trouble(&mut self) -> Option<String> {
        self.index().trouble.take()
    }

    /// Waits until all that was put before is on its way to the disk, as dropping it does.
    pub fn flush(self) {}
}

/// What came last would be lost with the program's end.
impl Drop for DiskCache {
    fn drop(&mut self) {
        let until = Instant::now() + LAST_WAIT;
        // The thread ends once it has done all, and closes its side.
        let mut is_left = self.commands.send(Command::End).is_ok();
        while is_left {
            let left = until.saturating_duration_since(Instant::now());
            is_left = match self.loaded.recv_timeout(left) {
                Ok(_) => true,
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => false,
            };
        }
    }
}

fn run(
    store: &mut Store,
    queue: &mut Receiver<Command>,
    queued: &AtomicUsize,
    found: &SyncSender<Loaded>,
    waker: &Waker,
) {
    while let Ok(command) = queue.recv() {
        let loaded = match command {
            Command::Put(chunk) => {
                store.put(&chunk);
                queued.fetch_sub(CHUNK_BYTES + chunk.bytes.len(), Ordering::Relaxed);
                continue;
            }
            Command::Confirm(same) => {
                store.confirm(&same);
                continue;
            }
            Command::End => return,
            Command::Start(manifest) => {
                store.start(&manifest);
                continue;
            }
            Command::Get(page) => store.get(page).map_or(Loaded::Gone(page), Loaded::Page),
        };
        // As many have room as may be asked for; a caller that is gone wants nothing.
        if let Err(TrySendError::Disconnected(_)) = found.try_send(loaded) {
            continue;
        }
        waker();
    }
}
