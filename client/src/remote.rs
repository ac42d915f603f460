//! A terrain behind a connection: what the programs of the client drive.

use crate::app::{StepStats, TerrainClient, Waker};
use crate::link::{Event, Link, LinkConfig, LinkState};
use crate::mesh::PageMesh;
use crate::net::{Connection, Url};
use crate::terrain::{Terrain, TerrainStep};
use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;
use escarp_proto::view::View;
use escarp_proto::wire::MissReason;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Where the connection's thread finds the waker once there is one.
type SharedWaker = Arc<Mutex<Option<Waker>>>;

/// Reasons for lost pages that are kept.
const MOST_REASONS: usize = 8;

fn in_words(reason: MissReason) -> &'static str {
    match reason {
        MissReason::NotFound => "the server does not have it",
        MissReason::Damaged => "damaged on the server, or on the way",
        MissReason::Busy => "the server is busy",
    }
}

/// A terrain on a server.
pub struct RemoteTerrain {
    link: Link,
    connection: Connection,
    terrain: Option<Terrain>,
    memory_cap_bytes: usize,
    waker: SharedWaker,
    now: Duration,
    refused: Option<String>,
    last_step: TerrainStep,
    /// Pages that were lost since the last session began, and why the first few were.
    lost: u64,
    reasons: Vec<String>,
}

impl RemoteTerrain {
    /// Begins to connect. Nothing blocks.
    pub fn open(url: Url, memory_cap_bytes: usize) -> RemoteTerrain {
        let waker = SharedWaker::default();
        let shared = waker.clone();
        let wake = move || {
            if let Ok(Some(waker)) = shared.lock().as_deref() {
                waker();
            }
        };
        RemoteTerrain {
            link: Link::new(LinkConfig::new(url.dataset().unwrap_or(""))),
            connection: Connection::with_waker(url, Box::new(wake)),
            terrain: None,
            memory_cap_bytes,
            waker,
            now: Duration::ZERO,
            refused: None,
            last_step: TerrainStep::default(),
            lost: 0,
            reasons: Vec::new(),
        }
    }

    /// Why there is no use in waiting: the server refused for good, or there never was a session.
    pub fn failure(&self) -> Option<String> {
        let never = self.link.stats().sessions == 0;
        let trouble = self.link.trouble().filter(|_| never);
        self.refused.clone().or_else(|| trouble.map(str::to_owned))
    }

    /// Whether all that can be had for the last view is here.
    pub fn is_settled(&self) -> bool {
        let in_flight = self.link.stats().in_flight_pages;
        self.terrain
            .as_ref()
            .is_some_and(|terrain| terrain.wants().is_empty() && in_flight == 0)
    }

    /// Whether there is a session now.
    pub fn is_connected(&self) -> bool {
        self.link.is_open()
    }

    /// Pages that do not come, or were refused, and why the first few were: a sentence each.
    pub fn lost_pages(&self) -> (u64, &[String]) {
        (self.lost, &self.reasons)
    }

    fn lose(&mut self, page: PageId, why: &str) {
        self.lost += 1;
        if self.reasons.len() < MOST_REASONS {
            self.reasons.push(format!("page {page}: {why}"));
        }
    }

    /// The terrain, once the server has told what it is.
    pub fn terrain(&self) -> Option<&Terrain> {
        self.terrain.as_ref()
    }

    /// Milliseconds to the server and back, if known.
    pub fn round_trip_ms(&self) -> Option<f64> {
        self.link.stats().round_trip_ms
    }

    fn handle_events(&mut self) {
        while let Some(event) = self.link.poll_event() {
            match event {
                Event::Welcome { manifest, changed } => {
                    self.lost = 0;
                    self.reasons.clear();
                    if changed {
                        self.terrain = Some(Terrain::new(manifest, self.memory_cap_bytes));
                    } else if let Some(terrain) = &mut self.terrain {
                        terrain.forget_misses();
                    }
                }
                Event::Chunk(chunk) => {
                    if let Some(terrain) = &mut self.terrain {
                        terrain.receive(chunk);
                    }
                }
                Event::Miss(miss) => {
                    let page = PageId::from_key(miss.page);
                    if let (Some(terrain), Some(page)) = (&mut self.terrain, page) {
                        terrain.miss(page);
                        self.lose(page, in_words(miss.reason));
                    }
                }
                Event::Refused {
                    fatal: true, text, ..
                } => {
                    // The link says what the server's text is about.
                    self.refused = Some(self.link.trouble().map_or(text, str::to_owned));
                }
                Event::Refused { .. }
                | Event::Idle { .. }
                | Event::GenChange { .. }
                | Event::Disconnected { .. } => {}
            }
        }
    }

    /// Updates the terrain for a view that is in order, and tells the link what follows.
    fn update(&mut self, view: &View) {
        let Some(terrain) = &mut self.terrain else {
            return;
        };
        if self.link.set_view(view, self.now).is_err() {
            return;
        }
        let step = terrain.update(view);
        self.link.evict(&step.dropped);
        self.link.set_wants(terrain.wants(), self.now);
        for (page, why) in &step.rejected {
            self.link.reject(*page);
            self.lose(*page, &why.to_string());
        }
        self.last_step = step;
    }
}

impl TerrainClient for RemoteTerrain {
    fn manifest(&self) -> Option<Arc<Manifest>> {
        self.terrain
            .as_ref()
            .map(|terrain| terrain.manifest().clone())
    }

    fn poll(&mut self, now: Duration) {
        self.now = now;
        self.connection.drive(&mut self.link, now);
        self.handle_events();
        // What the events led to is sent at once.
        self.connection.drive(&mut self.link, now);
    }

    fn step(&mut self, view: &View, now: Duration) -> StepStats {
        self.now = now;
        self.connection.drive(&mut self.link, now);
        self.handle_events();
        let began = Instant::now();
        self.update(view);
        let update_ms = began.elapsed().as_secs_f32() * 1e3;
        self.connection.drive(&mut self.link, now);
        let link = self.link.stats();
        let terrain = self.terrain.as_ref();
        let excess = terrain.map_or(f64::INFINITY, |_| self.last_step.excess);
        StepStats {
            triangles: self.last_step.triangles,
            bytes_received: link.received_bytes,
            pages_wanted: terrain.map_or(1, |_| self.last_step.lacking) as u32,
            pages_in_flight: link.in_flight_pages as u32,
            pages_resident: terrain.map_or(0, |terrain| terrain.tree().resident()) as u32,
            bound_px: excess * f64::from(view.max_screen_error_px),
            converged: excess <= 1.0,
            update_ms,
        }
    }

    fn visit_pages(&self, visit: &mut dyn FnMut(&PageMesh)) {
        self.terrain
            .iter()
            .flat_map(Terrain::meshes)
            .for_each(visit);
    }

    fn status(&self) -> String {
        if let Some(refused) = &self.refused {
            return refused.clone();
        }
        let full = if self.last_step.memory_full {
            ", memory cap reached"
        } else {
            ""
        };
        let lost = match self.reasons.first() {
            Some(first) => format!(", {} pages lost ({first})", self.lost),
            None => String::new(),
        };
        match self.link.state() {
            LinkState::Waiting { retry_at } => {
                let seconds = retry_at.saturating_sub(self.now).as_secs_f32().ceil();
                let trouble = self.link.trouble().unwrap_or("no connection yet");
                format!("{trouble}; trying again in {seconds} s")
            }
            LinkState::Connecting | LinkState::Greeting { .. } => "connecting".into(),
            LinkState::Open { .. } => format!("connected{full}{lost}"),
            LinkState::Refused => "refused".into(),
        }
    }

    fn set_waker(&mut self, waker: Waker) {
        if let Ok(mut shared) = self.waker.lock() {
            *shared = Some(waker);
        }
    }
}
