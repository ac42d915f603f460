//! A generator of HTTP load: so many connections, each asking as soon as it was answered.

use std::fs;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::runtime::Builder;

/// Ticks of `/proc/PID/stat` a second (`USER_HZ`, which Linux has fixed).
const TICKS: f64 = 100.0;
/// Time before counting, in which connections open and caches warm.
const WARM_UP: Duration = Duration::from_millis(500);
/// Longest head of an answer, bytes.
const MAX_HEAD: usize = 4096;

/// An address, and how long what it gives must be.
#[derive(Debug, Clone)]
pub struct Target {
    /// The path.
    pub path: String,
    /// Bytes of the body.
    pub bytes: usize,
}

/// What was measured.
#[derive(Debug, Clone, Copy)]
pub struct Figures {
    /// Answers a second.
    pub requests_s: f64,
    /// CPU time of the server an answer, in user mode and in the kernel, microseconds.
    pub cpu_us: f64,
    /// Half of the answers took no longer, milliseconds.
    pub p50_ms: f64,
    /// 99 % took no longer.
    pub p99_ms: f64,
}

/// Asks a server for targets in turn, over so many connections, for a time.
///
/// # Errors
/// If a connection fails, or an answer is not 200 and of the right length.
pub fn load(
    address: SocketAddr,
    process: u32,
    targets: &[Target],
    connections: usize,
    time: Duration,
) -> io::Result<Figures> {
    let runtime = Builder::new_current_thread().enable_all().build()?;
    let targets: Arc<[(Vec<u8>, usize)]> = targets.iter().map(request).collect();
    runtime.block_on(async move {
        let began = Instant::now();
        let (from, to) = (began + WARM_UP, began + WARM_UP + time);
        let tasks: Vec<_> = (0..connections)
            .map(|number| {
                let first = number * targets.len() / connections;
                tokio::spawn(ask(address, targets.clone(), first, from, to))
            })
            .collect();
        tokio::time::sleep_until(from.into()).await;
        let before = cpu_seconds(process)?;
        tokio::time::sleep_until(to.into()).await;
        let cpu_s = cpu_seconds(process)? - before;
        let mut took = Vec::new();
        for task in tasks {
            took.extend(task.await.map_err(io::Error::other)??);
        }
        Ok(figures(took, cpu_s, time))
    })
}

fn figures(mut took: Vec<Duration>, cpu_s: f64, time: Duration) -> Figures {
    took.sort_unstable();
    let answers = took.len().max(1);
    let at = |share: f64| {
        let place = (share * answers as f64) as usize;
        let found = took.get(place.min(answers - 1));
        found.map_or(f64::NAN, |took| took.as_secs_f64() * 1e3)
    };
    Figures {
        requests_s: took.len() as f64 / time.as_secs_f64(),
        cpu_us: cpu_s * 1e6 / answers as f64,
        p50_ms: at(0.5),
        p99_ms: at(0.99),
    }
}

fn request(target: &Target) -> (Vec<u8>, usize) {
    let text = format!("GET {} HTTP/1.1\r\nHost: localhost\r\n\r\n", target.path);
    (text.into_bytes(), target.bytes)
}

/// Asks over one connection; gives how long each answer took that came in time.
async fn ask(
    address: SocketAddr,
    targets: Arc<[(Vec<u8>, usize)]>,
    first: usize,
    from: Instant,
    to: Instant,
) -> io::Result<Vec<Duration>> {
    let mut stream = TcpStream::connect(address).await?;
    stream.set_nodelay(true)?;
    let mut took = Vec::new();
    let mut buffer = vec![0; 64 << 10];
    for (request, bytes) in targets.iter().cycle().skip(first) {
        let began = Instant::now();
        stream.write_all(request).await?;
        answer(&mut stream, &mut buffer, *bytes).await?;
        let ended = Instant::now();
        if ended >= to {
            break;
        }
        if ended >= from {
            took.push(ended - began);
        }
    }
    Ok(took)
}

/// Reads one answer, which must be 200 and have a body of so many bytes.
async fn answer(stream: &mut TcpStream, buffer: &mut [u8], bytes: usize) -> io::Result<()> {
    let mut filled = 0;
    let head = loop {
        let found = buffer[..filled]
            .windows(4)
            .position(|four| four == b"\r\n\r\n");
        if let Some(at) = found {
            break at + 4;
        }
        if filled > MAX_HEAD {
            return Err(io::Error::other("a head without end"));
        }
        match stream.read(&mut buffer[filled..]).await? {
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            read => filled += read,
        }
    };
    check(&buffer[..head], bytes)?;
    let mut there = filled - head;
    while there < bytes {
        match stream.read(buffer).await? {
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            read => there += read,
        }
    }
    match there == bytes {
        true => Ok(()),
        false => Err(io::Error::other(format!("{there} bytes, not {bytes}"))),
    }
}

fn check(head: &[u8], bytes: usize) -> io::Result<()> {
    let text = String::from_utf8_lossy(head);
    let length = |line: &str| {
        let (name, value) = line.split_once(':')?;
        let is = name.eq_ignore_ascii_case("content-length");
        is.then(|| value.trim().parse().ok())?
    };
    let said = text.lines().find_map(length);
    match text.starts_with("HTTP/1.1 200 ") && said == Some(bytes) {
        true => Ok(()),
        false => Err(io::Error::other(format!(
            "{bytes} bytes are wanted: {text}"
        ))),
    }
}

/// CPU time that a process has taken, seconds.
fn cpu_seconds(process: u32) -> io::Result<f64> {
    let stat = fs::read_to_string(format!("/proc/{process}/stat"))?;
    // The second field, a name in brackets, may have spaces in it.
    let fields = stat.rsplit(')').next().unwrap_or_default();
    let field = |i: usize| fields.split_whitespace().nth(i)?.parse::<f64>().ok();
    let ticks = field(11).zip(field(12)).map(|(user, system)| user + system);
    ticks
        .map(|ticks| ticks / TICKS)
        .ok_or_else(|| io::Error::other(stat))
}
