//! `escarp-server`: hosts datasets.

use clap::Parser;
use escarp_server::cli::{Cli, run};
use std::process::ExitCode;

fn main() -> ExitCode {
    run(&Cli::parse())
}
