//! The command line of `escarp-server`.

mod descriptors;
mod log;
mod notify;
mod probe;
mod reload;

use crate::catalog::{Catalog, CatalogError, percent_encoded};
use crate::config::{Config, ConfigError, Flags, IoChoice, Source};
use crate::serve::Serving;
use crate::tls::{Tls, TlsError};
use crate::watch::{WatchError, Watcher};
use anyhow::{Context, Result, anyhow};
use clap::error::ErrorKind;
use clap::parser::ValueSource;
use clap::{ArgMatches, CommandFactory, FromArgMatches, Parser, Subcommand};
use escarp_tiles::dataset::{DatasetError, Io};
use reload::Reload;
use std::io::Write;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::watch;

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
#[command(name = "escarp-server", version, after_help = EXAMPLES, args_conflicts_with_subcommands = true)]
pub struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    flags: Flags,
    /// Check all settings, and the files that they name, and end
    #[arg(long)]
    check_config: bool,
    /// Print all settings as a file of settings, each with where it comes from, and end
    #[arg(long)]
    print_config: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Ask a running server how it is: exit code 0 if it answers with a status of success
    Health {
        /// Such as http://127.0.0.1:8787/readyz, or https://terrain.example/readyz
        url: String,
        /// Certificates (PEM) to believe in place of the system's
        #[arg(long, value_name = "FILE")]
        ca: Option<PathBuf>,
        /// How long to wait, seconds
        #[arg(long, value_name = "SECONDS", default_value_t = 5.0)]
        timeout_s: f64,
    },
}

const EXAMPLES: &str = "\
Examples:
  escarp-server moon.escarp                             then: escarp-client view http://127.0.0.1:8787/moon
  escarp-server moon.escarp alps.escarp --listen 0.0.0.0:8787    for other machines too
  escarp-server --watch /srv/terrain                    all datasets in a folder, also later ones
  escarp-server --config server.toml --check-config     settings from a file; docs/escarp-server.toml has all
  curl http://127.0.0.1:8787/datasets                   what is hosted, as JSON

Flags go before variables of the environment, these before the file, it before defaults.
SIGTERM or Ctrl-C tells all clients, waits for them at most 5 seconds, and ends. SIGHUP reads
certificates and rules of access again.
RUST_LOG=debug shows more on standard error; RUST_LOG=warn less.

Exit codes: 0 ended by a signal, or all is well; 1 a dataset or certificate could not be opened, the
address not be taken, or the server asked is not well; 2 wrong usage or settings.";

/// Does what the command line says; for a server, until a signal ends it.
pub fn run() -> ExitCode {
    let matches = Cli::command().get_matches();
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    let done = match &cli.command {
        Some(Command::Health { url, ca, timeout_s }) => health(url, ca.as_deref(), *timeout_s),
        None => configured(cli, matches),
    };
    let Err(error) = done else {
        return ExitCode::SUCCESS;
    };
    eprintln!("error: {error:#}");
    let usage = error.is::<CatalogError>() || error.is::<ConfigError>();
    if usage {
        ExitCode::from(USAGE)
    } else {
        ExitCode::FAILURE
    }
}

fn health(url: &str, ca: Option<&Path>, timeout_s: f64) -> Result<()> {
    let within = Duration::try_from_secs_f64(timeout_s);
    let answer = probe::ask(url, ca, within.context("--timeout-s")?)?;
    println!("{answer}");
    Ok(())
}

/// Reads the settings, and does what they say.
fn configured(cli: Cli, matches: ArgMatches) -> Result<()> {
    let Cli {
        flags,
        check_config,
        print_config,
        ..
    } = cli;
    let read = move || {
        let given = |flag: &str| match matches.value_source(flag) {
            Some(ValueSource::EnvVariable) => Source::Environment,
            _ => Source::Flag,
        };
        // What is not UTF-8 is no name, and no number.
        let variables = std::env::vars_os().filter_map(|(name, value)| {
            Some((name.into_string().ok()?, value.into_string().ok()?))
        });
        Config::of(&flags, given, variables)
    };
    let config = read()?;
    if print_config {
        print!("{}", config.print());
        return Ok(());
    }
    if config.datasets.value.is_empty() && config.watch.value.is_empty() {
        let what = "no dataset to host: give folders NAME.escarp, --watch DIR, or `datasets` in \
                    the file of settings";
        Cli::command()
            .error(ErrorKind::MissingRequiredArgument, what)
            .exit();
    }
    log::start(config.log_format.value);
    if check_config {
        return check(&config);
    }
    host(config, Box::new(read))
}

/// Opens what the settings name, as a start would, but no address.
fn check(config: &Config) -> Result<()> {
    tls(config)?;
    let catalog = Arc::new(Catalog::default());
    open_all(catalog.clone(), config)?;
    println!(
        "the settings are right; datasets: {}",
        catalog.names().len()
    );
    Ok(())
}

fn tls(config: &Config) -> Result<Option<Arc<Tls>>, TlsError> {
    let load = |(cert, key)| Tls::load(cert, key).map(Arc::new);
    config.tls().map(load).transpose()
}

fn host(config: Config, read: reload::Read) -> Result<()> {
    let tls = tls(&config)?;
    let catalog = Arc::new(Catalog::default());
    let watcher = open_all(catalog.clone(), &config)?;
    descriptors::provide(&config.limits, catalog.names().len());
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .max_blocking_threads(DISK_THREADS)
        .build()
        .context("starting threads")?;
    runtime.block_on(async {
        let listener = bind(&config.listen.value, "--listen").await?;
        // Before anyone can know that the server is there, it can be told to go.
        let signal = signal()?;
        let mut serving = Serving::new(catalog.clone(), config.limits.clone())
            .with_access(config.access()?)
            .behind(config.proxies()?)
            .limiting_loopback(config.limit_loopback.value)
            .draining_after(config.drain_delay());
        if let Some(tls) = &tls {
            serving = serving.with_tls(tls.clone());
        }
        if let Some(address) = &config.metrics_listen.value {
            serving = serving.watched_at(bind(address, "--metrics-listen").await?);
        }
        let (rules, followed) = watch::channel(None);
        let address = listener.local_addr()?;
        announce(&catalog, address, tls.is_some())?;
        tokio::spawn(watcher.run());
        tokio::spawn(Reload::new(config, read, tls, rules)?.run());
        tokio::spawn(notify::watchdog());
        notify::tell("READY=1");
        let told = async {
            signal.await;
            notify::tell("STOPPING=1");
        };
        serving
            .run(listener, followed, told)
            .await
            .context("serving")
    })
}

async fn bind(address: &str, flag: &str) -> Result<TcpListener> {
    let bound = TcpListener::bind(address).await;
    bound.with_context(|| format!("listening on {address}; choose another address with {flag}"))
}

/// Opens all datasets under their names.
fn open_all(catalog: Arc<Catalog>, config: &Config) -> Result<Watcher> {
    let io = match config.io.value {
        IoChoice::Pread => Io::Pread,
        IoChoice::Mmap => Io::Mmap,
    };
    let (datasets, watch) = (&config.datasets.value, &config.watch.value);
    let started = Watcher::start(catalog, datasets, watch, io);
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
fn announce(catalog: &Catalog, address: SocketAddr, secure: bool) -> Result<()> {
    let mut out = std::io::stdout().lock();
    let scheme = if secure { "https" } else { "http" };
    let host = match address.ip() {
        // "Any address of this machine" is none to connect to.
        ip if ip.is_unspecified() => format!("127.0.0.1:{}", address.port()),
        _ => address.to_string(),
    };
    for name in catalog.names() {
        writeln!(out, "{scheme}://{host}/{}", percent_encoded(&name)).context("standard output")?;
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

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
