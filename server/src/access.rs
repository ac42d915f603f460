//! Who may see which dataset, from which web page, and how often one address may ask.
//!
//! A dataset that no rule with tokens names is open to all. One that is named is hidden from
//! whoever does not bring one of its tokens: not listed, not described, not streamed. What is
//! answered depends on the name and the rules alone, never on whether there is such a dataset.

mod address;
mod caller;
mod guard;
mod host;
mod origin;
mod rates;
mod token;

#[cfg(test)]
mod tests;

pub use address::{Address, Proxies, ProxyError};
pub use caller::Caller;
pub use host::{HostError, Hosts};
pub use origin::{OriginError, Origins};
pub use rates::{Place, Rates};
pub use token::{Token, TokenError};

pub(crate) use guard::{Gate, Peer, guard, too_many};

/// What one rule says about the datasets whose names fit its pattern.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rule {
    /// A dataset's name; `*` stands for any characters.
    pub datasets: String,
    /// Any of these opens them. `None`: the rule asks for none; an empty list lets nobody in.
    pub tokens: Option<Vec<Token>>,
    /// The web pages that may use them. `None`: see [`Access::origins`].
    pub origins: Option<Origins>,
}

/// All rules.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Access {
    /// Their order does not matter.
    pub rules: Vec<Rule>,
    /// The web pages that may use datasets without tokens for which no rule has origins. Datasets
    /// with tokens may then be used by pages of this server alone.
    pub origins: Origins,
    /// The names by which the server may be addressed.
    pub hosts: Hosts,
}

/// Why something was not granted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Denied {
    /// A token is needed, and there was none.
    NoToken,
    /// The token is none of those that open the dataset.
    WrongToken,
    /// The web page that asks comes from elsewhere.
    Origin,
}

impl Access {
    /// Whether a token, or none, opens a dataset.
    pub fn allows(&self, dataset: &str, token: Option<&str>) -> bool {
        self.opens(dataset, token.map(Token::of).as_ref()).is_ok()
    }

    /// As [`allows`](Self::allows), with the token's hash, and the reason.
    fn opens(&self, dataset: &str, token: Option<&Token>) -> Result<(), Denied> {
        if !self.needs_token(dataset) {
            return Ok(());
        }
        let given = token.ok_or(Denied::NoToken)?;
        let known = self.rules_of(dataset).flat_map(|rule| rule.tokens.iter());
        match token::is_among(given, known.flatten()) {
            true => Ok(()),
            false => Err(Denied::WrongToken),
        }
    }

    /// Whether a dataset of this name needs a token.
    pub fn needs_token(&self, dataset: &str) -> bool {
        self.rules_of(dataset).any(|rule| rule.tokens.is_some())
    }

    /// Whether everything is open to everyone, from every web page.
    fn is_open(&self) -> bool {
        self.rules.is_empty() && self.origins == Origins::default()
    }

    /// The web pages that may use a dataset: those of all its rules together.
    fn origins_of(&self, dataset: &str) -> Origins {
        let named = self
            .rules_of(dataset)
            .filter_map(|rule| rule.origins.as_ref());
        named
            .cloned()
            .reduce(Origins::or)
            .unwrap_or_else(|| match self.needs_token(dataset) {
                true => Origins::none(),
                false => self.origins.clone(),
            })
    }

    /// Whether pages of this origin may use any dataset.
    fn knows_origin(&self, origin: &str) -> bool {
        let named = self.rules.iter().filter_map(|rule| rule.origins.as_ref());
        self.origins.allow(origin) || named.into_iter().any(|origins| origins.allow(origin))
    }

    fn rules_of(&self, dataset: &str) -> impl Iterator<Item = &Rule> {
        let fits = |rule: &&Rule| fits(&rule.datasets, dataset);
        self.rules.iter().filter(fits)
    }
}

/// Whether a name fits a pattern, in which `*` stands for any characters, also none.
///
/// Goes back to the last `*` only, so it takes at most the product of both lengths.
fn fits(pattern: &str, name: &str) -> bool {
    let (pattern, name) = (pattern.as_bytes(), name.as_bytes());
    let (mut p, mut n) = (0, 0);
    let mut star = None;
    while n < name.len() {
        if pattern.get(p) == Some(&b'*') {
            star = Some((p, n));
            p += 1;
        } else if pattern.get(p) == Some(&name[n]) {
            (p, n) = (p + 1, n + 1);
        } else if let Some((at, from)) = star {
            star = Some((at, from + 1));
            (p, n) = (at + 1, from + 1);
        } else {
            return false;
        }
    }
    pattern[p..].iter().all(|&byte| byte == b'*')
}
