//! What was received, kept on disk for later runs.
//!
//! ```text
//! FOLDER/
//!   LOCK                      held while a segment is begun, and old ones are removed
//!   <16 hexadecimal digits>/  of one address, http://HOST:PORT/NAME
//!     manifest                of the last session
//!     seg-<time>-<pid>-<n>    records, appended by one program at a time
//! ```
//!
//! # What it promises
//!
//! - Each segment begins with the whole address; one of another address is not read. So a server
//!   can only ever spoil what it sent itself.
//! - Each record has checksums of its head and of all of it, and is read only if they match. A
//!   program that is killed leaves a tail that does not; what is before it counts.
//! - Files are only appended to by the program that holds their lock, and removed whole, oldest
//!   first. A page that is used from the older half is written once more, so that it is not old.
//! - With no room on disk, or no right to write, the client goes on without, and says so once.
//! - Nothing here runs on the thread that draws: [`DiskCache`] has a thread of its own, and a queue
//!   that drops what it has no room for.
//!
//! Pages enter the terrain as those from the server do, through the same checks.

mod folder;
mod index;
mod segment;
mod store;
mod worker;

#[cfg(test)]
mod tests;

pub use folder::default_folder;
pub use store::Store;
pub use worker::{DiskCache, Loaded};

use std::path::PathBuf;

/// Bytes on disk that a client takes if nobody says otherwise.
pub const DEFAULT_CACHE_BYTES: u64 = 256 << 20;

/// Where pages are kept, and how many.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CacheOptions {
    /// The folder; shared by all datasets and programs.
    pub folder: PathBuf,
    /// Bytes of all segments in it, at most.
    pub cap_bytes: u64,
}
