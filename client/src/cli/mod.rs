//! The command line of `escarp-client`.

mod arguments;
mod fly;
mod pull;
mod snapshot;
mod view;

use crate::pull::PullError;
use anyhow::Result;
use clap::{Parser, Subcommand};
use std::process::ExitCode;

/// Exit code for arguments that cannot be used, as clap's own.
const WRONG_USAGE: u8 = 2;

/// Look at terrain that an escarp-server hosts.
#[derive(Debug, Parser)]
#[command(name = "escarp-client", version, after_help = EXAMPLES)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "\
URL is http://HOST:PORT/NAME; without NAME the only dataset of the server is meant, and if it has
several they are listed. Positions are world metres: x east, y north, z up.

Examples:
  escarp-client view http://127.0.0.1:8787/moon
  escarp-client snapshot http://127.0.0.1:8787/moon -o moon.png --error-px 1
  escarp-client fly http://127.0.0.1:8787/moon --path flight.json -o frames
  escarp-client pull http://127.0.0.1:8787/moon --bounds 0,0,200000,150000 --error 10 -o local.escarp

Exit codes: 0 done; 1 failed; 2 wrong usage.";

#[derive(Debug, Subcommand)]
enum Command {
    /// Fly through a terrain in a window
    View(view::ViewArgs),
    /// Write a picture to a PNG file, once it is within the tolerance
    Snapshot(snapshot::SnapshotArgs),
    /// Take a region at a chosen error, as a dataset that escarp-server can host
    Pull(pull::PullArgs),
    /// Fly a path without a window; prints a line of JSON a frame
    Fly(fly::FlyArgs),
}

/// Runs a command.
///
/// # Errors
/// What stopped it.
pub fn run(cli: Cli) -> Result<()> {
    match cli.command {
        Command::View(args) => view::run(args),
        Command::Snapshot(args) => snapshot::run(&args),
        Command::Pull(args) => pull::run(args),
        Command::Fly(args) => fly::run(&args),
    }
}

/// How a program ends that failed so: 2 where other arguments would help, else 1.
pub fn exit_code(error: &anyhow::Error) -> ExitCode {
    match error.downcast_ref() {
        Some(PullError::Usage(_)) => ExitCode::from(WRONG_USAGE),
        _ => ExitCode::FAILURE,
    }
}
