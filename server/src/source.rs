//! Where the pages come from.

use bytes::Bytes;
use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;
use escarp_tiles::checksum::crc32c;
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;
use thiserror::Error;

/// A page's whole record. Its bytes are shared, not copied, wherever they lie in memory anyway,
/// and outlive the source.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Revised {
    /// Its content address.
    pub revision: u32,
    /// The record.
    pub bytes: Bytes,
}

/// A family: all records of the children of a page, with their table, as they lie on disk
/// (`tiles/FORMAT.md`, Family).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pack {
    /// CRC-32C of the table. As that has the records' lengths and revisions, it is the content
    /// address of them all.
    pub checksum: u32,
    /// Table and records.
    pub bytes: Bytes,
}

/// What is given where reading must not wait for the disk: `None` where it would.
pub type AtOnce<T> = Option<Result<Option<T>, SourceError>>;

/// One generation of a dataset as the server sees it. It never changes: a new generation is a new
/// source ([`Hosted::publish`](crate::catalog::Hosted::publish)).
pub trait PageSource: Send + Sync {
    /// The manifest.
    fn manifest(&self) -> &Manifest;

    /// The manifest as it is stored, byte for byte.
    fn manifest_json(&self) -> &[u8];

    /// Names the generation, and no other, not even of a dataset that was built again.
    fn generation_id(&self) -> GenerationId;

    /// A page's revision and its whole record, verified; `None` if no record is stored, as for
    /// flat and empty pages. May block on the disk.
    ///
    /// # Errors
    /// [`SourceError`] if there should be a record, and it is damaged or cannot be read.
    fn record(&self, page: PageId) -> Result<Option<Revised>, SourceError>;

    /// The revision of a page's record, without the record where the source can tell. May block
    /// on the disk.
    ///
    /// # Errors
    /// As [`record`](Self::record), of what is read.
    fn revision(&self, page: PageId) -> Result<Option<u32>, SourceError> {
        Ok(self.record(page)?.map(|record| record.revision))
    }

    /// The family below a page, each record verified; `None` if no child has one. May block on
    /// the disk.
    ///
    /// # Errors
    /// As [`record`](Self::record).
    fn pack(&self, parent: PageId) -> Result<Option<Pack>, SourceError>;

    /// As [`record`](Self::record), at once, or not at all.
    fn record_at_once(&self, _page: PageId) -> AtOnce<Revised> {
        None
    }

    /// As [`pack`](Self::pack), at once, or not at all.
    fn pack_at_once(&self, _parent: PageId) -> AtOnce<Pack> {
        None
    }
}

/// A stored record that cannot be given.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum SourceError {
    /// Bytes are not what was published: the file is to be restored, or the dataset built again.
    #[error("damaged: {why}")]
    Damaged {
        /// The file.
        file: PathBuf,
        /// Where in it, what was found, what is allowed.
        why: String,
    },
    /// They cannot be read.
    #[error("unreadable: {why}")]
    Read {
        /// The file.
        file: PathBuf,
        /// The system's reason.
        why: String,
    },
}

/// Names a generation of a dataset: by its number and by the checksum that `CURRENT` names, so
/// that a dataset that was built again under the same number has another one.
///
/// ```
/// use escarp_server::source::GenerationId;
/// let id: GenerationId = "3-00c0ffee".parse().unwrap();
/// assert_eq!(id.to_string(), "3-00c0ffee");
/// for wrong in ["3", "3-c0ffee", "03-00c0ffee", "3-00C0FFEE", "-00c0ffee", "3-00c0ffee1"] {
///     assert!(wrong.parse::<GenerationId>().is_err());
/// }
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct GenerationId {
    /// The generation's number.
    pub generation: u64,
    /// CRC-32C of its manifest.
    pub checksum: u32,
}

impl GenerationId {
    /// Of a manifest, and of its bytes.
    pub fn of(manifest: &Manifest, json: &[u8]) -> GenerationId {
        GenerationId {
            generation: manifest.generation,
            checksum: crc32c(json),
        }
    }
}

impl fmt::Display for GenerationId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-{:08x}", self.generation, self.checksum)
    }
}

/// A text that is no [`GenerationId`].
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("`{0}` is no generation's id; allowed is a number, `-`, 8 small hexadecimal digits")]
pub struct GenerationIdError(String);

impl FromStr for GenerationId {
    type Err = GenerationIdError;

    fn from_str(text: &str) -> Result<GenerationId, GenerationIdError> {
        let parsed = text.split_once('-').and_then(|(generation, checksum)| {
            Some(GenerationId {
                generation: generation.parse().ok()?,
                checksum: u32::from_str_radix(checksum, 16).ok()?,
            })
        });
        // One generation has one address only.
        parsed
            .filter(|id| id.to_string() == text)
            .ok_or_else(|| GenerationIdError(text.into()))
    }
}
