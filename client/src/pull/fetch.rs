//! Records from a server: many pages a request, over a link that reconnects by itself.

use super::PullError;
use super::spool::{Records, Spool};
use crate::link::{Event, Link, LinkConfig};
use crate::net::{Connection, Url, own_seed};
use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;
use escarp_proto::page::{MAX_RECORD_BYTES, last_part, revision};
use escarp_proto::wire::{Chunk, Class, MissReason, Want};
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::{Duration, Instant};

/// Pages asked for at a time.
const BATCH: usize = 1024;
/// How often a page whose bytes are wrong is asked for.
const TRIES: u8 = 3;
/// Longest sleep while nothing arrives.
const NAP: Duration = Duration::from_millis(50);

/// What was received, and how long it may take.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Received {
    pub(super) pages: u64,
    pub(super) bytes: u64,
}

/// A server, and a clock.
pub(super) struct Fetcher {
    link: Link,
    connection: Connection,
    news: Receiver<()>,
    began: Instant,
    /// A server from which nothing comes for so long is given up.
    patience: Duration,
    last_news: Duration,
    manifest: Option<Arc<Manifest>>,
    pub(super) received: Received,
}

impl Fetcher {
    /// Begins to connect.
    pub(super) fn new(url: &Url, token: Option<String>, patience: Duration) -> Fetcher {
        let (sender, news) = sync_channel(1);
        let wake = move || {
            // Full means that a wake-up is pending already.
            let _ = sender.try_send(());
        };
        let config = LinkConfig {
            token,
            push: false,
            max_in_flight_pages: BATCH,
            ..LinkConfig::new(url.dataset().unwrap_or("")).seeded(own_seed())
        };
        Fetcher {
            link: Link::new(config),
            connection: Connection::with_waker(url.clone(), Box::new(wake)),
            news,
            began: Instant::now(),
            patience,
            last_news: Duration::ZERO,
            manifest: None,
            received: Received::default(),
        }
    }

    /// Waits for the dataset's manifest.
    pub(super) fn manifest(&mut self) -> Result<Arc<Manifest>, PullError> {
        let mut none = |_| Ok(());
        while self.manifest.is_none() {
            self.turn(&mut none)?;
        }
        self.manifest.clone().ok_or_else(|| PullError::Server {
            why: "no manifest has come".into(),
        })
    }

    /// Fetches the records of pages, most of them at a time, and puts them where they belong; each
    /// batch is made durable before the next is asked for. `tell` is called after each.
    pub(super) fn fetch(
        &mut self,
        pages: &[PageId],
        records: &mut Records,
        mut spool: Option<&mut Spool>,
        tell: &mut dyn FnMut(Received),
    ) -> Result<(), PullError> {
        for batch in pages.chunks(BATCH) {
            let fetched = self.batch(batch)?;
            if let Some(spool) = spool.as_deref_mut() {
                spool.append(fetched.iter().map(|(page, record)| (*page, &record[..])))?;
            }
            records.extend(fetched);
            tell(self.received);
        }
        Ok(())
    }

    fn batch(&mut self, pages: &[PageId]) -> Result<Records, PullError> {
        let manifest = self.manifest()?;
        let mut batch = Batch::new(pages, &manifest);
        self.last_news = self.began.elapsed();
        while !batch.is_done() {
            self.link.set_wants(&batch.wants(), self.began.elapsed());
            let mut chunks = Vec::new();
            self.turn(&mut |chunk| {
                chunks.push(chunk);
                Ok(())
            })?;
            for chunk in chunks {
                let page = batch.take(chunk)?;
                // What is here need not be remembered on either side; what was wrong comes anew.
                if let Some(page) = page {
                    self.link.evict(&[page]);
                }
            }
        }
        self.received.pages += batch.done.len() as u64;
        self.received.bytes += batch.done.values().map(|r| r.len() as u64).sum::<u64>();
        Ok(batch.done)
    }

    /// Moves messages, hands on chunks, and sleeps if there are none.
    fn turn(
        &mut self,
        on_chunk: &mut dyn FnMut(Chunk) -> Result<(), PullError>,
    ) -> Result<(), PullError> {
        let now = self.began.elapsed();
        self.connection.drive(&mut self.link, now);
        let mut any = false;
        while let Some(event) = self.link.poll_event() {
            any = true;
            match event {
                Event::Chunk(chunk) => {
                    self.last_news = now;
                    on_chunk(chunk)?;
                }
                other => self.on_event(other)?,
            }
        }
        if any {
            return Ok(());
        }
        if now.saturating_sub(self.last_news) > self.patience {
            let why = self.link.trouble().unwrap_or("nothing came").to_owned();
            let seconds = self.patience.as_secs();
            return Err(PullError::Server {
                why: format!("no page for {seconds} s: {why}"),
            });
        }
        // Woken or not: the link has timers of its own.
        let _ = self.news.recv_timeout(NAP);
        Ok(())
    }

    fn on_event(&mut self, event: Event) -> Result<(), PullError> {
        match event {
            Event::Welcome { manifest, .. } | Event::GenChange { manifest } => {
                self.on_manifest(manifest)
            }
            Event::Refused {
                fatal: true, text, ..
            } => Err(PullError::Refused(
                self.link.trouble().map_or(text, str::to_owned),
            )),
            Event::Miss(miss) if miss.reason != MissReason::Busy => {
                let page = PageId::from_key(miss.page).map_or(String::new(), |p| p.to_string());
                let why = match miss.reason {
                    MissReason::NotFound => "is not there, but the page above says that it is",
                    _ => "is damaged on the server",
                };
                Err(PullError::Contradiction(format!("page {page} {why}")))
            }
            _ => Ok(()),
        }
    }

    fn on_manifest(&mut self, manifest: Arc<Manifest>) -> Result<(), PullError> {
        match &self.manifest {
            Some(before) if *before != manifest => Err(PullError::Changed {
                found: manifest.generation,
                pulled: before.generation,
            }),
            _ => {
                self.manifest = Some(manifest);
                Ok(())
            }
        }
    }
}

/// Pages on their way. Holds at most [`BATCH`] records of [`MAX_RECORD_BYTES`].
struct Batch<'a> {
    manifest: &'a Manifest,
    left: HashMap<PageId, Partial>,
    order: Vec<PageId>,
    done: Records,
}

#[derive(Debug, Clone, Default)]
struct Partial {
    bytes: Vec<u8>,
    parts: u8,
    revision: u32,
    tries: u8,
}

impl<'a> Batch<'a> {
    fn new(pages: &[PageId], manifest: &'a Manifest) -> Batch<'a> {
        Batch {
            manifest,
            left: pages
                .iter()
                .map(|&page| (page, Partial::default()))
                .collect(),
            order: pages.to_vec(),
            done: Records::new(),
        }
    }

    fn is_done(&self) -> bool {
        self.left.is_empty()
    }

    fn last_part(&self, page: PageId) -> u8 {
        last_part(self.manifest.grid_levels.is_finest(page))
    }

    fn wants(&self) -> Vec<Want> {
        let want = |page: &PageId| {
            let partial = self.left.get(page)?;
            Some(Want {
                page: page.key(),
                first_part: partial.parts,
                last_part: self.last_part(*page),
                class: Class::InView,
                priority: 1.0,
            })
        };
        self.order.iter().filter_map(want).collect()
    }

    /// Takes a chunk; the page, if it is whole, or has to be asked for from the start.
    fn take(&mut self, chunk: Chunk) -> Result<Option<PageId>, PullError> {
        let page = PageId::from_key(chunk.page).filter(|page| self.left.contains_key(page));
        let Some(page) = page else {
            return Ok(None);
        };
        let last = self.last_part(page);
        let Some(partial) = self.left.get_mut(&page) else {
            return Ok(None);
        };
        let continues = chunk.first_part == partial.parts
            && (partial.parts == 0 || chunk.revision == partial.revision)
            && partial.bytes.len() + chunk.bytes.len() <= MAX_RECORD_BYTES;
        if continues {
            partial.bytes.extend(&chunk.bytes);
            partial.parts = chunk.last_part.saturating_add(1);
            partial.revision = chunk.revision;
            if chunk.last_part < last {
                return Ok(None);
            }
            let found = revision(page, &partial.bytes);
            if found == chunk.revision {
                let partial = self.left.remove(&page).unwrap_or_default();
                self.done.insert(page, partial.bytes);
                return Ok(Some(page));
            }
        }
        *partial = Partial {
            tries: partial.tries + 1,
            ..Partial::default()
        };
        match partial.tries {
            TRIES.. => Err(PullError::Contradiction(format!(
                "page {page} does not match its revision {:08x}, in {TRIES} tries",
                chunk.revision
            ))),
            _ => Ok(Some(page)),
        }
    }
}
