//! Which web pages may use a dataset: browsers say with a request from which origin the page is
//! that asks (RFC 6454; the Fetch Standard, section 3.2; RFC 6455, section 10.2).

use thiserror::Error;

/// Origins of web pages.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum Origins {
    /// All of them.
    #[default]
    Any,
    /// These, in lower case; also those of pages that this server itself gave.
    List(Vec<String>),
}

/// What cannot be an origin.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error(
    "the origin {0:?}; allowed are `*`, `null`, and SCHEME://HOST or SCHEME://HOST:PORT without anything after it"
)]
pub struct OriginError(String);

impl Origins {
    /// Only pages of this server.
    pub fn none() -> Origins {
        Origins::List(Vec::new())
    }

    /// From a configuration.
    ///
    /// # Errors
    /// [`OriginError`] for the first that is none.
    pub fn parse<S: AsRef<str>>(texts: &[S]) -> Result<Origins, OriginError> {
        let mut list = Vec::new();
        for text in texts.iter().map(AsRef::as_ref) {
            match text {
                "*" => return Ok(Origins::Any),
                text if is_origin(text) => list.push(text.to_ascii_lowercase()),
                text => return Err(OriginError(text.into())),
            }
        }
        Ok(Origins::List(list))
    }

    /// Whether an origin is among them.
    pub fn allow(&self, origin: &str) -> bool {
        match self {
            Origins::Any => true,
            Origins::List(list) => list.iter().any(|one| one.eq_ignore_ascii_case(origin)),
        }
    }

    /// These and others.
    pub(super) fn or(self, other: Origins) -> Origins {
        match (self, other) {
            (Origins::List(mut list), Origins::List(more)) => {
                list.extend(more);
                Origins::List(list)
            }
            _ => Origins::Any,
        }
    }
}

fn is_origin(text: &str) -> bool {
    let host = |host: &str| !host.is_empty() && !host.contains(['/', '?', '#', '@', '*']);
    let plain = text.chars().all(|c| c.is_ascii_graphic());
    let split = text.split_once("://");
    text == "null" || plain && split.is_some_and(|(scheme, rest)| !scheme.is_empty() && host(rest))
}
