//! A terrain behind a connection: what the programs of the client drive.

mod generations;
mod kept;
mod options;

pub use options::ClientOptions;

use crate::app::{StepStats, TerrainClient, Waker};
use crate::governor::{Governor, Load};
use crate::link::{Event, Link, LinkConfig, LinkState};
use crate::mesh::{MeshOptions, PageMesh};
use crate::net::{Carrier, Connection, Url, own_seed};
use crate::stages::Stages;
use crate::terrain::{Terrain, TerrainStep};
use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;
use escarp_proto::view::{SCREEN_ERRORS_PX, View};
use escarp_proto::wire::MissReason;
use generations::Generations;
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
    connection: Box<dyn Carrier>,
    generations: Generations,
    options: ClientOptions,
    kept: Option<kept::Kept>,
    governor: Governor,
    waker: SharedWaker,
    now: Duration,
    /// Of the last step.
    tolerance_px: f32,
    refused: Option<String>,
    last_step: TerrainStep,
    /// What uploading the last mesh took, milliseconds.
    upload_ms: f32,
    /// What the last frame took beside its step.
    beside: Duration,
    /// What had to be changed of the last view.
    notes: Vec<String>,
    /// Pages that were refused, and that are lost, since the last session began, and why the
    /// first few were.
    refusals: u64,
    lost: u64,
    reasons: Vec<String>,
}

impl RemoteTerrain {
    /// Begins to connect. Nothing blocks.
    pub fn open(url: Url, memory_cap_bytes: usize) -> RemoteTerrain {
        let options = ClientOptions {
            memory_cap_bytes,
            ..ClientOptions::default()
        };
        RemoteTerrain::with_options(url, options)
    }

    /// As [`open`](Self::open), with all that can be said.
    pub fn with_options(url: Url, options: ClientOptions) -> RemoteTerrain {
        let waker = SharedWaker::default();
        let shared = waker.clone();
        let wake = move || {
            if let Ok(Some(waker)) = shared.lock().as_deref() {
                waker();
            }
        };
        let config = LinkConfig {
            push: options.push,
            ..LinkConfig::new(url.dataset().unwrap_or("")).seeded(own_seed())
        };
        let connection = Connection::with_waker(url, Box::new(wake));
        RemoteTerrain {
            waker,
            ..RemoteTerrain::over(Box::new(connection), config, options)
        }
    }

    /// A terrain behind another carrier than a socket of this machine, and another link than the
    /// usual one.
    pub fn over(
        connection: Box<dyn Carrier>,
        config: LinkConfig,
        options: ClientOptions,
    ) -> RemoteTerrain {
        let mut link = Link::new(config);
        link.set_push(options.mesh.scope().is_some());
        RemoteTerrain {
            link,
            connection,
            generations: Generations::default(),
            kept: None,
            governor: options.governor(),
            options,
            waker: SharedWaker::default(),
            now: Duration::ZERO,
            tolerance_px: 0.0,
            refused: None,
            last_step: TerrainStep::default(),
            upload_ms: 0.0,
            beside: Duration::ZERO,
            notes: Vec::new(),
            refusals: 0,
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

    /// Whether all that can be had for the last view is here, and the tolerance stands.
    pub fn is_settled(&self) -> bool {
        !self.awaits_pages() && self.governor.is_steady()
    }

    /// Whether anything is still to come for the last view.
    pub fn awaits_pages(&self) -> bool {
        let link = self.link.stats();
        let under_way = link.in_flight_pages + link.waiting_events > 0;
        let terrain = self.generations.newest();
        under_way
            || self.generations.is_changing()
            || self.lacks_room()
            || self.awaits_kept()
            || terrain.is_none_or(|t| !t.wants().is_empty() || t.waiting() > 0)
    }

    /// Whether pages are lacking for which a wider tolerance will make room.
    fn lacks_room(&self) -> bool {
        let [_, widest] = SCREEN_ERRORS_PX;
        let can_widen = self.options.promises_tolerance() && self.tolerance_px < widest;
        self.last_step.memory_full && self.last_step.lacking > 0 && can_widen
    }

    /// Whether there is a session now.
    pub fn is_connected(&self) -> bool {
        self.link.is_open()
    }

    /// Pages that do not come, and why the first few do not: a sentence each. Among the reasons
    /// are those for which pages were refused that came again since.
    pub fn lost_pages(&self) -> (u64, &[String]) {
        (self.lost, &self.reasons)
    }

    /// How often pages were refused in this session. Each is asked for once more.
    pub fn refusals(&self) -> u64 {
        self.refusals
    }

    fn note_reason(&mut self, page: PageId, why: &str) {
        if self.reasons.len() < MOST_REASONS {
            self.reasons.push(format!("page {page}: {why}"));
        }
    }

    /// The link to the server, for its figures.
    pub fn link(&self) -> &Link {
        &self.link
    }

    /// The terrain, once the server has told what it is.
    pub fn terrain(&self) -> Option<&Terrain> {
        self.generations.shown()
    }

    /// Milliseconds to the server and back, if known.
    pub fn round_trip_ms(&self) -> Option<f64> {
        self.link.stats().round_trip_ms
    }

    /// Takes over what happened, as far as the terrain has room for chunks. Those that stay in the
    /// link hold back the server.
    fn handle_events(&mut self) {
        while self.generations.newest().is_none_or(Terrain::has_room)
            && let Some(event) = self.link.poll_event()
        {
            self.handle(event);
        }
    }

    fn handle(&mut self, event: Event) {
        match event {
            Event::Welcome { manifest, changed } => {
                (self.refusals, self.lost) = (0, 0);
                self.reasons.clear();
                if changed {
                    self.start_anew(manifest);
                } else if let Some(terrain) = self.generations.newest_mut() {
                    terrain.forget_misses();
                }
            }
            Event::Chunk(chunk) => {
                self.keep(&chunk);
                if let Some(terrain) = self.generations.newest_mut() {
                    terrain.receive(chunk);
                }
            }
            Event::Miss(miss) => {
                let page = PageId::from_key(miss.page);
                if let (Some(terrain), Some(page)) = (self.generations.newest_mut(), page) {
                    terrain.miss(page);
                    self.lost += 1;
                    self.note_reason(page, in_words(miss.reason));
                }
            }
            Event::Refused {
                fatal: true, text, ..
            } => {
                // The link says what the server's text is about.
                self.refused = Some(self.link.trouble().map_or(text, str::to_owned));
            }
            Event::GenChange { manifest } => self.start_anew(manifest),
            Event::Confirmed { same } => {
                let cap = self.options.memory_cap_bytes;
                self.keep_on(&same);
                let missing = self.generations.confirm(same, cap);
                self.link.evict(&missing);
            }
            Event::Refused { .. } | Event::Idle { .. } | Event::Disconnected { .. } => {}
        }
    }

    /// From here on, chunks are of another generation.
    fn start_anew(&mut self, manifest: Arc<Manifest>) {
        self.keep_manifest(&manifest);
        let ClientOptions {
            memory_cap_bytes,
            mesh,
            ..
        } = self.options;
        let lost = self.generations.begin(manifest, memory_cap_bytes, mesh);
        self.link.evict(&lost);
        (self.refusals, self.lost) = (0, 0);
        self.reasons.clear();
    }

    /// Tells the link what is looked at. Whether that is in order.
    fn look(&mut self, view: &View) -> bool {
        let scope = self.options.mesh.scope().unwrap_or_default();
        let (tested, _) = self.options.mesh.tested(view).clamped();
        self.link.set_view_in(&tested, scope, self.now).is_ok()
    }

    /// Updates the terrain for a view that is in order, and tells the link what follows.
    fn update(&mut self, view: &View) {
        let clock = Instant::now();
        let now = || clock.elapsed();
        // What the mesh took last time it takes about this time, too.
        let mesh = Duration::from_secs_f32(self.last_step.times.mesh_ms().max(0.0) / 1e3);
        let budget = self.options.frame_budget.time(self.beside);
        let mut stages = Stages::begin(&now, budget, mesh);
        let mut step = TerrainStep::default();
        loop {
            self.handle_events();
            if self.generations.newest().is_none() {
                return;
            }
            let none_left = self.generations.link_arrived(&mut step, &mut stages);
            let more = self.link.stats().waiting_events > 0;
            if !none_left || !more || step.memory_full {
                break;
            }
        }
        let link = self.link.stats();
        let is_all = self.link.is_open() && link.in_flight_pages + link.waiting_events == 0;
        let cap = self.options.memory_cap_bytes;
        let step = self
            .generations
            .finish(view, step, &mut stages, cap, is_all);
        self.follow(step);
    }

    /// Tells the link, and the user, what a step of the terrain came to.
    fn follow(&mut self, step: TerrainStep) {
        self.link.evict(&step.dropped);
        self.link.discard(&step.orphans);
        for refusal in &step.refused {
            self.keep_no_more(refusal.page);
            match refusal.again {
                true => self.link.evict(&[refusal.page]),
                false => self.link.reject(refusal.page),
            }
            self.refusals += 1;
            self.lost += u64::from(!refusal.again);
            if refusal.again {
                self.note_reason(refusal.page, &refusal.why.to_string());
            }
        }
        let newest = self.generations.newest();
        if let Some(wants) = newest.map(|terrain| terrain.wants().to_vec()) {
            let left = self.ask_disk(&wants);
            self.link.set_wants(&left, self.now);
        }
        self.last_step = step;
    }

    /// Lets the governor know what the step came to.
    fn observe(&mut self) {
        let Some(terrain) = self.generations.newest() else {
            return;
        };
        // Where pictures are not made of each frame, one upload is not that of the next frames.
        let upload_ms = std::mem::take(&mut self.upload_ms);
        self.governor.observe(&Load {
            triangles: self.last_step.triangles,
            ms: f64::from(self.last_step.times.mesh_ms() + upload_ms),
            memory_bytes: terrain.needed_bytes() as u64,
            gpu_bytes: match self.options.gpu_cap_bytes {
                Some(_) => terrain.tree().mesh_bytes() as u64,
                None => 0,
            },
            settled: terrain.wants().is_empty() && terrain.waiting() == 0,
        });
    }

    /// The view that is in order and keeps to the budgets.
    fn govern(&mut self, view: &View) -> View {
        let (mut view, notes) = view.clamped();
        self.notes.clear();
        self.notes.extend(notes.iter().map(ToString::to_string));
        view.max_screen_error_px = self.governor.tolerance_px(view.max_screen_error_px);
        self.tolerance_px = view.max_screen_error_px;
        view
    }
}

impl TerrainClient for RemoteTerrain {
    fn manifest(&self) -> Option<Arc<Manifest>> {
        self.generations
            .shown()
            .map(|terrain| terrain.manifest().clone())
    }

    fn poll(&mut self, now: Duration) {
        self.now = now;
        self.drive();
        self.handle_events();
        // What the events led to is sent at once.
        self.drive();
    }

    fn step(&mut self, view: &View, now: Duration) -> StepStats {
        self.now = now;
        let view = self.govern(view);
        // Before a connection is made: the view goes with its first messages.
        let is_in_order = self.look(&view);
        self.drive();
        if is_in_order {
            self.update(&view);
        }
        self.observe();
        self.drive();
        let link = self.link.stats();
        let terrain = self.generations.shown();
        let excess = terrain.map_or(f64::INFINITY, |_| self.last_step.excess);
        StepStats {
            triangles: self.last_step.triangles,
            bytes_received: link.received_bytes,
            pages_wanted: terrain.map_or(1, |_| self.last_step.lacking) as u32,
            pages_in_flight: link.in_flight_pages as u32,
            pages_resident: terrain.map_or(0, |terrain| terrain.tree().resident()) as u32,
            chunks_waiting: (self.last_step.waiting + link.waiting_events) as u32,
            bound_px: excess * f64::from(view.max_screen_error_px),
            tolerance_px: view.max_screen_error_px,
            converged: match self.options.promises_tolerance() {
                true => excess <= 1.0,
                false => excess.is_finite() && self.last_step.lacking == 0,
            },
            steady: self.governor.is_steady(),
            times: self.last_step.times,
        }
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }

    fn uploaded(&mut self, upload_ms: f32) {
        self.upload_ms = upload_ms;
    }

    fn shown(&mut self, beside_ms: f32) {
        let seconds = f64::from(beside_ms) / 1e3;
        self.beside = Duration::try_from_secs_f64(seconds).unwrap_or(Duration::ZERO);
    }

    fn mesh_options(&self) -> MeshOptions {
        self.options.mesh
    }

    fn set_mesh_options(&mut self, mesh: MeshOptions) {
        if self.options.mesh == mesh {
            return;
        }
        self.options.mesh = mesh;
        self.link.set_push(mesh.scope().is_some());
        self.governor = self.options.governor();
        let dropped = self.generations.set_options(mesh);
        self.link.evict(&dropped);
    }

    fn visit_pages(&self, visit: &mut dyn FnMut(&PageMesh)) {
        self.generations
            .shown()
            .into_iter()
            .flat_map(Terrain::meshes)
            .for_each(visit);
    }

    fn status(&self) -> String {
        if let Some(refused) = &self.refused {
            return refused.clone();
        }
        let lacks = self.last_step.memory_full && self.last_step.lacking > 0;
        let full = match (self.governor.limit(), lacks) {
            (Some(limit), _) => format!(", tolerance {:.1} px, {limit}", self.tolerance_px),
            (None, true) => ", memory cap reached".to_owned(),
            (None, false) => String::new(),
        };
        let lost = match (self.reasons.first(), self.lost) {
            (None, _) => String::new(),
            (Some(first), 0) => format!(", {} pages asked for again ({first})", self.refusals),
            (Some(first), lost) => format!(", {lost} pages lost ({first})"),
        };
        if self.is_offline() {
            return format!("offline, from the disk{full}{lost}");
        }
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
