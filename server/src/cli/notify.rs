//! Tells systemd how the server is (sd_notify(3), whose protocol is a datagram to a socket that
//! the environment names). Elsewhere nothing happens.

use std::time::Duration;

/// Sends a state, such as `READY=1`, if anyone listens.
#[cfg(unix)]
pub(super) fn tell(state: &str) {
    use std::os::unix::net::UnixDatagram;
    let Some(address) = std::env::var_os("NOTIFY_SOCKET") else {
        return;
    };
    let told = address_of(&address).and_then(|address| {
        let socket = UnixDatagram::unbound()?;
        // Whoever does not listen must not hold the server up.
        socket.set_nonblocking(true)?;
        socket.send_to_addr(state.as_bytes(), &address)
    });
    if let Err(error) = told {
        tracing::warn!(%error, state, "systemd was not told");
    }
}

#[cfg(not(unix))]
pub(super) fn tell(_state: &str) {}

/// A path, or after `@` a name without a file.
#[cfg(unix)]
fn address_of(address: &std::ffi::OsStr) -> std::io::Result<std::os::unix::net::SocketAddr> {
    use std::os::unix::net::SocketAddr;
    #[cfg(target_os = "linux")]
    {
        use std::os::linux::net::SocketAddrExt;
        use std::os::unix::ffi::OsStrExt;
        if let Some(name) = address.as_bytes().strip_prefix(b"@") {
            return SocketAddr::from_abstract_name(name);
        }
    }
    SocketAddr::from_pathname(address)
}

/// Tells that the server still runs, twice in the time in which systemd wants to hear it.
pub(super) async fn watchdog() {
    let number = |name| std::env::var(name).ok()?.parse::<u64>().ok();
    let ours = number("WATCHDOG_PID").is_none_or(|id| id == u64::from(std::process::id()));
    let Some(every) = number("WATCHDOG_USEC").filter(|every| ours && *every > 1) else {
        return;
    };
    let mut ticks = tokio::time::interval(Duration::from_micros(every / 2));
    loop {
        ticks.tick().await;
        tell("WATCHDOG=1");
    }
}
