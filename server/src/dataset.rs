//! The datasets of `escarp-tiles` as sources of pages.

use crate::source::{PageSource, SourceError};
use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;
use escarp_tiles::dataset::Dataset;
use std::borrow::Cow;

impl PageSource for Dataset {
    fn manifest(&self) -> &Manifest {
        Dataset::manifest(self)
    }

    fn manifest_json(&self) -> &[u8] {
        Dataset::manifest_json(self)
    }

    fn record(&self, page: PageId) -> Result<Option<(u32, Cow<'_, [u8]>)>, SourceError> {
        let found = Dataset::record(self, page);
        let found = found.map_err(|error| SourceError::Damaged(error.to_string()))?;
        Ok(found.map(|record| (record.revision, Cow::Borrowed(record.bytes))))
    }
}
