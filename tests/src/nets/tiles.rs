//! A client as a map in a browser: one HTTP request a page, over six connections.
//!
//! It has the same mesh tree as the streaming client, and asks for what that lacks, most urgent
//! first, but for whole pages, as files on a web server are, and never takes a request back.

use super::http::KeptAlive;
use super::watch::{Looking, Stand, decoding};
use anyhow::{Context, Result, bail, ensure};
use escarp_client::net::Url;
use escarp_client::stages::Stages;
use escarp_client::terrain::{DEFAULT_MEMORY_BYTES, Terrain, TerrainStep};
use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;
use escarp_proto::page::last_part;
use escarp_proto::view::View;
use escarp_proto::wire::Chunk;
use std::collections::HashSet;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Connections to one host that browsers open.
pub const CONNECTIONS: usize = 6;
/// Frames are this far apart at most.
const FRAME: Duration = Duration::from_millis(16);

/// An answer to a request for a page.
struct Answer {
    page: PageId,
    /// Revision and record; absent where there is none.
    found: Option<(u32, Vec<u8>)>,
    bytes: u64,
}

/// A client that takes a page a request.
pub struct TileClient {
    terrain: Terrain,
    requests: Sender<PageId>,
    answers: Receiver<Result<Answer>>,
    under_way: HashSet<PageId>,
    bytes: u64,
}

impl TileClient {
    /// Connects, and reads what the dataset is. The other connections follow when needed.
    ///
    /// # Errors
    /// What the server, or the system, said instead.
    pub fn open(url: &Url) -> Result<TileClient> {
        let name = url.dataset().context("the address names no dataset")?;
        let mut first = KeptAlive::new(url);
        let answer = first.get(&format!("/{name}/manifest"))?;
        ensure!(
            answer.status == 200,
            "the manifest has status {}",
            answer.status
        );
        let manifest = Manifest::from_json(&answer.body).map_err(anyhow::Error::msg)?;
        let (requests, queue) = channel();
        let (sender, answers) = channel();
        let queue = Arc::new(Mutex::new(queue));
        let others = (1..CONNECTIONS).map(|_| KeptAlive::new(url));
        for connection in std::iter::once(first).chain(others) {
            let (queue, sender, name) = (Arc::clone(&queue), sender.clone(), name.to_owned());
            std::thread::Builder::new()
                .name("tiles".into())
                .spawn(move || work(connection, &name, &queue, &sender))
                .context("cannot start a thread")?;
        }
        let options = Default::default();
        Ok(TileClient {
            terrain: Terrain::new(Arc::new(manifest), DEFAULT_MEMORY_BYTES, options),
            requests,
            answers,
            under_way: HashSet::new(),
            bytes: answer.bytes,
        })
    }

    /// The terrain.
    pub fn terrain(&self) -> &Terrain {
        &self.terrain
    }

    /// Gives each free connection the most urgent page that is not under way.
    fn ask(&mut self) -> Result<()> {
        for want in self.terrain.wants() {
            if self.under_way.len() == CONNECTIONS {
                break;
            }
            let page = PageId::from_key(want.page).context("a wish for no page")?;
            if self.under_way.insert(page) {
                self.requests.send(page).context("no connection is left")?;
            }
        }
        Ok(())
    }

    fn take(&mut self, answer: Answer) {
        self.under_way.remove(&answer.page);
        self.bytes += answer.bytes;
        let finest = self.terrain.manifest().grid_levels.is_finest(answer.page);
        match answer.found {
            Some((revision, bytes)) => self.terrain.receive(Chunk {
                page: answer.page.key(),
                revision,
                first_part: 0,
                last_part: last_part(finest),
                bytes,
            }),
            None => self.terrain.miss(answer.page),
        }
    }
}

impl Looking for TileClient {
    fn frame(&mut self, view: &View) -> Result<Stand> {
        let clock = Instant::now();
        let now = || clock.elapsed();
        let mut stages = Stages::begin(&now, None, Duration::ZERO);
        let mut step = TerrainStep::default();
        self.terrain.link_arrived(&mut step, &mut stages);
        let step = self.terrain.finish(view, step, &mut stages);
        self.ask()?;
        let px = step.excess * f64::from(view.max_screen_error_px);
        Ok(Stand {
            bound_px: (px.is_finite() && step.triangles > 0).then_some(px),
            bytes: self.bytes,
            decoded: decoding(&step.times),
            open: true,
            settled: self.under_way.is_empty() && self.terrain.wants().is_empty(),
        })
    }

    fn rest(&mut self) -> Result<()> {
        let mut next = match self.answers.recv_timeout(FRAME) {
            Ok(answer) => Some(answer),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => bail!("no connection is left"),
        };
        while let Some(answer) = next {
            self.take(answer?);
            next = self.answers.try_recv().ok();
        }
        Ok(())
    }
}

/// One connection: asks for a page, answers, and so on, until the client is gone.
fn work(
    mut connection: KeptAlive,
    name: &str,
    queue: &Mutex<Receiver<PageId>>,
    answers: &Sender<Result<Answer>>,
) {
    loop {
        let Some(page) = queue.lock().ok().and_then(|queue| queue.recv().ok()) else {
            return;
        };
        let answer = fetch(&mut connection, name, page);
        let failed = answer.is_err();
        if answers.send(answer).is_err() || failed {
            return;
        }
    }
}

fn fetch(connection: &mut KeptAlive, name: &str, page: PageId) -> Result<Answer> {
    let square = page.square();
    let answer = connection.get(&format!(
        "/{name}/page/{}/{}/{}",
        square.level, square.x, square.y
    ))?;
    let found = match answer.status {
        200 => {
            let revision = u32::from_str_radix(&answer.tag, 16)
                .with_context(|| format!("{:?} is no revision", answer.tag))?;
            Some((revision, answer.body))
        }
        404 => None,
        status => bail!("page {page} has status {status}"),
    };
    Ok(Answer {
        page,
        found,
        bytes: answer.bytes,
    })
}
