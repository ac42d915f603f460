//! The datasets that a server hosts, by name.

use crate::source::PageSource;
use std::collections::BTreeMap;
use std::sync::Arc;
use thiserror::Error;

/// Longest name of a dataset, bytes.
pub const MAX_NAME: usize = 128;
/// First parts of the server's own addresses, which no dataset may take.
pub const RESERVED: [&str; 5] = ["datasets", "healthz", "metrics", "readyz", "session"];

/// Named datasets.
#[derive(Clone, Default)]
pub struct Catalog {
    sources: BTreeMap<String, Arc<dyn PageSource>>,
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
    pub fn add(&mut self, name: &str, source: Arc<dyn PageSource>) -> Result<(), CatalogError> {
        let usable = (1..=MAX_NAME).contains(&name.len())
            && !name.starts_with('.')
            && !name.contains(|c: char| c == '/' || c.is_control())
            && !RESERVED.contains(&name);
        if !usable {
            return Err(CatalogError::Name(name.into()));
        }
        if self.sources.contains_key(name) {
            return Err(CatalogError::Twice(name.into()));
        }
        self.sources.insert(name.into(), source);
        Ok(())
    }

    /// The dataset of this name.
    pub fn get(&self, name: &str) -> Option<&Arc<dyn PageSource>> {
        self.sources.get(name)
    }

    /// The dataset that a Hello means: by its name or, if that is empty, the only one.
    pub fn meant(&self, name: &str) -> Option<(&str, &Arc<dyn PageSource>)> {
        let named = self.sources.get_key_value(name);
        let only = || {
            self.sources
                .first_key_value()
                .filter(|_| self.sources.len() == 1)
        };
        let (name, source) = if name.is_empty() { only() } else { named }?;
        Some((name, source))
    }

    /// All, sorted by name.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Arc<dyn PageSource>)> {
        self.sources
            .iter()
            .map(|(name, source)| (name.as_str(), source))
    }

    /// The names, sorted.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.sources.keys().map(String::as_str)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::fake::FakeSource;

    fn catalog(names: &[&str]) -> Catalog {
        let mut catalog = Catalog::default();
        for name in names {
            catalog.add(name, FakeSource::shared()).unwrap();
        }
        catalog
    }

    #[test]
    fn an_empty_name_means_the_only_dataset() {
        assert_eq!(
            catalog(&["moon"]).meant("").map(|found| found.0),
            Some("moon")
        );
        assert!(catalog(&["moon", "mars"]).meant("").is_none());
        assert!(catalog(&[]).meant("").is_none());
        assert_eq!(
            catalog(&["moon", "mars"])
                .meant("mars")
                .map(|found| found.0),
            Some("mars")
        );
    }

    #[test]
    fn a_name_is_added_once_and_only_if_it_can_stand_in_an_address() {
        let mut catalog = catalog(&["moon"]);
        let add = |catalog: &mut Catalog, name: &str| catalog.add(name, FakeSource::shared());
        assert_eq!(
            add(&mut catalog, "moon"),
            Err(CatalogError::Twice("moon".into()))
        );
        let long = "n".repeat(MAX_NAME + 1);
        for name in [
            "", "a/b", "session", "datasets", "healthz", "..", "a\nb", &long,
        ] {
            assert_eq!(
                add(&mut catalog, name),
                Err(CatalogError::Name(name.into()))
            );
        }
    }

    #[test]
    fn odd_names_are_percent_encoded() {
        assert_eq!(percent_encoded("Grüße 1"), "Gr%C3%BC%C3%9Fe%201");
    }
}
