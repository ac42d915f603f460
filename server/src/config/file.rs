//! The file of settings.

use super::{ConfigError, IoChoice, LogFormat, Set, Source};
use crate::access::{Origins, Rule, Token};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use toml::{Spanned, Value};

/// Larger files are none of settings or tokens, bytes.
const MAX_BYTES: u64 = 1 << 20;

/// As it stands there.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Content {
    datasets: Option<Spanned<Vec<PathBuf>>>,
    watch: Option<Spanned<Vec<PathBuf>>>,
    io: Option<Spanned<IoChoice>>,
    listen: Option<Spanned<String>>,
    metrics_listen: Option<Spanned<String>>,
    tls_cert: Option<Spanned<PathBuf>>,
    tls_key: Option<Spanned<PathBuf>>,
    origins: Option<Spanned<Vec<String>>>,
    hosts: Option<Spanned<Vec<String>>>,
    trusted_proxies: Option<Spanned<Vec<String>>>,
    limit_loopback: Option<Spanned<bool>>,
    log_format: Option<Spanned<LogFormat>>,
    drain_delay_s: Option<Spanned<f64>>,
    #[serde(default)]
    limits: BTreeMap<String, Spanned<Value>>,
    #[serde(default)]
    access: Vec<Spanned<Ruling>>,
}

/// A rule as it stands there.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Ruling {
    datasets: String,
    tokens: Option<Vec<String>>,
    token_file: Option<PathBuf>,
    origins: Option<Vec<String>>,
}

/// The file, or one without anything in it. Paths in it are taken from its own folder.
#[derive(Debug, Default)]
pub(super) struct File {
    path: PathBuf,
    text: String,
    content: Content,
}

/// A value with its line.
type Found<T> = Option<(T, usize)>;

impl File {
    pub(super) fn read(path: &Path) -> Result<File, ConfigError> {
        let text = read(path)?;
        // The parser's message has line, column, and what was expected.
        let content = toml::from_str(&text)
            .map_err(|error| ConfigError::at(path.display(), error.to_string().trim_end()))?;
        Ok(File {
            path: path.into(),
            text,
            content,
        })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// What was given, else what the file has, else the default.
    pub(super) fn or<T>(
        &self,
        given: Option<T>,
        by: Source,
        found: Found<T>,
        default: T,
    ) -> Set<T> {
        match (given, found) {
            (Some(value), _) => Set { value, source: by },
            (None, Some((value, line))) => {
                let source = Source::File(self.path.clone(), line);
                Set { value, source }
            }
            (None, None) => Set {
                value: default,
                source: Source::Default,
            },
        }
    }

    pub(super) fn datasets(&self) -> Found<Vec<PathBuf>> {
        self.folders(&self.content.datasets)
    }

    pub(super) fn watch(&self) -> Found<Vec<PathBuf>> {
        self.folders(&self.content.watch)
    }

    fn folders(&self, field: &Option<Spanned<Vec<PathBuf>>>) -> Found<Vec<PathBuf>> {
        let (folders, line) = self.found(field)?;
        let beside = folders.iter().map(|folder| self.beside(folder));
        Some((beside.collect(), line))
    }

    pub(super) fn io(&self) -> Found<IoChoice> {
        self.found(&self.content.io)
    }

    pub(super) fn listen(&self) -> Found<String> {
        self.found(&self.content.listen)
    }

    pub(super) fn metrics_listen(&self) -> Found<Option<String>> {
        some(self.found(&self.content.metrics_listen))
    }

    pub(super) fn tls_cert(&self) -> Found<Option<PathBuf>> {
        let (path, line) = self.found(&self.content.tls_cert)?;
        Some((Some(self.beside(&path)), line))
    }

    pub(super) fn tls_key(&self) -> Found<Option<PathBuf>> {
        let (path, line) = self.found(&self.content.tls_key)?;
        Some((Some(self.beside(&path)), line))
    }

    pub(super) fn origins(&self) -> Found<Vec<String>> {
        self.found(&self.content.origins)
    }

    pub(super) fn hosts(&self) -> Found<Vec<String>> {
        self.found(&self.content.hosts)
    }

    pub(super) fn trusted_proxies(&self) -> Found<Vec<String>> {
        self.found(&self.content.trusted_proxies)
    }

    pub(super) fn limit_loopback(&self) -> Found<bool> {
        self.found(&self.content.limit_loopback)
    }

    pub(super) fn log_format(&self) -> Found<LogFormat> {
        self.found(&self.content.log_format)
    }

    pub(super) fn drain_delay_s(&self) -> Found<f64> {
        self.found(&self.content.drain_delay_s)
    }

    /// Name, value and line of each limit.
    pub(super) fn limits(&self) -> Result<Vec<(String, f64, usize)>, ConfigError> {
        let number = |(name, value): (&String, &Spanned<Value>)| {
            let line = self.line(value.span().start);
            let number = match value.get_ref() {
                Value::Integer(number) => *number as f64,
                Value::Float(number) => *number,
                other => {
                    let what = format!("{name} is a {}; allowed is a number", other.type_str());
                    return Err(self.wrong(line, what));
                }
            };
            Ok((name.clone(), number, line))
        };
        self.content.limits.iter().map(number).collect()
    }

    /// The rules, with the tokens of their files.
    pub(super) fn rules(&self) -> Result<Vec<Set<Rule>>, ConfigError> {
        let rules = self.content.access.iter().map(|ruling| {
            let line = self.line(ruling.span().start);
            let value = self.rule(ruling.get_ref(), line)?;
            let source = Source::File(self.path.clone(), line);
            Ok(Set { value, source })
        });
        rules.collect()
    }

    fn rule(&self, ruling: &Ruling, line: usize) -> Result<Rule, ConfigError> {
        let configured = |text: &String| Token::configured(text).map_err(|e| self.wrong(line, e));
        let listed = ruling
            .tokens
            .iter()
            .map(|texts| texts.iter().map(configured).collect());
        let filed = ruling
            .token_file
            .iter()
            .map(|path| tokens(&self.beside(path)));
        let lists = listed
            .chain(filed)
            .collect::<Result<Vec<Vec<Token>>, _>>()?;
        let origins = ruling.origins.as_ref().map(|texts| Origins::parse(texts));
        Ok(Rule {
            datasets: ruling.datasets.clone(),
            tokens: (!lists.is_empty()).then(|| lists.concat()),
            origins: origins
                .transpose()
                .map_err(|error| self.wrong(line, error))?,
        })
    }

    fn found<T: Clone>(&self, field: &Option<Spanned<T>>) -> Found<T> {
        let field = field.as_ref()?;
        Some((field.get_ref().clone(), self.line(field.span().start)))
    }

    fn beside(&self, path: &Path) -> PathBuf {
        self.path
            .parent()
            .map_or(path.into(), |folder| folder.join(path))
    }

    /// The line of a byte, from 1.
    fn line(&self, at: usize) -> usize {
        let before = self.text.as_bytes().iter().take(at);
        1 + before.filter(|&&byte| byte == b'\n').count()
    }

    fn wrong(&self, line: usize, what: impl std::fmt::Display) -> ConfigError {
        ConfigError::at(format!("{}:{line}", self.path.display()), what)
    }
}

fn some<T>(found: Found<T>) -> Found<Option<T>> {
    found.map(|(value, line)| (Some(value), line))
}

/// A file of tokens, one a line.
fn tokens(path: &Path) -> Result<Vec<Token>, ConfigError> {
    Token::listed(&read(path)?)
        .map_err(|(line, error)| ConfigError::at(format!("{}:{line}", path.display()), error))
}

fn read(path: &Path) -> Result<String, ConfigError> {
    let wrong = |what: String| ConfigError::at(path.display(), what);
    let found = std::fs::metadata(path).map_err(|error| wrong(error.to_string()))?;
    if !found.is_file() {
        // Reading a pipe or a device may never end.
        return Err(wrong("not a regular file".into()));
    }
    if found.len() > MAX_BYTES {
        let bytes = found.len();
        return Err(wrong(format!(
            "{bytes} bytes; at most {MAX_BYTES} are read"
        )));
    }
    std::fs::read_to_string(path).map_err(|error| wrong(error.to_string()))
}
