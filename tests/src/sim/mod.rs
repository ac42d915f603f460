//! Server and client under virtual time, over simulated lines: all from one seed.
//!
//! The server's sessions and whole clients ([`RemoteTerrain`](escarp_client::remote::RemoteTerrain):
//! link, terrain, governor), neither with sockets nor clock, are connected by lines with bandwidth,
//! delay, jitter and loss, which are cut at any byte. A seed decides about dataset, limits, lines
//! and clients, and about a script of what happens to them. Each frame of each client is examined,
//! and at the end, when the lines are left in peace, all must come to rest.

mod random;

mod pipe;

mod ground;

mod script;

mod net;

mod witness;

mod server;

mod client;

mod check;

mod world;

mod campaign;

pub mod cli;

pub use campaign::{Campaign, Failure, Tally};
pub use ground::Ground;
pub use script::{Act, Script};
