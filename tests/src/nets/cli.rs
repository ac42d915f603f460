//! The commands of `escarp-report` that measure server and clients as they run.

use super::client::{self, Job, Kind};
use super::convergence::{Plan, measure};
use super::shaper::Cell;
use super::show::{self, Measured};
use crate::report::facts::{DatasetFacts, Machine};
use anyhow::{Context, Result};
use clap::{Args, Subcommand};
use escarp_tiles::dataset::Dataset;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Server and clients as they run.
#[derive(Debug, Subcommand)]
pub enum Streaming {
    /// Error against time over lines of given delay, bandwidth and loss (as root)
    Network(Network),
    /// A client of `network`: does a job, and prints what it saw
    #[command(hide = true)]
    LineClient {
        /// The job, JSON
        job: String,
    },
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
    /// TCP's congestion control, such as cubic or bbr; default: the system's
    #[arg(long, value_name = "NAME")]
    congestion: Option<String>,
}

/// Runs a command; `called` is how the program was.
///
/// # Errors
/// What stopped it.
pub fn run(command: &Streaming, called: &str) -> Result<()> {
    match command {
        Streaming::Network(network) => network.run(called),
        Streaming::LineClient { job } => {
            let job: Job = serde_json::from_str(job).context("the job")?;
            let legs = client::work(&job)?;
            serde_json::to_writer(std::io::stdout(), &legs)?;
            Ok(())
        }
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
            congestion: self.congestion.clone(),
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

/// Prints a text. Nobody may be there to read it; the files are what counts.
fn say(text: &str) {
    let _ = writeln!(std::io::stdout(), "{text}");
}

/// Says what is being done.
fn note(text: &str) {
    let _ = writeln!(std::io::stderr(), "{text}");
}
