//! File descriptors: as many as connections and sessions may need.

use crate::limits::Limits;

/// Standard streams, listeners, the runtime's own, files that are read for a moment.
const OTHERS: u64 = 128;
/// Index, segments and what is open in a moment, of one dataset.
const DATASET: u64 = 16;

/// How many may be needed.
fn needed(limits: &Limits, datasets: usize) -> u64 {
    let peers = limits.connections.saturating_add(limits.sessions) as u64;
    let files = DATASET.saturating_mul(datasets as u64);
    peers.saturating_add(files).saturating_add(OTHERS)
}

/// Raises the soft limit to what may be needed; says so if the hard limit does not allow it.
#[cfg(unix)]
pub(super) fn provide(limits: &Limits, datasets: usize) {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let needed = needed(limits, datasets);
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    if current.is_none_or(|current| current >= needed) {
        return;
    }
    let raised = maximum.map_or(needed, |maximum| needed.min(maximum));
    let new = Rlimit {
        current: Some(raised),
        maximum,
    };
    let have = match setrlimit(Resource::Nofile, new) {
        Ok(()) => raised,
        Err(_) => current.unwrap_or(raised),
    };
    if have < needed {
        tracing::warn!(
            allowed = have,
            needed,
            connections = limits.connections,
            sessions = limits.sessions,
            "too few file descriptors for so many connections and sessions: raise the hard limit \
             (ulimit -Hn, LimitNOFILE=), or lower these limits; until then some will have to wait"
        );
    }
}

#[cfg(not(unix))]
pub(super) fn provide(_limits: &Limits, _datasets: usize) {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_connections_sessions_and_datasets_are_counted() {
        let limits = Limits {
            connections: 100,
            sessions: 50,
            ..Limits::default()
        };
        assert_eq!(needed(&limits, 2), 150 + 32 + OTHERS);
        let most = Limits {
            connections: usize::MAX,
            ..limits
        };
        assert_eq!(needed(&most, 2), u64::MAX);
    }
}
