//! Many seeds, and the shortest script of one that fails.

use super::client::Record;
use super::ground::Ground;
use super::script::Script;
use super::world::World;
use rayon::prelude::*;
use std::fmt;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

/// The datasets, made once.
pub struct Campaign {
    grounds: Vec<Ground>,
}

/// What many runs came to.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tally {
    /// Runs without failure.
    pub runs: u64,
    /// What there was of the clients.
    pub clients: Record,
}

/// A run in which something did not hold.
#[derive(Debug, Clone)]
pub struct Failure {
    /// Its script; of a failure that was shortened, with the acts that are left.
    pub script: Script,
    /// The acts that are left, by their numbers in the seed's script.
    pub acts: Vec<usize>,
    /// When, in the world's time.
    pub at: Duration,
    /// What did not hold.
    pub what: String,
}

impl Default for Campaign {
    fn default() -> Campaign {
        Campaign::new()
    }
}

impl Campaign {
    /// Builds the datasets.
    pub fn new() -> Campaign {
        Campaign {
            grounds: Ground::all(),
        }
    }

    /// Runs a script.
    ///
    /// # Errors
    /// What did not hold, and when.
    pub fn run(&self, script: &Script) -> Result<Record, (Duration, String)> {
        let ground = &self.grounds[script.ground % self.grounds.len()];
        let mut world = World::new(ground, script);
        let run = catch_unwind(AssertUnwindSafe(|| world.run()));
        let what = match run {
            Ok(Ok(record)) => return Ok(record),
            Ok(Err(what)) => what,
            Err(panic) => {
                let text = panic.downcast_ref::<String>().cloned();
                let text = text.or_else(|| panic.downcast_ref::<&str>().map(|s| s.to_string()));
                format!("panic: {}", text.unwrap_or_default())
            }
        };
        Err((world.now, what))
    }

    /// Runs a seed, or only some acts of it.
    ///
    /// # Errors
    /// What did not hold.
    pub fn run_seed(&self, seed: u64, acts: Option<&[usize]>) -> Result<Record, Box<Failure>> {
        let script = Script::of(seed);
        let all: Vec<usize> = (0..script.acts.len()).collect();
        let acts = acts.map_or(all, <[usize]>::to_vec);
        let script = script.with_acts(&acts);
        self.run(&script).map_err(|(at, what)| {
            Box::new(Failure {
                script,
                acts,
                at,
                what,
            })
        })
    }

    /// Runs many seeds on all threads of the pool.
    pub fn run_seeds(&self, seeds: Range<u64>, done: &(dyn Fn() + Sync)) -> (Tally, Vec<Failure>) {
        let results: Vec<_> = seeds
            .into_par_iter()
            .map(|seed| {
                let result = self.run_seed(seed, None);
                done();
                result
            })
            .collect();
        let (mut tally, mut failures) = (Tally::default(), Vec::new());
        for result in results {
            match result {
                Ok(record) => {
                    tally.runs += 1;
                    tally.clients.add(&record);
                }
                Err(failure) => failures.push(*failure),
            }
        }
        (tally, failures)
    }

    /// The same seed with as few acts as possible, such that something still does not hold.
    pub fn shorten(&self, failure: Failure) -> Failure {
        let seed = failure.script.seed;
        let (mut best, mut from) = (failure, 0);
        while from < best.acts.len() {
            let mut acts = best.acts.clone();
            acts.remove(from);
            match self.run_seed(seed, Some(&acts)) {
                Ok(_) => from += 1,
                Err(shorter) => best = *shorter,
            }
        }
        best
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let clients = &self.clients;
        write!(
            f,
            "{} runs hold: {} frames, {} meshes examined, {} of them measured, {} sessions, {} \
             new generations shown, {} page bytes, {} chunks of no use",
            self.runs,
            clients.frames,
            clients.meshes,
            clients.measured,
            clients.sessions,
            clients.generations,
            clients.page_bytes,
            clients.dropped
        )
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (script, acts) = (&self.script, &self.acts);
        writeln!(f, "seed {} at {:?}: {}", script.seed, self.at, self.what)?;
        let numbers: Vec<String> = acts.iter().map(usize::to_string).collect();
        let numbers = match numbers.is_empty() {
            true => "none".to_owned(),
            false => numbers.join(","),
        };
        let seed = script.seed;
        writeln!(
            f,
            "again: escarp-report simulate --seed {seed} --acts {numbers}"
        )?;
        writeln!(
            f,
            "  dataset {}, generation {}, {:?}",
            script.ground, script.generation, script.limits
        )?;
        for (number, client) in script.clients.iter().enumerate() {
            writeln!(f, "  client {number}: {client:?}")?;
        }
        for (number, (at, act)) in acts.iter().zip(&script.acts) {
            writeln!(f, "  {number} at {at:?}: {act:?}")?;
        }
        write!(f, "  peace at {:?}", script.peace)
    }
}
