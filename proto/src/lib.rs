//! What server and client of Escarp agree on: the geometry of the grid, pages and their error
//! bounds, the view and its tests, which pages it takes, the manifest, and the messages of the
//! protocol.
//!
//! Nothing here does I/O or knows the time. In reading order:

pub mod geometry;

pub mod err8;

pub mod bytes;

pub mod page;

pub mod georef;

pub mod manifest;

pub mod view;

pub mod sight;

pub mod select;

pub mod wire;
