//! Two network namespaces and a line between them, made and removed by this process.
//!
//! ```text
//! escarp-PID-s [ 10.77.0.1 ] -- veth -- macvtap -- Relay -- macvtap -- veth -- [ 10.77.0.2 ] escarp-PID-c
//! ```

use super::relay::Relay;
use super::shaper::Cell;
use anyhow::{Context, Result, ensure};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Once;
use tokio::runtime::Builder;
use tokio::signal::unix::{SignalKind, signal};

/// Where the server listens.
pub const SERVER: &str = "10.77.0.1";
const CLIENT: &str = "10.77.0.2";
const PREFIX: &str = "escarp-";
/// What a shell says after Ctrl-C.
const INTERRUPTED: i32 = 130;

/// What a machine needs for a lab.
pub const NEEDS: &str = "needs Linux, root, the programs ip (iproute2), nice, setpriv and \
                         renice (coreutils, util-linux), and a kernel with network namespaces, veth and macvtap";

/// Which end of the line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// Where the server is.
    Server,
    /// Where clients are.
    Client,
}

impl End {
    const BOTH: [End; 2] = [End::Server, End::Client];

    const fn letter(self) -> char {
        match self {
            End::Server => 's',
            End::Client => 'c',
        }
    }

    const fn address(self) -> &'static str {
        match self {
            End::Server => SERVER,
            End::Client => CLIENT,
        }
    }
}

/// Two namespaces and a line. Dropping it removes them; so do Ctrl-C and SIGTERM, and the next lab
/// if this process is killed.
#[derive(Debug)]
pub struct Lab {
    owner: u32,
    /// The line between the ends.
    pub line: Relay,
}

impl Lab {
    /// Makes one.
    ///
    /// # Errors
    /// What the system refuses, and what a lab needs.
    pub fn new() -> Result<Lab> {
        let owner = std::process::id();
        remove_left_behind();
        remove_at_signals(owner);
        Lab::make(owner)
            .inspect_err(|_| remove(owner))
            .context(NEEDS)
    }

    /// Runs a command of this program at the client's end, and gives what it found.
    ///
    /// # Errors
    /// If it fails, with what it said.
    pub fn measure<T: DeserializeOwned>(&self, command: &str, job: &impl Serialize) -> Result<T> {
        let mut client = self.command(End::Client, &beside("escarp-report")?);
        client.arg(command).arg(serde_json::to_string(job)?);
        let output = client.stdin(Stdio::null()).output()?;
        let said = String::from_utf8_lossy(&output.stderr);
        ensure!(
            output.status.success(),
            "the client failed: {}",
            said.trim()
        );
        Ok(serde_json::from_slice(&output.stdout)?)
    }

    fn make(owner: u32) -> Result<Lab> {
        for end in End::BOTH {
            make_end(owner, end)?;
        }
        let taps = End::BOTH.map(|end| open_tap(&tap_name(owner, end)));
        let [server, client] = taps;
        let line = Relay::start(
            [server?, client?],
            Cell {
                round_trip_ms: 0.0,
                mbit_s: 1e4,
                loss_percent: 0.0,
            },
        )?;
        Ok(Lab { owner, line })
    }

    /// A command that runs at one end, before other programs of a busy machine, and is killed when
    /// the thread that starts it ends.
    pub fn command(&self, end: End, program: &Path) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &namespace(self.owner, end)]);
        command
            .args(["setpriv", "--pdeathsig", "KILL"])
            .arg(program);
        command
    }

    /// Sets parameters of the kernel at both ends, such as `net.ipv4.tcp_congestion_control`.
    ///
    /// # Errors
    /// If the kernel refuses.
    pub fn set_parameters(&self, parameters: &[(String, String)]) -> Result<()> {
        for (name, value) in parameters {
            for end in End::BOTH {
                set_parameter(self.owner, end, name, value)?;
            }
        }
        Ok(())
    }
}

impl Drop for Lab {
    fn drop(&mut self) {
        remove(self.owner);
    }
}

fn namespace(owner: u32, end: End) -> String {
    format!("{PREFIX}{owner}-{}", end.letter())
}

/// Names of network cards have at most 15 characters; process numbers at most 7.
fn card_name(owner: u32, end: End) -> String {
    format!("esc{owner}{}", end.letter())
}

fn tap_name(owner: u32, end: End) -> String {
    format!("esc{owner}{}t", end.letter())
}

fn make_end(owner: u32, end: End) -> Result<()> {
    let (space, near, tap) = (
        namespace(owner, end),
        card_name(owner, end),
        tap_name(owner, end),
    );
    let far = format!("{near}1");
    let address = format!("{}/24", end.address());
    ip(&["netns", "add", &space])?;
    ip(&["link", "add", &near, "type", "veth", "peer", "name", &far])?;
    ip(&["link", "set", &far, "netns", &space])?;
    ip(&["-n", &space, "addr", "add", &address, "dev", &far])?;
    // The kernel must cut its data into frames itself, or many would count as one on the line.
    for (place, name) in [(Some(&space), &far), (None, &near)] {
        let mut words = place.map_or(vec![], |space| vec!["-n", space]);
        words.extend(["link", "set", name, "up", "gso_max_segs", "1"]);
        ip(&words)?;
    }
    ip(&["-n", &space, "link", "set", "lo", "up"])?;
    ip(&[
        "link", "add", "link", &near, "name", &tap, "type", "macvtap", "mode", "passthru",
    ])?;
    ip(&["link", "set", &tap, "up"])?;
    // What is known of one line must not be used on the next.
    set_parameter(owner, end, "net.ipv4.tcp_no_metrics_save", "1")
}

fn set_parameter(owner: u32, end: End, name: &str, value: &str) -> Result<()> {
    let path = format!("/proc/sys/{}", name.replace('.', "/"));
    let space = namespace(owner, end);
    let script = "echo \"$1\" > \"$2\"";
    ip(&[
        "netns", "exec", &space, "sh", "-c", script, "sh", value, &path,
    ])
    .with_context(|| format!("setting {name} to {value}"))
}

/// A tap's device is named by its number, and lies in `/dev` where that is the kernel's own folder.
fn open_tap(name: &str) -> Result<File> {
    let about = PathBuf::from("/sys/class/net").join(name);
    let number = std::fs::read_to_string(about.join("ifindex"))
        .with_context(|| format!("no network card {name}"))?;
    let path = PathBuf::from(format!("/dev/tap{}", number.trim()));
    let file = File::options().read(true).write(true).open(&path);
    file.with_context(|| format!("cannot open {}", path.display()))
}

fn ip(words: &[&str]) -> Result<()> {
    let output = Command::new("ip")
        .args(words)
        .stdin(Stdio::null())
        .output()
        .context("cannot run ip")?;
    let said = String::from_utf8_lossy(&output.stderr);
    ensure!(
        output.status.success(),
        "ip {}: {}",
        words.join(" "),
        said.trim()
    );
    Ok(())
}

/// Removes what a process made, as far as it is there.
fn remove(owner: u32) {
    for end in End::BOTH {
        // Cards go with their peers. What is not there needs no removing.
        let _ = ip(&["link", "del", &card_name(owner, end)]);
        let _ = ip(&["netns", "del", &namespace(owner, end)]);
    }
}

/// Removes what processes made that were killed.
fn remove_left_behind() {
    let Ok(entries) = std::fs::read_dir("/run/netns") else {
        return;
    };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let owner = name.to_str().and_then(owner_of);
        let gone = |owner: &u32| !Path::new("/proc").join(owner.to_string()).exists();
        if let Some(owner) = owner.filter(gone) {
            remove(owner);
        }
    }
}

fn owner_of(namespace: &str) -> Option<u32> {
    let rest = namespace.strip_prefix(PREFIX)?;
    rest.strip_suffix("-s")
        .or(rest.strip_suffix("-c"))?
        .parse()
        .ok()
}

/// From now on, a signal that ends this process removes its lab first.
fn remove_at_signals(owner: u32) {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // Without the thread, the next lab removes what this one leaves.
        let _ = std::thread::Builder::new()
            .name("signals".into())
            .spawn(move || {
                if wait_for_signal().is_ok() {
                    remove(owner);
                    std::process::exit(INTERRUPTED);
                }
            });
    });
}

fn wait_for_signal() -> Result<()> {
    let runtime = Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let mut terminate = signal(SignalKind::terminate())?;
        let mut interrupt = signal(SignalKind::interrupt())?;
        let mut hangup = signal(SignalKind::hangup())?;
        tokio::select! {
            _ = terminate.recv() => {}
            _ = interrupt.recv() => {}
            _ = hangup.recv() => {}
        }
        Ok(())
    })
}

/// A program that lies beside this one; beside the programs, if this is a test of them.
///
/// # Errors
/// If it does not.
pub fn beside(name: &str) -> Result<PathBuf> {
    let own = std::env::current_exe().context("the path of this program")?;
    let folder = own.parent().context("the folder of this program")?;
    let folder = match folder.file_name().is_some_and(|name| name == "deps") {
        true => folder.parent().context("the folder of programs")?,
        false => folder,
    };
    let path = folder.join(name);
    ensure!(
        path.is_file(),
        "there is no {}; build it: cargo build --release --workspace --bins",
        path.display()
    );
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_names_that_a_lab_gives_are_removed() {
        assert_eq!(owner_of("escarp-12-s"), Some(12));
        assert_eq!(owner_of("escarp-12-c"), Some(12));
        for other in [
            "escarp-12-x",
            "escarp--s",
            "escarp-a-s",
            "other-12-s",
            "escarp-12",
        ] {
            assert_eq!(owner_of(other), None, "{other}");
        }
        assert!(tap_name(4_194_304, End::Server).len() <= 15);
        assert!(format!("{}1", card_name(4_194_304, End::Client)).len() <= 15);
    }
}
