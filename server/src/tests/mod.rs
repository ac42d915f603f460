//! The server over real loopback sockets, on a fake dataset.

pub(crate) mod fake;
