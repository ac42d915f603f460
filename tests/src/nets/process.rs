//! What the system says of a process.

use anyhow::{Context, Result};
use serde::Serialize;

/// Clock ticks a second in which the kernel counts a process's time for programs.
const TICKS_A_SECOND: f64 = 100.0;

/// A process at a moment.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Usage {
    /// Processor time since it began, seconds.
    pub cpu_s: f64,
    /// Memory that is its own, bytes: without files that are mapped.
    pub memory_bytes: u64,
    /// Files and sockets that are open.
    pub files: u64,
    /// Threads.
    pub threads: u64,
}

impl Usage {
    /// Of a process, now.
    ///
    /// # Errors
    /// If there is no such process.
    pub fn of(process: u32) -> Result<Usage> {
        let read = |name: &str| {
            let path = format!("/proc/{process}/{name}");
            std::fs::read_to_string(&path).with_context(|| format!("no {path}"))
        };
        let status = read("status")?;
        let stat = read("stat")?;
        let files = std::fs::read_dir(format!("/proc/{process}/fd"))?.count() as u64;
        Ok(Usage {
            cpu_s: cpu_s(&stat).context("no times in stat")?,
            memory_bytes: field(&status, "RssAnon").context("no RssAnon in status")? * 1024,
            threads: field(&status, "Threads").context("no Threads in status")?,
            files,
        })
    }
}

fn field(status: &str, name: &str) -> Option<u64> {
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix(name)?.strip_prefix(':'))?;
    line.split_whitespace().next()?.parse().ok()
}

/// The name may hold spaces; what follows its bracket does not.
fn cpu_s(stat: &str) -> Option<f64> {
    let (_, rest) = stat.rsplit_once(')')?;
    let mut fields = rest.split_whitespace().skip(11);
    let mut ticks = || fields.next()?.parse::<f64>().ok();
    Some((ticks()? + ticks()?) / TICKS_A_SECOND)
}

/// Values and their quantiles.
#[derive(Debug, Clone, Default)]
pub struct Delays(Vec<f64>);

impl Delays {
    /// Adds a delay, milliseconds.
    pub fn add(&mut self, ms: f64) {
        self.0.push(ms);
    }

    /// Adds those of others.
    pub fn join(&mut self, other: Delays) {
        self.0.extend(other.0);
    }

    /// Milliseconds that a share of all do not exceed (nearest rank), if there are any.
    pub fn quantile(&self, share: f64) -> Option<f64> {
        let mut sorted = self.0.clone();
        sorted.sort_by(f64::total_cmp);
        let rank = (share * sorted.len() as f64).ceil().max(1.0) as usize;
        sorted.get(rank - 1).copied()
    }

    /// How many, and their quantiles.
    pub fn summary(&self) -> Summary {
        Summary {
            count: self.0.len(),
            p50_ms: self.quantile(0.5),
            p99_ms: self.quantile(0.99),
            max_ms: self.quantile(1.0),
        }
    }
}

/// Delays in a few numbers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Summary {
    /// How many there were.
    pub count: usize,
    /// Half are at most this, milliseconds.
    pub p50_ms: Option<f64>,
    /// 99 of 100 are.
    pub p99_ms: Option<f64>,
    /// All are.
    pub max_ms: Option<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_process_has_memory_files_threads_and_takes_time() {
        let usage = Usage::of(std::process::id()).expect("it is there");
        assert!(
            usage.memory_bytes > 0 && usage.files >= 3 && usage.threads >= 1,
            "{usage:?}"
        );
        assert!(Usage::of(u32::MAX).is_err());
    }

    #[test]
    fn times_are_found_behind_a_name_with_spaces_and_brackets() {
        let stat = "12 (a b) c) S 1 1 1 0 -1 4194560 1 0 0 0 250 50 0 0 20 0 1 0 1 1 1";
        assert_eq!(cpu_s(stat), Some(3.0));
        assert_eq!(field("Name:\tx\nThreads:\t7\n", "Threads"), Some(7));
    }

    #[test]
    fn quantiles_are_values_by_nearest_rank() {
        let mut delays = Delays::default();
        (1..=200).rev().for_each(|ms| delays.add(f64::from(ms)));
        assert_eq!(delays.quantile(0.5), Some(100.0));
        assert_eq!(delays.quantile(0.99), Some(198.0));
        assert_eq!(delays.quantile(1.0), Some(200.0));
        assert_eq!(Delays::default().quantile(0.5), None);
    }
}
