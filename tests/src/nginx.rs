//! A stock nginx as a process, where there is one.

use std::fs;
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// An nginx that does not answer for so long does not work.
const PATIENCE: Duration = Duration::from_secs(20);

/// A running nginx with a configuration and a folder of its own; killed when dropped.
pub struct Nginx {
    child: Child,
    folder: TempDir,
    port: u16,
}

impl Nginx {
    /// Whether one is installed; says so where it is not.
    pub fn is_installed() -> bool {
        let there = Command::new("nginx")
            .arg("-v")
            .stderr(Stdio::null())
            .status()
            .is_ok_and(|status| status.success());
        if !there {
            println!("skipped: nginx is not installed");
        }
        there
    }

    /// Starts it with the `http` block that a function writes for its port and folder, through a
    /// wrapper such as `taskset` if one is given.
    ///
    /// # Panics
    /// If it does not listen.
    pub fn start(wrapper: &[&str], http: impl FnOnce(u16, &Path) -> String) -> Nginx {
        let folder = tempfile::tempdir().expect("a temporary folder");
        // Free a moment ago; nginx cannot choose one itself.
        let free = TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr());
        let port = free.expect("a free port").port();
        let http = http(port, folder.path());
        let path = folder.path().display().to_string();
        let config = format!(
            "{user}daemon off;\nworker_processes 1;\nworker_rlimit_nofile 8192;\n\
             pid {path}/pid;\nerror_log {path}/error.log warn;\nevents {{ worker_connections 4096; }}\n\
             http {{\naccess_log off;\nclient_body_temp_path {path}/body;\n\
             proxy_temp_path {path}/proxy;\nfastcgi_temp_path {path}/fastcgi;\n\
             uwsgi_temp_path {path}/uwsgi;\nscgi_temp_path {path}/scgi;\n{http}\n}}\n",
            user = user(),
        );
        fs::write(folder.path().join("nginx.conf"), config).expect("a configuration");
        let arguments = ["nginx", "-p", &path, "-e", "error.log", "-c", "nginx.conf"];
        let mut words = wrapper.iter().chain(&arguments);
        let mut command = Command::new(words.next().expect("a program"));
        let child = command.args(words).stdin(Stdio::null()).spawn();
        let nginx = Nginx {
            child: child.expect("nginx starts"),
            folder,
            port,
        };
        let began = Instant::now();
        while TcpStream::connect(("127.0.0.1", port)).is_err() {
            assert!(began.elapsed() < PATIENCE, "{}", nginx.errors());
            std::thread::sleep(Duration::from_millis(10));
        }
        nginx
    }

    /// Where it listens, on this machine.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Its folder.
    pub fn folder(&self) -> PathBuf {
        self.folder.path().to_path_buf()
    }

    /// The process that answers.
    ///
    /// # Panics
    /// If there is none.
    pub fn worker(&self) -> u32 {
        let id = self.child.id();
        let list = format!("/proc/{id}/task/{id}/children");
        let children = fs::read_to_string(list).expect("its children");
        let first = children.split_whitespace().next().expect("a worker");
        first.parse().expect("a number")
    }

    /// What it has complained of.
    pub fn errors(&self) -> String {
        fs::read_to_string(self.folder.path().join("error.log")).unwrap_or_default()
    }
}

impl Drop for Nginx {
    fn drop(&mut self) {
        // Its worker goes with it when it is told, and not when it is killed.
        let told = Command::new("kill")
            .args(["-TERM", &self.child.id().to_string()])
            .status();
        if !told.is_ok_and(|status| status.success()) {
            let _ = self.child.kill();
        }
        let _ = self.child.wait();
    }
}

/// Workers of a root's nginx are someone else by default, who may not see temporary folders.
fn user() -> &'static str {
    match fs::metadata("/proc/self") {
        #[cfg(unix)]
        Ok(own) if std::os::unix::fs::MetadataExt::uid(&own) == 0 => "user root;\n",
        _ => "",
    }
}
