//! Progress of long work: a bar on a terminal, plain lines elsewhere, at most one in ten seconds.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::sync::Mutex;
use std::time::{Duration, Instant};

const LINE_EVERY: Duration = Duration::from_secs(10);

pub(super) struct Progress {
    what: &'static str,
    bar: Option<ProgressBar>,
    last_line: Mutex<Instant>,
}

impl Progress {
    /// `quiet` shows nothing.
    pub(super) fn new(what: &'static str, quiet: bool) -> Progress {
        let bar = std::io::stderr().is_terminal().then(|| {
            let template = format!("{what} {{bar:40}} {{percent}} %  {{elapsed}} of {{duration}}");
            let style = ProgressStyle::with_template(&template);
            ProgressBar::new(1).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
        });
        Progress {
            what,
            bar: bar.filter(|_| !quiet),
            last_line: Mutex::new(if quiet {
                Instant::now() + Duration::MAX / 4
            } else {
                Instant::now()
            }),
        }
    }

    pub(super) fn at(&self, done: u64, total: u64) {
        if let Some(bar) = &self.bar {
            bar.set_length(total);
            bar.set_position(done);
            return;
        }
        let Ok(mut last) = self.last_line.lock() else {
            return;
        };
        if Instant::now().saturating_duration_since(*last) >= LINE_EVERY {
            eprintln!("{}: {} of {total}", self.what, done);
            *last = Instant::now();
        }
    }

    pub(super) fn end(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
