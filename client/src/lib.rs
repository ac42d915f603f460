//! The thin client of Escarp. In reading order:

pub mod mesh;

pub mod governor;

pub mod stages;

mod lost;

pub mod terrain;

pub mod link;

pub mod net;

pub mod camera;

pub mod flight;

pub mod render;

pub mod app;

pub mod cache;

pub mod remote;

pub mod pull;

pub mod cli;
