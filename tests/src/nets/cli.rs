//! The commands of `escarp-report` that measure server and clients as they run.

use super::cancel::{self, CancelJob};
use super::client::{self, Job, Kind};
use super::convergence::{Plan, measure};
use super::fly::{self, FlightPlan, FlyJob};
use super::load::{self, Load};
use super::process::Usage;
use super::renew::{self, Renewal};
use super::shaper::Cell;
use super::show::{self, Measured};
use super::soak;
use crate::report::facts::{DatasetFacts, Machine};
use anyhow::{Context, Result};
use clap::{Args, Subcommand};
use escarp_tiles::dataset::Dataset;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Server and clients as they run.
#[derive(Debug, Subcommand)]
pub enum Streaming {
    /// Error against time over lines of given delay, bandwidth and loss (as root)
    Network(Network),
    /// What many sessions cost the server, how long they wait, and what a greedy one does to them
    Load(LoadCommand),
    /// Steady flight over a line: bytes a second, and stalls (as root)
    Flight(FlightCommand),
    /// Clients coming and going: does the server grow?
    Soak(SoakCommand),
    /// How long a teleport waits behind what was asked for before it (as root)
    Cancel(CancelCommand),
    /// A copy of a dataset is updated while clients fly over it: frames lost, cracks, delays
    Renew(RenewCommand),
    /// A client of `cancel`: teleports, and prints how long it waited
    #[command(hide = true)]
    LineCancel {
        /// The job, JSON
        job: String,
    },
    /// A client of `flight`: flies, and prints what it was like
    #[command(hide = true)]
    LineFlight {
        /// The job, JSON
        job: String,
    },
    /// A client of `network`: does a job, and prints what it saw
    #[command(hide = true)]
    LineClient {
        /// The job, JSON
        job: String,
    },
}

/// How the kernel at both ends of a line is set.
#[derive(Debug, Args)]
struct Kernel {
    /// A parameter of the kernel at both ends, such as net.ipv4.tcp_congestion_control=bbr; again
    /// for more
    #[arg(long = "kernel", value_name = "NAME=VALUE", value_parser = parameter)]
    parameters: Vec<(String, String)>,
}

fn parameter(text: &str) -> Result<(String, String), String> {
    let plain = |c: char| c.is_ascii_alphanumeric() || "._- ".contains(c);
    let pair = text
        .split_once('=')
        .filter(|_| text.replacen('=', "", 1).chars().all(plain));
    let pair = pair.filter(|(name, _)| name.starts_with("net."));
    let (name, value) = pair.ok_or("allowed are net.NAME=VALUE, as sysctl takes it")?;
    Ok((name.to_owned(), value.to_owned()))
}

/// Error against time over lines.
#[derive(Debug, Args)]
pub struct Network {
    /// Dataset, as `escarp-tiles build` makes it
    #[arg(value_name = "DATASET")]
    dataset: PathBuf,
    /// Folder for network.json, network.csv and the plots
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// A line: round trip, bandwidth, loss; again for more. Default: 0, 50 and 200 ms with 1, 10
    /// and 100 Mbit/s and 0 and 1 %
    #[arg(long = "line", value_name = "50ms,10Mbit/s,1%")]
    lines: Vec<Cell>,
    /// Clients; default: all there are
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    clients: Vec<Kind>,
    /// Times that a line with loss is measured
    #[arg(long, value_name = "N", default_value_t = 3)]
    repeats: u32,
    /// The tolerance, pixels
    #[arg(long, value_name = "PX", default_value_t = 2.0)]
    error_px: f32,
    /// Longest time for a picture, seconds
    #[arg(long, value_name = "S", default_value_t = 60.0)]
    limit_s: f64,
    #[command(flatten)]
    kernel: Kernel,
}

/// Runs a command; `called` is how the program was.
///
/// # Errors
/// What stopped it.
pub fn run(command: &Streaming, called: &str) -> Result<()> {
    match command {
        Streaming::Network(network) => network.run(called),
        Streaming::Load(load) => load.run(),
        Streaming::Flight(flight) => flight.run(),
        Streaming::Soak(soak) => soak.run(),
        Streaming::Cancel(cancel) => cancel.run(),
        Streaming::Renew(renew) => renew.run(),
        Streaming::LineCancel { job } => {
            let job: CancelJob = serde_json::from_str(job).context("the job")?;
            serde_json::to_writer(std::io::stdout(), &cancel::work(&job)?)?;
            Ok(())
        }
        Streaming::LineFlight { job } => {
            let job: FlyJob = serde_json::from_str(job).context("the job")?;
            serde_json::to_writer(std::io::stdout(), &fly::work(&job)?)?;
            Ok(())
        }
        Streaming::LineClient { job } => {
            let job: Job = serde_json::from_str(job).context("the job")?;
            let legs = client::work(&job)?;
            serde_json::to_writer(std::io::stdout(), &legs)?;
            Ok(())
        }
    }
}

/// Steady flight over a line.
#[derive(Debug, Args)]
pub struct FlightCommand {
    /// Dataset, as `escarp-tiles build` makes it
    #[arg(value_name = "DATASET")]
    dataset: PathBuf,
    /// Folder for flight.json and flight.csv
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// The line: round trip, bandwidth, loss
    #[arg(long, value_name = "LINE", default_value = "50ms,1Mbit/s,0%")]
    line: Cell,
    /// Speeds, metres a second
    #[arg(
        long,
        value_name = "N,...",
        value_delimiter = ',',
        default_value = "150,1500,15000"
    )]
    speeds: Vec<f64>,
    /// Clients; default: all there are
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    clients: Vec<Kind>,
    /// Longest flight, seconds
    #[arg(long, value_name = "S", default_value_t = 60.0)]
    seconds: f64,
    /// The tolerance, pixels
    #[arg(long, value_name = "PX", default_value_t = 2.0)]
    error_px: f32,
    /// Flights of each
    #[arg(long, value_name = "N", default_value_t = 1)]
    repeats: u32,
}

impl FlightCommand {
    fn run(&self) -> Result<()> {
        prepare(&self.output)?;
        let kinds = match self.clients.as_slice() {
            [] => Kind::ALL.to_vec(),
            own => own.to_vec(),
        };
        let both = |kind: &Kind| {
            let predicts: &[bool] = if kind.predicts() {
                &[true, false]
            } else {
                &[false]
            };
            predicts
                .iter()
                .map(|&predicts| (*kind, predicts))
                .collect::<Vec<_>>()
        };
        let plan = FlightPlan {
            line: self.line,
            speeds: self.speeds.clone(),
            clients: kinds.iter().flat_map(both).collect(),
            seconds: self.seconds,
            error_px: self.error_px,
            repeats: self.repeats,
        };
        let flights = fly::measure(&self.dataset, &plan, &note)?;
        let table = fly::table(&flights);
        write(
            &self.output,
            "flight.json",
            &serde_json::to_vec_pretty(&flights)?,
        )?;
        write(&self.output, "flight.csv", table.csv().as_bytes())?;
        say(&table.markdown());
        Ok(())
    }
}

/// How long a teleport waits.
#[derive(Debug, Args)]
pub struct CancelCommand {
    /// Dataset, as `escarp-tiles build` makes it
    #[arg(value_name = "DATASET")]
    dataset: PathBuf,
    /// A line: round trip, bandwidth, loss; again for more. Default: 0, 50 and 200 ms with 1 Mbit/s
    #[arg(long = "line", value_name = "LINE",
          default_values = ["0ms,1Mbit/s,0%", "50ms,1Mbit/s,0%", "200ms,1Mbit/s,0%"])]
    lines: Vec<Cell>,
    /// The server sends unasked
    #[arg(long)]
    push: bool,
    /// Teleports of each
    #[arg(long, value_name = "N", default_value_t = 3)]
    repeats: u32,
    /// The tolerance, pixels
    #[arg(long, value_name = "PX", default_value_t = 2.0)]
    error_px: f32,
    #[command(flatten)]
    kernel: Kernel,
}

impl CancelCommand {
    fn run(&self) -> Result<()> {
        let (push, px) = (self.push, self.error_px);
        let parameters = &self.kernel.parameters;
        let repeats = self.repeats.max(1);
        let all = cancel::measure(&self.dataset, &self.lines, push, repeats, px, parameters)?;
        say(&cancel::table(&all).markdown());
        Ok(())
    }
}

/// A dataset that is updated while clients fly over it.
#[derive(Debug, Args)]
pub struct RenewCommand {
    /// Dataset, as `escarp-tiles build` makes it; it is copied
    #[arg(value_name = "DATASET")]
    dataset: PathBuf,
    /// Clients
    #[arg(long, value_name = "N", default_value_t = 50)]
    clients: usize,
    /// Updates, one after the other
    #[arg(long, value_name = "N", default_value_t = 3)]
    updates: u32,
    /// Seconds from one to the next
    #[arg(long, value_name = "S", default_value_t = 10.0)]
    between_s: f64,
    /// Width and height of the pictures, pixels
    #[arg(long, num_args = 2, value_names = ["W", "H"], default_values_t = [320, 180])]
    size: Vec<u32>,
    /// The tolerance, pixels
    #[arg(long, value_name = "PX", default_value_t = 4.0)]
    error_px: f32,
}

impl RenewCommand {
    fn run(&self) -> Result<()> {
        let renewal = Renewal {
            clients: self.clients,
            updates: self.updates,
            between_s: self.between_s,
            size: [self.size[0], self.size[1]],
            error_px: self.error_px,
        };
        let seen = renew::renew(&self.dataset, &renewal, &note)?;
        say(&serde_json::to_string_pretty(&seen)?);
        Ok(())
    }
}

/// Clients coming and going.
#[derive(Debug, Args)]
pub struct SoakCommand {
    /// Dataset, as `escarp-tiles build` makes it
    #[arg(value_name = "DATASET")]
    dataset: PathBuf,
    /// Folder for soak.json, soak.csv, a plot, and the server's log
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// How long
    #[arg(long, value_name = "N", default_value_t = 30.0)]
    minutes: f64,
    /// The server sends unasked
    #[arg(long)]
    push: bool,
    /// One more argument of the server; again for more
    #[arg(long = "server-arg", value_name = "ARG", allow_hyphen_values = true)]
    server: Vec<String>,
}

impl SoakCommand {
    fn run(&self) -> Result<()> {
        prepare(&self.output)?;
        let seconds = self.minutes * 60.0;
        let soaked = soak::soak(
            &self.dataset,
            &self.output,
            seconds,
            self.push,
            &self.server,
            &note,
        )?;
        soak::write(&self.output, &soaked)?;
        let mib = |usage: &Usage| usage.memory_bytes as f64 / (1 << 20) as f64;
        let last = soaked
            .samples
            .last()
            .context("it was too short for a sample")?;
        say(&format!(
            "sessions: {} opened, {} failed\n\
             memory: {:.1} MiB before, last third over middle third {:.3}, {:.1} MiB when all had \
             gone\n\
             files: {} before, {} at the end, {} when all had gone\n\
             threads: {} before, {} when all had gone\n\
             warnings in the server's log: {}",
            last.opened,
            last.failed,
            mib(&soaked.before),
            soaked.growth(),
            mib(&soaked.after),
            soaked.before.files,
            last.usage.files,
            soaked.after.files,
            soaked.before.threads,
            soaked.after.threads,
            soaked.log_lines,
        ));
        for why in &soaked.failures {
            say(&format!("a session failed: {why}"));
        }
        Ok(())
    }
}

/// Many sessions from one process, against a server of its own.
#[derive(Debug, Args)]
pub struct LoadCommand {
    /// Dataset, as `escarp-tiles build` makes it
    #[arg(value_name = "DATASET")]
    dataset: PathBuf,
    /// Folder for load.json
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Sessions that look nowhere
    #[arg(long, value_name = "N", default_value_t = 2000)]
    idle: usize,
    /// Sessions that fly at 150 m/s, 500 m above the ground
    #[arg(long, value_name = "N", default_value_t = 200)]
    flying: usize,
    /// Sessions that want all they can, from everywhere; with any, the same load without them is
    /// measured first
    #[arg(long, value_name = "N", default_value_t = 0)]
    greedy: usize,
    /// The server sends unasked
    #[arg(long)]
    push: bool,
    /// Views a second of a session that flies
    #[arg(long, value_name = "N", default_value_t = 20.0)]
    views_per_s: f64,
    /// Width and height of their pictures, pixels
    #[arg(long, num_args = 2, value_names = ["W", "H"], default_values_t = [1280, 720])]
    size: Vec<u32>,
    /// Seconds before anything counts
    #[arg(long, value_name = "S", default_value_t = 20.0)]
    warm_s: f64,
    /// Seconds that count
    #[arg(long, value_name = "S", default_value_t = 30.0)]
    seconds: f64,
    /// One more argument of the server; again for more
    #[arg(long = "server-arg", value_name = "ARG", allow_hyphen_values = true)]
    server: Vec<String>,
}

impl LoadCommand {
    fn load(&self, greedy: usize) -> Load {
        Load {
            idle: self.idle,
            flying: self.flying,
            greedy,
            push: self.push,
            views_a_second: self.views_per_s,
            warm_s: self.warm_s,
            seconds: self.seconds,
            size: [self.size[0], self.size[1]],
            server: self.server.clone(),
        }
    }

    fn run(&self) -> Result<()> {
        prepare(&self.output)?;
        let dataset =
            Dataset::open(&self.dataset).with_context(|| format!("{}", self.dataset.display()))?;
        note("writing scripts");
        let scripts = Arc::new(load::scripts(&dataset, &self.load(0))?);
        let mut loaded = Vec::new();
        for greedy in [0, self.greedy]
            .iter()
            .take(if self.greedy > 0 { 2 } else { 1 })
        {
            note(&format!(
                "{} idle, {} flying, {greedy} greedy",
                self.idle, self.flying
            ));
            let load = self.load(*greedy);
            loaded.push(load::measure(&self.dataset, scripts.clone(), &load)?);
        }
        write(
            &self.output,
            "load.json",
            &serde_json::to_vec_pretty(&loaded)?,
        )?;
        say(&load::table(&loaded).markdown());
        for why in loaded.iter().filter_map(|one| one.failure.as_ref()) {
            say(&format!("a session failed: {why}"));
        }
        Ok(())
    }
}

impl Network {
    fn plan(&self) -> Plan {
        let or = |own: &[Cell], usual: fn() -> Vec<Cell>| match own {
            [] => usual(),
            own => own.to_vec(),
        };
        Plan {
            cells: or(&self.lines, Plan::usual_cells),
            kinds: match self.clients.as_slice() {
                [] => Kind::ALL.to_vec(),
                own => own.to_vec(),
            },
            repeats: self.repeats.max(1),
            error_px: self.error_px,
            limit_s: self.limit_s,
            parameters: self.kernel.parameters.clone(),
        }
    }

    fn run(&self, called: &str) -> Result<()> {
        prepare(&self.output)?;
        let dataset =
            Dataset::open(&self.dataset).with_context(|| format!("{}", self.dataset.display()))?;
        let outcomes = measure(&self.dataset, &self.plan(), &note)?;
        let measured = Measured {
            command: called.into(),
            machine: Machine::here(),
            dataset: DatasetFacts::of(&dataset),
            error_px: self.error_px,
            outcomes,
        };
        show::write(&self.output, &measured)?;
        say(&show::table(&measured.outcomes).markdown());
        Ok(())
    }
}

/// Makes a folder for results, before anything is measured.
fn prepare(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))
}

fn write(folder: &Path, name: &str, bytes: &[u8]) -> Result<()> {
    let path = folder.join(name);
    std::fs::write(&path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

/// Prints a text. Nobody may be there to read it; the files are what counts.
fn say(text: &str) {
    let _ = writeln!(std::io::stdout(), "{text}");
}

/// Says what is being done.
fn note(text: &str) {
    let _ = writeln!(std::io::stderr(), "{text}");
}
