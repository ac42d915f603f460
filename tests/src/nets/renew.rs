//! A dataset is published anew while many look at it: nobody may lose a frame, see a crack, or be
//! without a bound.

use super::lab::beside;
use super::load::start;
use super::places::{Ground, Way};
use crate::measure::check_cracks;
use anyhow::{Context, Result, bail, ensure};
use escarp_client::app::TerrainClient;
use escarp_client::app::headless::Driver;
use escarp_client::flight::Path as Flight;
use escarp_client::net::Url;
use escarp_client::remote::{ClientOptions, RemoteTerrain};
use escarp_proto::manifest::Manifest;
use escarp_server::native::native;
use escarp_tiles::dataset::Dataset;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Frames a second of each client.
const FPS: f64 = 10.0;
/// Frames from check to check for cracks, but at a change, when each is checked.
const CHECK_EVERY: u64 = 20;
/// Frames that are all checked after a change.
const CHECK_AFTER: u64 = 10;
/// Memory of each client, bytes.
const MEMORY: usize = 256 << 20;
/// How long the first picture may take.
const PATIENCE: Duration = Duration::from_secs(120);

/// What is done.
#[derive(Debug, Clone, Serialize)]
pub struct Renewal {
    /// Clients that fly.
    pub clients: usize,
    /// Updates, one after the other.
    pub updates: u32,
    /// Seconds from one to the next, and before the first and after the last.
    pub between_s: f64,
    /// Width and height of the pictures, pixels.
    pub size: [u32; 2],
    /// The tolerance, pixels.
    pub error_px: f32,
}

/// What the clients saw.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Seen {
    /// Frames after each client's first picture.
    pub frames: u64,
    /// Of them, those without a triangle.
    pub lost: u64,
    /// Those without a bound.
    pub unbounded: u64,
    /// Those in which there was no session.
    pub unconnected: u64,
    /// Those that were checked for cracks.
    pub checked: u64,
    /// What checks found, the first few.
    pub cracks: Vec<String>,
    /// Changes of generation, all clients.
    pub changes: u64,
    /// Longest time from an update's end to a client's change, seconds.
    pub latest_s: f64,
    /// Clients that failed, and why.
    pub failures: Vec<String>,
    /// The generation that each client had at the end.
    pub generations: Vec<u64>,
}

impl Seen {
    fn join(&mut self, other: Seen) {
        self.frames += other.frames;
        self.lost += other.lost;
        self.unbounded += other.unbounded;
        self.unconnected += other.unconnected;
        self.checked += other.checked;
        self.cracks.extend(other.cracks);
        self.cracks.truncate(8);
        self.changes += other.changes;
        self.latest_s = self.latest_s.max(other.latest_s);
        self.failures.extend(other.failures);
        self.generations.extend(other.generations);
    }
}

/// When each update had ended.
type Ends = std::sync::Mutex<Vec<(u64, Instant)>>;

/// Copies a dataset, hosts it, and updates it while clients fly.
///
/// # Errors
/// If something cannot be started, or an update fails.
pub fn renew(folder: &Path, renewal: &Renewal, say: &dyn Fn(&str)) -> Result<Seen> {
    super::load::allow_files()?;
    let desk = tempfile::tempdir().context("a temporary folder")?;
    let copy = copy(folder, desk.path())?;
    let dataset = Dataset::open(&copy)?;
    let server = start(&copy, renewal.clients + 16, &[], None)?;
    let (over, ends) = (Arc::new(AtomicBool::new(false)), Arc::new(Ends::default()));
    let mut clients = Vec::new();
    for number in 0..renewal.clients {
        let flight = flight(&dataset, number, renewal)?;
        let url: Url = server.url.parse().context("the server's address")?;
        let (over, ends) = (over.clone(), ends.clone());
        let client = std::thread::Builder::new()
            .name("client".into())
            .spawn(move || fly(url, &flight, number, &over, &ends));
        clients.push(client.context("cannot start a thread")?);
    }
    let between = Duration::from_secs_f64(renewal.between_s);
    std::thread::sleep(between);
    let updated = (0..renewal.updates).try_for_each(|number| {
        let generation = update(&copy, &dataset, number)?;
        say(&format!("generation {generation}"));
        if let Ok(mut ends) = ends.lock() {
            ends.push((generation, Instant::now()));
        }
        std::thread::sleep(between);
        Ok(())
    });
    over.store(true, Ordering::Relaxed);
    let mut seen = Seen::default();
    for client in clients {
        match client.join() {
            Ok(one) => seen.join(one),
            Err(_) => bail!("a client panicked"),
        }
    }
    updated.map(|()| seen)
}

fn copy(folder: &Path, to: &Path) -> Result<PathBuf> {
    let name = folder.file_name().context("the dataset's name")?;
    let copy = to.join(name);
    std::fs::create_dir(&copy)?;
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        std::fs::copy(entry.path(), copy.join(entry.file_name()))
            .with_context(|| format!("cannot copy {}", entry.path().display()))?;
    }
    Ok(copy)
}

/// Clients begin at places of their own, and fly in directions of their own.
fn flight(dataset: &Dataset, number: usize, renewal: &Renewal) -> Result<Flight> {
    // Shares that lie evenly, however many there are.
    let golden = |n: f64| (number as f64 * n).fract();
    let way = Way {
        from: [
            0.25 + 0.5 * golden(0.618_034),
            0.25 + 0.5 * golden(0.754_878),
        ],
        course_deg: 360.0 * golden(0.569_84),
        speed_m_s: 150.0,
        seconds: 120.0,
        error_px: renewal.error_px,
    };
    let mut flight = Ground::new(dataset).flight(way, FPS)?;
    flight.size = renewal.size;
    Ok(flight)
}

/// A rectangle of the dataset, another for each update: west, south, east, north in the coordinates
/// of its own reference system, as `escarp-tiles update` takes them.
fn rectangle(manifest: &Manifest, number: u32) -> [f64; 4] {
    let [x, y, _] = manifest.extent_m();
    let from = 0.3 + 0.1 * f64::from(number);
    let at = |share: f64| {
        let along = |[least, most]: [f64; 2]| least + share * (most - least);
        native(&manifest.georef, [along(x), along(y)])
    };
    let [[west, south], [east, north]] = [from, from + 0.05].map(at);
    [west, south, east, north]
}

/// Makes a rectangle of the dataset a hole, by the program. The new generation.
fn update(folder: &Path, dataset: &Dataset, number: u32) -> Result<u64> {
    let [west, south, east, north] = rectangle(dataset.manifest(), number);
    let output = Command::new(beside("escarp-tiles")?)
        .arg("update")
        .arg(folder)
        .arg(format!("--remove={west},{south},{east},{north}"))
        .stdin(Stdio::null())
        .output()?;
    let said = String::from_utf8_lossy(&output.stderr);
    ensure!(
        output.status.success(),
        "escarp-tiles update: {}",
        said.trim()
    );
    Ok(Dataset::open(folder)?.manifest().generation)
}

fn fly(url: Url, flight: &Flight, number: usize, over: &AtomicBool, ends: &Ends) -> Seen {
    let mut seen = Seen::default();
    if let Err(why) = watch(url, flight, over, ends, &mut seen) {
        seen.failures.push(format!("client {number}: {why:#}"));
    }
    seen
}

fn watch(url: Url, flight: &Flight, over: &AtomicBool, ends: &Ends, seen: &mut Seen) -> Result<()> {
    let options = ClientOptions {
        memory_cap_bytes: MEMORY,
        ..ClientOptions::default()
    };
    let mut driver = Driver::new(RemoteTerrain::with_options(url, options));
    let mut generation = driver.connect(PATIENCE)?.generation;
    driver.settle(&flight.view(0.0), PATIENCE)?;
    let cells = driver
        .client
        .terrain()
        .map(|t| t.manifest().grid_levels.cells_per_side());
    let cells = cells.context("no terrain")?;
    let (began, mut frame, mut unchecked) = (Instant::now(), 0u64, 0);
    while !over.load(Ordering::Relaxed) {
        // There and back.
        let t = frame as f64 / FPS % (2.0 * flight.duration_s().max(1.0));
        let t = if t > flight.duration_s() {
            2.0 * flight.duration_s() - t
        } else {
            t
        };
        let stats = driver.step(&flight.view(t.max(0.0)));
        if let Some(failure) = driver.client.failure() {
            bail!(failure);
        }
        seen.frames += 1;
        seen.lost += u64::from(stats.triangles == 0);
        seen.unbounded += u64::from(!stats.bound_px.is_finite());
        seen.unconnected += u64::from(!driver.client.is_connected());
        let now = driver
            .client
            .manifest()
            .map_or(generation, |manifest| manifest.generation);
        if now != generation {
            generation = now;
            unchecked = CHECK_AFTER;
            seen.changes += 1;
            seen.latest_s = seen.latest_s.max(since(ends, generation));
        }
        if unchecked > 0 || frame.is_multiple_of(CHECK_EVERY) {
            unchecked = unchecked.saturating_sub(1);
            seen.checked += 1;
            if let Some(terrain) = driver.client.terrain()
                && let Err(why) = check_cracks(terrain.tree(), cells)
            {
                seen.cracks.push(why);
            }
        }
        frame = (frame + 1).max((began.elapsed().as_secs_f64() * FPS) as u64);
        let due = Duration::from_secs_f64(frame as f64 / FPS);
        if let Some(left) = due.checked_sub(began.elapsed()) {
            driver.nap(left);
        }
    }
    seen.generations.push(generation);
    Ok(())
}

/// Seconds since the update that made a generation had ended; 0 if it has not.
fn since(ends: &Ends, generation: u64) -> f64 {
    let ends = ends.lock();
    let end = ends.ok().and_then(|ends| {
        let of = ends.iter().find(|(made, _)| *made == generation);
        of.map(|(_, at)| at.elapsed().as_secs_f64())
    });
    end.unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::{FunctionSource, TempDataset, hills};
    use escarp_tiles::dem::Crs;
    use escarp_tiles::update::{Edit, update};

    #[test]
    fn rectangles_lie_in_the_data_in_degrees_as_well_as_in_metres() {
        let degrees = FunctionSource::new(200, 180, hills).with(|info| {
            info.crs = Crs::Geographic {
                name: "EPSG:4326".into(),
                radius_m: 6_378_137.0,
            };
            let place = &mut info.placement;
            (place.x0, place.y0, place.dx, place.dy) = (86.0, 28.0, 0.001, 0.001);
        });
        let metres = FunctionSource::new(200, 180, hills);
        for mut source in [degrees, metres] {
            let data = TempDataset::build(&mut source);
            let edit = Edit {
                patches: Vec::new(),
                remove: vec![rectangle(data.dataset.manifest(), 2)],
                sources: Vec::new(),
            };
            let report = update(&data.dataset, edit, &|_, _| {}).unwrap();
            assert!((80..=130).contains(&report.removed), "{report:?}");
        }
    }
}
