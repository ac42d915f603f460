//! What the server is told: by flags, else by the environment, else by one file, else by default.

mod file;
mod print;

#[cfg(test)]
mod tests;

use crate::access::{Access, Hosts, Origins, Proxies, Rule};
use crate::limits::{Entry, Limits};
use clap::{Args, ValueEnum};
use std::collections::BTreeMap;
use std::fmt;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;
use thiserror::Error;

/// Before the name of a limit, in capitals, in the environment.
const LIMIT_VARIABLE: &str = "ESCARP_LIMIT_";
/// Longest delay before sessions are told to go, seconds.
const MAX_DRAIN_DELAY_S: f64 = 3600.0;

/// What can be told on the command line, and by variables of the environment.
#[derive(Debug, Clone, Default, Args)]
pub struct Flags {
    /// Folders of datasets; the name of each, without .escarp, becomes its address
    #[arg(
        value_name = "NAME.escarp",
        env = "ESCARP_DATASETS",
        value_delimiter = ':'
    )]
    pub datasets: Vec<PathBuf>,
    /// Host all datasets NAME.escarp in this folder, those to come as well; may be given again
    /// [env: ESCARP_WATCH, separated by colons]
    #[arg(long, value_name = "DIR")]
    pub watch: Vec<PathBuf>,
    /// How datasets are read: pread is safe from files that are cut short or written over while
    /// the server runs; mmap shares the system's memory, and dies with such a file
    /// [default: pread]
    #[arg(long, value_name = "HOW", env = "ESCARP_IO")]
    pub io: Option<IoChoice>,
    /// File with settings (TOML), for what neither flags nor environment say
    #[arg(long, value_name = "FILE", env = "ESCARP_CONFIG")]
    pub config: Option<PathBuf>,
    /// Address to listen on; port 0 takes a free one. Only this machine can connect by default
    /// [default: 127.0.0.1:8787]
    #[arg(long, value_name = "HOST:PORT", env = "ESCARP_LISTEN")]
    pub listen: Option<String>,
    /// Address for /metrics, /healthz and /readyz alone, in plain HTTP [default: with the others]
    #[arg(long, value_name = "HOST:PORT", env = "ESCARP_METRICS_LISTEN")]
    pub metrics_listen: Option<String>,
    /// Chain of certificates (PEM), the server's own first: TLS only. Read again on SIGHUP, and
    /// when it changes
    #[arg(long, value_name = "FILE", env = "ESCARP_TLS_CERT")]
    pub tls_cert: Option<PathBuf>,
    /// The certificate's private key (PEM)
    #[arg(long, value_name = "FILE", env = "ESCARP_TLS_KEY")]
    pub tls_key: Option<PathBuf>,
    /// Web pages that may use datasets without tokens, as https://map.example, or `*`; may be
    /// given again [default: *]
    #[arg(
        long,
        value_name = "ORIGIN",
        env = "ESCARP_ORIGINS",
        value_delimiter = ','
    )]
    pub origin: Vec<String>,
    /// Name by which the server may be addressed, or `*`; may be given again [default: any; on
    /// loopback and without a trusted proxy, localhost alone]
    #[arg(long, value_name = "NAME", env = "ESCARP_HOSTS", value_delimiter = ',')]
    pub host: Vec<String>,
    /// Proxy whose X-Forwarded-For is believed, an address or network; may be given again
    #[arg(
        long,
        value_name = "IP",
        env = "ESCARP_TRUSTED_PROXIES",
        value_delimiter = ','
    )]
    pub trusted_proxy: Vec<String>,
    /// Whether the limits for one address hold for this machine itself [default: false]
    #[arg(long, value_name = "BOOL", env = "ESCARP_LIMIT_LOOPBACK", num_args = 0..=1, default_missing_value = "true")]
    pub limit_loopback: Option<bool>,
    /// How the log is written [default: text]
    #[arg(long, value_name = "FORMAT", env = "ESCARP_LOG_FORMAT")]
    pub log_format: Option<LogFormat>,
    /// After the signal to go, seconds in which /readyz says so, and all else goes on [default: 0]
    #[arg(long, value_name = "SECONDS", env = "ESCARP_DRAIN_DELAY_S")]
    pub drain_delay_s: Option<f64>,
    /// Any limit; --print-config lists them. In the environment: ESCARP_LIMIT_NAME
    #[arg(long, value_name = "NAME=VALUE")]
    pub limit: Vec<String>,
    /// Sessions at a time; more are refused with HTTP status 503. As --limit sessions=N
    #[arg(long, value_name = "N")]
    pub max_sessions: Option<usize>,
}

/// How datasets are read.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum IoChoice {
    /// By reading.
    #[default]
    Pread,
    /// By mapping.
    Mmap,
}

/// How the log is written.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    /// Lines for people.
    #[default]
    Text,
    /// An object a line.
    Json,
}

/// Where a value comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Source {
    /// Nobody said anything.
    Default,
    /// The file, and the line in it, from 1.
    File(PathBuf, usize),
    /// The environment.
    Environment,
    /// The command line.
    Flag,
}

/// A value, and where it comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Set<T> {
    /// The value.
    pub value: T,
    /// Where it comes from.
    pub source: Source,
}

/// What holds.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// Folders of datasets.
    pub datasets: Set<Vec<PathBuf>>,
    /// Folders whose datasets come and go.
    pub watch: Set<Vec<PathBuf>>,
    /// How datasets are read.
    pub io: Set<IoChoice>,
    /// Address to listen on.
    pub listen: Set<String>,
    /// Address for those who watch.
    pub metrics_listen: Set<Option<String>>,
    /// Chain of certificates.
    pub tls_cert: Set<Option<PathBuf>>,
    /// Private key.
    pub tls_key: Set<Option<PathBuf>>,
    /// Web pages that may use what needs no token.
    pub origins: Set<Vec<String>>,
    /// Names by which the server may be addressed; see [`Config::hosts`].
    pub hosts: Set<Vec<String>>,
    /// Proxies that are believed.
    pub trusted_proxies: Set<Vec<String>>,
    /// Whether limits for one address hold for loopback.
    pub limit_loopback: Set<bool>,
    /// How the log is written.
    pub log_format: Set<LogFormat>,
    /// From the signal to go to going.
    pub drain_delay_s: Set<f64>,
    /// Every limit.
    pub limits: Limits,
    /// Where those limits come from that are not by default, by name.
    limit_sources: BTreeMap<&'static str, Source>,
    /// Rules of access, from the file alone, and the lines where they begin.
    pub rules: Vec<Set<Rule>>,
}

/// What cannot be: where it was said, what was found, and what is allowed.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{place}: {what}")]
pub struct ConfigError {
    place: String,
    what: String,
}

impl ConfigError {
    fn at(place: impl fmt::Display, what: impl fmt::Display) -> ConfigError {
        ConfigError {
            place: place.to_string(),
            what: what.to_string(),
        }
    }
}

impl Config {
    /// Puts together what flags and environment say (`given`: which of them it was, by the flag's
    /// name), the rest of the environment, and the file that they name.
    ///
    /// # Errors
    /// [`ConfigError`] for the first value that cannot be.
    pub fn of(
        flags: &Flags,
        given: impl Fn(&str) -> Source,
        environment: impl Iterator<Item = (String, String)>,
    ) -> Result<Config, ConfigError> {
        let environment: BTreeMap<String, String> = environment.collect();
        let file = match &flags.config {
            Some(path) => file::File::read(path)?,
            None => file::File::default(),
        };
        let list = |id: &str, flag: &[String], in_file, default: &[&str]| {
            let flag = (!flag.is_empty()).then(|| flag.to_vec());
            let default = default.iter().map(ToString::to_string).collect();
            file.or(flag, given(id), in_file, default)
        };
        // Not by the parser: it would take folders with a colon apart on the command line, too.
        let folders = |variable: &str, flag: &[PathBuf], in_file| {
            let named = environment.get(variable).filter(|all| !all.is_empty());
            let (given, by) = match named {
                _ if !flag.is_empty() => (Some(flag.to_vec()), Source::Flag),
                Some(all) => (
                    Some(std::env::split_paths(all).collect()),
                    Source::Environment,
                ),
                None => (None, Source::Default),
            };
            file.or(given, by, in_file, Vec::new())
        };
        let path = |id, flag: &Option<PathBuf>, in_file| {
            file.or(flag.clone().map(Some), given(id), in_file, None)
        };
        let metrics_listen = flags.metrics_listen.clone().map(Some);
        let mut config = Config {
            datasets: folders("ESCARP_DATASETS", &flags.datasets, file.datasets()),
            watch: folders("ESCARP_WATCH", &flags.watch, file.watch()),
            io: file.or(flags.io, given("io"), file.io(), IoChoice::Pread),
            listen: file.or(
                flags.listen.clone(),
                given("listen"),
                file.listen(),
                "127.0.0.1:8787".into(),
            ),
            metrics_listen: file.or(
                metrics_listen,
                given("metrics_listen"),
                file.metrics_listen(),
                None,
            ),
            tls_cert: path("tls_cert", &flags.tls_cert, file.tls_cert()),
            tls_key: path("tls_key", &flags.tls_key, file.tls_key()),
            origins: list("origin", &flags.origin, file.origins(), &["*"]),
            hosts: list("host", &flags.host, file.hosts(), &[]),
            trusted_proxies: list(
                "trusted_proxy",
                &flags.trusted_proxy,
                file.trusted_proxies(),
                &[],
            ),
            limit_loopback: file.or(
                flags.limit_loopback,
                given("limit_loopback"),
                file.limit_loopback(),
                false,
            ),
            log_format: file.or(
                flags.log_format,
                given("log_format"),
                file.log_format(),
                LogFormat::Text,
            ),
            drain_delay_s: file.or(
                flags.drain_delay_s,
                given("drain_delay_s"),
                file.drain_delay_s(),
                0.0,
            ),
            limits: Limits::default(),
            limit_sources: BTreeMap::new(),
            rules: file.rules()?,
        };
        for (name, value, line) in file.limits()? {
            config.set_limit(&name, value, Source::File(file.path().into(), line))?;
        }
        for (name, text) in environment
            .iter()
            .filter(|(name, _)| *name != "ESCARP_LIMIT_LOOPBACK")
        {
            if let Some(limit) = name.strip_prefix(LIMIT_VARIABLE) {
                let value = number(text)
                    .ok_or_else(|| ConfigError::at(name, format!("{text:?} is no number")))?;
                config.set_limit(&limit.to_ascii_lowercase(), value, Source::Environment)?;
            }
        }
        config.set_by_flags(flags)?;
        config.check()?;
        Ok(config)
    }

    fn set_by_flags(&mut self, flags: &Flags) -> Result<(), ConfigError> {
        if let Some(sessions) = flags.max_sessions {
            self.set_limit("sessions", sessions as f64, Source::Flag)?;
        }
        for text in &flags.limit {
            let parts = text
                .split_once('=')
                .and_then(|(name, value)| Some((name, number(value)?)));
            let (name, value) = parts.ok_or_else(|| {
                ConfigError::at(
                    "--limit",
                    format!("{text:?} is not NAME=VALUE with a number"),
                )
            })?;
            self.set_limit(name, value, Source::Flag)?;
        }
        Ok(())
    }

    fn set_limit(&mut self, name: &str, value: f64, source: Source) -> Result<(), ConfigError> {
        let place = match &source {
            Source::Flag => "--limit".into(),
            Source::Environment => format!("{LIMIT_VARIABLE}{}", name.to_ascii_uppercase()),
            other => other.to_string(),
        };
        let entry = Entry::named(name).ok_or_else(|| {
            let names: Vec<_> = crate::limits::ENTRIES
                .iter()
                .map(|entry| entry.name)
                .collect();
            let what = format!("there is no limit {name:?}; there are {}", names.join(", "));
            ConfigError::at(&place, what)
        })?;
        entry
            .set(&mut self.limits, value)
            .map_err(|what| ConfigError::at(&place, what))?;
        self.limit_sources.insert(entry.name, source);
        Ok(())
    }

    /// What is wrong in itself, or with something else.
    fn check(&self) -> Result<(), ConfigError> {
        Origins::parse(&self.origins.value)
            .map_err(|error| self.origins.wrong("origins", error))?;
        self.proxies()?;
        self.hosts()?;
        self.check_listen()?;
        let delay = self.drain_delay_s.value;
        if !(0.0..=MAX_DRAIN_DELAY_S).contains(&delay) {
            let what = format!("{delay}; allowed are seconds from 0 to {MAX_DRAIN_DELAY_S}");
            return Err(self.drain_delay_s.wrong("drain_delay_s", what));
        }
        if self.limits.ping_interval >= self.limits.idle_timeout {
            let what =
                "idle_timeout_s must be longer than ping_interval_s: an idle client answers pings";
            return Err(ConfigError::at("limits", what));
        }
        match (&self.tls_cert.value, &self.tls_key.value) {
            (Some(_), None) => Err(self
                .tls_cert
                .wrong("tls_cert", "without tls_key; give both")),
            (None, Some(_)) => Err(self.tls_key.wrong("tls_key", "without tls_cert; give both")),
            _ => Ok(()),
        }
    }

    /// Addresses are only looked at: whether they can be taken shows when they are.
    fn check_listen(&self) -> Result<(), ConfigError> {
        let (listen, watchers) = (&self.listen, &self.metrics_listen);
        if let Err(what) = port(&listen.value) {
            return Err(listen.wrong("listen", what));
        }
        let Some(address) = &watchers.value else {
            return Ok(());
        };
        match port(address) {
            Err(what) => Err(watchers.wrong("metrics_listen", what)),
            Ok(port) if port != 0 && *address == listen.value => {
                let what = format!("{address}, which is that of `listen`, too; give another one");
                Err(watchers.wrong("metrics_listen", what))
            }
            Ok(_) => Ok(()),
        }
    }

    /// Certificates and key, if there shall be TLS.
    pub fn tls(&self) -> Option<(&Path, &Path)> {
        Some((
            self.tls_cert.value.as_deref()?,
            self.tls_key.value.as_deref()?,
        ))
    }

    /// The rules that hold.
    ///
    /// # Errors
    /// If an origin is none.
    pub fn access(&self) -> Result<Access, ConfigError> {
        let origins = Origins::parse(&self.origins.value);
        Ok(Access {
            rules: self.rules.iter().map(|rule| rule.value.clone()).collect(),
            origins: origins.map_err(|error| self.origins.wrong("origins", error))?,
            hosts: self.hosts()?,
        })
    }

    /// The names by which the server may be addressed. Unless something is said: any; but where
    /// only this machine can connect, and no proxy speaks for others, what leads to it for sure.
    ///
    /// # Errors
    /// If one is no name.
    pub fn hosts(&self) -> Result<Hosts, ConfigError> {
        let named = &self.hosts.value;
        let alone = is_loopback(&self.listen.value) && self.trusted_proxies.value.is_empty();
        match (named.is_empty(), alone) {
            (true, true) => Ok(Hosts::local()),
            (true, false) => Ok(Hosts::Any),
            _ => Hosts::parse(named).map_err(|error| self.hosts.wrong("hosts", error)),
        }
    }

    /// The proxies that are believed.
    ///
    /// # Errors
    /// If one is no address.
    pub fn proxies(&self) -> Result<Proxies, ConfigError> {
        let proxies = Proxies::parse(&self.trusted_proxies.value);
        proxies.map_err(|error| self.trusted_proxies.wrong("trusted_proxies", error))
    }

    /// From the signal to go to going.
    pub fn drain_delay(&self) -> Duration {
        Duration::try_from_secs_f64(self.drain_delay_s.value).unwrap_or_default()
    }
}

impl<T> Set<T> {
    fn wrong(&self, name: &str, what: impl fmt::Display) -> ConfigError {
        ConfigError::at(format!("{name} ({})", self.source), what)
    }
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Source::Default => f.write_str("default"),
            Source::File(path, line) => write!(f, "{}:{line}", path.display()),
            Source::Environment => f.write_str("environment"),
            Source::Flag => f.write_str("command line"),
        }
    }
}

/// The port of an address to listen on, or what is wrong with it.
fn port(address: &str) -> Result<u16, String> {
    let found = address.rsplit_once(':');
    let port = found.and_then(|(host, port)| port.parse().ok().filter(|_| !host.is_empty()));
    port.ok_or_else(|| {
        format!("{address:?}; allowed is HOST:PORT, such as 127.0.0.1:8787 or [::]:8787")
    })
}

fn is_loopback(address: &str) -> bool {
    let ip = address.parse().map(|address: SocketAddr| address.ip());
    ip.map_or_else(
        |_| address.starts_with("localhost:"),
        |ip| ip.to_canonical().is_loopback(),
    )
}

fn number(text: &str) -> Option<f64> {
    text.trim()
        .parse()
        .ok()
        .filter(|value: &f64| value.is_finite())
}
