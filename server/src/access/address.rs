//! The address that a request counts for.

use axum::http::HeaderMap;
use ipnet::IpNet;
use std::net::{IpAddr, Ipv4Addr};
use thiserror::Error;

/// The header in which proxies note for whom they ask, the nearest last.
const FORWARDED_FOR: &str = "x-forwarded-for";
/// Entries of it that are looked at.
const MAX_HOPS: usize = 32;

/// Whoever has an address is taken to have all of it: an IPv4 address, or an IPv6 network of 64
/// bits, which is what one customer of a provider has at least.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Address {
    /// One address.
    V4(Ipv4Addr),
    /// The first 64 bits.
    V6(u64),
}

impl Address {
    /// Of an address as the socket has it.
    pub fn of(ip: IpAddr) -> Address {
        match ip.to_canonical() {
            IpAddr::V4(ip) => Address::V4(ip),
            IpAddr::V6(ip) => Address::V6((ip.to_bits() >> 64) as u64),
        }
    }
}

/// Proxies whose word is taken for the address of their clients.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Proxies(Vec<IpNet>);

/// What is neither an address nor a network.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("the proxy {0:?}; allowed is an IP address, or a network such as 10.0.0.0/8 or fd00::/8")]
pub struct ProxyError(String);

impl Proxies {
    /// From a configuration.
    ///
    /// # Errors
    /// [`ProxyError`] for the first that is wrong.
    pub fn parse<S: AsRef<str>>(texts: &[S]) -> Result<Proxies, ProxyError> {
        let network = |text: &str| {
            let ip = || text.parse::<IpAddr>().map(IpNet::from);
            text.parse().or_else(|_| ip())
        };
        let all = texts.iter().map(|text| {
            let text = text.as_ref();
            network(text).map_err(|_| ProxyError(text.into()))
        });
        all.collect::<Result<_, _>>().map(Proxies)
    }

    /// Whether an address is that of a proxy.
    pub fn trust(&self, ip: IpAddr) -> bool {
        let ip = ip.to_canonical();
        self.0.iter().any(|network| network.contains(&ip))
    }

    /// The client of a connection's peer: what the trusted proxies say, from the nearest on, and
    /// nothing that stands before the first that is not trusted.
    pub fn client(&self, peer: IpAddr, headers: &HeaderMap) -> IpAddr {
        let mut client = peer.to_canonical();
        if self.0.is_empty() || !self.trust(client) {
            return client;
        }
        let lines = headers.get_all(FORWARDED_FOR).into_iter().rev();
        let hops = lines.flat_map(|line| line.to_str().unwrap_or("?").rsplit(','));
        for hop in hops.take(MAX_HOPS) {
            let Ok(ip) = hop.trim().parse::<IpAddr>() else {
                break;
            };
            client = ip.to_canonical();
            if !self.trust(client) {
                break;
            }
        }
        client
    }
}
