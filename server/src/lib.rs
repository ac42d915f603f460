//! Escarp's server: hosts datasets over HTTP and over sessions of the streaming protocol
//! (`proto/PROTOCOL.md`).
//!
//! [`session`] is the protocol's core. It has no sockets, threads or clock: a test can drive it
//! under virtual time. Everything else carries its messages and answers HTTP. In reading order:

pub mod limits;

pub mod metrics;

pub mod access;

pub mod source;

pub mod catalog;

mod published;

pub mod sketches;

pub mod session;

pub mod native;

pub mod dataset;

pub mod heights;

pub mod watch;

mod http;

mod socket;

mod stall;

pub mod tls;

mod health;

mod serve;

pub mod config;

pub mod cli;

#[cfg(test)]
mod tests;

pub use access::Access;
pub use catalog::{Catalog, CatalogError, Hosted};
pub use limits::Limits;
pub use published::Published;
pub use serve::{Serving, serve};
pub use session::Session;
pub use sketches::Sketches;
pub use source::{PageSource, SourceError};
