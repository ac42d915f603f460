//! The programs as processes.

use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// A program that runs longer has failed: far above what any needs.
const PATIENCE: Duration = Duration::from_secs(300);

/// The folder of the programs. They are brought up to date once, as tests of this package alone
/// do not build them.
///
/// # Panics
/// If they do not build.
fn folder() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        // TARGET/PROFILE/deps/TEST
        let test = std::env::current_exe().expect("the test's own path");
        let folder = test
            .ancestors()
            .nth(2)
            .expect("a target folder")
            .to_path_buf();
        let profile = match folder.file_name().and_then(|name| name.to_str()) {
            None | Some("debug") => "dev",
            Some(profile) => profile,
        };
        let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".into());
        let built = Command::new(cargo)
            .args([
                "build",
                "--quiet",
                "--workspace",
                "--bins",
                "--profile",
                profile,
            ])
            .arg("--target-dir")
            .arg(folder.parent().expect("a target folder"))
            .current_dir(workspace())
            .status();
        assert!(
            built.expect("cargo runs").success(),
            "the programs do not build"
        );
        folder
    })
}

/// The workspace's root.
pub fn workspace() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

/// A call of one of the programs.
pub fn program(name: &str) -> Command {
    let mut command = Command::new(folder().join(name));
    // Logs below warnings would stand among the results of the tests.
    command.stdin(Stdio::null()).env("RUST_LOG", "warn");
    command.env("XDG_CACHE_HOME", cache_home());
    command
}

/// Where the programs of this test keep what they receive: not where the user's own do, and fresh.
/// What tests that have ended left behind is removed.
fn cache_home() -> &'static Path {
    static HOME: OnceLock<PathBuf> = OnceLock::new();
    HOME.get_or_init(|| {
        let all = folder().with_file_name("test-caches");
        let is_over = |path: &Path| {
            let process = path.file_name().map(|name| Path::new("/proc").join(name));
            process.is_none_or(|process| !process.exists())
        };
        let own = all.join(std::process::id().to_string());
        let found = std::fs::read_dir(&all).into_iter().flatten().flatten();
        for path in found.map(|entry| entry.path()) {
            if path == own || is_over(&path) {
                // Another test may be removing it, too.
                let _ = std::fs::remove_dir_all(path);
            }
        }
        std::fs::create_dir_all(&own).expect("a folder in the target folder");
        own
    })
}

/// What a program printed, and how it ended.
#[derive(Debug)]
pub struct Ran {
    /// Exit code; `None` if a signal ended it.
    pub code: Option<i32>,
    /// Standard output.
    pub out: String,
    /// Standard error.
    pub err: String,
}

impl Ran {
    /// The standard output of a program that did what it should.
    ///
    /// # Panics
    /// If it did not.
    pub fn ok(self) -> String {
        assert_eq!(self.code, Some(0), "{self:?}");
        self.out
    }
}

/// Runs a program to its end.
///
/// # Panics
/// If it does not start, or does not end.
pub fn run(name: &str, arguments: &[&str]) -> Ran {
    let mut command = program(name);
    command
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let child = command
        .spawn()
        .unwrap_or_else(|error| panic!("{name}: {error}"));
    let id = child.id();
    let (sender, ended) = channel();
    std::thread::spawn(move || sender.send(child.wait_with_output()));
    match ended.recv_timeout(PATIENCE) {
        Ok(output) => ran(output.expect("output")),
        Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {
            send(id, "KILL");
            panic!("{name} {arguments:?} did not end within {PATIENCE:?}");
        }
    }
}

fn ran(output: Output) -> Ran {
    Ran {
        code: output.status.code(),
        out: String::from_utf8_lossy(&output.stdout).into_owned(),
        err: String::from_utf8_lossy(&output.stderr).into_owned(),
    }
}

/// `escarp-server` as a process, killed when dropped.
pub struct ServerProcess {
    child: Child,
    /// The addresses that it printed, one a dataset.
    pub urls: Vec<String>,
    log: Arc<Mutex<String>>,
}

impl ServerProcess {
    /// Starts it, and waits for the addresses of so many datasets.
    ///
    /// # Panics
    /// If it does not print them.
    pub fn start(datasets: &[&Path]) -> ServerProcess {
        ServerProcess::start_on(0, datasets)
    }

    /// As [`start`](Self::start), on a port that another one has left.
    ///
    /// # Panics
    /// If it does not print the addresses.
    pub fn start_on(port: u16, datasets: &[&Path]) -> ServerProcess {
        ServerProcess::spawn(program("escarp-server"), port, datasets)
    }

    /// As [`start`](Self::start), with so few open files allowed.
    ///
    /// # Panics
    /// If it does not print the addresses.
    pub fn start_with_files(files: u32, datasets: &[&Path]) -> ServerProcess {
        let mut command = Command::new("sh");
        let limited = format!("ulimit -n {files} && exec \"$@\"");
        command
            .args(["-c", &limited, "sh"])
            .arg(folder().join("escarp-server"))
            .env("RUST_LOG", "warn");
        ServerProcess::spawn(command, 0, datasets)
    }

    fn spawn(mut command: Command, port: u16, datasets: &[&Path]) -> ServerProcess {
        command
            .args(datasets)
            .args(["--listen", &format!("127.0.0.1:{port}")]);
        ServerProcess::of(command, datasets.len())
    }

    /// As [`start`](Self::start), with a command line of its own.
    ///
    /// # Panics
    /// If it does not print so many addresses.
    pub fn of(mut command: Command, datasets: usize) -> ServerProcess {
        let mut child = command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the server starts");
        let out = child.stdout.take().expect("its output");
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            for line in BufReader::new(out).lines().map_while(Result::ok) {
                let _ = sender.send(line);
            }
        });
        let (log, err) = (Arc::<Mutex<String>>::default(), child.stderr.take());
        let (shared, err) = (log.clone(), err.expect("its log"));
        std::thread::spawn(move || {
            for line in BufReader::new(err).lines().map_while(Result::ok) {
                // Nothing panics under this lock.
                if let Ok(mut log) = shared.lock() {
                    log.push_str(&line);
                    log.push('\n');
                }
            }
        });
        let mut server = ServerProcess {
            child,
            urls: Vec::new(),
            log,
        };
        for _ in 0..datasets {
            let line = lines
                .recv_timeout(PATIENCE)
                .unwrap_or_else(|_| panic!("the server prints no address: {}", server.log()));
            server.urls.push(line);
        }
        server
    }

    /// What it logged: warnings and errors.
    pub fn log(&self) -> String {
        self.log.lock().map(|log| log.clone()).unwrap_or_default()
    }

    /// Its process's number.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Whether it still runs.
    pub fn lives(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// Host and port.
    ///
    /// # Panics
    /// If it hosts nothing.
    pub fn address(&self) -> SocketAddr {
        let rest = self.urls[0].trim_start_matches("http://");
        let address = rest.split('/').next().unwrap_or_default();
        address.parse().expect("an address")
    }

    /// Sends a signal by name.
    pub fn tell(&self, signal: &str) {
        send(self.child.id(), signal);
    }

    /// Sends a signal by name, and waits for the end.
    ///
    /// # Panics
    /// If it goes on.
    pub fn end(mut self, signal: &str) -> ExitStatus {
        send(self.child.id(), signal);
        let began = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().expect("its status") {
                return status;
            }
            assert!(
                began.elapsed() < PATIENCE,
                "the server goes on after SIG{signal}"
            );
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for ServerProcess {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Sends a signal to a process that this one started.
fn send(process: u32, signal: &str) {
    let sent = Command::new("sh")
        .args(["-c", &format!("kill -s {signal} {process}")])
        .status();
    assert!(
        sent.is_ok_and(|status| status.success()),
        "SIG{signal} is not sent"
    );
}

/// A folder for one test, and the names of files in it.
pub struct Desk(TempDir);

impl Desk {
    /// An empty folder.
    ///
    /// # Panics
    /// If the system refuses.
    #[allow(clippy::new_without_default, reason = "it makes a folder")]
    pub fn new() -> Desk {
        Desk(TempDir::new().expect("a temporary folder"))
    }

    /// The path of a file.
    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// The path of a file, as an argument.
    ///
    /// # Panics
    /// If it is not UTF-8.
    pub fn name(&self, name: &str) -> String {
        self.path(name).to_str().expect("UTF-8").to_owned()
    }

    /// A sample DEM and the dataset of it.
    ///
    /// # Panics
    /// If a program fails.
    pub fn dataset(&self) -> PathBuf {
        let (tif, out) = (self.name("demo.tif"), self.name("demo.escarp"));
        run(
            "escarp-tiles",
            &["sample", "-o", &tif, "--size", "300", "--seed", "3"],
        )
        .ok();
        run("escarp-tiles", &["build", &tif, "-o", &out]).ok();
        self.path("demo.escarp")
    }
}
