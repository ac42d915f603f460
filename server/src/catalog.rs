//! The datasets that a server hosts, by name. They come and go, and are published anew, while it
//! runs.

use crate::published::Published;
use crate::source::{AtOnce, GenerationId, Pack, PageSource, Revised, SourceError};
use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use thiserror::Error;
use tokio::sync::watch;

/// Longest name of a dataset, bytes.
pub const MAX_NAME: usize = 128;
/// First parts of the server's own addresses, which no dataset may take.
pub const RESERVED: [&str; 6] = [
    "datasets",
    "healthz",
    "metrics",
    "readyz",
    "session",
    "openapi.json",
];

/// Named datasets.
#[derive(Default)]
pub struct Catalog {
    hosted: RwLock<BTreeMap<String, Arc<Hosted>>>,
}

/// Why a dataset was not added.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum CatalogError {
    /// Another one has this name.
    #[error("two datasets are named `{0}`; rename the folder of one")]
    Twice(String),
    /// The name cannot stand in an address.
    #[error(
        "a dataset cannot be named `{0}`; allowed are 1 to {MAX_NAME} bytes without `/` or control \
         characters, not starting with a dot, and none of {RESERVED:?}; rename its folder"
    )]
    Name(String),
}

impl Catalog {
    /// Adds a dataset.
    ///
    /// # Errors
    /// [`CatalogError`] if the name is taken or cannot be one.
    pub fn add(
        &self,
        name: &str,
        source: Arc<dyn PageSource>,
    ) -> Result<Arc<Hosted>, CatalogError> {
        let usable = (1..=MAX_NAME).contains(&name.len())
            && !name.starts_with('.')
            && !name.contains(|c: char| c == '/' || c.is_control())
            && !RESERVED.contains(&name);
        if !usable {
            return Err(CatalogError::Name(name.into()));
        }
        let mut all = self.hosted.write().unwrap_or_else(PoisonError::into_inner);
        if all.contains_key(name) {
            return Err(CatalogError::Twice(name.into()));
        }
        let hosted = Arc::new(Hosted::new(name, source));
        all.insert(name.into(), hosted.clone());
        Ok(hosted)
    }

    /// Hosts a dataset no longer, and tells those who watch it. Who has its source can go on
    /// reading from it. `None` if there is no such dataset.
    pub fn remove(&self, name: &str) -> Option<Arc<Hosted>> {
        let mut all = self.hosted.write().unwrap_or_else(PoisonError::into_inner);
        let hosted = all.remove(name)?;
        hosted.stand.send_modify(|stand| stand.hosted = false);
        Some(hosted)
    }

    /// The dataset of this name.
    pub fn get(&self, name: &str) -> Option<Arc<Hosted>> {
        self.read(|all| all.get(name).cloned())
    }

    /// The dataset that a Hello means: by its name or, if that is empty, the only one.
    pub fn meant(&self, name: &str) -> Option<Arc<Hosted>> {
        self.read(|all| match name {
            "" if all.len() == 1 => all.values().next().cloned(),
            _ => all.get(name).cloned(),
        })
    }

    /// All, sorted by name.
    pub fn all(&self) -> Vec<Arc<Hosted>> {
        self.read(|all| all.values().cloned().collect())
    }

    /// The names, sorted.
    pub fn names(&self) -> Vec<String> {
        self.read(|all| all.keys().cloned().collect())
    }

    fn read<T>(&self, read: impl FnOnce(&BTreeMap<String, Arc<Hosted>>) -> T) -> T {
        // Nothing is left half done under this lock.
        read(&self.hosted.read().unwrap_or_else(PoisonError::into_inner))
    }
}

/// A dataset by its name, in the generation that is current.
pub struct Hosted {
    name: String,
    stand: watch::Sender<Stand>,
    /// Files whose damage was logged.
    reported: Arc<Mutex<BTreeSet<PathBuf>>>,
}

/// What is hosted under a name.
#[derive(Clone)]
pub struct Stand {
    /// The current generation.
    pub published: Arc<Published>,
    /// False when the dataset is hosted no longer.
    pub hosted: bool,
}

impl Hosted {
    fn new(name: &str, source: Arc<dyn PageSource>) -> Hosted {
        let reported = Arc::default();
        let source = Reporting::over(source, name, &reported);
        let stand = Stand {
            published: Arc::new(Published::new(source)),
            hosted: true,
        };
        Hosted {
            name: name.into(),
            stand: watch::Sender::new(stand),
            reported,
        }
    }

    /// Its name, the last part of its address.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The current generation. Whoever holds it can read it for as long as it likes.
    pub fn source(&self) -> Arc<dyn PageSource> {
        self.published().source().clone()
    }

    /// The current generation, to select from.
    pub fn published(&self) -> Arc<Published> {
        self.stand.borrow().published.clone()
    }

    /// Takes a new generation live, and tells all who watch.
    pub fn publish(&self, source: Arc<dyn PageSource>) {
        // Files of this generation may have the names of old ones.
        let mut reported = self.reported.lock().unwrap_or_else(PoisonError::into_inner);
        reported.clear();
        drop(reported);
        let source = Reporting::over(source, &self.name, &self.reported);
        let published = Arc::new(Published::new(source));
        self.stand.send_modify(|stand| stand.published = published);
    }

    /// Tells of every new generation, and of the dataset's end.
    pub fn subscribe(&self) -> watch::Receiver<Stand> {
        self.stand.subscribe()
    }
}

/// A source, and the log of which of its files are damaged: once a file, however often its pages
/// are asked for.
struct Reporting {
    source: Arc<dyn PageSource>,
    name: String,
    reported: Arc<Mutex<BTreeSet<PathBuf>>>,
}

impl Reporting {
    fn over(
        source: Arc<dyn PageSource>,
        name: &str,
        reported: &Arc<Mutex<BTreeSet<PathBuf>>>,
    ) -> Arc<dyn PageSource> {
        Arc::new(Reporting {
            source,
            name: name.into(),
            reported: reported.clone(),
        })
    }

    fn noted<T>(&self, result: Result<T, SourceError>) -> Result<T, SourceError> {
        let (Err(SourceError::Damaged { file, .. }) | Err(SourceError::Read { file, .. })) =
            &result
        else {
            return result;
        };
        if let Some(error) = result.as_ref().err().filter(|_| self.is_first(file)) {
            tracing::error!(
                dataset = self.name, file = %file.display(), %error,
                "pages of this file cannot be sent; restore it, or build the dataset again"
            );
        }
        result
    }

    fn is_first(&self, file: &Path) -> bool {
        let mut reported = self.reported.lock().unwrap_or_else(PoisonError::into_inner);
        // As many as a dataset has files.
        reported.insert(file.to_path_buf())
    }
}

impl PageSource for Reporting {
    fn manifest(&self) -> &Manifest {
        self.source.manifest()
    }

    fn manifest_json(&self) -> &[u8] {
        self.source.manifest_json()
    }

    fn generation_id(&self) -> GenerationId {
        self.source.generation_id()
    }

    fn record(&self, page: PageId) -> Result<Option<Revised>, SourceError> {
        self.noted(self.source.record(page))
    }

    fn revision(&self, page: PageId) -> Result<Option<u32>, SourceError> {
        self.noted(self.source.revision(page))
    }

    fn pack(&self, parent: PageId) -> Result<Option<Pack>, SourceError> {
        self.noted(self.source.pack(parent))
    }

    fn record_at_once(&self, page: PageId) -> AtOnce<Revised> {
        let found = self.source.record_at_once(page)?;
        Some(self.noted(found))
    }

    fn pack_at_once(&self, parent: PageId) -> AtOnce<Pack> {
        let found = self.source.pack_at_once(parent)?;
        Some(self.noted(found))
    }
}

/// A name as it stands in an address: whatever is not plain is percent-encoded.
pub fn percent_encoded(name: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-._~".contains(&byte);
    name.bytes()
        .map(|byte| match plain(byte) {
            true => char::from(byte).to_string(),
            false => format!("%{byte:02X}"),
        })
        .collect()
}

/// A part of an address as a name; `None` if it is not UTF-8.
pub fn percent_decoded(text: &str) -> Option<Cow<'_, str>> {
    if !text.contains('%') {
        return Some(text.into());
    }
    let digit = |byte: Option<&u8>| char::from(*byte?).to_digit(16);
    let bytes = text.as_bytes();
    let mut decoded = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while let Some(&byte) = bytes.get(at) {
        let pair = digit(bytes.get(at + 1)).zip(digit(bytes.get(at + 2)));
        let coded = pair.filter(|_| byte == b'%');
        decoded.push(coded.map_or(byte, |(high, low)| (high * 16 + low) as u8));
        at += if coded.is_some() { 3 } else { 1 };
    }
    String::from_utf8(decoded).ok().map(Cow::Owned)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::fake::FakeSource;

    fn catalog(names: &[&str]) -> Catalog {
        let catalog = Catalog::default();
        for name in names {
            catalog.add(name, FakeSource::shared()).unwrap();
        }
        catalog
    }

    fn meant(catalog: &Catalog, name: &str) -> Option<String> {
        catalog.meant(name).map(|found| found.name().to_owned())
    }

    #[test]
    fn an_empty_name_means_the_only_dataset() {
        let two = catalog(&["moon", "mars"]);
        assert_eq!(meant(&catalog(&["moon"]), ""), Some("moon".into()));
        assert_eq!(meant(&two, ""), None);
        assert_eq!(meant(&catalog(&[]), ""), None);
        assert_eq!(meant(&two, "mars"), Some("mars".into()));
    }

    #[test]
    fn a_name_is_added_once_and_only_if_it_can_stand_in_an_address() {
        let catalog = catalog(&["moon"]);
        let refused = |name: &str| catalog.add(name, FakeSource::shared()).err();
        assert_eq!(refused("moon"), Some(CatalogError::Twice("moon".into())));
        let long = "n".repeat(MAX_NAME + 1);
        for name in [
            "", "a/b", "session", "datasets", "healthz", "..", "a\nb", &long,
        ] {
            assert_eq!(refused(name), Some(CatalogError::Name(name.into())));
        }
    }

    #[test]
    fn a_new_generation_reaches_who_watches_and_the_old_one_goes_with_its_last_reader() {
        let catalog = catalog(&["moon"]);
        let hosted = catalog.get("moon").unwrap();
        let old = Arc::new(FakeSource::new());
        hosted.publish(old.clone());
        let mut watched = hosted.subscribe();
        let read = hosted.source();
        assert!(!watched.has_changed().unwrap());
        hosted.publish(Arc::new(FakeSource::of_generation(4)));
        assert!(watched.has_changed().unwrap());
        let stand = watched.borrow_and_update().clone();
        assert_eq!(
            (
                stand.published.source().generation_id().generation,
                stand.hosted
            ),
            (4, true)
        );
        assert_eq!(read.generation_id(), old.generation_id());
        assert_eq!(Arc::strong_count(&old), 2);
        drop(read);
        assert_eq!(Arc::strong_count(&old), 1);
    }

    #[test]
    fn a_dataset_that_is_removed_says_so_and_its_name_can_be_given_again() {
        let catalog = catalog(&["moon"]);
        let hosted = catalog.get("moon").unwrap();
        let watched = hosted.subscribe();
        assert!(catalog.remove("moon").is_some() && catalog.remove("moon").is_none());
        assert!(!watched.borrow().hosted && catalog.get("moon").is_none());
        catalog.add("moon", FakeSource::shared()).unwrap();
        assert!(catalog.get("moon").unwrap().subscribe().borrow().hosted);
    }

    #[test]
    fn a_damaged_file_is_noted_once_a_generation() {
        let catalog = catalog(&["moon"]);
        let hosted = catalog.get("moon").unwrap();
        let noted = || hosted.reported.lock().unwrap().len();
        let damaged = PageId::new(4, 14, 0).unwrap();
        let source = hosted.source();
        assert!(source.record(PageId::ROOT).is_ok() && noted() == 0);
        for _ in 0..3 {
            assert!(source.record(damaged).is_err());
            assert_eq!(noted(), 1);
        }
        hosted.publish(FakeSource::shared());
        assert_eq!(noted(), 0);
    }

    #[test]
    fn odd_names_are_percent_encoded() {
        assert_eq!(percent_encoded("Grüße 1"), "Gr%C3%BC%C3%9Fe%201");
        for name in ["Grüße 1", "moon", "50%", "%41", "%"] {
            let there = percent_encoded(name);
            assert_eq!(percent_decoded(&there).as_deref(), Some(name));
        }
        assert_eq!(percent_decoded("a%4x%").as_deref(), Some("a%4x%"));
        assert_eq!(percent_decoded("%ff"), None);
    }
}
