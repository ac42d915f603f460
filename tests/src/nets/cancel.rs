//! How long a teleport waits behind what was asked for before it: from its View to the first chunk
//! that only the new place needs, while the queue for the old one is full.

use super::client::Sight;
use super::convergence::views;
use super::lab::{End, Lab, SERVER, beside};
use super::server::Server;
use super::shaper::Cell;
use super::talk::Talk;
use crate::report::supply::Supply;
use crate::report::tables::Table;
use crate::report::variant::Variant;
use anyhow::{Context, Result, bail, ensure};
use escarp_client::mesh::Wish;
use escarp_client::net::Url;
use escarp_proto::view::View;
use escarp_proto::wire::{ClientMessage, MAX_LIST, Scope, ServerMessage, Want};
use escarp_tiles::dataset::Dataset;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};

/// From the first View to the teleport: the queue is full then, and the line busy.
const BEFORE: Duration = Duration::from_millis(1500);
/// A teleport that has waited for so long has failed.
const PATIENCE: Duration = Duration::from_secs(60);

/// What a client shall do.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct CancelJob {
    /// The dataset's address.
    pub url: String,
    /// Where it lies: what the views need is found out from it.
    pub dataset: PathBuf,
    /// Whether the server sends unasked.
    pub push: bool,
    /// The old place and the new one.
    pub views: [Sight; 2],
}

/// What came of it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Cancelled {
    /// From the new View to the first chunk that only it needs, milliseconds.
    pub waited_ms: f64,
    /// Page bytes that came in between.
    pub stale_bytes: u64,
}

/// What a view needs, with nothing there before.
fn needs(dataset: &Dataset, view: &View) -> Result<Vec<Want>> {
    let mut supply = Supply::new(dataset, Variant::usual());
    let mut wants = Vec::new();
    supply.converge_noting(view, &mut |wishes| {
        wants.extend(wishes.iter().map(Wish::to_want));
    })?;
    Ok(wants)
}

/// Does a job.
///
/// # Errors
/// If the server cannot be reached, or nothing comes.
pub fn work(job: &CancelJob) -> Result<Cancelled> {
    let dataset = Dataset::open(&job.dataset)?;
    let views = job.views.map(View::from);
    let wants = [needs(&dataset, &views[0])?, needs(&dataset, &views[1])?];
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    runtime.block_on(teleport(job, views, wants))
}

async fn teleport(job: &CancelJob, views: [View; 2], wants: [Vec<Want>; 2]) -> Result<Cancelled> {
    let pages = |wants: &[Want]| wants.iter().map(|want| want.page).collect::<HashSet<u64>>();
    let old = pages(&wants[0]);
    let new: HashSet<u64> = pages(&wants[1]).difference(&old).copied().collect();
    ensure!(!new.is_empty(), "both places need the same pages");
    let url: Url = job.url.parse().context("the address")?;
    let mut talk = Talk::open(&url, job.push).await?;
    look(&mut talk, job, 1, views[0], &wants[0]).await?;
    let until = Instant::now() + BEFORE;
    let mut here = HashSet::new();
    while let Some(left) = until.checked_duration_since(Instant::now()) {
        if let Ok(message) = tokio::time::timeout(left, talk.hear()).await {
            if let ServerMessage::Pages(chunks) = message? {
                here.extend(chunks.iter().map(|chunk| chunk.page));
            }
            talk.grant().await?;
        }
    }
    ensure!(
        old.iter().any(|page| !here.contains(page)),
        "all had come before the teleport: the line is too fast for this"
    );
    let (since, before) = (Instant::now(), talk.received);
    if !job.push {
        let waiting: Vec<u64> = old.difference(&here).copied().collect();
        for some in waiting.chunks(MAX_LIST) {
            talk.say(&ClientMessage::Cancel(some.to_vec())).await?;
        }
    }
    look(&mut talk, job, 2, views[1], &wants[1]).await?;
    loop {
        let message = tokio::time::timeout(PATIENCE, talk.hear()).await;
        let message = message.context("nothing came for the new place")??;
        if let ServerMessage::Pages(chunks) = message
            && chunks.iter().any(|chunk| new.contains(&chunk.page))
        {
            let first = chunks
                .iter()
                .map(|chunk| chunk.bytes.len() as u64)
                .sum::<u64>();
            return Ok(Cancelled {
                waited_ms: since.elapsed().as_secs_f64() * 1e3,
                stale_bytes: talk.received - before - first,
            });
        }
        talk.grant().await?;
    }
}

async fn look(
    talk: &mut Talk,
    job: &CancelJob,
    sequence: u32,
    view: View,
    wants: &[Want],
) -> Result<()> {
    let scope = Scope::All;
    talk.say(&ClientMessage::View {
        sequence,
        view,
        scope,
    })
    .await?;
    if !job.push {
        for some in wants.chunks(MAX_LIST / 2) {
            talk.say(&ClientMessage::Want(some.to_vec())).await?;
        }
    }
    Ok(())
}

/// Teleports over some lines, each so often. Without a result where the line is too fast.
///
/// # Errors
/// What a lab needs, and what a client says that fails.
pub fn measure(
    folder: &Path,
    cells: &[Cell],
    push: bool,
    repeats: u32,
    error_px: f32,
    parameters: &[(String, String)],
) -> Result<Vec<(Cell, Vec<Cancelled>)>> {
    let dataset = Dataset::open(folder).with_context(|| format!("{}", folder.display()))?;
    let views = views(&dataset, error_px)?.map(Sight::from);
    let lab = Lab::new()?;
    lab.set_parameters(parameters)?;
    let mut command = lab.command(End::Server, &beside("escarp-server")?);
    command
        .arg(folder)
        .args(["--listen", &format!("{SERVER}:8787")]);
    let server = Server::start(command)?;
    let job = CancelJob {
        url: server.url.clone(),
        dataset: folder.to_path_buf(),
        push,
        views,
    };
    let job = serde_json::to_string(&job)?;
    let mut all = Vec::new();
    for &cell in cells {
        let once = |repeat: u32| -> Result<Cancelled> {
            lab.line.set(cell, repeat.into());
            let mut command = lab.command(End::Client, &beside("escarp-report")?);
            let output = command
                .arg("line-cancel")
                .arg(&job)
                .stdin(Stdio::null())
                .output()?;
            let said = String::from_utf8_lossy(&output.stderr);
            if !output.status.success() {
                bail!("{cell}: {}", said.trim());
            }
            Ok(serde_json::from_slice(&output.stdout)?)
        };
        all.push((cell, (0..repeats).map(once).collect::<Result<_>>()?));
    }
    Ok(all)
}

/// A row for each line.
pub fn table(all: &[(Cell, Vec<Cancelled>)]) -> Table {
    let mut table = Table::new(&[
        "RTT ms",
        "Mbit/s",
        "loss %",
        "waited ms",
        "RTTs",
        "stale kB",
    ]);
    for (cell, found) in all {
        let middle = |of: &dyn Fn(&Cancelled) -> f64| {
            super::figures::median(found.iter().map(|one| Some(of(one))))
        };
        let waited = middle(&|one| one.waited_ms).unwrap_or(f64::NAN);
        let stale = middle(&|one| one.stale_bytes as f64).unwrap_or(f64::NAN);
        table.rows.push(vec![
            cell.round_trip_ms.to_string(),
            cell.mbit_s.to_string(),
            cell.loss_percent.to_string(),
            format!("{waited:.0}"),
            match cell.round_trip_ms {
                0.0 => "-".into(),
                ms => format!("{:.1}", waited / ms),
            },
            format!("{:.0}", stale / 1e3),
        ]);
    }
    table
}
