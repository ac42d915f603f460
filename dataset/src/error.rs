//! What can be wrong with a dataset on disk, sorted by who must act.

use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a dataset could not be opened, read or written.
#[derive(Debug, Error)]
pub enum DatasetError {
    /// The folder holds no finished dataset: build it (again).
    #[error("{}: {why}", path.display())]
    NotADataset {
        /// The folder.
        path: PathBuf,
        /// What is missing.
        why: String,
    },
    /// A file is not what was published: restore it, or build again.
    #[error("{}: damaged: {why}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where, what was found, what is allowed.
        why: String,
    },
    /// Another program writes, or the target is taken: wait, or choose another target.
    #[error("{}: {why}", path.display())]
    Usage {
        /// The folder.
        path: PathBuf,
        /// What to do.
        why: String,
    },
    /// The system refused.
    #[error("{}: cannot {action}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// The system's reason.
        source: io::Error,
    },
}

impl DatasetError {
    /// A file that is not what was published, and why.
    pub fn damaged(path: &Path, why: impl Into<String>) -> Self {
        DatasetError::Damaged {
            path: path.to_path_buf(),
            why: why.into(),
        }
    }

    /// What the system refused, from its reason.
    pub fn io(path: &Path, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| DatasetError::Io {
            path,
            action,
            source,
        }
    }
}
