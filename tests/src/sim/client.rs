//! A client: a whole [`RemoteTerrain`], its clock, and the examination of what it shows.

use super::check::{check_bound, check_converged, check_mesh, shown};
use super::ground::Ground;
use super::net::{Net, Socket};
use super::script::{Gaze, Setup};
use escarp_client::app::{StepStats, TerrainClient};
use escarp_client::link::LinkStats;
use escarp_client::mesh::MeshOptions;
use escarp_client::remote::RemoteTerrain;
use escarp_client::terrain::Terrain;
use escarp_proto::view::{SCREEN_ERRORS_PX, View};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// One in so many examined meshes is measured.
const MEASURED: u64 = 6;

/// A client's program, and its machine's clock.
pub struct Client<'a> {
    ground: &'a Ground,
    setup: Setup,
    /// None while it is not running.
    remote: Option<RemoteTerrain>,
    gaze: Gaze,
    gazed: Duration,
    /// Its tolerance, pixels.
    pub error_px: f32,
    /// When the next frame is due.
    pub next_frame: Duration,
    /// By how much its clock is ahead of the world's, or behind.
    ahead: Duration,
    behind: Duration,
    stats: StepStats,
    /// Stamps of the mesh that was examined last.
    examined: u64,
    /// The generation that it showed last.
    shown: Option<u64>,
    /// What there was of it.
    pub record: Record,
}

/// What there was of a client.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Record {
    /// Frames.
    pub frames: u64,
    /// Meshes examined.
    pub meshes: u64,
    /// Meshes measured.
    pub measured: u64,
    /// Sessions.
    pub sessions: u64,
    /// Page bytes received.
    pub page_bytes: u64,
    /// Chunks of no use.
    pub dropped: u64,
    /// Generations shown after the first.
    pub generations: u64,
    /// A number that depends on all of this.
    pub digest: u64,
}

impl Record {
    /// Adds another one.
    pub fn add(&mut self, other: &Record) {
        self.frames += other.frames;
        self.meshes += other.meshes;
        self.measured += other.measured;
        self.sessions += other.sessions;
        self.page_bytes += other.page_bytes;
        self.dropped += other.dropped;
        self.generations += other.generations;
        self.note(other.digest);
    }

    fn note(&mut self, number: u64) {
        self.digest = (self.digest ^ number)
            .wrapping_mul(0x9e37_79b9_7f4a_7c15)
            .rotate_left(29);
    }
}

impl<'a> Client<'a> {
    /// A client that is not running yet.
    pub fn new(ground: &'a Ground, setup: Setup) -> Client<'a> {
        Client {
            ground,
            remote: None,
            gaze: setup.gaze,
            gazed: setup.comes,
            error_px: setup.error_px,
            next_frame: setup.comes,
            ahead: Duration::ZERO,
            behind: Duration::ZERO,
            stats: StepStats::default(),
            examined: 0,
            shown: None,
            record: Record::default(),
            setup,
        }
    }

    /// Looks elsewhere.
    pub fn set_gaze(&mut self, gaze: Gaze, now: Duration) {
        (self.gaze, self.gazed) = (gaze, now);
    }

    /// Stays where it is.
    pub fn stand(&mut self, now: Duration) {
        let flown = (now.saturating_sub(self.gazed)).as_secs_f64();
        for i in 0..2 {
            self.gaze.eye[i] += self.gaze.velocity[i] * flown;
        }
        (self.gaze.velocity, self.gazed) = ([0.0; 2], now);
    }

    /// Meshes in another way.
    pub fn set_mesh(&mut self, options: MeshOptions) {
        self.setup.options.mesh = options;
        if let Some(remote) = &mut self.remote {
            remote.set_mesh_options(options);
        }
    }

    /// Its clock jumps ahead.
    pub fn jump(&mut self, by: Duration) {
        self.ahead += by;
    }

    /// It slept for so long, without its clock.
    pub fn slept(&mut self, by: Duration) {
        self.behind += by;
    }

    /// Kills it. Another one comes later.
    pub fn kill(&mut self, comes: Duration) {
        self.close_account();
        self.shown = None;
        self.remote = None;
        self.next_frame = comes;
    }

    fn close_account(&mut self) {
        if let Some(remote) = &self.remote {
            let stats = remote.link().stats();
            self.record.sessions += stats.sessions;
            self.record.page_bytes += stats.page_bytes;
            self.record.dropped += stats.dropped_chunks;
        }
    }

    fn view(&self, now: Duration) -> View {
        let extent = self.ground.generations[0].dataset.manifest().extent_m();
        let place = |share: [f64; 2]| -> [f64; 2] {
            std::array::from_fn(|i| extent[i][0] + share[i] * (extent[i][1] - extent[i][0]))
        };
        let flown = now.saturating_sub(self.gazed).as_secs_f64();
        let gaze = &self.gaze;
        let eye = place(std::array::from_fn(|i| {
            gaze.eye[i] + gaze.velocity[i] * flown
        }));
        let (at, up) = (place(gaze.at), extent[2][1] + gaze.above_m);
        let speed = |i: usize| (gaze.velocity[i] * (extent[i][1] - extent[i][0])) as f32;
        View {
            eye_m: [eye[0], eye[1], up],
            direction: [
                (at[0] - eye[0]) as f32,
                (at[1] - eye[1]) as f32,
                (extent[2][0] - up) as f32,
            ],
            velocity_m_s: [speed(0), speed(1), 0.0],
            fov_y: 1.0,
            viewport_px: [640, 400],
            max_screen_error_px: self.error_px,
        }
    }

    /// A frame.
    ///
    /// # Errors
    /// What does not hold of the mesh.
    pub fn frame(
        &mut self,
        net: &Arc<Mutex<Net>>,
        number: usize,
        now: Duration,
    ) -> Result<(), String> {
        self.next_frame = now + self.setup.frame;
        let view = self.view(now);
        let time = (now + self.ahead).saturating_sub(self.behind);
        let remote = self.remote.get_or_insert_with(|| {
            let socket = Socket::new(net.clone(), number);
            let (config, options) = (self.setup.config.clone(), self.setup.options);
            RemoteTerrain::over(Box::new(socket), config, options)
        });
        self.stats = remote.step(&view, time);
        self.record.frames += 1;
        self.record.note(self.stats.bytes_received);
        self.record.note(self.stats.bound_px.to_bits());
        self.check_link()?;
        self.examine(&view)
    }

    /// What the link keeps is bounded.
    fn check_link(&self) -> Result<(), String> {
        let Some(stats) = self.link() else {
            return Ok(());
        };
        let pages = self.setup.config.max_in_flight_pages;
        let window = self.setup.config.credit_window_bytes.max(1 << 15);
        // With push, chunks that nobody asked for wait as well: no more than the credit allows.
        let most = pages + window as usize / 16;
        match stats.in_flight_pages <= pages && stats.waiting_events <= most {
            true => Ok(()),
            false => Err(format!("the link keeps too much: {stats:?}")),
        }
    }

    fn examine(&mut self, view: &View) -> Result<(), String> {
        let Some(terrain) = self.remote.as_ref().and_then(RemoteTerrain::terrain) else {
            return Ok(());
        };
        let stamp = stamp(terrain);
        if stamp == self.examined {
            return Ok(());
        }
        self.examined = stamp;
        let data = shown(self.ground, terrain)?;
        let generation = data.dataset.manifest().generation;
        let before = self.shown.replace(generation);
        self.record.generations += u64::from(before.is_some_and(|before| before != generation));
        check_mesh(terrain.tree(), data)?;
        self.record.meshes += 1;
        if self.record.meshes.is_multiple_of(MEASURED) && self.stats.bound_px.is_finite() {
            check_bound(terrain.tree(), data, view, &self.stats)?;
            self.record.measured += 1;
        }
        Ok(())
    }

    /// The link's figures, if it is running.
    pub fn link(&self) -> Option<LinkStats> {
        self.remote.as_ref().map(|remote| remote.link().stats())
    }

    /// The number of its newest View, if it is running.
    pub fn view_sequence(&self) -> Option<u32> {
        let link = self.remote.as_ref()?.link();
        (!link.view_pending()).then(|| link.view_sequence())
    }

    /// The generation that it shows.
    pub fn generation(&self) -> Option<u64> {
        let terrain = self.remote.as_ref()?.terrain()?;
        Some(terrain.manifest().generation)
    }

    /// Whether it has all that it can have.
    pub fn is_settled(&self) -> bool {
        self.remote
            .as_ref()
            .is_some_and(|remote| remote.is_connected() && remote.is_settled())
    }

    /// Where it stands, for people.
    pub fn status(&self) -> String {
        let status = self.remote.as_ref().map(TerrainClient::status);
        format!("{status:?} {:?} {:?}", self.stats, self.link())
    }

    /// At rest, the mesh is all that was asked for, as far as memory allows.
    ///
    /// # Errors
    /// What does not hold.
    pub fn check_rest(&mut self, now: Duration) -> Result<(), String> {
        self.close_account();
        let view = self.view(now);
        let terrain = self.remote.as_ref().and_then(RemoteTerrain::terrain);
        let terrain = terrain.ok_or("there is no terrain")?;
        let data = shown(self.ground, terrain)?;
        check_mesh(terrain.tree(), data)?;
        check_bound(terrain.tree(), data, &view, &self.stats)?;
        // With no room at the widest tolerance, or a mesher that has none, nobody can do better.
        let widens = terrain.tree().options().scope().is_some();
        if !terrain.is_full() || widens && self.stats.tolerance_px < SCREEN_ERRORS_PX[1] {
            check_converged(terrain.tree(), data, &view, &self.stats)
                .map_err(|why| format!("{why}; {}", self.status()))?;
        }
        let lost = self
            .remote
            .as_ref()
            .map_or(0, |remote| remote.lost_pages().0);
        match lost {
            0 => Ok(()),
            _ => Err(format!("{lost} pages are lost: {}", self.status())),
        }
    }
}

/// Changes when the mesh does.
fn stamp(terrain: &Terrain) -> u64 {
    let mut record = Record::default();
    record.note(terrain.manifest().generation);
    // In no order, as the pages are in none.
    let stamps = terrain.meshes().map(|mesh| {
        let mut page = Record::default();
        for number in [mesh.id.key(), mesh.vertex_stamp, mesh.index_stamp] {
            page.note(number);
        }
        page.digest
    });
    record.note(stamps.fold(0, u64::wrapping_add));
    record.digest
}
