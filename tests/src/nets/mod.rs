//! Measurements with the real server and real clients: over lines of given delay, bandwidth and
//! loss, and under load. In reading order:

pub mod shaper;

pub mod relay;

pub mod lab;

pub mod places;

pub mod watch;

pub mod http;

pub mod tiles;

pub mod client;

pub mod server;

pub mod figures;

pub mod convergence;

pub mod show;

pub mod cli;

pub mod process;

pub mod script;

pub mod talk;

pub mod crowd;

pub mod load;

pub mod soak;

pub mod fly;

pub mod cancel;

pub mod renew;
