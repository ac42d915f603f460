//! Other ways to a mesh of the same samples, and what they come to, measured in one way: RTIN,
//! a free TIN, and the right triangles of ours with bounds as they are or as tight as can be.

pub mod window;

pub mod right;

pub mod tin;

pub mod ours;
