//! `escarp-report`: error against run time, and all that belongs to it, measured on datasets.
//!
//! No network is in the way: pages go straight from a dataset into a mesh tree, but for the cold
//! starts, where server and client talk in virtual time. In reading order:

pub mod variant;

pub mod plan;

pub mod measure;

pub mod clock;

pub mod flight;

pub mod supply;

pub mod sweep;

pub mod pop;

pub mod leave_out;

pub mod lines;

pub mod facts;

pub mod conduct;

pub mod plot;

pub mod tables;

pub mod sections;

pub mod html;

pub mod write;

pub mod cli;
