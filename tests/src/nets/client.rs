//! The client that is measured: a process of its own, told what to do by a line of JSON, which
//! says by another what it saw.

use super::tiles::TileClient;
use super::watch::{Leg, Looking, Stand, Until, decoding, look};
use crate::report::leave_out::{UsedParts, parts_of};
use anyhow::{Context, Result, bail};
use escarp_client::app::TerrainClient;
use escarp_client::app::headless::Driver;
use escarp_client::net::Url;
use escarp_client::remote::{ClientOptions, RemoteTerrain};
use escarp_proto::view::View;
use escarp_tiles::dataset::Dataset;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::{Duration, Instant};

/// Frames are this far apart at most.
const FRAME: Duration = Duration::from_millis(16);
/// And at least, however much arrives.
const LEAST_FRAME: Duration = Duration::from_millis(4);

/// How a client gets its pages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// The server sends what its view needs.
    Push,
    /// It asks for what its mesh lacks.
    Pull,
    /// One HTTP request a page.
    Tiles,
}

impl Kind {
    /// All there are.
    pub const ALL: [Kind; 3] = [Kind::Push, Kind::Pull, Kind::Tiles];

    /// For people.
    pub const fn in_words(self) -> &'static str {
        match self {
            Kind::Push => "push: the server sends what the view needs",
            Kind::Pull => "pull only: the client asks for what its mesh lacks",
            Kind::Tiles => "tile by tile: one HTTP request a page, six at a time",
        }
    }

    /// Whether the server uses its velocity.
    pub const fn predicts(self) -> bool {
        matches!(self, Kind::Push)
    }

    /// When it has been watched long enough. What a page a request takes beyond the picture, out
    /// of view, takes minutes.
    const fn until(self) -> Until {
        match self {
            Kind::Tiles => Until::Converged,
            Kind::Push | Kind::Pull => Until::Settled,
        }
    }

    /// Number of its colour.
    pub const fn number(self) -> usize {
        match self {
            Kind::Push => 0,
            Kind::Pull => 1,
            Kind::Tiles => 5,
        }
    }
}

impl FromStr for Kind {
    type Err = String;

    fn from_str(text: &str) -> Result<Kind, String> {
        let named = Kind::ALL.into_iter().find(|kind| kind.to_string() == text);
        named.ok_or_else(|| {
            let names = Kind::ALL.map(|kind| kind.to_string()).join(", ");
            format!("{text:?} is no kind of client; allowed are {names}")
        })
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Kind::Push => "push",
            Kind::Pull => "pull",
            Kind::Tiles => "tiles",
        })
    }
}

/// A [`View`] that can be written down.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Sight {
    eye_m: [f64; 3],
    direction: [f32; 3],
    velocity_m_s: [f32; 3],
    fov_y: f32,
    viewport_px: [u32; 2],
    max_screen_error_px: f32,
}

impl From<View> for Sight {
    fn from(view: View) -> Sight {
        Sight {
            eye_m: view.eye_m,
            direction: view.direction,
            velocity_m_s: view.velocity_m_s,
            fov_y: view.fov_y,
            viewport_px: view.viewport_px,
            max_screen_error_px: view.max_screen_error_px,
        }
    }
}

impl From<Sight> for View {
    fn from(sight: Sight) -> View {
        View {
            eye_m: sight.eye_m,
            direction: sight.direction,
            velocity_m_s: sight.velocity_m_s,
            fov_y: sight.fov_y,
            viewport_px: sight.viewport_px,
            max_screen_error_px: sight.max_screen_error_px,
        }
    }
}

/// What a client shall do.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Job {
    /// How it gets its pages.
    pub kind: Kind,
    /// The dataset's address.
    pub url: String,
    /// The first is looked at from connecting on, each of the others after a teleport.
    pub views: Vec<Sight>,
    /// Longest time for each, seconds.
    pub limit_s: f64,
    /// Where the dataset lies, to count how many of the bytes were used.
    pub dataset: Option<PathBuf>,
}

/// A client that streams.
struct Streaming {
    driver: Driver,
    stepped: Instant,
}

impl Looking for Streaming {
    fn frame(&mut self, view: &View) -> Result<Stand> {
        self.stepped = Instant::now();
        let stats = self.driver.step(view);
        if let Some(failure) = self.driver.client.failure() {
            bail!(failure);
        }
        let bound = stats.bound_px.is_finite() && stats.triangles > 0;
        Ok(Stand {
            bound_px: bound.then_some(stats.bound_px),
            bytes: stats.bytes_received,
            decoded: decoding(&stats.times),
            open: self.driver.client.manifest().is_some(),
            settled: self.driver.client.is_connected() && self.driver.client.is_settled(),
        })
    }

    fn rest(&mut self) -> Result<()> {
        self.driver.nap(FRAME);
        if let Some(left) = LEAST_FRAME.checked_sub(self.stepped.elapsed()) {
            std::thread::sleep(left);
        }
        Ok(())
    }
}

/// Either of them.
pub struct Client(Either);

enum Either {
    Streaming(Box<Streaming>),
    Tiles(Box<TileClient>),
}

impl Client {
    /// Begins to connect: what it shall look at is known before.
    ///
    /// # Errors
    /// If the address is none, or the server has no such dataset.
    pub fn open(kind: Kind, url: &str) -> Result<Client> {
        let url: Url = url.parse().context("the address")?;
        Ok(Client(match kind {
            Kind::Tiles => Either::Tiles(Box::new(TileClient::open(&url)?)),
            Kind::Push | Kind::Pull => {
                let options = ClientOptions {
                    push: kind == Kind::Push,
                    ..ClientOptions::default()
                };
                let client = RemoteTerrain::with_options(url, options);
                let driver = Driver::new(client);
                let stepped = Instant::now();
                Either::Streaming(Box::new(Streaming { driver, stepped }))
            }
        }))
    }

    fn parts(&self) -> UsedParts {
        let terrain = match &self.0 {
            Either::Streaming(streaming) => streaming.driver.client.terrain(),
            Either::Tiles(tiles) => Some(tiles.terrain()),
        };
        terrain
            .map(|terrain| parts_of(terrain.tree()))
            .unwrap_or_default()
    }
}

impl Looking for Client {
    fn frame(&mut self, view: &View) -> Result<Stand> {
        match &mut self.0 {
            Either::Streaming(client) => client.frame(view),
            Either::Tiles(client) => client.frame(view),
        }
    }

    fn rest(&mut self) -> Result<()> {
        match &mut self.0 {
            Either::Streaming(client) => client.rest(),
            Either::Tiles(client) => client.rest(),
        }
    }
}

/// Does a job.
///
/// # Errors
/// If the server cannot be reached, or refuses.
pub fn work(job: &Job) -> Result<Vec<Leg>> {
    let dataset = job.dataset.as_deref().map(Dataset::open).transpose()?;
    let limit = Duration::from_secs_f64(job.limit_s);
    let mut began = Instant::now();
    let mut client = Client::open(job.kind, &job.url)?;
    let (mut legs, mut bytes, mut had) = (Vec::new(), 0, UsedParts::default());
    for &sight in &job.views {
        let mut leg = Leg::default();
        let end = (job.kind.until(), limit);
        look(&mut client, &sight.into(), began, bytes, end, &mut leg)?;
        let has = client.parts();
        if let Some(dataset) = &dataset {
            leg.page_bytes = Some(has.resident_bytes(dataset, &had)?);
            leg.used_bytes = Some(has.used_bytes(dataset, &had)?);
        }
        (bytes, had, began) = (bytes + leg.bytes, has, Instant::now());
        legs.push(leg);
    }
    Ok(legs)
}
