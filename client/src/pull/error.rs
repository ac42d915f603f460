//! Why a region could not be pulled, sorted by who must act.

use escarp_dataset::DatasetError;
use escarp_proto::page::PageError;
use std::path::PathBuf;
use thiserror::Error;

/// Why a region could not be pulled.
#[derive(Debug, Error)]
pub enum PullError {
    /// Bounds, error or target are not what is allowed: choose others.
    #[error("{0}")]
    Usage(String),
    /// The server refuses for good: there is no such dataset, or no access to it. To try again is
    /// of no use before that is changed.
    #[error("the server refuses: {0}")]
    Refused(String),
    /// The server cannot be reached, or has fallen silent: what was received is kept.
    #[error("{why}; what was received is kept, run the same command again to go on")]
    Server {
        /// What happened.
        why: String,
    },
    /// The dataset was published anew in between.
    #[error(
        "the dataset has been published anew (generation {found}, pulled was {pulled}); \
         run the same command again"
    )]
    Changed {
        /// What the server has now.
        found: u64,
        /// What was being pulled.
        pulled: u64,
    },
    /// The server's pages do not go together: tell its keeper.
    #[error("from the server: {0}")]
    Contradiction(String),
    /// A page of the server's is wrong.
    #[error("from the server: {0}")]
    Page(#[from] PageError),
    /// The target cannot be written.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The system refused.
    #[error("{}: cannot {action}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// The system's reason.
        source: std::io::Error,
    },
}
