//! Takes on what can change while the server runs: certificates, tokens, origins.

use super::notify;
use crate::access::Access;
use crate::config::{Config, ConfigError};
use crate::tls::Tls;
use anyhow::{Context, Result};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;

/// How often the files of the certificate are looked at.
const LOOK_INTERVAL: Duration = Duration::from_secs(10);

/// Reads all settings as they are now.
pub(super) type Read = Box<dyn Fn() -> Result<Config, ConfigError> + Send>;

/// What is needed for it.
pub(super) struct Reload {
    config: Config,
    read: Read,
    tls: Option<Arc<Tls>>,
    rules: watch::Sender<Option<Access>>,
    #[cfg(unix)]
    hangup: tokio::signal::unix::Signal,
}

impl Reload {
    /// Listens for SIGHUP from now on.
    pub(super) fn new(
        config: Config,
        read: Read,
        tls: Option<Arc<Tls>>,
        rules: watch::Sender<Option<Access>>,
    ) -> Result<Reload> {
        #[cfg(unix)]
        let hangup = {
            use tokio::signal::unix::{SignalKind, signal};
            signal(SignalKind::hangup()).context("watching for SIGHUP")?
        };
        Ok(Reload {
            config,
            read,
            tls,
            rules,
            #[cfg(unix)]
            hangup,
        })
    }

    /// Reloads whenever it is told to, and the certificate when it has changed.
    pub(super) async fn run(mut self) {
        let mut looks = tokio::time::interval(LOOK_INTERVAL);
        loop {
            tokio::select! {
                () = told(&mut self) => self.reload(),
                _ = looks.tick() => self.look(),
            }
        }
    }

    fn reload(&mut self) {
        notify::tell("RELOADING=1");
        if let Some(tls) = &self.tls {
            match tls.reload() {
                Ok(()) => tracing::info!("certificate read again"),
                Err(error) => tracing::error!(%error, "the old certificate stays"),
            }
        }
        match (self.read)() {
            Ok(config) => self.take(config),
            Err(error) => tracing::error!(%error, "the old settings stay"),
        }
        notify::tell("READY=1");
    }

    /// Rules, origins and hosts are taken on; for the rest, the server is to be started anew.
    fn take(&mut self, config: Config) {
        let access = match config.access() {
            Ok(access) => access,
            Err(error) => return tracing::error!(%error, "the old settings stay"),
        };
        tracing::info!(
            rules = access.rules.len(),
            "rules of access, origins and hosts read again"
        );
        self.rules.send_replace(Some(access));
        let mut others = self.config.changes(&config);
        others.retain(|name| !["origins", "hosts"].contains(&name.as_str()));
        if !others.is_empty() {
            tracing::warn!(settings = ?others, "changed, and taken on at the next start only");
        }
    }

    fn look(&self) {
        match self.tls.as_ref().map(|tls| tls.reload_if_changed()) {
            Some(Ok(true)) => tracing::info!("the certificate has changed, and was read again"),
            Some(Err(error)) => tracing::error!(%error, "the old certificate stays"),
            Some(Ok(false)) | None => {}
        }
    }
}

/// Ready at a SIGHUP.
#[cfg(unix)]
async fn told(reload: &mut Reload) {
    if reload.hangup.recv().await.is_none() {
        std::future::pending::<()>().await;
    }
}

#[cfg(not(unix))]
async fn told(_reload: &mut Reload) {
    std::future::pending::<()>().await;
}
