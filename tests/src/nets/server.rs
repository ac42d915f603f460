//! The server as a process: started, watched and ended.

use anyhow::{Context, Result};
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

/// A server. Dropping it kills it.
#[derive(Debug)]
pub struct Server {
    child: Child,
    /// The address of its dataset.
    pub url: String,
}

impl Server {
    /// Starts it by a command that has all arguments, and waits until it says its address.
    ///
    /// # Errors
    /// If it does not start.
    pub fn start(mut command: Command) -> Result<Server> {
        let child = command
            .env("RUST_LOG", "warn")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn();
        let mut child = child.context("cannot start the server")?;
        let out = child.stdout.take().context("the server's output")?;
        let mut url = String::new();
        let said = BufReader::new(out).read_line(&mut url);
        let server = Server {
            child,
            url: url.trim().to_owned(),
        };
        said?;
        anyhow::ensure!(
            !server.url.is_empty(),
            "the server ended before it listened"
        );
        Ok(server)
    }

    /// Its process.
    pub fn id(&self) -> u32 {
        self.child.id()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
