//! Errors of the input side, sorted by who must act.

use std::path::{Path, PathBuf};

/// Why an input could not be used. Each names the file, where in it, what was found, and what is
/// allowed.
#[derive(Debug, thiserror::Error)]
pub enum DemError {
    /// The file is of another kind: the user gave the wrong file.
    #[error("{}: not a DEM that Escarp reads: {found}; it reads GeoTIFF, .hgt, DTED, ESRI ASCII grids, .bil/.flt/ENVI with their .hdr, USGS ASCII DEM, greyscale and RGB-coded PNG, ASCII matrices, gzip and zip around them, and anything by --raw WIDTHxHEIGHT:TYPE; most others become a GeoTIFF by: gdal_translate INPUT OUTPUT.tif", path.display())]
    NotADem {
        /// The file.
        path: PathBuf,
        /// What its first bytes, size or name say.
        found: String,
    },
    /// The file breaks its own format: it must be fetched or made again.
    #[error("{}: damaged at {place}: found {found}, expected {expected}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where in it.
        place: String,
        /// What is there.
        found: String,
        /// What may be there.
        expected: String,
    },
    /// A sound file of a kind this program does not read: convert it.
    #[error("{}: {what} is not supported; {hint}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What was met.
        what: String,
        /// What to do, with the command.
        hint: String,
    },
    /// The file asks for more than this program grants to any file.
    #[error("{}: {what} is {found} {unit}, at most {allowed} are allowed", path.display())]
    Limits {
        /// The file.
        path: PathBuf,
        /// What is too large.
        what: String,
        /// Its size.
        found: u64,
        /// The limit.
        allowed: u64,
        /// Unit of both.
        unit: &'static str,
    },
    /// The call or the command line must change.
    #[error("{}: {what}; {hint}", path.display())]
    Usage {
        /// The file.
        path: PathBuf,
        /// What is wrong with the request.
        what: String,
        /// What to do.
        hint: String,
    },
    /// The operating system refused.
    #[error("{}: cannot {doing}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was being done.
        doing: &'static str,
        /// The system's answer.
        source: std::io::Error,
    },
}

impl DemError {
    pub(super) fn not_a_dem(path: &Path, found: impl Into<String>) -> Self {
        Self::NotADem {
            path: path.into(),
            found: found.into(),
        }
    }

    pub(crate) fn damaged(
        path: &Path,
        place: impl Into<String>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        let (place, found, expected) = (place.into(), found.into(), expected.into());
        Self::Damaged {
            path: path.into(),
            place,
            found,
            expected,
        }
    }

    pub(super) fn unsupported(
        path: &Path,
        what: impl Into<String>,
        hint: impl Into<String>,
    ) -> Self {
        Self::Unsupported {
            path: path.into(),
            what: what.into(),
            hint: hint.into(),
        }
    }

    pub(crate) fn limits(
        path: &Path,
        what: impl Into<String>,
        found: u64,
        allowed: u64,
        unit: &'static str,
    ) -> Self {
        Self::Limits {
            path: path.into(),
            what: what.into(),
            found,
            allowed,
            unit,
        }
    }

    pub(crate) fn usage(path: &Path, what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::Usage {
            path: path.into(),
            what: what.into(),
            hint: hint.into(),
        }
    }

    /// The same error with another path, and other texts: for files that the user does not know.
    pub(super) fn renamed(
        mut self,
        to: impl FnOnce(PathBuf) -> PathBuf,
        text: impl Fn(&str) -> String,
    ) -> Self {
        match &mut self {
            Self::NotADem { found, .. } => *found = text(found),
            Self::Damaged { found, .. } => *found = text(found),
            Self::Unsupported { what, hint, .. } | Self::Usage { what, hint, .. } => {
                (*what, *hint) = (text(what), text(hint));
            }
            Self::Limits { what, .. } => *what = text(what),
            Self::Io { .. } => {}
        }
        let (Self::NotADem { path, .. }
        | Self::Damaged { path, .. }
        | Self::Unsupported { path, .. }
        | Self::Limits { path, .. }
        | Self::Usage { path, .. }
        | Self::Io { path, .. }) = &mut self;
        *path = to(std::mem::take(path));
        self
    }

    pub(crate) fn io(path: &Path, doing: &'static str, source: std::io::Error) -> Self {
        Self::Io {
            path: path.into(),
            doing,
            source,
        }
    }
}

/// `IN` and `OUT.tif` for a conversion command that the user can paste.
pub(super) fn in_and_out(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    format!("'{}' '{stem}-converted.tif'", path.display())
}
