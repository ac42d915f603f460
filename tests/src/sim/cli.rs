//! `escarp-report simulate`.

use super::campaign::Campaign;
use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use indicatif::ProgressBar;
use std::io::Write;

/// Failures that are shortened, and printed with their scripts.
const MOST_SHOWN: usize = 5;

/// Which seeds.
#[derive(Debug, Args)]
pub struct Simulate {
    /// How many
    #[arg(long, default_value_t = 1000, conflicts_with = "seed")]
    seeds: u64,
    /// The first one
    #[arg(long, default_value_t = 0, conflicts_with = "seed")]
    from: u64,
    /// Only this one
    #[arg(long)]
    seed: Option<u64>,
    /// Of that seed's script, only these acts, by their numbers, or `none`; as they are printed
    #[arg(long, requires = "seed", value_name = "N,...")]
    acts: Option<String>,
}

/// Simulates, and prints what fails.
///
/// # Errors
/// What did not hold, or how many seeds fail.
pub fn simulate(which: &Simulate) -> Result<()> {
    let campaign = Campaign::new();
    if let Some(seed) = which.seed {
        let acts = which.acts.as_deref().map(numbers).transpose()?;
        let failure = campaign.run_seed(seed, acts.as_deref()).err();
        return match failure {
            None => {
                say(&format!("seed {seed} holds"));
                Ok(())
            }
            Some(failure) => bail!("{failure}"),
        };
    }
    let seeds = which.from..which.from.saturating_add(which.seeds);
    let bar = ProgressBar::new(which.seeds);
    let (tally, mut failures) = campaign.run_seeds(seeds, &|| bar.inc(1));
    bar.finish_and_clear();
    say(&tally.to_string());
    for failure in &failures {
        let script = &failure.script;
        say(&format!(
            "seed {} at {:?}: {}",
            script.seed, failure.at, failure.what
        ));
    }
    failures.truncate(MOST_SHOWN);
    for failure in failures {
        say(&format!("\n{}", campaign.shorten(failure)));
    }
    ensure!(
        tally.runs == which.seeds,
        "{} of {} seeds fail",
        which.seeds - tally.runs,
        which.seeds
    );
    Ok(())
}

fn numbers(text: &str) -> Result<Vec<usize>> {
    if text == "none" {
        return Ok(Vec::new());
    }
    let numbers = text.split(',').map(str::parse);
    let numbers = numbers.collect::<Result<_, _>>();
    numbers.with_context(|| format!("--acts {text:?}: allowed are none, or numbers such as 0,3,7"))
}

/// Prints a text. Nobody may be there to read it.
fn say(text: &str) {
    let _ = writeln!(std::io::stdout(), "{text}");
}
