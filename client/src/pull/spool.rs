//! What was received so far, on disk: a journal for each stretch of the work, so that one that is
//! begun again asks for nothing twice, and no more than a stretch is in memory.

use super::PullError;
use escarp_dataset::{DatasetError, Journal};
use escarp_proto::geometry::PageId;
use escarp_proto::page::{MAX_RECORD_BYTES, revision};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Records by page.
pub(super) type Records = HashMap<PageId, Vec<u8>>;

/// A journal of records. An entry is a list of them: key (8 bytes), revision (4), length (2), and
/// the record.
#[derive(Debug)]
pub(super) struct Spool {
    journal: Journal,
}

const HEAD: usize = 8 + 4 + 2;

impl Spool {
    /// Opens a stretch's journal, and what is in it. Records that do not match their revision are
    /// left out, and so asked for again.
    pub(super) fn open(folder: &Path, stretch: usize) -> Result<(Spool, Records), PullError> {
        let path: PathBuf = folder.join(format!("received-{stretch}"));
        let mut records = Records::new();
        let opened = Journal::open(&path, |_, content| {
            take(content, &mut records);
            Ok::<(), DatasetError>(())
        })?;
        let journal = match opened {
            Some(journal) => journal,
            None => Journal::create(&path)?,
        };
        Ok((Spool { journal }, records))
    }

    /// Appends records, and makes them durable.
    pub(super) fn append<'a>(
        &mut self,
        records: impl Iterator<Item = (PageId, &'a [u8])>,
    ) -> Result<(), PullError> {
        let mut content = Vec::new();
        for (page, record) in records {
            content.extend(page.key().to_le_bytes());
            content.extend(revision(page, record).to_le_bytes());
            content.extend((record.len() as u16).to_le_bytes());
            content.extend(record);
        }
        if !content.is_empty() {
            self.journal.append(&content)?;
        }
        Ok(())
    }
}

/// Takes the records of an entry. Safe on any bytes.
fn take(mut content: &[u8], records: &mut Records) {
    while let Some((head, rest)) = content.split_first_chunk::<HEAD>() {
        let [k @ .., r0, r1, r2, r3, l0, l1] = *head;
        let length = usize::from(u16::from_le_bytes([l0, l1]));
        let Some((record, rest)) = rest.split_at_checked(length) else {
            return;
        };
        content = rest;
        let stated = u32::from_le_bytes([r0, r1, r2, r3]);
        let page = PageId::from_key(u64::from_le_bytes(k));
        let page =
            page.filter(|&page| length <= MAX_RECORD_BYTES && revision(page, record) == stated);
        if let Some(page) = page {
            records.insert(page, record.to_vec());
        }
    }
}
