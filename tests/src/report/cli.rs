//! The command line of `escarp-report`.

use super::conduct::{conduct, steps};
use super::lines::Line;
use super::plan::Plan;
use super::variant::Variant;
use super::write;
use super::{flight, tables};
use crate::nets::{self, cli::Streaming};
use crate::sim::cli::{Simulate, simulate};
use crate::stability;
use anyhow::{Context, Result, ensure};
use clap::error::ErrorKind;
use clap::{Parser, Subcommand};
use escarp_tiles::dataset::Dataset;
use indicatif::{ProgressBar, ProgressStyle};
use std::cell::Cell;
use std::collections::HashSet;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Measure meshers on datasets: error against run time, and what belongs to it.
#[derive(Debug, Parser)]
#[command(
    name = "escarp-report",
    version,
    after_help = EXAMPLES,
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true
)]
pub struct Cli {
    #[command(subcommand)]
    other: Option<Other>,
    /// Datasets, as `escarp-tiles build` makes them
    #[arg(required_unless_present = "stability", value_name = "DATASET")]
    datasets: Vec<PathBuf>,
    /// Folder for the report; one below it for each dataset if there are several
    #[arg(short, long, required = true, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Flight, JSON as `escarp-client fly` reads it; default: from the overview down to a low flight
    #[arg(long, value_name = "FILE.json")]
    path: Option<PathBuf>,
    /// Meshers, each with `:local` for the article's metric, `+morph` for vertices that come and go gradually; default: all there are
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    meshers: Vec<Variant>,
    /// Tolerances, pixels; default: 0.5,1,2,4,8,16,32, quick 1,2,4,16
    #[arg(long, value_name = "PX,...", value_delimiter = ',')]
    error_px: Vec<f32>,
    /// Lines for cold starts: bandwidth and delay of one way; default: 1Mbit/s@50ms,
    /// 10Mbit/s@50ms, 100Mbit/s@10ms, quick the second
    #[arg(long, value_name = "LINE,...", value_delimiter = ',')]
    lines: Vec<Line>,
    /// Fewer frames, tolerances and repeats: under a minute for a million samples
    #[arg(long)]
    quick: bool,
    /// Run the stiff and extreme cases instead, on datasets of their own, and write their table
    #[arg(long, conflicts_with_all = ["datasets", "path", "meshers", "error_px", "lines", "quick"])]
    stability: bool,
}

/// Server and clients as they run, over lines, under load, and in virtual time.
#[derive(Debug, Subcommand)]
enum Other {
    #[command(flatten)]
    Streaming(Streaming),
    /// Simulate servers and clients under virtual time, from seeds; a seed that fails is shortened
    /// and printed
    Simulate(Simulate),
}

const EXAMPLES: &str = "\
Writes report.html, which needs no other file, report.json with every number, tables as CSV, and
each plot as SVG and PNG. Prints a short table.

Examples:
  escarp-report everest.escarp -o report
  escarp-report everest.escarp moon.escarp --quick -o reports
  escarp-report --stability -o stability
  escarp-report simulate --seeds 10000
  escarp-report network everest.escarp -o network      (as root)
  escarp-report moon.escarp --path docs/moon-flight.json --meshers quadtree,roam --error-px 1,2,4 -o report

Exit codes: 0 done; 1 failed; 2 wrong usage.";

impl Cli {
    /// What is to be measured, or why not, as clap says it.
    fn plan(&self) -> Result<Plan, clap::Error> {
        let plan = Plan::usual(self.quick);
        plan.with(
            self.meshers.clone(),
            self.error_px.clone(),
            self.lines.clone(),
        )
        .map_err(|why| {
            use clap::CommandFactory;
            Cli::command().error(ErrorKind::ValueValidation, why)
        })
    }
}

/// Opens a dataset that has something to measure.
fn open(path: &Path) -> Result<Arc<Dataset>> {
    let dataset = Dataset::open(path).with_context(|| format!("{}", path.display()))?;
    let valid = dataset.manifest().valid_samples;
    ensure!(valid > 0, "{} has no sample with data", path.display());
    Ok(Arc::new(dataset))
}

/// The folder of each dataset's report, below the one that was asked for if there are several.
fn folders(output: &Path, datasets: &[Arc<Dataset>]) -> Vec<PathBuf> {
    if datasets.len() == 1 {
        return vec![output.to_path_buf()];
    }
    let mut taken = HashSet::new();
    let mut folder = |name: &str| {
        let names = (1..).map(|n| {
            if n == 1 {
                name.to_owned()
            } else {
                format!("{name}-{n}")
            }
        });
        let free = names.into_iter().find(|name| taken.insert(name.clone()));
        output.join(free.unwrap_or_default())
    };
    datasets
        .iter()
        .map(|dataset| folder(dataset.name()))
        .collect()
}

/// Runs the program.
///
/// # Errors
/// What stopped it.
pub fn run(cli: &Cli) -> Result<()> {
    match &cli.other {
        Some(Other::Streaming(streaming)) => return nets::cli::run(streaming, &command()),
        Some(Other::Simulate(which)) => return simulate(which),
        None => {}
    }
    let output = cli.output.as_deref().context("-o is missing")?;
    if cli.stability {
        return run_stability(output);
    }
    let plan = cli.plan().unwrap_or_else(|error| error.exit());
    let datasets: Vec<Arc<Dataset>> = cli
        .datasets
        .iter()
        .map(|path| open(path))
        .collect::<Result<_>>()?;
    let flights = datasets.iter();
    let flights: Vec<_> = flights
        .map(|dataset| flight::open(cli.path.as_deref(), dataset.manifest()))
        .collect::<Result<_>>()?;
    let folders = folders(output, &datasets);
    for folder in &folders {
        write::prepare(folder)?;
    }
    let bar = Progress::new((steps(&plan) + 1) * datasets.len() as u64);
    let mut reports = Vec::new();
    for ((dataset, flight), folder) in datasets.iter().zip(&flights).zip(&folders) {
        let name = dataset.name();
        let report = conduct(dataset, flight, &plan, command(), &|step| {
            bar.step(name, step)
        })?;
        write::report(folder, &report)?;
        bar.print(&tables::summary(&report));
        reports.push((report, folder.clone()));
    }
    bar.end();
    if reports.len() > 1 {
        write::index(output, &reports)?;
    }
    Ok(())
}

/// Runs the stiff and extreme cases, and prints those that fail.
fn run_stability(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let bar = Progress::new(stability::cases());
    let rows = stability::run(&|case| bar.step("stability", case));
    bar.end();
    stability::render::write(folder, &rows)
        .with_context(|| format!("cannot write to {}", folder.display()))?;
    for row in rows.iter().filter(|row| row.verdict.is_failure()) {
        say(&format!("{}: {}", row.case, row.verdict));
    }
    say(&stability::render::summary(&rows).to_string());
    Ok(())
}

/// Prints a text. Nobody may be there to read it; the files are what counts.
fn say(text: &str) {
    let _ = writeln!(std::io::stdout(), "{text}");
}

/// How this program was called, its folder left out.
fn command() -> String {
    let mut words = vec!["escarp-report".to_owned()];
    words.extend(
        std::env::args_os()
            .skip(1)
            .map(|word| word.to_string_lossy().into_owned()),
    );
    words.join(" ")
}

/// A bar on a terminal, lines elsewhere.
struct Progress {
    bar: ProgressBar,
    done: Cell<u64>,
}

impl Progress {
    fn new(steps: u64) -> Progress {
        let style = ProgressStyle::with_template("{bar:30} {pos}/{len} {elapsed} {wide_msg}");
        let bar = ProgressBar::new(steps);
        if let Ok(style) = style {
            bar.set_style(style);
        }
        let done = Cell::new(0);
        Progress { bar, done }
    }

    /// A step begins; the one before it is done.
    fn step(&self, dataset: &str, step: &str) {
        let text = format!("{dataset}: {step}");
        self.bar.set_position(self.done.get());
        self.done.set(self.done.get() + 1);
        if self.bar.is_hidden() {
            // Nobody may be there to read it; the files are what counts.
            let _ = writeln!(std::io::stderr(), "{text}");
        }
        self.bar.set_message(text);
        self.bar.tick();
    }

    fn print(&self, text: &str) {
        self.bar.suspend(|| say(text));
    }

    fn end(&self) {
        self.bar.finish_and_clear();
    }
}
