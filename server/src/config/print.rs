//! The settings that hold, as a file that could be read again; tokens are counted, not shown.

use super::{Config, IoChoice, LogFormat, Set, Source};
use crate::access::{Origins, Rule};
use crate::limits::ENTRIES;
use std::fmt::Write;
use std::path::PathBuf;

/// Where the notes begin.
const COLUMN: usize = 44;

/// One setting.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Line {
    /// Its name, after `limits.` for a limit.
    pub name: String,
    /// Its value as in a file; `None` if it has none.
    pub value: Option<String>,
    /// Where the value comes from.
    pub source: Source,
}

impl Config {
    /// Every setting but the rules of access.
    pub fn lines(&self) -> Vec<Line> {
        let paths = |paths: &Vec<PathBuf>| {
            let shown = paths.iter().map(|path| path.display().to_string());
            Some(list(&shown.collect::<Vec<_>>()))
        };
        let path =
            |path: &Option<PathBuf>| path.as_ref().map(|path| text(&path.display().to_string()));
        let format = |format: &LogFormat| match format {
            LogFormat::Text => Some(text("text")),
            LogFormat::Json => Some(text("json")),
        };
        let io = |io: &IoChoice| match io {
            IoChoice::Pread => Some(text("pread")),
            IoChoice::Mmap => Some(text("mmap")),
        };
        let mut lines = vec![
            line("datasets", &self.datasets, paths),
            line("watch", &self.watch, paths),
            line("io", &self.io, io),
            line("listen", &self.listen, |value| Some(text(value))),
            line("metrics_listen", &self.metrics_listen, |value| {
                value.as_deref().map(text)
            }),
            line("tls_cert", &self.tls_cert, path),
            line("tls_key", &self.tls_key, path),
            line("origins", &self.origins, |value| Some(list(value))),
            line("hosts", &self.hosts, |value| Some(list(value))),
            line("trusted_proxies", &self.trusted_proxies, |value| {
                Some(list(value))
            }),
            line("limit_loopback", &self.limit_loopback, |value| {
                Some(value.to_string())
            }),
            line("log_format", &self.log_format, format),
            line("drain_delay_s", &self.drain_delay_s, |value| {
                Some(value.to_string())
            }),
        ];
        lines.extend(ENTRIES.iter().map(|entry| {
            Line {
                name: format!("limits.{}", entry.name),
                value: Some(entry.get(&self.limits).to_string()),
                source: self
                    .limit_sources
                    .get(entry.name)
                    .cloned()
                    .unwrap_or(Source::Default),
            }
        }));
        lines
    }

    /// The names of settings that another configuration has otherwise; of rules, too.
    pub fn changes(&self, other: &Config) -> Vec<String> {
        let pairs = self.lines().into_iter().zip(other.lines());
        let changed = pairs.filter(|(old, new)| old.value != new.value);
        changed.map(|(old, _)| old.name).collect()
    }

    /// All as text.
    pub fn print(&self) -> String {
        let mut out = String::new();
        let mut in_limits = false;
        for line in self.lines() {
            let name = line.name.strip_prefix("limits.");
            if name.is_some() && !std::mem::replace(&mut in_limits, true) {
                out += "\n[limits]\n";
            }
            let name = name.unwrap_or(&line.name);
            let setting = match line.value {
                Some(value) => format!("{name} = {value}"),
                None => format!("# {name} is not set"),
            };
            // Writing to text cannot fail.
            let _ = writeln!(out, "{setting:COLUMN$} # {}", line.source);
        }
        for Set { value, source } in &self.rules {
            let _ = write!(out, "\n[[access]] # {source}\n{}", rule(value));
        }
        out
    }
}

fn line<T>(name: &str, set: &Set<T>, show: impl Fn(&T) -> Option<String>) -> Line {
    Line {
        name: name.into(),
        value: show(&set.value),
        source: set.source.clone(),
    }
}

fn rule(rule: &Rule) -> String {
    let mut out = format!("datasets = {}\n", text(&rule.datasets));
    if let Some(tokens) = &rule.tokens {
        out += &format!("# {} tokens, not shown\n", tokens.len());
    }
    match &rule.origins {
        None => {}
        Some(Origins::Any) => out += "origins = [\"*\"]\n",
        Some(Origins::List(origins)) => out += &format!("origins = {}\n", list(origins)),
    }
    out
}

/// A JSON string is one of TOML, too.
fn text(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

fn list(texts: &[String]) -> String {
    let shown: Vec<_> = texts.iter().map(|one| text(one)).collect();
    format!("[{}]", shown.join(", "))
}
