//! Pictures and flights without a window.

use super::{StepStats, TerrainClient};
use crate::flight::Path as Flight;
use crate::remote::RemoteTerrain;
use crate::render::{DrawParams, Gpu, Headless, Scene};
use crate::stages::StageTimes;
use anyhow::{Context, Result, bail};
use escarp_proto::manifest::Manifest;
use escarp_proto::view::View;
use image::RgbaImage;
use serde::Serialize;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::{Duration, Instant};

/// How long a program sleeps at most while it waits for the network.
const NAP: Duration = Duration::from_millis(20);

/// A remote terrain, a clock, and a way to sleep until something arrives.
pub struct Driver {
    /// The terrain.
    pub client: RemoteTerrain,
    began: Instant,
    news: Receiver<()>,
    first_picture: Option<Duration>,
}

impl Driver {
    /// Takes over a terrain.
    pub fn new(mut client: RemoteTerrain) -> Driver {
        let (sender, news) = sync_channel(1);
        client.set_waker(Arc::new(move || {
            // Full means that a wake-up is pending already.
            let _ = sender.try_send(());
        }));
        Driver {
            client,
            began: Instant::now(),
            news,
            first_picture: None,
        }
    }

    /// Time since the beginning.
    pub fn now(&self) -> Duration {
        self.began.elapsed()
    }

    /// When there were triangles to draw for the first time, since the beginning.
    pub fn first_picture(&self) -> Option<Duration> {
        self.first_picture
    }

    /// One step of the client.
    pub fn step(&mut self, view: &View) -> StepStats {
        let stats = self.client.step(view, self.began.elapsed());
        if stats.triangles > 0 && self.first_picture.is_none() {
            self.first_picture = Some(self.began.elapsed());
        }
        stats
    }

    /// Waits for the server to say what the dataset is.
    ///
    /// # Errors
    /// What the server, or the system, said instead; or that nothing was said in time.
    pub fn connect(&mut self, wait: Duration) -> Result<Arc<Manifest>> {
        self.connect_looking(None, wait)
    }

    /// As [`connect`](Self::connect), with what will be looked at: what that needs comes with the
    /// first answer.
    ///
    /// # Errors
    /// Those of [`connect`](Self::connect).
    pub fn connect_looking(
        &mut self,
        view: Option<&View>,
        wait: Duration,
    ) -> Result<Arc<Manifest>> {
        loop {
            match view {
                Some(view) => drop(self.step(view)),
                None => self.client.poll(self.began.elapsed()),
            }
            if let Some(manifest) = self.client.manifest() {
                return Ok(manifest);
            }
            if let Some(failure) = self.client.failure() {
                bail!(failure);
            }
            if self.now() > wait {
                bail!(
                    "no answer within {} s: {}",
                    wait.as_secs(),
                    self.client.status()
                );
            }
            self.nap(NAP);
        }
    }

    /// Steps until all that can be had for a view is here and the tolerance stands, or time is up.
    ///
    /// # Errors
    /// If the server refuses for good.
    pub fn settle(&mut self, view: &View, wait: Duration) -> Result<StepStats> {
        let until = self.now().saturating_add(wait);
        loop {
            let stats = self.step(view);
            if let Some(failure) = self.client.failure() {
                bail!(failure);
            }
            if self.client.is_settled() || self.now() > until {
                return Ok(stats);
            }
            // With budgets, the tolerance goes on to move when all pages are here.
            if self.client.awaits_pages() {
                self.nap(NAP);
            }
        }
    }

    /// Checks that the server still hosts what it did, or a newer generation of it, as scenes and
    /// flights are made for its place.
    ///
    /// # Errors
    /// If it does not.
    pub fn check_same(&self, manifest: &Manifest) -> Result<()> {
        let is_same = |now: &Manifest| {
            now.grid_levels == manifest.grid_levels && now.georef == manifest.georef
        };
        match self.client.manifest() {
            Some(now) if !is_same(&now) => {
                bail!("the server has another dataset at this address than before")
            }
            _ => Ok(()),
        }
    }

    /// Sleeps until something arrives, or this long.
    pub fn nap(&self, most: Duration) {
        let _ = self.news.recv_timeout(most);
    }
}

/// A scene and an image to draw it into.
pub struct Painter {
    scene: Scene,
    target: Headless,
}

/// A picture, and what it took.
pub struct Painted {
    /// The picture.
    pub image: RgbaImage,
    /// Bringing the GPU up to date, milliseconds.
    pub upload_ms: f32,
    /// Drawing and reading back, milliseconds.
    pub draw_ms: f32,
}

impl Painter {
    /// Finds an adapter and prepares pictures of this size in pixels.
    ///
    /// # Errors
    /// If there is no adapter, or the size is not possible.
    pub fn new(manifest: &Manifest, size_px: [u32; 2]) -> Result<Painter> {
        let gpu = Gpu::headless()?;
        let target = Headless::new(&gpu, size_px, 4)?;
        let scene = Scene::new(
            &gpu,
            &manifest.georef,
            manifest.height_range,
            target.output(),
        );
        Ok(Painter { scene, target })
    }

    /// Draws what a client has.
    ///
    /// # Errors
    /// If the device is lost.
    pub fn paint(
        &mut self,
        client: &impl TerrainClient,
        view: View,
        wireframe: bool,
    ) -> Result<Painted> {
        let began = Instant::now();
        let mut sync = self.scene.begin_sync();
        client.visit_pages(&mut |mesh| sync.keep(mesh));
        sync.end();
        let uploaded = began.elapsed();
        let params = DrawParams {
            wireframe,
            ..DrawParams::new(view)
        };
        let (image, _) = self.target.render(&mut self.scene, &params)?;
        let ms = |time: Duration| time.as_secs_f32() * 1e3;
        Ok(Painted {
            image,
            upload_ms: ms(uploaded),
            draw_ms: ms(began.elapsed() - uploaded),
        })
    }
}

/// A frame of a flight, as printed.
#[derive(Debug, Clone, Serialize)]
pub struct FrameReport {
    /// Time on the path, seconds.
    pub time_s: f64,
    /// The eye, metres.
    pub eye_m: [f64; 3],
    /// Triangles of the mesh.
    pub triangles: u64,
    /// Bytes received since the beginning.
    pub bytes: u64,
    /// Pages wanted and not here.
    pub pages_wanted: u32,
    /// Pages on their way.
    pub pages_in_flight: u32,
    /// Pages here.
    pub pages_resident: u32,
    /// Chunks here for which there was no time yet.
    pub chunks_waiting: u32,
    /// Error bound of the frame, pixels; `null` while there is none.
    pub bound_px: Option<f64>,
    /// Tolerance of the frame, pixels: the path's, or more where a budget is kept.
    pub tolerance_px: f32,
    /// Whether there was a session with the server.
    pub connected: bool,
    /// What the stages took, milliseconds: `decode_ms`, `link_ms`, `update_ms`, `triangulate_ms`.
    #[serde(flatten)]
    pub times: StageTimes,
    /// Bringing the GPU up to date, milliseconds; absent where no picture is made.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub upload_ms: Option<f32>,
    /// Drawing and reading back, milliseconds; absent where no picture is made.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub draw_ms: Option<f32>,
    /// What had to be changed of the view; absent if nothing.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

impl FrameReport {
    fn new(time_s: f64, eye_m: [f64; 3], stats: &StepStats, client: &RemoteTerrain) -> FrameReport {
        FrameReport {
            time_s,
            eye_m,
            triangles: stats.triangles,
            bytes: stats.bytes_received,
            pages_wanted: stats.pages_wanted,
            pages_in_flight: stats.pages_in_flight,
            pages_resident: stats.pages_resident,
            chunks_waiting: stats.chunks_waiting,
            bound_px: stats.bound_px.is_finite().then_some(stats.bound_px),
            tolerance_px: stats.tolerance_px,
            connected: client.is_connected(),
            times: stats.times,
            upload_ms: None,
            draw_ms: None,
            notes: client.notes().to_vec(),
        }
    }
}

/// How a flight is flown.
#[derive(Debug, Clone)]
pub struct FlyOptions {
    /// Folder for pictures; none are made without it.
    pub pictures: Option<PathBuf>,
    /// A picture every so many frames.
    pub every: u64,
    /// Wait at each frame until it is converged, instead of keeping to the clock.
    pub settle: bool,
    /// Draw the triangles' edges.
    pub wireframe: bool,
    /// Longest wait at a frame.
    pub wait: Duration,
}

/// Flies a path, and writes a line of JSON a frame.
///
/// # Errors
/// If the server refuses for good, if it hosts another dataset than before, or if a picture cannot
/// be drawn or written.
pub fn fly(
    driver: &mut Driver,
    manifest: &Manifest,
    flight: &Flight,
    options: &FlyOptions,
    out: &mut impl Write,
) -> Result<Vec<FrameReport>> {
    let mut painter = match &options.pictures {
        Some(folder) => {
            std::fs::create_dir_all(folder)
                .with_context(|| format!("cannot create the folder {}", folder.display()))?;
            Some(Painter::new(manifest, flight.view(0.0).viewport_px)?)
        }
        None => None,
    };
    let began = driver.now();
    let mut reports = Vec::new();
    for frame in 0..flight.frames() {
        let time_s = flight.frame_time_s(frame);
        let view = flight.view(time_s);
        let stats = if options.settle {
            driver.settle(&view, options.wait)?
        } else {
            wait_until(
                driver,
                began + Duration::from_secs_f64(time_s - flight.frame_time_s(0)),
            );
            driver.step(&view)
        };
        driver.check_same(manifest)?;
        if let Some(failure) = driver.client.failure() {
            bail!(failure);
        }
        let mut report = FrameReport::new(time_s, view.eye_m, &stats, &driver.client);
        let last = frame + 1 == flight.frames();
        if let (Some(painter), Some(folder)) = (&mut painter, &options.pictures)
            && (frame.is_multiple_of(options.every) || last)
        {
            let (view, _) = view.clamped();
            let painted = painter.paint(&driver.client, view, options.wireframe)?;
            driver.client.uploaded(painted.upload_ms);
            (report.upload_ms, report.draw_ms) = (Some(painted.upload_ms), Some(painted.draw_ms));
            save(
                &painted.image,
                &folder.join(format!("frame-{frame:05}.png")),
            )?;
        }
        serde_json::to_writer(&mut *out, &report)?;
        writeln!(out)?;
        reports.push(report);
    }
    Ok(reports)
}

/// Keeps to the clock; the network goes on meanwhile in its own thread.
fn wait_until(driver: &Driver, when: Duration) {
    while let Some(left) = when
        .checked_sub(driver.now())
        .filter(|left| !left.is_zero())
    {
        std::thread::sleep(left);
    }
}

/// Writes a picture.
///
/// # Errors
/// If the file cannot be written.
pub fn save(image: &RgbaImage, path: &Path) -> Result<()> {
    image
        .save(path)
        .with_context(|| format!("cannot write {}", path.display()))
}
