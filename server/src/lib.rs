//! Escarp's server: hosts datasets over HTTP and over sessions of the streaming protocol
//! (`proto/PROTOCOL.md`).
//!
//! [`session`] is the protocol's core. It has no sockets, threads or clock: a test can drive it
//! under virtual time. Everything else carries its messages and answers HTTP. In reading order:

pub mod limits;

pub mod source;

pub mod catalog;

pub mod sketches;

pub mod session;

pub mod native;

pub mod dataset;

mod http;

mod socket;

mod stall;

mod serve;

pub mod cli;

#[cfg(test)]
mod tests;

pub use catalog::{Catalog, CatalogError};
pub use limits::Limits;
pub use serve::serve;
pub use session::Session;
pub use sketches::Sketches;
pub use source::{PageSource, SourceError};
