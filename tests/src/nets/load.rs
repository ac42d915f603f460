//! What many sessions cost a server, how long each of them waits, and what one can do to the rest.

use super::crowd::{self, Found, Phase, Run};
use super::lab::beside;
use super::places::Way;
use super::process::{Summary, Usage};
use super::script::Script;
use super::server::Server;
use crate::report::tables::Table;
use anyhow::{Context, Result, ensure};
use escarp_tiles::dataset::Dataset;
use serde::Serialize;
use std::fs::File;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinSet;

/// Flights that are different; sessions share them.
const SCRIPTS: usize = 4;
/// Seconds of a script.
const SCRIPT_S: f64 = 30.0;
/// Sessions that open at a time.
const OPENING: usize = 50;
/// Files that the server may open, and this program.
const FILES: u64 = 20_000;

/// What a load consists of.
#[derive(Debug, Clone, Serialize)]
pub struct Load {
    /// Sessions that look nowhere.
    pub idle: usize,
    /// Sessions that fly at 150 m/s.
    pub flying: usize,
    /// Sessions that want all they can.
    pub greedy: usize,
    /// Whether the server sends unasked.
    pub push: bool,
    /// Views a second of a session that flies.
    pub views_a_second: f64,
    /// Seconds before anything counts.
    pub warm_s: f64,
    /// Seconds that count.
    pub seconds: f64,
    /// Width and height of the pictures, pixels.
    pub size: [u32; 2],
    /// More arguments of the server.
    pub server: Vec<String>,
}

/// What was found.
#[derive(Debug, Clone, Serialize)]
pub struct Loaded {
    /// The load.
    pub load: Load,
    /// Sessions that were open at the end.
    pub sessions: usize,
    /// Sessions that failed, and why the first one did.
    pub failed: usize,
    /// Why.
    pub failure: Option<String>,
    /// Processors that the server kept busy while it counted.
    pub server_cpus: f64,
    /// Processors that this program kept busy.
    pub own_cpus: f64,
    /// Memory of the server without sessions, bytes.
    pub memory_empty: u64,
    /// With the idle ones.
    pub memory_idle: u64,
    /// With all, at the end.
    pub memory_all: u64,
    /// Threads of the server at the end.
    pub threads: u64,
    /// From a View to the first chunk for it.
    pub chunks: Summary,
    /// From Ping to Pong.
    pub pongs: Summary,
    /// Page bytes a second, all sessions but the greedy ones.
    pub bytes_a_second: f64,
    /// Those of the greedy ones.
    pub greedy_bytes_a_second: f64,
    /// Views that needed pages and got none before the next one that did.
    pub unanswered: u64,
    /// From a View that needed pages to Idle.
    pub settled: Summary,
    /// Views that needed pages, all of which had come before.
    pub early: u64,
    /// Views that needed pages, and did not have all of them before the next one that did.
    pub unsettled: u64,
}

/// The flights that sessions read from.
///
/// # Errors
/// If the dataset is damaged.
pub fn scripts(dataset: &Dataset, load: &Load) -> Result<Vec<Script>> {
    let script = |i: usize| {
        let turn = i as f64 / SCRIPTS as f64;
        let way = Way {
            from: [0.35 + 0.3 * turn, 0.6 - 0.25 * turn],
            course_deg: 30.0 + 360.0 * turn,
            speed_m_s: 150.0,
            seconds: SCRIPT_S,
            error_px: 2.0,
        };
        Script::write(dataset, way, load.views_a_second, load.size)
    };
    (0..SCRIPTS).map(script).collect()
}

/// Starts a server on this machine that takes so many sessions, and logs into a file, or to where
/// this program does.
///
/// # Errors
/// If it does not start.
pub fn start(
    folder: &Path,
    sessions: usize,
    more: &[String],
    log: Option<&Path>,
) -> Result<Server> {
    let mut command = Command::new("prlimit");
    command
        .arg(format!("--nofile={FILES}"))
        .args(["setpriv", "--pdeathsig", "KILL"])
        .arg(beside("escarp-server")?)
        .arg(folder)
        .args(["--listen", "127.0.0.1:0", "--max-sessions"])
        .arg(sessions.to_string())
        .args(["--limit", &format!("connections={}", 2 * sessions + 64)])
        .args(more);
    if let Some(log) = log {
        let file = File::create(log).with_context(|| format!("cannot write {}", log.display()))?;
        command.stderr(file);
    }
    Server::start(command)
}

/// Allows this process to open many files.
///
/// # Errors
/// If the system does not.
pub fn allow_files() -> Result<()> {
    let status = Command::new("prlimit")
        .arg(format!("--pid={}", std::process::id()))
        .arg(format!("--nofile={FILES}"))
        .status()
        .context("cannot run prlimit (util-linux)")?;
    ensure!(status.success(), "this process may not open {FILES} files");
    Ok(())
}

/// Measures a load.
///
/// # Errors
/// If the server does not start, or the dataset is damaged.
pub fn measure(folder: &Path, scripts: Arc<Vec<Script>>, load: &Load) -> Result<Loaded> {
    allow_files()?;
    let dataset = Dataset::open(folder)?;
    let all = load.idle + load.flying + load.greedy;
    let server = start(folder, all + 16, &load.server, None)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()?;
    runtime.block_on(run(&server, &dataset, scripts, load))
}

async fn run(
    server: &Server,
    dataset: &Dataset,
    scripts: Arc<Vec<Script>>,
    load: &Load,
) -> Result<Loaded> {
    let (phase, watched) = watch::channel(Phase::Warming);
    let run = Run {
        url: crowd::parse(&server.url)?,
        scripts,
        push: load.push,
        lines_a_second: load.views_a_second,
        phase: watched,
    };
    let own = std::process::id();
    let (mut crowd, mut greedy) = (JoinSet::new(), JoinSet::new());
    let empty = settled(server).await?;
    for number in 0..load.idle {
        crowd.spawn(crowd::idle(run.clone()));
        breathe(number).await;
    }
    let idle = settled(server).await?;
    for number in 0..load.flying {
        crowd.spawn(crowd::flying(run.clone(), number));
        breathe(number).await;
    }
    for _ in 0..load.greedy {
        greedy.spawn(crowd::greedy(run.clone(), dataset.grid()));
    }
    sleep(load.warm_s).await;
    phase.send_replace(Phase::Measured);
    let (before, own_before) = (Usage::of(server.id())?, Usage::of(own)?);
    sleep(load.seconds).await;
    let (after, own_after) = (Usage::of(server.id())?, Usage::of(own)?);
    phase.send_replace(Phase::Over);
    let (found, failures) = ended(crowd).await;
    let (grabbed, greedy_failures) = ended(greedy).await;
    let failed = failures.len() + greedy_failures.len();
    Ok(Loaded {
        load: load.clone(),
        sessions: load.idle + load.flying + load.greedy - failed,
        failed,
        failure: failures.into_iter().chain(greedy_failures).next(),
        server_cpus: (after.cpu_s - before.cpu_s) / load.seconds,
        own_cpus: (own_after.cpu_s - own_before.cpu_s) / load.seconds,
        memory_empty: empty.memory_bytes,
        memory_idle: idle.memory_bytes,
        memory_all: after.memory_bytes,
        threads: after.threads,
        chunks: found.chunks.summary(),
        pongs: found.pongs.summary(),
        bytes_a_second: found.bytes as f64 / load.seconds,
        greedy_bytes_a_second: grabbed.bytes as f64 / load.seconds,
        unanswered: found.unanswered,
        settled: found.settled.summary(),
        early: found.early,
        unsettled: found.unsettled,
    })
}

async fn sleep(seconds: f64) {
    tokio::time::sleep(Duration::from_secs_f64(seconds)).await;
}

/// Not all at once: what is measured is sessions, not a rush.
async fn breathe(number: usize) {
    if number % OPENING == OPENING - 1 {
        sleep(0.1).await;
    }
}

/// The server when it has come to rest.
async fn settled(server: &Server) -> Result<Usage> {
    sleep(1.0).await;
    Usage::of(server.id())
}

/// What all found, and why some failed.
async fn ended(mut crowd: JoinSet<Result<Found>>) -> (Found, Vec<String>) {
    let (mut all, mut failures) = (Found::default(), Vec::new());
    while let Some(ended) = crowd.join_next().await {
        match ended {
            Ok(Ok(found)) => all.join(found),
            Ok(Err(why)) => failures.push(format!("{why:#}")),
            Err(why) => failures.push(why.to_string()),
        }
    }
    (all, failures)
}

impl Loaded {
    /// Memory of the server a session, bytes: of an idle one, and of one that flies.
    pub fn memory_a_session(&self) -> [Option<f64>; 2] {
        let over = |bytes: u64, less: u64, sessions: usize| {
            (sessions > 0).then(|| (bytes as f64 - less as f64) / sessions as f64)
        };
        let others = self.load.flying + self.load.greedy;
        [
            over(self.memory_idle, self.memory_empty, self.load.idle),
            over(self.memory_all, self.memory_idle, others),
        ]
    }
}

/// A row for each.
pub fn table(loaded: &[Loaded]) -> Table {
    let mut table = Table::new(&[
        "idle",
        "flying",
        "greedy",
        "push",
        "failed",
        "server CPUs",
        "own CPUs",
        "KiB/idle",
        "KiB/flying",
        "chunk p50 ms",
        "chunk p99 ms",
        "chunks",
        "late",
        "came before",
        "all p50 ms",
        "all p99 ms",
        "all",
        "not all",
        "pong p50 ms",
        "pong p99 ms",
        "MB/s",
        "greedy MB/s",
    ]);
    let ms = |value: Option<f64>| value.map_or("-".into(), |v| format!("{v:.1}"));
    let kib = |value: Option<f64>| value.map_or("-".into(), |v| format!("{:.0}", v / 1024.0));
    for one in loaded {
        let [idle, flying] = one.memory_a_session();
        table.rows.push(vec![
            one.load.idle.to_string(),
            one.load.flying.to_string(),
            one.load.greedy.to_string(),
            one.load.push.to_string(),
            one.failed.to_string(),
            format!("{:.2}", one.server_cpus),
            format!("{:.2}", one.own_cpus),
            kib(idle),
            kib(flying),
            ms(one.chunks.p50_ms),
            ms(one.chunks.p99_ms),
            one.chunks.count.to_string(),
            one.unanswered.to_string(),
            one.early.to_string(),
            ms(one.settled.p50_ms),
            ms(one.settled.p99_ms),
            one.settled.count.to_string(),
            one.unsettled.to_string(),
            ms(one.pongs.p50_ms),
            ms(one.pongs.p99_ms),
            format!("{:.2}", one.bytes_a_second / 1e6),
            format!("{:.2}", one.greedy_bytes_a_second / 1e6),
        ]);
    }
    table
}
