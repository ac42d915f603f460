//! Takes datasets live: those in a folder that come, go, and are published anew.
//!
//! A look is a few system calls a dataset: its `CURRENT` is read, and the files that the hosted
//! generation has are asked for length, time and identity. Only where that differs from the last
//! look is anything opened. Looking costs so little, and works on every file system, that nothing
//! is to be notified.
//!
//! What is damaged is said once, and what was hosted before stays.

use crate::catalog::{Catalog, CatalogError, Hosted};
use escarp_proto::manifest::Manifest;
use escarp_tiles::dataset::{Dataset, DatasetError, Io, current_path, name_of};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, Metadata};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};
use thiserror::Error;
use tokio::time::{MissedTickBehavior, interval};

/// From look to look.
pub const LOOK_INTERVAL: Duration = Duration::from_secs(1);
/// Looks until a dataset that could not be opened is tried again, though it looks the same.
const PATIENCE: u32 = 10;
/// More of `CURRENT` is not compared: a sound one is shorter.
const CURRENT_BYTES: u64 = 256;

/// Why hosting does not begin.
#[derive(Debug, Error)]
pub enum WatchError {
    /// A dataset that was named cannot be opened.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// Its name cannot be taken.
    #[error(transparent)]
    Catalog(#[from] CatalogError),
    /// A folder that was named cannot be listed.
    #[error("{}: cannot list the folder: {why}", folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// The system's reason.
        why: String,
    },
}

/// Keeps a catalog as the disk has it.
pub struct Watcher {
    catalog: Arc<Catalog>,
    io: Io,
    /// Datasets by their own folder.
    given: Vec<PathBuf>,
    /// Folders of datasets.
    folders: Vec<PathBuf>,
    known: BTreeMap<PathBuf, Known>,
    /// Folders that could not be listed the last time.
    closed: BTreeSet<PathBuf>,
}

/// What is known of a dataset.
#[derive(Default)]
struct Known {
    seen: Option<Print>,
    hosted: Option<Arc<Hosted>>,
    /// Of the hosted generation.
    files: Vec<PathBuf>,
    complaint: Option<String>,
    /// Looks since it was last tried.
    looks: u32,
}

/// What a dataset looks like from outside.
#[derive(PartialEq, Eq)]
struct Print {
    current: Vec<u8>,
    files: Vec<Option<Identity>>,
}

type Identity = (u64, Option<SystemTime>, [u64; 2]);

impl Print {
    /// `None` if there is no `CURRENT`.
    fn of(folder: &Path, files: &[PathBuf]) -> Option<Print> {
        let path = current_path(folder);
        let identity = identity(&path)?;
        let mut current = Vec::new();
        // Who cannot read it will be told why when it is opened.
        let _ = File::open(&path).map(|file| file.take(CURRENT_BYTES).read_to_end(&mut current));
        let others = files.iter().map(|path| self::identity(path));
        let files = std::iter::once(Some(identity)).chain(others).collect();
        Some(Print { current, files })
    }
}

/// Length, time of the last change, device and inode. `None` if it is no file.
fn identity(path: &Path) -> Option<Identity> {
    let found = fs::metadata(path).ok().filter(Metadata::is_file)?;
    Some((found.len(), found.modified().ok(), place(&found)))
}

#[cfg(unix)]
fn place(found: &Metadata) -> [u64; 2] {
    use std::os::unix::fs::MetadataExt;
    [found.dev(), found.ino()]
}

#[cfg(not(unix))]
fn place(_: &Metadata) -> [u64; 2] {
    [0; 2]
}

impl Watcher {
    /// Hosts datasets: each of `paths` is one, or a folder with such in it; each of `folders` is
    /// the latter, and may be empty for now.
    ///
    /// # Errors
    /// [`WatchError`] if a dataset among `paths` cannot be hosted, or a folder not be listed. A
    /// damaged dataset inside a folder is logged, and left out.
    pub fn start(
        catalog: Arc<Catalog>,
        paths: &[PathBuf],
        folders: &[PathBuf],
        io: Io,
    ) -> Result<Watcher, WatchError> {
        let (folded, given): (Vec<_>, Vec<_>) =
            paths.iter().cloned().partition(|path| has_datasets(path));
        let mut watcher = Watcher {
            catalog,
            io,
            given,
            folders: folded.into_iter().chain(folders.iter().cloned()).collect(),
            known: BTreeMap::new(),
            closed: BTreeSet::new(),
        };
        for path in watcher.given.clone() {
            if watcher.known.contains_key(&path) {
                return Err(CatalogError::Twice(name_of(&path)).into());
            }
            watcher.open(&path)?;
        }
        for folder in &watcher.folders {
            datasets_in(folder).map_err(|error| WatchError::Folder {
                folder: folder.clone(),
                why: error.to_string(),
            })?;
        }
        watcher.look();
        Ok(watcher)
    }

    /// Looks again and again. Ends with the program only.
    pub async fn run(mut self) {
        let mut looks = interval(LOOK_INTERVAL);
        looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            looks.tick().await;
            // Opening a dataset reads its index, which may take a while.
            let looked = tokio::task::spawn_blocking(move || {
                self.look();
                self
            });
            match looked.await {
                Ok(watcher) => self = watcher,
                Err(error) => {
                    tracing::error!(%error, "folders are watched no longer");
                    return;
                }
            }
        }
    }

    /// Looks once, and brings the catalog up to date.
    pub fn look(&mut self) {
        let mut paths: BTreeSet<PathBuf> = self.given.iter().cloned().collect();
        paths.extend(self.known.keys().cloned());
        for folder in &self.folders {
            match datasets_in(folder) {
                Ok(found) => {
                    paths.extend(found);
                    self.closed.remove(folder);
                }
                Err(error) => {
                    if self.closed.insert(folder.clone()) {
                        tracing::error!(folder = %folder.display(), %error, "cannot be listed");
                    }
                }
            }
        }
        for path in paths {
            self.look_at(&path);
        }
    }

    fn look_at(&mut self, path: &Path) {
        let known = self.known.entry(path.to_path_buf()).or_default();
        let Some(print) = Print::of(path, &known.files) else {
            return self.forget(path);
        };
        known.looks += 1;
        let same = known.seen.as_ref() == Some(&print);
        if same && (known.complaint.is_none() || known.looks < PATIENCE) {
            return;
        }
        let Err(error) = self.open(path) else {
            return;
        };
        let known = self.known.entry(path.to_path_buf()).or_default();
        known.looks = 0;
        // A generation that was replaced while it was opened is not damaged, but gone.
        let stands = Print::of(path, &known.files).as_ref() == Some(&print);
        known.seen = Some(print);
        let complaint = error.to_string();
        if stands && known.complaint.as_ref() != Some(&complaint) {
            let kept = match &known.hosted {
                Some(_) => "what was hosted before stays",
                None => "it is not hosted",
            };
            tracing::error!(%error, "a dataset cannot be opened; {kept}");
            known.complaint = Some(complaint);
        }
    }

    /// A dataset is no longer there.
    fn forget(&mut self, path: &Path) {
        let hosted = self.known.remove(path).and_then(|known| known.hosted);
        if let Some(hosted) = hosted {
            self.catalog.remove(hosted.name());
            let folder = path.display();
            tracing::warn!(dataset = hosted.name(), %folder, "removed: hosted no longer");
        }
    }

    /// Hosts what is at a path, or publishes its new generation.
    fn open(&mut self, path: &Path) -> Result<(), WatchError> {
        let dataset = Dataset::open(path)?.with_io(self.io);
        let known = self.known.entry(path.to_path_buf()).or_default();
        let (name, generation) = (dataset.name().to_owned(), dataset.manifest().generation);
        let files = files_of(path, dataset.manifest());
        let pages = dataset.manifest().pages;
        match &known.hosted {
            Some(hosted) => {
                hosted.publish(Arc::new(dataset));
                tracing::info!(
                    dataset = name,
                    generation,
                    pages,
                    "a new generation is live"
                );
            }
            None => {
                known.hosted = Some(self.catalog.add(&name, Arc::new(dataset))?);
                tracing::info!(dataset = name, generation, pages, "hosted");
            }
        }
        *known = Known {
            // Of the files as they are from here on.
            seen: Print::of(path, &files),
            hosted: known.hosted.take(),
            files,
            ..Known::default()
        };
        Ok(())
    }
}

/// The files that a generation is read from.
fn files_of(folder: &Path, manifest: &Manifest) -> Vec<PathBuf> {
    let segments = manifest.segments.iter();
    segments.map(|segment| folder.join(&segment.file)).collect()
}

/// Whether a path is a folder with datasets in it, and no dataset itself.
fn has_datasets(path: &Path) -> bool {
    !current_path(path).exists() && datasets_in(path).is_ok_and(|found| !found.is_empty())
}

/// The datasets in a folder, finished ones.
fn datasets_in(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let named = path.extension().is_some_and(|ending| ending == "escarp");
        if named && !name_of(&path).is_empty() && current_path(&path).exists() {
            found.push(path);
        }
    }
    Ok(found)
}
