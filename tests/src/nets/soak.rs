//! Clients coming and going for as long as one likes: does the server grow?

use super::crowd::{self, Phase, Run};
use super::http::KeptAlive;
use super::load::{allow_files, start};
use super::places::Way;
use super::process::Usage;
use super::script::Script;
use crate::report::plot::font::Font;
use crate::report::plot::png::png;
use crate::report::plot::svg::{Colours, svg};
use crate::report::plot::{Axis, Chart, Scale, Series, Style};
use crate::report::tables::Table;
use anyhow::{Context, Result};
use escarp_client::net::Url;
use escarp_tiles::dataset::Dataset;
use serde::Serialize;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::watch;
use tokio::task::JoinSet;

/// Sessions at a time.
const SESSIONS: usize = 60;
/// Shortest and longest life of one, seconds.
const LIFE_S: [f64; 2] = [0.5, 20.0];
/// Samples of a soak.
const SAMPLES: f64 = 240.0;
/// Seconds that sessions get to end.
const END_S: u64 = 5;

/// A moment of a soak.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Sample {
    /// Seconds since the beginning.
    pub time_s: f64,
    /// What the server takes.
    pub usage: Usage,
    /// Sessions that have been opened, and those that failed other than by being killed.
    pub opened: u64,
    /// Those that failed other than by being killed.
    pub failed: u64,
}

/// What a soak came to.
#[derive(Debug, Clone, Serialize)]
pub struct Soaked {
    /// Before the first client.
    pub before: Usage,
    /// While clients came and went.
    pub samples: Vec<Sample>,
    /// When all had gone.
    pub after: Usage,
    /// Lines that the server logged as warnings or worse.
    pub log_lines: usize,
    /// Why the first sessions failed.
    pub failures: Vec<String>,
}

impl Soaked {
    /// Mean memory of the last third over that of the middle third: 1 if it is flat.
    pub fn growth(&self) -> f64 {
        let third = self.samples.len() / 3;
        let mean = |from: usize, to: usize| {
            let part = self.samples.get(from..to).unwrap_or_default();
            let sum: f64 = part.iter().map(|s| s.usage.memory_bytes as f64).sum();
            sum / part.len().max(1) as f64
        };
        mean(2 * third, 3 * third) / mean(third, 2 * third).max(1.0)
    }
}

#[derive(Debug, Default)]
struct Counts {
    opened: AtomicU64,
    failed: AtomicU64,
    failures: std::sync::Mutex<Vec<String>>,
}

/// Lets clients come and go.
///
/// # Errors
/// If the server does not start, or ends.
pub fn soak(
    folder: &Path,
    output: &Path,
    seconds: f64,
    push: bool,
    arguments: &[String],
    say: &dyn Fn(&str),
) -> Result<Soaked> {
    allow_files()?;
    let dataset = Dataset::open(folder).with_context(|| format!("{}", folder.display()))?;
    let way = Way {
        from: [0.3, 0.3],
        course_deg: 45.0,
        speed_m_s: 1500.0,
        seconds: 40.0,
        error_px: 2.0,
    };
    let script = Script::write(&dataset, way, 10.0, [1280, 720])?;
    let log = output.join("server.log");
    let server = start(folder, 4 * SESSIONS, arguments, Some(&log))?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()?;
    let (phase, watched) = watch::channel(Phase::Warming);
    let run = Run {
        url: crowd::parse(&server.url)?,
        scripts: Arc::new(vec![script]),
        push,
        lines_a_second: 10.0,
        phase: watched,
    };
    let before = Usage::of(server.id())?;
    let counts = Arc::new(Counts::default());
    let mut crowd = JoinSet::new();
    for number in 0..SESSIONS {
        crowd.spawn_on(live(run.clone(), number, counts.clone()), runtime.handle());
    }
    let reader = read_pages(run.clone(), server.url.clone())?;
    let samples = watch_server(server.id(), seconds, &counts, say)?;
    phase.send_replace(Phase::Over);
    runtime.block_on(async { while crowd.join_next().await.is_some() {} });
    // Whether it read to the end is of no account: the soak is over.
    let _ = reader.join();
    std::thread::sleep(Duration::from_secs(END_S));
    let after = Usage::of(server.id())?;
    let text = std::fs::read_to_string(&log).unwrap_or_default();
    let failures = counts.failures.lock().map(|list| list.clone());
    Ok(Soaked {
        before,
        samples,
        after,
        log_lines: text.lines().count(),
        failures: failures.unwrap_or_default(),
    })
}

/// One place for sessions: one after the other, some of which say good-bye, and some are killed.
async fn live(run: Run, number: usize, counts: Arc<Counts>) {
    let mut random = number as u64 * 0x9e37_79b9 + 1;
    let mut next = move || {
        random = random
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (random >> 33) as f64 / (1u64 << 31) as f64
    };
    let mut all_over = run.phase.clone();
    while !run.is_over() {
        let life = Duration::from_secs_f64(LIFE_S[0] + (LIFE_S[1] - LIFE_S[0]) * next().powi(2));
        let is_killed = next() < 0.5;
        let (phase, watched) = watch::channel(Phase::Warming);
        let own = Run {
            phase: watched,
            ..run.clone()
        };
        counts.opened.fetch_add(1, Ordering::Relaxed);
        let flight = crowd::flying(own, (next() * 1e3) as usize);
        tokio::pin!(flight);
        let ended = tokio::select! {
            ended = &mut flight => Some(ended),
            () = tokio::time::sleep(life) => None,
            _ = all_over.changed() => None,
        };
        let ended = match ended {
            // Dropping it closes its socket without a word.
            None if is_killed => continue,
            None => {
                phase.send_replace(Phase::Over);
                flight.await
            }
            Some(ended) => ended,
        };
        if let Err(why) = ended {
            counts.failed.fetch_add(1, Ordering::Relaxed);
            if let Ok(mut failures) = counts.failures.lock()
                && failures.len() < 8
            {
                failures.push(format!("{why:#}"));
            }
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
    }
}

/// A program that reads pages by HTTP, and comes back by a new connection now and then.
fn read_pages(run: Run, url: String) -> Result<std::thread::JoinHandle<()>> {
    let reader = move || {
        let Ok(url) = url.parse::<Url>() else { return };
        let name = url.dataset().unwrap_or_default().to_owned();
        while !run.is_over() {
            let mut connection = KeptAlive::new(&url);
            for path in ["manifest", "page/0/0/0", "page/4/1/1", "page/4/0/0"] {
                // The server may be gone; then the samples say so.
                let _ = connection.get(&format!("/{name}/{path}"));
                std::thread::sleep(Duration::from_millis(20));
            }
        }
    };
    std::thread::Builder::new()
        .name("pages".into())
        .spawn(reader)
        .context("cannot start a thread")
}

fn watch_server(
    server: u32,
    seconds: f64,
    counts: &Counts,
    say: &dyn Fn(&str),
) -> Result<Vec<Sample>> {
    let began = Instant::now();
    let mut samples: Vec<Sample> = Vec::new();
    let every = Duration::from_secs_f64((seconds / SAMPLES).max(1.0));
    while began.elapsed().as_secs_f64() < seconds {
        std::thread::sleep(every);
        let sample = Sample {
            time_s: began.elapsed().as_secs_f64(),
            usage: Usage::of(server).context("the server ended")?,
            opened: counts.opened.load(Ordering::Relaxed),
            failed: counts.failed.load(Ordering::Relaxed),
        };
        if samples.len().is_multiple_of(10) {
            say(&format!(
                "{:5.0} s: {:6.1} MiB, {} files, {} threads, {} sessions so far, {} failed",
                sample.time_s,
                sample.usage.memory_bytes as f64 / (1 << 20) as f64,
                sample.usage.files,
                sample.usage.threads,
                sample.opened,
                sample.failed
            ));
        }
        samples.push(sample);
    }
    Ok(samples)
}

/// Writes `soak.json`, `soak.csv` and a plot of memory and files.
///
/// # Errors
/// If a file cannot be written.
pub fn write(folder: &Path, soaked: &Soaked) -> Result<()> {
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        std::fs::write(&path, bytes).with_context(|| format!("cannot write {}", path.display()))
    };
    write("soak.json", &serde_json::to_vec_pretty(soaked)?)?;
    let mut table = Table::new(&[
        "s", "bytes", "files", "threads", "cpu s", "opened", "failed",
    ]);
    for sample in &soaked.samples {
        table.rows.push(vec![
            format!("{:.1}", sample.time_s),
            sample.usage.memory_bytes.to_string(),
            sample.usage.files.to_string(),
            sample.usage.threads.to_string(),
            format!("{:.2}", sample.usage.cpu_s),
            sample.opened.to_string(),
            sample.failed.to_string(),
        ]);
    }
    write("soak.csv", table.csv().as_bytes())?;
    let font = Font::load().context("the program's font is damaged")?;
    let of = |value: &dyn Fn(&Usage) -> f64| {
        let points = soaked.samples.iter();
        points
            .map(|s| [s.time_s / 60.0, value(&s.usage)])
            .collect::<Vec<_>>()
    };
    let memory = of(&|usage| usage.memory_bytes as f64 / (1 << 20) as f64);
    let files = of(&|usage| usage.files as f64);
    let values = || memory.iter().chain(&files);
    let chart = Chart {
        title: "A server while clients come and go".into(),
        x: Axis::around("minutes", Scale::Linear, values().map(|p| p[0])),
        y: Axis::around("MiB, files", Scale::Linear, values().map(|p| p[1])),
        series: vec![
            Series::new("memory of its own, MiB", 0, Style::Plain, memory.clone()),
            Series::new("open files and sockets", 1, Style::Plain, files.clone()),
        ],
        marks: Vec::new(),
    };
    let drawing = chart.draw(&font);
    write("soak.svg", svg(&drawing, Colours::Light).as_bytes())?;
    write("soak.png", &png(&drawing)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_is_that_of_the_last_third_over_the_middle_one() {
        let sample = |i: u64, memory_bytes: u64| Sample {
            time_s: i as f64,
            usage: Usage {
                memory_bytes,
                ..Usage::default()
            },
            opened: 0,
            failed: 0,
        };
        let soaked = |memory: [u64; 6]| Soaked {
            before: Usage::default(),
            samples: (0..).zip(memory).map(|(i, m)| sample(i, m)).collect(),
            after: Usage::default(),
            log_lines: 0,
            failures: Vec::new(),
        };
        assert_eq!(soaked([1, 5, 10, 10, 10, 10]).growth(), 1.0);
        assert_eq!(soaked([1, 5, 10, 10, 20, 20]).growth(), 2.0);
    }
}
