//! `escarp-server`: hosts datasets.

use std::process::ExitCode;

fn main() -> ExitCode {
    escarp_server::cli::run()
}
