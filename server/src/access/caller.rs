//! Who asks: the token and the web page of one request or session, held against the rules.

use super::{Access, Denied, Origins, Token};
use axum::http::{HeaderMap, HeaderValue, header};
use std::net::IpAddr;
use std::sync::Arc;

/// Stands in the extensions of every request.
#[derive(Debug, Clone)]
pub struct Caller {
    access: Arc<Access>,
    token: Option<Token>,
    /// Of the web page that asks, unless this server gave it.
    origin: Option<String>,
    /// The client's address, as far as it is known.
    pub(crate) address: Option<IpAddr>,
    /// Whether the client came by TLS.
    pub(crate) secure: bool,
}

impl Caller {
    /// Without token and web page.
    pub fn new(access: Arc<Access>) -> Caller {
        Caller {
            access,
            token: None,
            origin: None,
            address: None,
            secure: false,
        }
    }

    /// What the header of a request says.
    pub(super) fn of(access: Arc<Access>, headers: &HeaderMap) -> Caller {
        let text = |name| {
            headers
                .get(name)
                .and_then(|value: &HeaderValue| value.to_str().ok())
        };
        let host = text(header::HOST).unwrap_or("");
        let foreign = |origin: &&str| {
            let own = origin.split_once("://").map(|(_, own)| own);
            !own.is_some_and(|own| own.eq_ignore_ascii_case(host))
        };
        Caller {
            token: text(header::AUTHORIZATION).and_then(bearer).map(Token::of),
            origin: text(header::ORIGIN).filter(foreign).map(str::to_owned),
            ..Caller::new(access)
        }
    }

    /// The same with the token of a Hello, if it has one.
    #[must_use]
    pub fn with_token(mut self, token: Option<&str>) -> Caller {
        self.token = token.map(Token::of).or(self.token);
        self
    }

    /// Whether a dataset may be seen.
    pub fn sees(&self, dataset: &str) -> bool {
        self.opens(dataset).is_ok()
    }

    /// Whether the token, or none, opens a dataset.
    pub(super) fn opens(&self, dataset: &str) -> Result<(), Denied> {
        self.access.opens(dataset, self.token.as_ref())
    }

    /// Whether a dataset may be streamed to this caller.
    ///
    /// # Errors
    /// Why not.
    pub fn check(&self, dataset: &str) -> Result<(), Denied> {
        self.opens(dataset)?;
        match &self.origin {
            Some(origin) if !self.access.origins_of(dataset).allow(origin) => Err(Denied::Origin),
            _ => Ok(()),
        }
    }

    /// Whether a session may be begun at all; of which dataset is not known yet.
    pub(crate) fn may_connect(&self) -> bool {
        let origin = self.origin.as_ref();
        origin.is_none_or(|origin| self.access.knows_origin(origin))
    }

    /// The scheme of addresses as this caller uses them: `http` or `ws`, with an `s` over TLS.
    pub(crate) fn scheme(&self, plain: &str) -> String {
        format!("{plain}{}", if self.secure { "s" } else { "" })
    }

    /// Whether a dataset needs a token.
    pub(super) fn needs_token(&self, dataset: &str) -> bool {
        self.access.needs_token(dataset)
    }

    /// `Access-Control-Allow-Origin` for answers about a dataset, or about all of them, and
    /// whether it depends on who asks.
    pub(super) fn allowed_origin(&self, dataset: Option<&str>) -> (Option<HeaderValue>, bool) {
        let origins = match dataset {
            Some(dataset) => self.access.origins_of(dataset),
            None => self.access.origins.clone(),
        };
        match (&origins, &self.origin) {
            (Origins::Any, _) => (Some(HeaderValue::from_static("*")), false),
            (_, Some(origin)) if origins.allow(origin) => (origin.parse().ok(), true),
            _ => (None, true),
        }
    }
}

impl Default for Caller {
    /// Everything is open.
    fn default() -> Caller {
        Caller::new(Arc::default())
    }
}

/// The token of `Authorization: Bearer TOKEN` (RFC 6750, section 2.1).
fn bearer(value: &str) -> Option<&str> {
    let (scheme, token) = value.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}
