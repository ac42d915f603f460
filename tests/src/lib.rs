//! What the whole-system tests share: datasets made from functions, a feed of pages without a
//! network, and naive measurements of a mesh.

pub mod feed;
pub mod measure;
pub mod terrain;
