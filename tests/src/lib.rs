//! What the whole-system tests share: datasets made from functions, DEM files, a feed of pages
//! without a network, servers honest and lying, programs, naive measurements of a mesh, and the
//! table of stiff and extreme cases.

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

pub mod programs;

pub mod peers;
pub mod report;

pub mod stability;
