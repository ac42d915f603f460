//! Where the pages come from.

use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;
use std::borrow::Cow;
use thiserror::Error;

/// A page's revision and its whole record.
pub type Revised<'a> = (u32, Cow<'a, [u8]>);

/// A dataset as the server sees it.
pub trait PageSource: Send + Sync {
    /// The manifest.
    fn manifest(&self) -> &Manifest;

    /// The manifest as it is stored, byte for byte.
    fn manifest_json(&self) -> &[u8];

    /// A page's revision and its whole record, verified; `None` if no record is stored, as for
    /// flat and empty pages. May block on the disk.
    ///
    /// # Errors
    /// [`SourceError`] if there should be a record, and it is damaged or cannot be read.
    fn record(&self, page: PageId) -> Result<Option<Revised<'_>>, SourceError>;
}

/// A stored record that cannot be given.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum SourceError {
    /// Its bytes are not what was written.
    #[error("damaged: {0}")]
    Damaged(String),
    /// They cannot be read.
    #[error("unreadable: {0}")]
    Read(String),
}
