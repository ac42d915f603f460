//! By which names the server may be addressed.
//!
//! A web page of any site can have its name lead to 127.0.0.1 after it was loaded (DNS rebinding);
//! to the browser, what listens there is then the page's own server, and neither CORS nor an Origin
//! header stands in between. What stays is the Host header, which has the name of that site. An
//! address cannot be led elsewhere, and `localhost` is the browser's own (RFC 6761, section 6.3).

use axum::http::{HeaderMap, header};
use std::net::IpAddr;
use thiserror::Error;

/// Names that a request may have in its Host header.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum Hosts {
    /// All of them.
    #[default]
    Any,
    /// These; also `localhost`, names below it, and every address.
    List(Vec<String>),
}

/// What cannot be the name of a host.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("the host {0:?}; allowed are `*`, and names without a port, such as terrain.example")]
pub struct HostError(String);

impl Hosts {
    /// Only what leads to this machine whoever says it.
    pub fn local() -> Hosts {
        Hosts::List(Vec::new())
    }

    /// From a configuration.
    ///
    /// # Errors
    /// [`HostError`] for the first that is none.
    pub fn parse<S: AsRef<str>>(texts: &[S]) -> Result<Hosts, HostError> {
        let mut list = Vec::new();
        for text in texts.iter().map(AsRef::as_ref) {
            let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-._".contains(&byte);
            match text {
                "*" => return Ok(Hosts::Any),
                text if !text.is_empty() && text.bytes().all(plain) => list.push(text.into()),
                text => return Err(HostError(text.into())),
            }
        }
        Ok(Hosts::List(list))
    }

    /// Whether a request with this header may be answered. One without a Host comes from no
    /// browser.
    pub(super) fn allow(&self, headers: &HeaderMap) -> bool {
        let Hosts::List(list) = self else {
            return true;
        };
        let Some(host) = headers.get(header::HOST) else {
            return true;
        };
        host.to_str()
            .is_ok_and(|host| is_local(name(host)) || has(list, name(host)))
    }
}

/// Without the port, the brackets of an IPv6 address, and the dot that may end a name.
fn name(host: &str) -> &str {
    if let Some(rest) = host.strip_prefix('[') {
        let (address, port) = rest.split_once(']').unwrap_or_default();
        return if port.is_empty() || port.starts_with(':') {
            address
        } else {
            ""
        };
    }
    let name = host.rsplit_once(':').map_or(host, |(name, _)| name);
    name.strip_suffix('.').unwrap_or(name)
}

fn is_local(name: &str) -> bool {
    let end = name.len().checked_sub("localhost".len());
    let (below, end) = match end.and_then(|end| name.split_at_checked(end)) {
        Some((below, end)) => (below, end),
        None => ("", ""),
    };
    let localhost = end.eq_ignore_ascii_case("localhost");
    localhost && (below.is_empty() || below.ends_with('.')) || name.parse::<IpAddr>().is_ok()
}

fn has(list: &[String], name: &str) -> bool {
    list.iter().any(|one| one.eq_ignore_ascii_case(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn allows(hosts: &Hosts, host: &'static str) -> bool {
        let host = axum::http::HeaderValue::from_static(host);
        hosts.allow(&HeaderMap::from_iter([(header::HOST, host)]))
    }

    #[test]
    fn what_leads_to_this_machine_is_allowed_and_a_name_only_if_it_is_listed() {
        let local = Hosts::local();
        let listed = Hosts::parse(&["Terrain.example"]).unwrap();
        for host in [
            "localhost",
            "LOCALHOST:8787",
            "a.localhost:1",
            "localhost.:1",
            "127.0.0.1:8787",
            "10.1.2.3",
            "[::1]:8787",
            "[::1]",
        ] {
            assert!(allows(&local, host) && allows(&listed, host), "{host}");
        }
        for host in [
            "evil.example",
            "evil.example:8787",
            "localhost.evil.example",
            "notlocalhost",
            "127.0.0.1.evil.example",
            "",
            ":8787",
            "[::1].evil.example",
            "xlocalhost:1",
        ] {
            assert!(!allows(&local, host) && !allows(&listed, host), "{host}");
        }
        assert!(allows(&listed, "terrain.EXAMPLE:443") && !allows(&listed, "x.terrain.example"));
        assert!(allows(&Hosts::Any, "evil.example") && local.allow(&HeaderMap::new()));
    }

    #[test]
    fn a_name_of_a_host_has_no_port_scheme_or_star_in_it() {
        assert_eq!(Hosts::parse(&["a", "*"]), Ok(Hosts::Any));
        for wrong in ["", "a:1", "http://a", "*.a", "a/b", "a b"] {
            let error = Hosts::parse(&[wrong]).unwrap_err().to_string();
            assert!(error.contains("allowed are"), "{error}");
        }
    }
}
