//! Addresses of datasets.

use super::Credentials;
use escarp_proto::wire::MAX_TEXT;
use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// The server's usual port, for addresses without scheme and port.
pub const DEFAULT_PORT: u16 = 8787;
/// What an address looks like.
const ALLOWED: &str = "http://HOST:PORT/NAME, or https://";

/// The address of a dataset on a server: `http://HOST:PORT/NAME`, `ws://HOST:PORT/NAME`, or
/// `HOST:PORT/NAME`; over TLS `https://` or `wss://`. Without a port, that of the scheme is meant,
/// 80 or 443, and without a scheme [`DEFAULT_PORT`]. NAME is
/// percent-encoded UTF-8; left out, the only dataset of the server is meant.
///
/// ```
/// # use escarp_client::net::Url;
/// let url: Url = "http://127.0.0.1:8787/south%20pole".parse().unwrap();
/// assert_eq!(url.dataset(), Some("south pole"));
/// assert!("http://127.0.0.1:8787/a/b".parse::<Url>().is_err()); // one name only
/// assert!("ftp://127.0.0.1/moon".parse::<Url>().is_err()); // HTTP and WebSocket only
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Url {
    secure: bool,
    host: String,
    port: u16,
    dataset: Option<String>,
    credentials: Credentials,
}

/// Why an address was refused.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("the address \"{url}\" {what}, allowed is {ALLOWED}")]
pub struct UrlError {
    url: String,
    what: String,
}

impl Url {
    /// The same with what is needed to be let in; it is not shown with the address.
    #[must_use]
    pub fn with_credentials(mut self, credentials: Credentials) -> Url {
        self.credentials = credentials;
        self
    }

    /// What is needed to be let in.
    pub const fn credentials(&self) -> &Credentials {
        &self.credentials
    }

    /// Whether the server is reached over TLS.
    pub const fn is_secure(&self) -> bool {
        self.secure
    }

    /// Name or IP address of the server; an IPv6 address without its brackets.
    pub fn host(&self) -> &str {
        &self.host
    }

    /// Port of the server.
    pub const fn port(&self) -> u16 {
        self.port
    }

    /// Name of the dataset, decoded; `None` if the address has none.
    pub fn dataset(&self) -> Option<&str> {
        self.dataset.as_deref()
    }

    /// `HOST:PORT`, an IPv6 address in brackets.
    pub fn authority(&self) -> String {
        let Url { host, port, .. } = self;
        if host.contains(':') {
            format!("[{host}]:{port}")
        } else {
            format!("{host}:{port}")
        }
    }

    /// Where the server takes sessions.
    pub fn session(&self) -> String {
        let scheme = if self.secure { "wss" } else { "ws" };
        format!("{scheme}://{}/session", self.authority())
    }
}

impl fmt::Display for Url {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = if self.secure { "https" } else { "http" };
        write!(f, "{scheme}://{}/", self.authority())?;
        for byte in self.dataset.iter().flat_map(|name| name.bytes()) {
            match byte {
                b'A'..=b'Z' | b'a'..=b'z' | b'0'..=b'9' | b'-' | b'.' | b'_' | b'~' => {
                    write!(f, "{}", byte as char)?;
                }
                _ => write!(f, "%{byte:02X}")?,
            }
        }
        Ok(())
    }
}

impl FromStr for Url {
    type Err = UrlError;

    fn from_str(url: &str) -> Result<Url, UrlError> {
        parse(url.trim()).map_err(|what| UrlError {
            url: url
                .trim()
                .chars()
                .take(200)
                .flat_map(char::escape_debug)
                .collect(),
            what,
        })
    }
}

fn parse(url: &str) -> Result<Url, String> {
    let (secure, default_port, rest) = scheme(url)?;
    let (authority, path) = rest.split_once('/').unwrap_or((rest, ""));
    let (host, port) = host_and_port(authority, default_port)?;
    let dataset = dataset(path)?;
    Ok(Url {
        secure,
        host,
        port,
        dataset,
        credentials: Credentials::default(),
    })
}

/// Whether the scheme is one of TLS, its default port, and what follows it.
fn scheme(url: &str) -> Result<(bool, u16, &str), String> {
    let Some((scheme, rest)) = url.split_once("://") else {
        return Ok((false, DEFAULT_PORT, url));
    };
    match scheme.to_ascii_lowercase().as_str() {
        "http" | "ws" => Ok((false, 80, rest)),
        "https" | "wss" => Ok((true, 443, rest)),
        _ => Err(format!("has the scheme \"{scheme}\"")),
    }
}

fn host_and_port(authority: &str, default_port: u16) -> Result<(String, u16), String> {
    if authority.contains('@') {
        return Err("has a user name".into());
    }
    let (host, port) = match authority.strip_prefix('[') {
        Some(v6) => {
            let (host, after) = v6.split_once(']').ok_or("has a \"[\" without \"]\"")?;
            host.parse::<std::net::Ipv6Addr>()
                .map_err(|error| format!("has the host [{host}]: {error}"))?;
            (host, after)
        }
        None => authority.split_at(authority.find(':').unwrap_or(authority.len())),
    };
    check_host(host)?;
    Ok((host.to_owned(), parse_port(port, default_port)?))
}

fn check_host(host: &str) -> Result<(), String> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || "-._:".contains(c);
    match host.chars().find(|&c| !allowed(c)) {
        _ if host.is_empty() => Err("has no host".into()),
        Some(c) => Err(format!("has {c:?} in its host")),
        None => Ok(()),
    }
}

/// Of what follows the host: nothing, or `:PORT`.
fn parse_port(text: &str, default_port: u16) -> Result<u16, String> {
    if text.is_empty() {
        return Ok(default_port);
    }
    let digits = text
        .strip_prefix(':')
        .filter(|d| d.bytes().all(|b| b.is_ascii_digit()));
    match digits.and_then(|digits| digits.parse().ok()) {
        None | Some(0) => Err(format!("has {text:?} for a port; a port is 1 to 65535")),
        Some(port) => Ok(port),
    }
}

fn dataset(path: &str) -> Result<Option<String>, String> {
    let name = path.strip_suffix('/').unwrap_or(path);
    if let Some(c) = name.chars().find(|c| "?#/".contains(*c)) {
        return Err(format!("has {c:?} in its NAME"));
    }
    let name = percent_decoded(name)?;
    match name.chars().find(|c| c.is_control()) {
        Some(c) => Err(format!("has {c:?} in its NAME")),
        None if name.len() > MAX_TEXT => Err(format!(
            "has a NAME of {} bytes, at most {MAX_TEXT} may be",
            name.len()
        )),
        None => Ok((!name.is_empty()).then_some(name)),
    }
}

fn percent_decoded(text: &str) -> Result<String, String> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        if byte != b'%' {
            bytes.push(byte);
            continue;
        }
        let mut digit = || rest.next().and_then(|b| (b as char).to_digit(16));
        match (digit(), digit()) {
            (Some(high), Some(low)) => bytes.push((high * 16 + low) as u8),
            _ => return Err("has a \"%\" without two hexadecimal digits".into()),
        }
    }
    String::from_utf8(bytes).map_err(|_| "has a NAME that is not UTF-8".into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parts(url: &str) -> (String, u16, Option<String>) {
        let url: Url = url.parse().unwrap();
        (url.host, url.port, url.dataset)
    }

    #[test]
    fn every_allowed_form_is_understood() {
        let moon = |port| ("moon.example".to_owned(), port, Some("lola".to_owned()));
        assert_eq!(parts("http://moon.example:8787/lola"), moon(8787));
        assert_eq!(parts("WS://moon.example:1/lola/"), moon(1));
        assert_eq!(parts(" http://moon.example/lola\n"), moon(80));
        assert_eq!(parts("moon.example:99/lola"), moon(99));
        assert_eq!(parts("moon.example/lola"), moon(DEFAULT_PORT));
        assert_eq!(
            parts("[::1]:99/a%2Fb"),
            ("::1".into(), 99, Some("a/b".into()))
        );
        assert_eq!(parts("http://h:1/"), ("h".into(), 1, None));
        assert_eq!(parts("h"), ("h".into(), DEFAULT_PORT, None));
        assert_eq!(parts("https://moon.example/lola"), moon(443));
        assert_eq!(parts("wss://moon.example:8787/lola"), moon(8787));
        let secure: Url = "wss://h/n".parse().unwrap();
        assert_eq!(secure.session(), "wss://h:443/session");
        assert_eq!(secure.to_string(), "https://h:443/n");
        let v6: Url = "[::1]:99/n".parse().unwrap();
        assert_eq!(v6.session(), "ws://[::1]:99/session");
    }

    #[test]
    fn a_wrong_address_is_told_with_what_was_found() {
        let cases = [
            ("ftp://h/n", "has the scheme \"ftp\""),
            ("", "has no host"),
            ("http:///n", "has no host"),
            ("http://:80/n", "has no host"),
            ("http://u:p@h/n", "has a user name"),
            ("http://a b/n", "has ' ' in its host"),
            ("http://[::1/n", "has a \"[\" without \"]\""),
            (
                "http://[::x]/n",
                "has the host [::x]: invalid IPv6 address syntax",
            ),
            ("h:/n", "has \":\" for a port; a port is 1 to 65535"),
            ("h:0/n", "has \":0\" for a port; a port is 1 to 65535"),
            (
                "h:65536/n",
                "has \":65536\" for a port; a port is 1 to 65535",
            ),
            ("h:+1/n", "has \":+1\" for a port; a port is 1 to 65535"),
            ("h:1:2/n", "has \":1:2\" for a port; a port is 1 to 65535"),
            ("h:1/a/b", "has '/' in its NAME"),
            ("h:1/a?b", "has '?' in its NAME"),
            ("h:1/a%2", "has a \"%\" without two hexadecimal digits"),
            ("h:1/a%+1", "has a \"%\" without two hexadecimal digits"),
            ("h:1/%ff", "has a NAME that is not UTF-8"),
            ("h:1/%00", "has '\\0' in its NAME"),
        ];
        for (url, what) in cases {
            let error = url.parse::<Url>().unwrap_err().to_string();
            let whole = format!("the address \"{url}\" {what}, allowed is {ALLOWED}");
            assert_eq!(error, whole);
        }
    }

    proptest! {
        #[test]
        fn what_is_shown_is_understood_again(name in "[^/\\pC]{1,40}", port in 1u16.., secure: bool) {
            let credentials = Credentials::default();
            let url = Url { secure, host: "h".into(), port, dataset: Some(name), credentials };
            prop_assert_eq!(url.to_string().parse::<Url>(), Ok(url));
        }

        #[test]
        fn any_text_is_an_address_or_refused(text: String) {
            let _ = text.parse::<Url>();
        }
    }
}
