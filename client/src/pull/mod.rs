//! `pull`: a region of a served dataset, at a chosen error, as a dataset of one's own.
//!
//! # What is taken
//!
//! ```text
//! server's grid            taken, level by level          the new dataset
//! +--------------+         a page is stored if what       +-------+
//! |   +-----+    |         its parent knows of it may     |. . . .|  below the other slots
//! |   |  R  |    |   --->  be further than the error  --> |. . : :|  the surface is what
//! |   +-----+    |         from what its corners imply    |. . : :|  their corners imply
//! +--------------+                                        +-------+
//! ```
//!
//! A page that is not taken becomes what its corners imply, as a cut slot of `tiles/FORMAT.md`
//! says. Heights on the side that it shares with a page that is taken become what the side's ends
//! imply, so that both have the same; no rule of mesh or bounds knows of it.
//!
//! # What it promises
//!
//! Let `M` be the error in quanta, rounded down. By induction from the coarse levels on, no height
//! that is kept is more than `M` from the server's, and no surface that is implied either:
//!
//! - a slot says that the surface is within `e` of its cell's two triangles. With corners moved by
//!   at most `d`, and `n` levels below of which each rounds by less than a quantum, the implied
//!   surface is within `e + d + n` of the server's. Its page is left out only if that is at most
//!   `M` ([`plan`]);
//! - a height that is moved lies on the side of such a page, and so within its `e + d + n`.
//!
//! All in integers, and rounded up. Outside of the region there are holes: every height that there
//! is keeps the error.

mod build;
mod error;
mod fetch;
mod frame;
mod plan;
mod run;
mod spool;

pub use error::PullError;
pub use frame::{Bounds, Region};
pub use run::{Progress, PullOptions, PullReport, pull};
