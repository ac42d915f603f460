//! `escarp-client pull`.

use crate::net::{Credentials, TOKEN_VARIABLE, Url};
use crate::pull::{Bounds, Progress, PullOptions, pull};
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::{Duration, Instant};

#[derive(Debug, Args)]
pub(super) struct PullArgs {
    /// Address of the dataset, http://HOST:PORT/NAME, or https:// for TLS
    #[arg(value_name = "URL")]
    url: Url,
    /// Region, in metres of the world; widened to whole pages, by an eighth at most. Outside there
    /// are holes. Default: all of the data
    #[arg(long, value_name = "W,S,E,N", allow_hyphen_values = true)]
    bounds: Option<Sides>,
    /// The bounds are longitudes and latitudes, degrees
    #[arg(long, requires = "bounds")]
    lonlat: bool,
    /// How far heights may be from the server's, straight up or down, metres; 0 takes all
    #[arg(long, value_name = "M", allow_hyphen_values = true)]
    error: f64,
    /// Folder to write; it must not exist
    #[arg(short, long, value_name = "NAME.escarp")]
    output: PathBuf,
    /// File with the token that opens the dataset; without it, ESCARP_TOKEN has the token itself
    #[arg(long, value_name = "FILE")]
    token: Option<PathBuf>,
    /// Certificates (PEM) to believe in place of the system's, for a server of a private authority
    #[arg(long, value_name = "FILE")]
    ca: Option<PathBuf>,
    /// Say how many pages and bytes it would be, and write nothing
    #[arg(long)]
    dry_run: bool,
    /// Give up a server from which no page comes for so many seconds
    #[arg(long, default_value_t = 120, value_name = "S", value_parser = clap::value_parser!(u64).range(1..=86_400))]
    wait: u64,
}

/// West, south, east, north.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Sides([f64; 4]);

impl FromStr for Sides {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong =
            || format!("{text:?} are no bounds; write W,S,E,N, such as -500,1000,2500,4000");
        let numbers: Vec<f64> = text
            .split(',')
            .map(|part| part.trim().parse().map_err(|_| wrong()))
            .collect::<Result<_, _>>()?;
        numbers.try_into().map(Sides).map_err(|_| wrong())
    }
}

/// Time between two lines of progress.
const LINES: Duration = Duration::from_secs(1);

pub(super) fn run(args: PullArgs) -> Result<()> {
    let options = PullOptions {
        bounds: args.bounds.map(|Sides(sides)| Bounds {
            sides,
            is_lonlat: args.lonlat,
        }),
        error_m: args.error,
        output: args.output.clone(),
        dry_run: args.dry_run,
        patience: Duration::from_secs(args.wait),
        token: None,
    };
    let variable = std::env::var(TOKEN_VARIABLE).ok();
    let credentials = Credentials::read(args.token.as_deref(), variable, args.ca)?;
    let url = args.url.with_credentials(credentials);
    let mut last = Instant::now();
    let report = pull(&url, &options, &mut |progress: Progress| {
        if last.elapsed() >= LINES {
            last = Instant::now();
            let Progress {
                pages,
                bytes,
                tiles,
                all_tiles,
            } = progress;
            let mb = bytes as f64 / 1e6;
            eprintln!("{pages} pages, {mb:.1} MB received, {tiles} of {all_tiles} tiles done");
        }
    })?;
    let [width, height] = report.samples;
    let (pages, bytes, error_m) = (report.pages, report.bytes, report.storage_error_m);
    match args.dry_run {
        true => println!(
            "about {pages} pages, {bytes} bytes, for {width} x {height} samples within {error_m} m \
             of the sources"
        ),
        false => println!(
            "{}: {width} x {height} samples within {error_m} m of the sources, {} pages; \
             {pages} pages, {bytes} bytes received",
            args.output.display(),
            report.stored_pages
        ),
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_read_or_refused_with_the_right_form() {
        assert_eq!("-1,2,3.5,4e3".parse(), Ok(Sides([-1.0, 2.0, 3.5, 4e3])));
        for wrong in ["", "1,2,3", "1,2,3,4,5", "a,b,c,d"] {
            assert!(wrong.parse::<Sides>().unwrap_err().contains("W,S,E,N"));
        }
    }
}
