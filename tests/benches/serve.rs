//! What an answer over HTTP costs the server, beside nginx that sends files of the same bytes.
//!
//! `cargo bench -p escarp-tests --bench serve -- DATASET [--seconds N] [--server PROGRAM]...`
//!
//! Server and nginx run on the first core with one worker, this program on the second. In each of
//! three rounds every server answers for `N` (2) seconds over 64 and over 1000 connections; medians
//! are printed. `--server` may be given again, with options after a comma, to compare builds and
//! ways of reading: `--server target/release/escarp-server,--io=mmap`.

use escarp_proto::geometry::PageId;
use escarp_server::PageSource;
use escarp_tests::load::{Figures, Target, load};
use escarp_tests::nginx::Nginx;
use escarp_tests::programs::program;
use escarp_tiles::dataset::Dataset;
use std::fs;
use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::time::Duration;

const ROUNDS: usize = 3;
const CONNECTIONS: [usize; 2] = [64, 1000];
/// Addresses that are asked for in turn, at most.
const TARGETS: usize = 2000;
/// Packs of about 20 kB.
const PACK_BYTES: std::ops::Range<usize> = 17_000..23_000;
/// The first core is the server's, the second ours.
const CORES: [&str; 2] = ["0", "1"];

struct Args {
    dataset: PathBuf,
    time: Duration,
    servers: Vec<String>,
}

/// A program that answers.
struct Server {
    name: String,
    address: SocketAddr,
    process: u32,
    /// Before the path of a page or pack.
    base: String,
    _running: Running,
}

enum Running {
    Nginx { _nginx: Nginx },
    Ours { child: Child },
}

impl Drop for Running {
    fn drop(&mut self) {
        if let Running::Ours { child } = self {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

fn main() -> ExitCode {
    // `cargo test --benches` runs it without arguments.
    let Some(args) = arguments() else {
        eprintln!("usage: serve DATASET [--seconds N] [--server PROGRAM[,OPTION]]...");
        return ExitCode::SUCCESS;
    };
    match run(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn arguments() -> Option<Args> {
    let mut words = std::env::args().skip(1).filter(|word| word != "--bench");
    let mut args = Args {
        dataset: PathBuf::new(),
        time: Duration::from_secs(2),
        servers: Vec::new(),
    };
    while let Some(word) = words.next() {
        match word.as_str() {
            "--seconds" => args.time = Duration::from_secs(words.next()?.parse().ok()?),
            "--server" => args.servers.push(words.next()?),
            _ => args.dataset = word.into(),
        }
    }
    args.dataset.is_dir().then_some(args)
}

fn run(args: &Args) -> Result<(), Box<dyn std::error::Error>> {
    let dataset = Dataset::open(&args.dataset)?;
    let kinds = [("page", pages(&dataset)), ("pack", packs(&dataset))];
    pin_self();
    let mut servers = Vec::new();
    if Nginx::is_installed() {
        servers.push(nginx(&dataset, &kinds)?);
    }
    for server in &args.servers {
        servers.push(ours(server, &args.dataset, &dataset)?);
    }
    if args.servers.is_empty() {
        let own = program("escarp-server");
        let own = own.get_program().to_string_lossy();
        servers.push(ours(&own, &args.dataset, &dataset)?);
    }
    for (kind, targets) in &kinds {
        let mean = targets.iter().map(|(_, bytes)| bytes.len()).sum::<usize>() / targets.len();
        for connections in CONNECTIONS {
            println!("\n{kind}s of {mean} bytes, {connections} connections");
            println!("  CPU us   requests/s   p50 ms   p99 ms");
            let mut found = vec![Vec::new(); servers.len()];
            for _ in 0..ROUNDS {
                for (server, found) in servers.iter().zip(&mut found) {
                    let at = |(path, bytes): &(String, Vec<u8>)| Target {
                        path: format!("{}/{path}", server.base),
                        bytes: bytes.len(),
                    };
                    let targets: Vec<Target> = targets.iter().map(at).collect();
                    let (address, process) = (server.address, server.process);
                    found.push(load(address, process, &targets, connections, args.time)?);
                }
            }
            for (server, found) in servers.iter().zip(&mut found) {
                print_line(&server.name, found);
            }
        }
    }
    Ok(())
}

fn print_line(name: &str, found: &[Figures]) {
    let median = |of: fn(&Figures) -> f64| {
        let mut all: Vec<f64> = found.iter().map(of).collect();
        all.sort_by(f64::total_cmp);
        all[all.len() / 2]
    };
    println!(
        "{:8.1} {:12.0} {:8.2} {:8.2}   {name}",
        median(|f| f.cpu_us),
        median(|f| f.requests_s),
        median(|f| f.p50_ms),
        median(|f| f.p99_ms)
    );
}

/// Pages, and their records.
fn pages(dataset: &Dataset) -> Vec<(String, Vec<u8>)> {
    let all = ids(dataset).filter_map(|page| {
        let record = dataset.record(page).ok()??;
        Some((address("page", page), record.bytes.to_vec()))
    });
    thinned(all.collect())
}

/// Pages, and the families below them.
fn packs(dataset: &Dataset) -> Vec<(String, Vec<u8>)> {
    let all = ids(dataset).filter_map(|page| {
        let pack = dataset.pack(page).ok()??;
        Some((address("pack", page), pack.bytes.to_vec()))
    });
    let all: Vec<_> = all.collect();
    let fits = |(_, bytes): &&(String, Vec<u8>)| PACK_BYTES.contains(&bytes.len());
    match all.iter().filter(fits).count() {
        0 => thinned(all),
        _ => thinned(all.iter().filter(fits).cloned().collect()),
    }
}

/// Evenly chosen, at most [`TARGETS`].
fn thinned(all: Vec<(String, Vec<u8>)>) -> Vec<(String, Vec<u8>)> {
    let step = all.len().div_ceil(TARGETS).max(1);
    all.into_iter().step_by(step).collect()
}

/// The pages with a record.
fn ids(dataset: &Dataset) -> impl Iterator<Item = PageId> + '_ {
    let families = dataset.families();
    families.flat_map(|entry| {
        let table = dataset.family(&entry).ok();
        let records: Vec<_> = table.iter().flat_map(|table| table.records()).collect();
        records
            .into_iter()
            .filter_map(|record| Some(record.ok()?.page))
    })
}

fn address(kind: &str, page: PageId) -> String {
    let square = page.square();
    format!("{kind}/{}/{}/{}", page.level(), square.x, square.y)
}

/// Addresses, and the bytes that each gives.
type Answers = Vec<(String, Vec<u8>)>;

/// nginx, with a file for each address.
fn nginx(
    dataset: &Dataset,
    kinds: &[(&str, Answers)],
) -> Result<Server, Box<dyn std::error::Error>> {
    let base = format!("/{}/{}", dataset.name(), dataset.generation_id());
    let nginx = Nginx::start(&["taskset", "-c", CORES[0]], |port, folder| {
        format!(
            "sendfile on; tcp_nopush on; keepalive_requests 1000000000; keepalive_timeout 600s;\n\
             open_file_cache max=20000 inactive=600s; open_file_cache_valid 600s;\n\
             server {{ listen 127.0.0.1:{port} backlog=4096; location / {{ root {}/root; \
             default_type application/octet-stream; }} }}",
            folder.display()
        )
    });
    let root = nginx.folder().join("root");
    for (path, bytes) in kinds.iter().flat_map(|(_, targets)| targets) {
        let file = root.join(format!("{}/{path}", &base[1..]));
        fs::create_dir_all(file.parent().unwrap_or(&root))?;
        fs::write(file, bytes)?;
    }
    Ok(Server {
        name: "nginx, sendfile".into(),
        address: ([127, 0, 0, 1], nginx.port()).into(),
        process: nginx.worker(),
        base,
        _running: Running::Nginx { _nginx: nginx },
    })
}

/// escarp-server, from a program and options after commas.
fn ours(words: &str, path: &Path, dataset: &Dataset) -> Result<Server, Box<dyn std::error::Error>> {
    let mut child = Command::new("taskset")
        .args(["-c", CORES[0]])
        .args(words.split(','))
        .args(["--listen", "127.0.0.1:0"])
        .arg(path)
        .env("RUST_LOG", "warn")
        .stdout(Stdio::piped())
        .spawn()?;
    let mut line = String::new();
    let out = child.stdout.take().ok_or("no output")?;
    let process = child.id();
    let running = Running::Ours { child };
    BufReader::new(out).read_line(&mut line)?;
    let address = line
        .trim()
        .strip_prefix("http://")
        .and_then(|rest| rest.split('/').next());
    Ok(Server {
        name: words.into(),
        address: address.ok_or("no address")?.parse()?,
        process,
        base: format!("/{}/{}", dataset.name(), dataset.generation_id()),
        _running: running,
    })
}

/// Leaves the first core to the servers.
fn pin_self() {
    let id = std::process::id().to_string();
    // Where it fails, the figures are only less steady.
    let _ = Command::new("taskset")
        .args(["-cp", CORES[1], &id])
        .stdout(Stdio::null())
        .status();
}
