//! `escarp-tiles`: makes, describes and verifies datasets.

use clap::Parser;
use escarp_tiles::cli::{Cli, run};
use std::process::ExitCode;

/// Ends quietly when whoever reads the output has had enough, as `head` does.
fn end_with_the_reader() {
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let said = panic.payload().downcast_ref::<String>();
        if said.is_some_and(|said| said.starts_with("failed printing to stdout: Broken pipe")) {
            std::process::exit(141); // As a shell says of a program that SIGPIPE ended.
        }
        usual(panic);
    }));
}

fn main() -> ExitCode {
    end_with_the_reader();
    match run(Cli::parse()) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
