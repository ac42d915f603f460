//! What the whole-system tests share: datasets made from functions, DEM files, a feed of pages
//! without a network, servers honest and lying, programs, naive measurements of a mesh, the
//! table of stiff and extreme cases, and the simulation of servers and clients.

pub mod terrain;

pub mod inputs;

pub mod files;

pub mod feed;

pub mod selected;

pub mod measure;

pub mod displayed;

pub mod host;

pub mod drive;

pub mod carried;

pub mod liar;

pub mod raw;

pub mod programs;

pub mod nginx;

pub mod load;

pub mod peers;

pub mod nets;

pub mod report;

pub mod stability;

pub mod sim;
