//! The process as the system sees it, under the names that Prometheus' own libraries use. What
//! the system does not tell is left out.

use super::Registrar;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;
use std::sync::atomic::AtomicU64;
use std::time::SystemTime;

/// Memory, open files, start.
pub(super) fn registry(started: SystemTime) -> Registry {
    let mut all = Registrar(Registry::default());
    let start = started.duration_since(SystemTime::UNIX_EPOCH);
    let found = [
        (
            "process_start_time_seconds",
            "Start, seconds since 1970",
            start.ok().map(|t| t.as_secs_f64()),
        ),
        (
            "process_resident_memory_bytes",
            "Resident memory",
            status("VmRSS:").map(|kib| kib * 1024.0),
        ),
        (
            "process_virtual_memory_bytes",
            "Virtual memory",
            status("VmSize:").map(|kib| kib * 1024.0),
        ),
        ("process_threads", "Threads", status("Threads:")),
        ("process_open_fds", "Open file descriptors", open_files()),
        (
            "process_max_fds",
            "File descriptors that may be open",
            max_files(),
        ),
    ];
    for (name, help, value) in found {
        if let Some(value) = value {
            all.add(name, help, Gauge::<f64, AtomicU64>::default())
                .set(value);
        }
    }
    all.0
}

/// A number from the kernel's description of this process (proc(5), `status`).
fn status(key: &str) -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(key))?;
    line.split_whitespace().next()?.parse().ok()
}

fn open_files() -> Option<f64> {
    // The folder that is being read is open itself.
    let count = std::fs::read_dir("/proc/self/fd").ok()?.count();
    Some(count.saturating_sub(1) as f64)
}

#[cfg(unix)]
fn max_files() -> Option<f64> {
    let limit = rustix::process::getrlimit(rustix::process::Resource::Nofile);
    limit.current.map(|current| current as f64)
}

#[cfg(not(unix))]
fn max_files() -> Option<f64> {
    None
}
