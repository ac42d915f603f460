//! Heights for programs: points, profiles, lines of sight and viewsheds, from the same storage tree
//! that viewers stream. No sockets, threads or clock; what a request may cost is a [`Work`].
//!
//! **The surface** is that of the finest mesh: each cell of samples is two triangles, whose
//! diagonal is the one that every mesh tree ends with (`escarp_proto::geometry`). It is what a
//! viewer converges to; bilinear interpolation differs from it inside a cell. A triangle is there
//! if its three samples are data; where none is, there is no height.
//!
//! **The bound** that goes with a height says how far the surface of the source's own samples may
//! be from it, straight up or down: what storing and resampling them cost, as the manifest states,
//! and what a coarser level leaves out. It is rounded up. How true the source is, no dataset knows.
//!
//! In reading order:

mod work;

mod place;

mod accuracy;

mod pages;

mod surface;

mod profile;

mod walk;

mod sight;

mod window;

mod viewshed;

mod overview;

#[cfg(test)]
pub(crate) mod tests;

pub use accuracy::{Accuracy, Detail};
pub use overview::{Overview, overview};
pub use pages::Pages;
pub use place::{CoordinateKind, Frame, GridPlace};
pub use profile::{MAX_VERTICES, Profile, Spread, along};
pub use sight::{Curvature, Sight, SightEnds, Verdict, sight};
pub use surface::{Height, height_at, heights_at};
pub use viewshed::{Seen, Viewshed, ViewshedRequest, viewshed};
pub use window::{Ground, Window};
pub use work::{HeightError, HeightLimits, Work};
