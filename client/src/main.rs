//! `escarp-client`: views terrain that a server hosts.

use clap::Parser;
use escarp_client::cli::{Cli, exit_code, run};
use std::process::ExitCode;

fn main() -> ExitCode {
    match run(Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            exit_code(&error)
        }
    }
}
