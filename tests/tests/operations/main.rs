//! The server as those who run it meet it: TLS, tokens, limits, settings, metrics, logs, signals.

mod access;
mod running;
mod tls;
mod watching;

use escarp_client::app::headless::Driver;
use escarp_client::net::{Credentials, Url};
use escarp_client::remote::RemoteTerrain;
use escarp_tests::host::{MEMORY, PATIENCE};
use escarp_tests::programs::{Desk, Ran, ServerProcess, program, run};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const TOKEN: &str = "a-token-of-some-length";

/// A server and its log.
struct Served {
    server: ServerProcess,
}

impl Served {
    /// Hosts the desk's dataset.
    fn start(desk: &Desk, arguments: &[&str]) -> Served {
        let mut command = program("escarp-server");
        command.args(arguments).arg(dataset(desk));
        Served::of(command)
    }

    fn of(mut command: Command) -> Served {
        command
            .args(["--listen", "127.0.0.1:0"])
            .env("RUST_LOG", "info");
        Served {
            server: ServerProcess::of(command, 1),
        }
    }

    fn url(&self) -> &str {
        &self.server.urls[0]
    }

    /// Host and port.
    fn address(&self) -> &str {
        let rest = self.url().split("://").nth(1).expect("a scheme");
        rest.split('/').next().expect("a host")
    }

    fn log(&self) -> String {
        self.server.log()
    }

    /// Waits until the log says something.
    fn says(&self, text: &str) {
        wait(
            || self.log().contains(text),
            || format!("no {text:?} in {}", self.log()),
        );
    }

    /// One request, and all that is answered.
    fn get(&self, path: &str, headers: &str) -> String {
        get(self.address(), path, headers)
    }
}

fn wait(mut is: impl FnMut() -> bool, why: impl Fn() -> String) {
    let began = Instant::now();
    while !is() {
        assert!(began.elapsed() < PATIENCE, "{}", why());
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn get(address: &str, path: &str, headers: &str) -> String {
    let mut stream = TcpStream::connect(address).expect("the server listens");
    let text =
        format!("GET {path} HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\n{headers}\r\n");
    stream.write_all(text.as_bytes()).unwrap();
    let mut answer = Vec::new();
    // A connection that is refused may be reset.
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8_lossy(&answer).into_owned()
}

/// The desk's dataset, made for the first who asks.
fn dataset(desk: &Desk) -> PathBuf {
    let made = desk.path("demo.escarp");
    if made.exists() { made } else { desk.dataset() }
}

/// What `--check-config` says of the desk's dataset and these settings.
fn check(desk: &Desk, arguments: &[&str]) -> Ran {
    let dataset = dataset(desk);
    let dataset = dataset.to_str().expect("UTF-8");
    run(
        "escarp-server",
        &[arguments, &["--check-config", dataset]].concat(),
    )
}

fn status(answer: &str) -> &str {
    answer.get(9..12).unwrap_or("")
}

fn header<'a>(answer: &'a str, name: &str) -> Option<&'a str> {
    let mut lines = answer.lines().map_while(|line| {
        line.split_once(": ")
            .or((!line.is_empty()).then_some((line, "")))
    });
    lines
        .find(|(found, _)| found.eq_ignore_ascii_case(name))
        .map(|(_, value)| value)
}

/// What a client is told: the dataset's name, or why not.
fn session(url: &str, token: Option<&str>, ca: Option<&Path>) -> Result<(), String> {
    let url: Url = url.parse().expect("an address");
    let token = token.map(str::to_owned);
    let credentials = Credentials::read(None, token, ca.map(Into::into)).expect("a token");
    let mut driver = Driver::new(RemoteTerrain::open(
        url.with_credentials(credentials),
        MEMORY,
    ));
    driver
        .connect(PATIENCE)
        .map(|_| ())
        .map_err(|why| why.to_string())
}

/// Checks the format (OpenMetrics 1.0) line by line, and gives the samples.
fn samples(answer: &str) -> BTreeMap<String, f64> {
    let (head, body) = answer.split_once("\r\n\r\n").expect("head and body");
    assert!(
        head.to_ascii_lowercase()
            .contains("content-type: application/openmetrics-text"),
        "{head}"
    );
    let mut found = BTreeMap::new();
    let (mut families, mut current) = (BTreeSet::new(), String::new());
    for line in body.strip_suffix("# EOF\n").expect("an end").lines() {
        if let Some(help) = line.strip_prefix("# HELP ") {
            current = help.split(' ').next().expect("a name").to_owned();
            assert!(families.insert(current.clone()), "{current} comes twice");
        } else if let Some(kind) = line.strip_prefix("# TYPE ") {
            assert_eq!(kind.split(' ').next(), Some(current.as_str()));
        } else {
            let (name, value) = line.rsplit_once(' ').expect("name and value");
            assert!(name.starts_with(&current), "{line} under {current}");
            let value = value.parse().unwrap_or_else(|_| panic!("{line}"));
            assert!(
                found.insert(name.to_owned(), value).is_none(),
                "{name} comes twice"
            );
        }
    }
    found
}
