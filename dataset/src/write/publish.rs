//! Publishing a generation, which is the last step of writing one.

use super::super::FilledRuns;
use super::super::current::{Current, sync_folder};
use super::super::files::remove_files;
use super::super::index::{write_index, write_synced};
use super::{DatasetError, DatasetWriter};
use crate::checksum::crc32c;
use escarp_proto::manifest::{Filled, MAX_MANIFEST_BYTES, Manifest};
use std::collections::HashSet;

impl DatasetWriter {
    /// Writes which samples are fill, and gives what the manifest is to say of it; `None` if none
    /// is.
    ///
    /// # Errors
    /// [`DatasetError::Io`] if the system refuses.
    pub fn write_filled(&self, filled: &FilledRuns) -> Result<Option<Filled>, DatasetError> {
        match filled.samples() {
            0 => Ok(None),
            _ => filled.write(&self.folder, self.generation).map(Some),
        }
    }

    /// Publishes, and removes what only generations before need.
    ///
    /// # Errors
    /// As [`publish_beside`](Self::publish_beside).
    pub fn publish(mut self, manifest: Manifest) -> Result<Manifest, DatasetError> {
        let manifest = self.publish_now(manifest)?;
        self.remove_unnamed(&manifest)?;
        Ok(manifest)
    }

    /// Removes all files that a published manifest does not name. Gives its generation.
    pub fn remove_unnamed(&self, manifest: &Manifest) -> Result<u64, DatasetError> {
        let own = manifest.generation;
        let named: HashSet<&str> = manifest.segments.iter().map(|s| s.file.as_str()).collect();
        remove_files(&self.folder, |name, generation| {
            let is_kept = match name.starts_with("seg-") {
                true => named.contains(name),
                false => generation == own && !name.starts_with("resume-"),
            };
            !is_kept
        })?;
        Ok(own)
    }

    /// Publishes; the generations before stay on disk. The writer fills in generation, pages,
    /// segments and index of the manifest.
    ///
    /// # Errors
    /// [`DatasetError::Usage`] if there are more segments than a manifest can name;
    /// [`DatasetError::Io`] if the system refuses. What was published before then stays.
    pub fn publish_beside(mut self, manifest: Manifest) -> Result<Manifest, DatasetError> {
        self.publish_now(manifest)
    }

    fn publish_now(&mut self, mut manifest: Manifest) -> Result<Manifest, DatasetError> {
        self.close_segment()?;
        self.drop_unused();
        manifest.generation = self.generation;
        manifest.pages = self.pages;
        manifest.index = write_index(&self.folder, self.generation, &mut self.index)?;
        manifest.segments = std::mem::take(&mut self.segments);
        let json = manifest.to_json();
        if json.len() > MAX_MANIFEST_BYTES {
            return Err(DatasetError::Usage {
                path: self.folder.clone(),
                why: format!(
                    "{} segments are more than a manifest can name; compact the dataset first",
                    manifest.segments.len()
                ),
            });
        }
        let current = Current {
            generation: self.generation,
            manifest_bytes: json.len() as u64,
            manifest_crc32c: crc32c(&json),
        };
        write_synced(&current.manifest_path(&self.folder), &json)?;
        sync_folder(&self.folder)?;
        // From here on CURRENT may name this generation, whatever fails.
        self.keep = true;
        current.publish(&self.folder)?;
        Ok(manifest)
    }

    /// Leaves out replaced families, and segments in which nothing is left.
    fn drop_unused(&mut self) {
        let (shared, replaced) = (self.shared as u32, &self.replaced);
        self.index
            .retain(|entry| entry.segment >= shared || !replaced.contains(&entry.family));
        let mut used = vec![false; self.segments.len()];
        for entry in &self.index {
            used[entry.segment as usize] = true;
        }
        let mut next = 0;
        let numbers: Vec<u32> = used
            .iter()
            .map(|&used| {
                next += u32::from(used);
                next.saturating_sub(1)
            })
            .collect();
        for entry in &mut self.index {
            entry.segment = numbers[entry.segment as usize];
        }
        let mut used = used.into_iter();
        self.segments.retain(|_| used.next() == Some(true));
    }
}
