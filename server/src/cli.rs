//! The command line of `escarp-server`.

use crate::catalog::{Catalog, CatalogError, percent_encoded};
use crate::limits::Limits;
use crate::serve;
use crate::watch::{WatchError, Watcher};
use anyhow::{Context, Result, anyhow};
use clap::{Parser, ValueEnum};
use escarp_tiles::dataset::{DatasetError, Io};
use std::io::{IsTerminal, Write};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use tokio::net::TcpListener;
use tracing_subscriber::EnvFilter;

/// Threads that may wait for the disk at a time.
const DISK_THREADS: usize = 32;
/// As of any other wrong usage.
const USAGE: u8 = 2;

/// Host terrain datasets: pages over HTTP, and views streamed over WebSocket.
///
/// A dataset is a folder NAME.escarp made by escarp-tiles; it is read only. When ready, the server
/// prints one URL a dataset to standard output, to give to escarp-client. A new generation of a
/// dataset is taken live when it is published.
#[derive(Debug, Parser)]
#[command(name = "escarp-server", version, after_help = EXAMPLES)]
pub struct Cli {
    /// Folders of datasets; the name of each, without .escarp, becomes its address. A folder with
    /// such in it stands for all of them, as --watch
    #[arg(required_unless_present = "watch", value_name = "NAME.escarp")]
    datasets: Vec<PathBuf>,
    /// Host all datasets NAME.escarp in this folder, those to come as well; may be given again
    #[arg(long, value_name = "DIR")]
    watch: Vec<PathBuf>,
    /// How datasets are read: pread is safe from files that are cut short or written over while
    /// the server runs; mmap shares the system's memory, and dies with such a file
    #[arg(long, value_name = "HOW", default_value = "pread")]
    io: IoChoice,
    /// Address to listen on; port 0 takes a free one. Only this machine can connect by default
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:8787")]
    listen: String,
    /// Sessions at a time; more are refused with HTTP status 503
    #[arg(long, value_name = "N", default_value_t = Limits::default().sessions)]
    max_sessions: usize,
}

/// [`Io`] on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum IoChoice {
    Pread,
    Mmap,
}

const EXAMPLES: &str = "\
Examples:
  escarp-server moon.escarp                             then: escarp-client view http://127.0.0.1:8787/moon
  escarp-server moon.escarp alps.escarp --listen 0.0.0.0:8787    for other machines too
  escarp-server --watch /srv/terrain                    all datasets in a folder, also later ones
  curl http://127.0.0.1:8787/datasets                   what is hosted, as JSON

SIGTERM or Ctrl-C tells all clients, waits for them at most 5 seconds, and ends.
RUST_LOG=debug shows more on standard error; RUST_LOG=warn less.

Exit codes: 0 ended by a signal; 1 a dataset could not be opened, or the address not be taken;
2 wrong usage.";

/// Runs the server until a signal ends it.
pub fn run(cli: &Cli) -> ExitCode {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    let colours = std::io::stderr().is_terminal();
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(colours);
    log.with_writer(std::io::stderr).init();
    match host(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            let usage = error.downcast_ref::<CatalogError>().is_some();
            if usage {
                ExitCode::from(USAGE)
            } else {
                ExitCode::FAILURE
            }
        }
    }
}

fn host(cli: &Cli) -> Result<()> {
    let catalog = Arc::new(Catalog::default());
    let watcher = open_all(catalog.clone(), cli)?;
    let limits = Limits {
        sessions: cli.max_sessions,
        ..Limits::default()
    };
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .max_blocking_threads(DISK_THREADS)
        .build()
        .context("starting threads")?;
    runtime.block_on(async {
        let listener = TcpListener::bind(&cli.listen).await.with_context(|| {
            format!(
                "listening on {}; choose another address with --listen",
                cli.listen
            )
        })?;
        // Before anyone can know that the server is there, it can be told to go.
        let signal = signal()?;
        announce(&catalog, listener.local_addr()?)?;
        tokio::spawn(watcher.run());
        serve(listener, catalog, limits, signal)
            .await
            .context("serving")
    })
}

/// Opens all datasets under their names.
fn open_all(catalog: Arc<Catalog>, cli: &Cli) -> Result<Watcher> {
    let io = match cli.io {
        IoChoice::Pread => Io::Pread,
        IoChoice::Mmap => Io::Mmap,
    };
    let started = Watcher::start(catalog, &cli.datasets, &cli.watch, io);
    started.map_err(|error| match error {
        WatchError::Dataset(error @ DatasetError::Damaged { .. }) => {
            anyhow!("{error}; restore the file, or build the dataset again")
        }
        WatchError::Catalog(error) => error.into(),
        // The other kinds say themselves what to do.
        _ => error.into(),
    })
}

/// Prints where to connect, one dataset a line.
fn announce(catalog: &Catalog, address: SocketAddr) -> Result<()> {
    let mut out = std::io::stdout().lock();
    let host = match address.ip() {
        // "Any address of this machine" is none to connect to.
        ip if ip.is_unspecified() => format!("127.0.0.1:{}", address.port()),
        _ => address.to_string(),
    };
    for name in catalog.names() {
        writeln!(out, "http://{host}/{}", percent_encoded(&name)).context("standard output")?;
    }
    out.flush().context("standard output")
}

/// Ready at the first SIGTERM or Ctrl-C from now on.
#[cfg(unix)]
fn signal() -> Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut terminate = signal(SignalKind::terminate()).context("watching for SIGTERM")?;
    let mut interrupt = signal(SignalKind::interrupt()).context("watching for Ctrl-C")?;
    Ok(async move {
        tokio::select! {
            _ = terminate.recv() => tracing::info!("SIGTERM: going down"),
            _ = interrupt.recv() => tracing::info!("Ctrl-C: going down"),
        }
    })
}

/// Ready at Ctrl-C.
#[cfg(not(unix))]
fn signal() -> Result<impl Future<Output = ()>> {
    Ok(async {
        // Without a way to be told, only the end of the process ends the server.
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
