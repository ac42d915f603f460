//! What an earlier run has kept on disk enters the terrain, before or without a server.

use super::RemoteTerrain;
use crate::cache::{CacheOptions, DiskCache, Loaded};
use crate::net::Url;
use crate::terrain::Terrain;
use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;
use escarp_proto::wire::{Chunk, Have, Want};
use std::sync::Arc;
use std::time::Duration;

/// How long the connection waits for a disk that gives nothing. What is here by then is announced
/// in one go with the first view, so that the server does not send it.
const PATIENCE: Duration = Duration::from_secs(1);
/// How long it waits for one that does, while the view still needs what it has.
const HEAD_START: Duration = Duration::from_secs(20);

/// A cache, and where the start of the first session stands.
pub(super) struct Kept {
    cache: DiskCache,
    is_offline: bool,
    /// Whether the kept manifest was looked for.
    is_resumed: bool,
    /// Whether the connection may be made.
    is_released: bool,
    /// Whether the disk was asked for what a view needs.
    is_asked: bool,
    /// Whether it had some of that, so that there may be more below.
    has_more: bool,
    since: Option<Duration>,
    /// When the disk last gave something.
    given_at: Option<Duration>,
}

impl Kept {
    fn poll(&mut self, now: Duration) -> Option<Loaded> {
        let loaded = self.cache.poll()?;
        self.given_at = Some(now);
        Some(loaded)
    }
}

impl RemoteTerrain {
    /// Keeps what is received on disk, and uses what is there. Say so before the first step.
    pub fn keep_on_disk(&mut self, options: CacheOptions, url: &Url) {
        let shared = self.waker.clone();
        let wake = move || {
            if let Ok(Some(waker)) = shared.lock().as_deref() {
                waker();
            }
        };
        self.kept = Some(Kept {
            cache: DiskCache::open(options, &url.to_string(), Box::new(wake)),
            is_offline: false,
            is_resumed: false,
            is_released: false,
            is_asked: false,
            has_more: false,
            since: None,
            given_at: None,
        });
    }

    /// Uses only what is on disk, and never connects.
    pub fn stay_offline(&mut self) {
        if let Some(kept) = &mut self.kept {
            kept.is_offline = true;
        }
    }

    /// Whether it never connects.
    pub(super) fn is_offline(&self) -> bool {
        self.kept.as_ref().is_some_and(|kept| kept.is_offline)
    }

    /// Waits for all that was received to be on its way to the disk; the terrain is at its end.
    pub fn close(self) {
        if let Some(kept) = self.kept {
            kept.cache.flush();
        }
    }

    /// Whether what is on disk, or the first session, is still to come.
    pub(super) fn awaits_kept(&self) -> bool {
        let Some(kept) = &self.kept else {
            return false;
        };
        let is_first = !kept.is_offline && self.link.stats().sessions == 0;
        kept.cache.is_reading() || !kept.is_released || is_first
    }

    /// Moves messages to and from the server, once it is time for that.
    pub(super) fn drive(&mut self) {
        self.feed();
        if self.may_connect() {
            self.connection.drive(&mut self.link, self.now);
        }
    }

    fn may_connect(&mut self) -> bool {
        let now = self.now;
        let waiting = self.generations.newest().map_or(0, Terrain::waiting);
        let Some(kept) = &mut self.kept else {
            return true;
        };
        let since = *kept.since.get_or_insert(now);
        if waiting > 0 {
            // It is not the disk that is slow.
            kept.given_at = Some(now);
        }
        let silent_since = kept.given_at.unwrap_or(since);
        let is_over = now >= silent_since + PATIENCE || now >= since + HEAD_START;
        let is_loaded = kept.is_asked && !kept.has_more && !kept.cache.is_reading() && waiting == 0;
        let has_nothing = kept.is_resumed && kept.cache.manifest().is_none();
        kept.is_released |= is_loaded || has_nothing || is_over;
        kept.is_released && !kept.is_offline
    }

    /// Takes over what the disk has given.
    fn feed(&mut self) {
        self.resume();
        while self.generations.newest().is_some_and(Terrain::has_room)
            && let Some(loaded) = self.kept.as_mut().and_then(|kept| kept.poll(self.now))
        {
            if let (Loaded::Page(chunk), Some(terrain)) = (loaded, self.generations.newest_mut())
                && self.link.adopt(&chunk)
            {
                terrain.receive(chunk);
            }
        }
        if let Some(trouble) = self
            .kept
            .as_mut()
            .and_then(|kept| kept.cache.take_trouble())
        {
            eprintln!("note: {trouble}");
        }
    }

    /// Starts from the manifest that was kept, as soon as it is known.
    fn resume(&mut self) {
        let Some(kept) = &mut self.kept else {
            return;
        };
        if kept.is_resumed || !kept.cache.is_ready() {
            return;
        }
        kept.is_resumed = true;
        let manifest = kept.cache.manifest();
        if self.generations.newest().is_some() || kept.is_released && !kept.is_offline {
            return;
        }
        match manifest.map(|json| Manifest::from_json(&json)) {
            Some(Ok(manifest)) => {
                let manifest = Arc::new(manifest);
                self.link.resume(Arc::clone(&manifest));
                let (cap, mesh) = (self.options.memory_cap_bytes, self.options.mesh);
                self.generations.begin(manifest, cap, mesh);
            }
            Some(Err(_)) | None if kept.is_offline => {
                self.refused = Some("nothing is kept of this dataset; view it online first".into());
            }
            Some(Err(_)) | None => {}
        }
    }

    /// A session, or a generation, has begun.
    pub(super) fn keep_manifest(&mut self, manifest: &Manifest) {
        if let Some(kept) = &mut self.kept {
            kept.cache.start(&manifest.to_json());
        }
    }

    /// These pages of before are of this generation, too: so they are of use to later runs.
    pub(super) fn keep_on(&mut self, same: &[PageId]) {
        if let Some(kept) = &mut self.kept {
            let have = |page: &PageId| {
                Some(Have {
                    page: page.key(),
                    revision: self.link.revision(*page)?,
                    parts: 0,
                })
            };
            kept.cache.confirm(same.iter().filter_map(have).collect());
        }
    }

    /// Keeps what has come from the server.
    pub(super) fn keep(&mut self, chunk: &Chunk) {
        if let Some(kept) = &mut self.kept {
            kept.cache.put(chunk);
        }
    }

    /// A page that was kept, or came, is wrong.
    pub(super) fn keep_no_more(&mut self, page: PageId) {
        if let Some(kept) = &mut self.kept {
            kept.cache.forget(page.key());
        }
    }

    /// Asks the disk for what it has. What is left, the server is asked for; without one it is
    /// missing.
    pub(super) fn ask_disk(&mut self, wants: &[Want]) -> Vec<Want> {
        let Some(kept) = &mut self.kept else {
            return wants.to_vec();
        };
        let left = kept.cache.take_over(wants);
        kept.is_asked |= kept.is_resumed;
        kept.has_more = left.len() < wants.len();
        if !kept.is_offline {
            return left;
        }
        if let Some(terrain) = self.generations.newest_mut() {
            let pages = left.iter().filter_map(|want| PageId::from_key(want.page));
            pages.for_each(|page| terrain.miss(page));
        }
        Vec::new()
    }
}
