//! The datasets of `escarp-tiles` as sources of pages.

use crate::source::{AtOnce, GenerationId, Pack, PageSource, Revised, SourceError};
use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;
use escarp_tiles::dataset::{Dataset, DatasetError, ReadError, Stored, Wait};

impl PageSource for Dataset {
    fn manifest(&self) -> &Manifest {
        Dataset::manifest(self)
    }

    fn manifest_json(&self) -> &[u8] {
        Dataset::manifest_json(self)
    }

    fn generation_id(&self) -> GenerationId {
        GenerationId {
            generation: self.manifest().generation,
            checksum: self.manifest_crc32c(),
        }
    }

    fn record(&self, page: PageId) -> Result<Option<Revised>, SourceError> {
        let found = self.read_record(page, Wait::Yes);
        Ok(found.map_err(|error| refused(self, error))?.map(revised))
    }

    fn revision(&self, page: PageId) -> Result<Option<u32>, SourceError> {
        let found = self.read_revision(page, Wait::Yes);
        found.map_err(|error| refused(self, error))
    }

    fn pack(&self, parent: PageId) -> Result<Option<Pack>, SourceError> {
        let found = self.read_family(parent, Wait::Yes);
        Ok(found.map_err(|error| refused(self, error))?.map(packed))
    }

    fn record_at_once(&self, page: PageId) -> AtOnce<Revised> {
        match self.read_record(page, Wait::No) {
            Err(ReadError::WouldWait) => None,
            found => Some(
                found
                    .map(|found| found.map(revised))
                    .map_err(|e| refused(self, e)),
            ),
        }
    }

    fn pack_at_once(&self, parent: PageId) -> AtOnce<Pack> {
        match self.read_family(parent, Wait::No) {
            Err(ReadError::WouldWait) => None,
            found => Some(
                found
                    .map(|found| found.map(packed))
                    .map_err(|e| refused(self, e)),
            ),
        }
    }
}

fn revised(stored: Stored) -> Revised {
    Revised {
        revision: stored.checksum,
        bytes: stored.bytes,
    }
}

fn packed(stored: Stored) -> Pack {
    Pack {
        checksum: stored.checksum,
        bytes: stored.bytes,
    }
}

/// Who must act: whoever has the files, or whoever has the machine.
fn refused(dataset: &Dataset, error: ReadError) -> SourceError {
    match error {
        ReadError::Dataset(DatasetError::Damaged { path: file, why }) => {
            SourceError::Damaged { file, why }
        }
        ReadError::Dataset(DatasetError::Io { path, source, .. }) => SourceError::Read {
            file: path,
            why: source.to_string(),
        },
        other => SourceError::Read {
            file: dataset.folder().to_path_buf(),
            why: other.to_string(),
        },
    }
}
