//! CPU time of this process.

use std::time::Duration;

/// What the times of a report are.
pub const KIND: &str = if cfg!(unix) {
    "CPU time of all threads of the process"
} else {
    "time as it passes"
};

/// CPU time that the whole process has used so far; elsewhere than on Unix, time as it passes.
pub fn cpu() -> Duration {
    #[cfg(unix)]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
        let (s, ns) = (u64::try_from(time.tv_sec), u32::try_from(time.tv_nsec));
        Duration::new(s.unwrap_or(0), ns.unwrap_or(0))
    }
    #[cfg(not(unix))]
    {
        static STARTED: std::sync::LazyLock<std::time::Instant> =
            std::sync::LazyLock::new(std::time::Instant::now);
        STARTED.elapsed()
    }
}

/// What a piece of work gives, and the CPU time it took, milliseconds.
pub fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let before = cpu();
    let result = work();
    (result, (cpu().saturating_sub(before)).as_secs_f64() * 1e3)
}
